"""A position freed of its white noise by the velocity that was measured with it.

The field turns metres into metres per second and radians: five centimetres of noise from one measurement to
the next are more than a rover's speed and yaw rate may change between two setpoints, and the limits on change
would be busy with noise alone. The velocity, integrated, is smooth, and the position keeps it where it is: a
complementary filter, without lag on any motion that the velocity shows. An estimator that is smooth already
loses nothing by it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.se3 import ZERO, Vec3


class Parameters(NamedTuple):
    """What the velocity does not explain is taken over in `time_constant_s`, and at once beyond `jump_m`: a
    reset has its own treatment. A time constant of 0 switches it off."""

    time_constant_s: float
    jump_m: float


class Memory(NamedTuple):
    """The smooth position, world, m."""

    started: bool
    position: Vec3


UNSTARTED: Final = Memory(False, ZERO)


def smoothing_step(
    parameters: Parameters, memory: Memory, position: Vec3, velocity: Vec3, dt: float
) -> Memory:
    """`dt` s after the step before, with position and velocity over ground in the world's axes."""
    p = parameters
    if not memory.started or p.time_constant_s <= 0.0:
        return Memory(True, position)
    led = memory.position
    x, y, z = led.x + velocity.x * dt, led.y + velocity.y * dt, led.z + velocity.z * dt
    dx, dy, dz = position.x - x, position.y - y, position.z - z
    if dx * dx + dy * dy + dz * dz > p.jump_m * p.jump_m:
        return Memory(True, position)
    part = dt / (p.time_constant_s + dt)
    return Memory(True, Vec3(x + part * dx, y + part * dy, z + part * dz))
