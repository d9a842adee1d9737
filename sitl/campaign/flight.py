"""Flights of law and plant at a fixed step: the loop of a campaign, as it is or compiled (`sitl.compiled`).

A flight is a row of `PARAMETERS`, and what came of it a row of `OUTCOMES`; what all flights of a campaign
share is `Common`. Rows rather than tuples, because a campaign has a million of them; everything in between,
law and plant, is `guidance`'s and `sitl.plant`'s own. Units are SI, the world is NED.

A few flights take their steps together: the references of all, then the law of all, then the plant of all.
They have nothing to do with one another, so that a processor works on one while another waits for a square
root, and the shorter each of the three is, the more flights it sees ahead. A flight's numbers are the same in
any company.
"""

from __future__ import annotations

from math import acos, ceil, inf, isfinite, nan, sin, sqrt, tau
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from guidance import trajectory
from guidance.error_function import ErrorFunction
from guidance.law import Gains, Limits, Memory, Parameters, guide_step, planar
from guidance.limits import Controls
from guidance.se3 import Pose, Quaternion, Reference, Twist, Vec3
from guidance.trajectory import circle, helix, lemniscate, line, zigzag
from sitl.plant import PlantCommand, PlantParameters, PlantState, step

#: What may differ from flight to flight: start, gains, limits, wind, delay, and the motion at the start.
PARAMETERS: Final = (
    "north_m",
    "east_m",
    "down_m",
    "qw",
    "qx",
    "qy",
    "qz",
    "start_s",
    "k",
    "rho2_per_s",
    "rho3_per_s",
    "beta",
    "speed_min_m_s",
    "speed_max_m_s",
    "rate_max_rad_s",
    "wind_north_m_s",
    "wind_east_m_s",
    "wind_down_m_s",
    "gust_north_m_s",
    "gust_east_m_s",
    "gust_down_m_s",
    "gust_phase_rad",
    "delay_s",
    "rate_lag_s",
    "speed_lag_s",
    "start_roll_rate_rad_s",
    "start_pitch_rate_rad_s",
    "start_yaw_rate_rad_s",
    "start_speed_m_s",
)
#: Of these, the body rates at the start.
START_RATES: Final = PARAMETERS[25:28]

#: What came of it; times are from the start of the flight, NaN where it did not happen.
#: `entered_s`: below the radius for the first time; `settled_s`: for good; `excursion_m`: the largest error
#: after the first entry; `rms_m`: over the last quarter; the counts are of law steps, out of all.
OUTCOMES: Final = (
    "start_error_m",
    "start_heading_error_rad",
    "entered_s",
    "settled_s",
    "final_error_m",
    "excursion_m",
    "rms_m",
    "y4_min",
    "singular_steps",
    "saturated_steps",
    "reverse_steps",
    "finite",
)

#: Flights that step together. Two would do to hide the latencies; these still fit the first-level cache.
ABREAST: Final = 8

Rows = NDArray[np.float64]


class Common(NamedTuple):
    """What all flights share. `trajectory` is a place in `TRAJECTORIES`, `shape` its parameters in order.

    A flight has `steps` steps of `dt_s`; its error is to get, and stay, below `within_m`. `longest_delay` in
    steps bounds `delay_s`; unless `is_windy`, wind and gusts are not looked at; `gust_period_s` > 0. The
    rates of change are limits of the law alone.
    """

    law: int
    allocation: int
    error_function: ErrorFunction
    keep_direction: bool
    acceleration_m_s2: float
    turn_acceleration_rad_s2: float
    trajectory: int
    shape: tuple[float, float, float, float, float, float]
    is_planar: bool
    dt_s: float
    steps: int
    within_m: float
    longest_delay: int
    is_windy: bool
    gust_period_s: float


#: Trajectories that a campaign can fly, and their numbers in `Common`.
TRAJECTORIES: Final[dict[type[trajectory.Trajectory], int]] = {
    trajectory.Helix: 0,
    trajectory.Circle: 1,
    trajectory.Line: 2,
    trajectory.Zigzag: 3,
    trajectory.Lemniscate: 4,
}


