"""From the velocity that a copter is to fly to body rates and thrust, for an autopilot that is told these.

What PX4's `PositionControl` does with a velocity is done here: a PI loop on it, of which `response` is the
inverse as it is of the autopilot's own, so that `velocity_step` says what to ask for either way:

    a = P (asked - v) + held        held' = I (asked - v)          level, down alike with gains of its own

The rotors push along -z of the body. In the level `held` is what wind takes; in the vertical it is the part
of the hover thrust that differs from what the autopilot tells, and a factor, for batteries and payloads are.
The axis of thrust is turned to g - a by the shortest way, in proportion, and the whole body about down at
the yaw rate, which turns the axis with the nose:

    w = gain log(q_e) + R^T (0, 0, yaw rate)        q_e: the shortest turn of the body's z to there

Height goes before the way: the tilt is cut and not the climb. What is at an end does not learn further beyond
it; the hover thrust learns from what is carried, which is bounded, or a wrong one would never be found.
"""

from __future__ import annotations

from math import atan2, exp, hypot, pi, sqrt, tan
from typing import Final, NamedTuple

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.limits import clamp
from guidance.se3 import Quaternion, Vec3, rotate_inverse

#: Of the loop on velocity; the vertical one has rotors alone to wait for, and these may take 0.2 s.
P_PER_S: Final = 2.5
I_PER_S2: Final = 0.8
P_UP_PER_S: Final = 2.5
I_UP_PER_S2: Final = 0.8
#: Of an acceleration up or down no more than this part of gravity is asked for.
VERTICAL_PART: Final = 0.5
#: Of the level acceleration that the tilt allows, wind may take this part.
HELD_PART: Final = 0.8
#: The hover thrust is this many times what the autopilot tells, at least and at most.
HOVER_LEAST: Final = 0.5
HOVER_MOST: Final = 2.0
#: Leaning further, no more thrust is given for it.
UPRIGHT_LEAST: Final = 0.5


class Parameters(NamedTuple):
    """`hover_thrust` (0 to 1) is as the autopilot tells it, and `thrust_min..thrust_max` what may be asked.

    `boosts`: the autopilot gives more thrust by itself where it leans. `climbs`: it takes no thrust but a
    climb rate, 0.5 is none, 1 `climb_up_m_s` and 0 `climb_down_m_s` down. `rates_max_rad_s` are FRD.
    `drag_per_s` is what the air takes of a velocity before it is learned.
    """

    p_per_s: float
    i_per_s2: float
    p_up_per_s: float
    i_up_per_s2: float
    drag_per_s: float
    tilt_max_rad: float
    attitude_per_s: float
    rates_max_rad_s: Vec3
    hover_thrust: float
    thrust_min: float
    thrust_max: float
    boosts: bool
    climbs: bool
    climb_up_m_s: float
    climb_down_m_s: float


class Memory(NamedTuple):
    """Held against wind (m/s^2, NED, level), and hover thrust over the one that is told.

    `given_ned_m_s2` is what of `a` is given by now, held and all: the tilt follows with its gain.
    """

    held_ned_m_s2: Vec3
    hover_part: float
    given_ned_m_s2: Vec3


class Demand(NamedTuple):
    """Body rates (FRD, rad/s), and thrust or what stands for a climb rate (0 to 1)."""

    body_rates_frd_rad_s: Vec3
    thrust: float


class Ends(NamedTuple):
    """What is at its end."""

    tilt: bool
    thrust: bool


def standing(parameters: Parameters, hover_part: float, attitude: Quaternion, velocity: Vec3) -> Memory:
    """Of a copter that flies steadily: so much it leans, and of that the air takes what its velocity needs.

    World NED; for any attitude, upside down too, the level part is finite and bounded.
    """
    p = parameters
    down = rotate_inverse(attitude, Vec3(0.0, 0.0, 1.0))
    upright = max(down.z, UPRIGHT_LEAST)
    # b3's level part, of the body's axes: R e3 = (2(xz + wy), 2(yz - wx), .)
    w, x, y, z = attitude
    lean = GRAVITY_M_S2 / upright
    north = -lean * 2.0 * (x * z + w * y) - p.drag_per_s * velocity.x
    east = -lean * 2.0 * (y * z - w * x) - p.drag_per_s * velocity.y
    held = _bounded(p, north, east)
    given = Vec3(held.x + p.drag_per_s * velocity.x, held.y + p.drag_per_s * velocity.y, 0.0)
    return Memory(held, hover_part, given)


