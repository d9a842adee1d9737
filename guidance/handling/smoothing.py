"""A position freed of its white noise by the velocity that was measured with it.

The field turns metres into metres per second and radians: five centimetres of noise from one measurement to
the next are more than a rover's speed and yaw rate may change between two setpoints, and the limits on change
would be busy with noise alone. The velocity, integrated, is smooth, and the position keeps it where it is: a
complementary filter, without lag on any motion that the velocity shows. An estimator that is smooth already
loses nothing by it.

A velocity that is wrong for seconds, as PX4's estimator has it (0.5 m/s in PX4's own simulator, of 1.17;
not ArduPilot's in its own), disagrees with the positions that come with it. What of it is no noise is found
as the velocity's error: an observer of position and that error, damped by 0.7 where `error_s` is 2
`time_constant_s`.
"""

from __future__ import annotations

from math import sqrt
from typing import Final, NamedTuple

from guidance.se3 import ZERO, Vec3

#: What of a velocity is wrong for longer than this is found: shorter, and white noise becomes it.
ERROR_S: Final = 0.6


class Parameters(NamedTuple):
    """What the velocity does not explain is taken over in `time_constant_s`, and at once beyond `jump_m`: a
    reset has its own treatment. A time constant of 0 switches it off.

    The velocity's error is found over `error_s` (0: it has none), up to `error_max_m_s` (> 0 then) long.
    """

    time_constant_s: float
    jump_m: float
    error_s: float = 0.0
    error_max_m_s: float = 0.0


class Memory(NamedTuple):
    """The smooth position (m), and by how much the velocity is too large (m/s); world."""

    started: bool
    position: Vec3
    error: Vec3


UNSTARTED: Final = Memory(False, ZERO, ZERO)


def smoothing_step(
    parameters: Parameters, memory: Memory, position: Vec3, velocity: Vec3, dt: float
) -> Memory:
    """`dt` s after the step before, with position and velocity over ground in the world's axes."""
    p = parameters
    if not memory.started or p.time_constant_s <= 0.0:
        return Memory(True, position, ZERO)
    led, error = memory.position, memory.error
    x = led.x + (velocity.x - error.x) * dt
    y = led.y + (velocity.y - error.y) * dt
    z = led.z + (velocity.z - error.z) * dt
    dx, dy, dz = position.x - x, position.y - y, position.z - z
    if dx * dx + dy * dy + dz * dz > p.jump_m * p.jump_m:
        return Memory(True, position, error)
    part = dt / (p.time_constant_s + dt)
    if p.error_s > 0.0:
        gain, most = part / p.error_s, p.error_max_m_s
        ex, ey, ez = error.x - gain * dx, error.y - gain * dy, error.z - gain * dz
        shorter = most / max(most, sqrt(ex * ex + ey * ey + ez * ez))
        error = Vec3(shorter * ex, shorter * ey, shorter * ez)
    return Memory(True, Vec3(x + part * dx, y + part * dy, z + part * dz), error)