def reference_at(kind: int, shape: tuple[float, float, float, float, float, float], t_s: float) -> Reference:
    """The trajectory at `t_s`."""
    if kind == 0:
        return helix(t_s, shape[0], shape[1], shape[2], shape[3], shape[4])
    if kind == 1:
        return circle(t_s, shape[0], shape[1], shape[2] != 0.0, shape[3])
    if kind == 2:
        return line(t_s, shape[0], shape[1], shape[2], shape[3], shape[4], shape[5])
    if kind == 3:
        return zigzag(t_s, shape[0], shape[1])
    return lemniscate(t_s, shape[0], shape[1], shape[2], shape[3])


def angle_off(y4: float, v2: float) -> float:
    """The angle (rad) between b1 and the field, from y4 and V2 = (y5^2 + y6^2)/2; 0 where there is none."""
    field = sqrt(y4 * y4 + 2.0 * v2)
    if field == 0.0:
        return 0.0
    return acos(max(-1.0, min(1.0, y4 / field)))


def fly(common: Common, flights: Rows, outcomes: Rows) -> None:
    """Fly each row of `flights` (n, PARAMETERS) and write its row of `outcomes` (n, OUTCOMES)."""
    dt = common.dt_s
    steps = common.steps
    tail = steps - steps // 4
    within2 = common.within_m * common.within_m
    slots = common.longest_delay + 1
    gust_rate = tau / common.gust_period_s
    turn_slew = common.turn_acceleration_rad_s2
    # Of each flight that is under way: r, r', r''; pose, rates and speed; the law's memory; the commands on
    # their way; and what has been seen.
    R = np.zeros((ABREAST, 9))
    S = np.zeros((ABREAST, 11))
    M = np.zeros((ABREAST, 4))
    U = np.zeros((ABREAST, slots, 4))
    seen = np.zeros((ABREAST, 9))
    for first in range(0, flights.shape[0], ABREAST):
        abreast = min(ABREAST, flights.shape[0] - first)
        for j in range(abreast):
            for i in range(7):
                S[j, i] = flights[first + j, i]
            for i in range(4):
                S[j, 7 + i] = flights[first + j, 25 + i]
            for i in range(9):
                seen[j, i] = 0.0
            seen[j, 0] = -1.0  # first step below the radius
            seen[j, 1] = -1.0  # last step not below it
            seen[j, 4] = inf  # lowest y4
            for i in range(slots):
                U[j, i, 0] = U[j, i, 1] = U[j, i, 2] = U[j, i, 3] = 0.0

        # Flights that are always at the same place of the trajectory look it up once for all.
        apart = 1
        for j in range(1, abreast):
            if flights[first + j, 7] != flights[first, 7]:
                apart = abreast

        for n in range(steps + 1):
            for j in range(apart):
                t = flights[first + j, 7] + n * dt
                r = reference_at(common.trajectory, common.shape, t)
                R[j, 0], R[j, 1], R[j, 2] = r.position
                R[j, 3], R[j, 4], R[j, 5] = r.velocity
                R[j, 6], R[j, 7], R[j, 8] = r.acceleration
            for j in range(apart, abreast):
                for i in range(9):
                    R[j, i] = R[0, i]

            for j in range(abreast):
                f = first + j
                speed_min, speed_max = flights[f, 12], flights[f, 13]
                rate_max = flights[f, 14]
                parameters = Parameters(
                    common.law,
                    common.allocation,
                    Gains(flights[f, 8], flights[f, 9], flights[f, 10], flights[f, 11]),
                    common.error_function,
                    Limits(
                        speed_min,
                        speed_max,
                        rate_max,
                        rate_max,
                        rate_max,
                        common.keep_direction,
                        common.acceleration_m_s2,
                        turn_slew,
                        turn_slew,
                        turn_slew,
                    ),
                )
                pose = Pose(Vec3(S[j, 0], S[j, 1], S[j, 2]), Quaternion(S[j, 3], S[j, 4], S[j, 5], S[j, 6]))
                twist = Twist(Vec3(S[j, 7], S[j, 8], S[j, 9]), Vec3(S[j, 10], 0.0, 0.0))
                reference = Reference(
                    Vec3(R[j, 0], R[j, 1], R[j, 2]),
                    Vec3(R[j, 3], R[j, 4], R[j, 5]),
                    Vec3(R[j, 6], R[j, 7], R[j, 8]),
                )
                if common.is_planar:
                    pose, reference = planar(pose, reference)
                memory = Memory(n > 0, Controls(M[j, 0], M[j, 1], M[j, 2], M[j, 3]))
                memory, found = guide_step(parameters, memory, pose, twist, reference, dt)

                u = memory.controls
                M[j, 0], M[j, 1], M[j, 2], M[j, 3] = u.u1, u.u2, u.u3, u.u4
                e = found.e
                error2 = e.x * e.x + e.y * e.y + e.z * e.z
                if n == 0:
                    outcomes[f, 0] = sqrt(error2)
                    outcomes[f, 1] = angle_off(found.y4, found.V2)
                if not error2 < within2:
                    seen[j, 1] = n
                elif seen[j, 0] < 0.0:
                    seen[j, 0] = n
                if seen[j, 0] >= 0.0 and error2 > seen[j, 2]:
                    seen[j, 2] = error2
                if n >= tail:
                    seen[j, 3] += error2
                if found.y4 < seen[j, 4]:
                    seen[j, 4] = found.y4
                if found.singular:
                    seen[j, 5] += 1.0
                if found.saturated:
                    seen[j, 6] += 1.0
                if u.u4 < 0.0:
                    seen[j, 7] += 1.0
                seen[j, 8] = error2
            if n == steps:
                break

            for j in range(abreast):
                f = first + j
                u = Controls(M[j, 0], M[j, 1], M[j, 2], M[j, 3])
                if slots > 1:
                    U[j, n % slots, 0], U[j, n % slots, 1] = u.u1, u.u2
                    U[j, n % slots, 2], U[j, n % slots, 3] = u.u3, u.u4
                    # A delay between two steps is rounded up; until the first command arrives, none acts.
                    late = (n + slots - ceil(flights[f, 22] / dt - 1e-9)) % slots
                    u = Controls(U[j, late, 0], U[j, late, 1], U[j, late, 2], U[j, late, 3])
                body = PlantParameters(
                    flights[f, 14],
                    max(abs(flights[f, 12]), abs(flights[f, 13])),
                    flights[f, 23],
                    flights[f, 24],
                    common.is_planar,
                )
                before = PlantState(
                    (S[j, 0], S[j, 1], S[j, 2]),
                    (S[j, 3], S[j, 4], S[j, 5], S[j, 6]),
                    (S[j, 7], S[j, 8], S[j, 9]),
                    S[j, 10],
                )
                after = step(body, before, PlantCommand((u.u1, u.u2, u.u3), u.u4), dt)
                S[j, 0], S[j, 1], S[j, 2] = after.position_ned_m
                if common.is_windy:
                    # Wind and current carry the body along, x' = u4 b1 + w(t), and do not turn it.
                    gust = sin(flights[f, 21] + gust_rate * ((n + 0.5) * dt))
                    S[j, 0] += (flights[f, 15] + gust * flights[f, 18]) * dt
                    S[j, 1] += (flights[f, 16] + gust * flights[f, 19]) * dt
                    S[j, 2] += (flights[f, 17] + gust * flights[f, 20]) * dt
                S[j, 3], S[j, 4], S[j, 5], S[j, 6] = after.attitude_wxyz
                S[j, 7], S[j, 8], S[j, 9] = after.body_rates_frd_rad_s
                S[j, 10] = after.speed_m_s

        for j in range(abreast):
            f = first + j
            outcomes[f, 2] = seen[j, 0] * dt if seen[j, 0] >= 0.0 else nan
            outcomes[f, 3] = (seen[j, 1] + 1.0) * dt if seen[j, 1] < steps else nan
            outcomes[f, 4] = sqrt(seen[j, 8])
            outcomes[f, 5] = sqrt(seen[j, 2]) if seen[j, 0] >= 0.0 else nan
            outcomes[f, 6] = sqrt(seen[j, 3] / (steps + 1 - tail))
            outcomes[f, 7] = seen[j, 4]
            outcomes[f, 8] = seen[j, 5]
            outcomes[f, 9] = seen[j, 6]
            outcomes[f, 10] = seen[j, 7]
            outcomes[f, 11] = 1.0 if isfinite(seen[j, 8]) else 0.0