def rates_step(
    parameters: Parameters,
    memory: Memory,
    attitude: Quaternion,
    velocity: Vec3,
    asked: Vec3,
    yaw_rate: float,
    dt: float,
) -> tuple[Memory, Demand, Ends]:
    """`dt` s (>= 0; 0 learns nothing) after the last: `velocity` is flown and `asked` wanted (NED, m/s),
    `yaw_rate` about down (rad/s). Attitude and velocity are those of the instant at which the demand acts."""
    p = parameters
    short = Vec3(asked.x - velocity.x, asked.y - velocity.y, asked.z - velocity.z)
    held = memory.held_ned_m_s2
    down = rotate_inverse(attitude, Vec3(0.0, 0.0, 1.0))

    # Up: what the rotors carry, over gravity.
    part = memory.hover_part
    carried = 1.0
    thrust, at_end = 0.0, False
    if p.climbs:
        climb = -asked.z
        thrust = clamp(0.5 + 0.5 * climb / (p.climb_up_m_s if climb > 0.0 else p.climb_down_m_s), 0.0, 1.0)
    else:
        wanted = 1.0 - p.p_up_per_s * short.z / GRAVITY_M_S2
        carried = clamp(wanted, 1.0 - VERTICAL_PART, 1.0 + VERTICAL_PART)
        lean = 1.0 if p.boosts else max(down.z, UPRIGHT_LEAST)
        wished = part * p.hover_thrust * carried / lean
        thrust = clamp(wished, p.thrust_min, p.thrust_max)
        at_end = carried != wanted or thrust != wished
        if (wished - thrust) * (carried - 1.0) <= 0.0:  # what the rotors cannot give is not learned
            part += dt * p.i_up_per_s2 / p.p_up_per_s * part * (carried - 1.0)
            part = clamp(part, HOVER_LEAST, HOVER_MOST)

    # Level: as far as the tilt goes.
    north, east = p.p_per_s * short.x + held.x, p.p_per_s * short.y + held.y
    most = GRAVITY_M_S2 * carried * tan(p.tilt_max_rad)
    length = hypot(north, east)
    leans = length > most
    if leans:
        north, east = most / length * north, most / length * east
    else:
        gain = p.i_per_s2 * dt
        held = _bounded(p, held.x + gain * short.x, held.y + gain * short.y)

    error = _tilt_error(rotate_inverse(attitude, Vec3(-north, -east, GRAVITY_M_S2 * carried)))
    gain, limits = p.attitude_per_s, p.rates_max_rad_s
    rates = Vec3(
        clamp(gain * error.x + yaw_rate * down.x, -limits.x, limits.x),
        clamp(gain * error.y + yaw_rate * down.y, -limits.y, limits.y),
        clamp(yaw_rate * down.z, -limits.z, limits.z),
    )
    given, keep = memory.given_ned_m_s2, exp(-p.attitude_per_s * dt)
    rises = GRAVITY_M_S2 * (1.0 - carried)
    given = Vec3(
        north + keep * (given.x - north), east + keep * (given.y - east), rises + keep * (given.z - rises)
    )
    return Memory(held, part, given), Demand(rates, thrust), Ends(leans, at_end)


def _tilt_error(axis: Vec3) -> Vec3:
    """The shortest turn (rotation vector, body axes) of the body's z to `axis`, of any length above 0."""
    across = hypot(axis.x, axis.y)
    if across < 1e-9 * sqrt(axis.z * axis.z + across * across):
        return Vec3(0.0 if axis.z > 0.0 else pi, 0.0, 0.0)
    angle = atan2(across, axis.z) / across
    return Vec3(-angle * axis.y, angle * axis.x, 0.0)


def _bounded(p: Parameters, north: float, east: float) -> Vec3:
    most = HELD_PART * GRAVITY_M_S2 * tan(p.tilt_max_rad)
    length = hypot(north, east)
    part = most / length if length > most else 1.0
    return Vec3(part * north, part * east, 0.0)
