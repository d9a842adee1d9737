"""The speed that is asked for so that the wanted one is driven: feed-forward, and PI on the measured speed.

A thrust becomes a speed by a map that is never right (WP_SPEED, a battery, a slope). The wanted speed goes
through as it is, and what is missing is added in proportion and over time. A map is wrong by a factor, so the
integral is one: what it has learned at one speed it knows at all.

What counts as missing is measured against what the vehicle would show by now if the map were right: the
wanted speed after the delay of the line, which is known at every step, and the lag that it is known to answer
with. Without that, each change of speed would fill the integral, and over a slow line the loop would drive
the vehicle to and fro. The integral rests where the sum is at its end, and below `SLOWEST_M_S` there is no
factor to be seen.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.limits import clamp

#: Slower speeds (m/s) move the integral less and less.
SLOWEST_M_S: Final = 0.5


class Parameters(NamedTuple):
    """`kp` without unit, `ki` in 1/s, `lag_s` (>= 0); each correction is within +-`part` of the wanted speed.

    `kp` = `ki` = 0 leaves the feed-forward alone.
    """

    kp: float
    ki: float
    lag_s: float
    part: float


class Memory(NamedTuple):
    """Speeds (m/s) that should be acted on and show by now; by which part the map is short, as learned."""

    acted_on_m_s: float
    expected_m_s: float
    integral: float


START: Final = Memory(0.0, 0.0, 0.0)


def speed_step(
    parameters: Parameters,
    memory: Memory,
    wanted_m_s: float,
    measured_m_s: float,
    age_s: float,
    lowest_m_s: float,
    highest_m_s: float,
    dt: float,
) -> tuple[Memory, float]:
    """The speed to ask for, within [lowest, highest]; all speeds forward, over ground. `dt` > 0.

    The measurement is older by `age_s` (>= 0) than the setpoint is when it acts.
    """
    p = parameters
    acted_on = memory.acted_on_m_s + dt / (age_s + dt) * (wanted_m_s - memory.acted_on_m_s)
    expected = memory.expected_m_s + dt / (p.lag_s + dt) * (acted_on - memory.expected_m_s)
    missing = expected - measured_m_s
    scale = max(expected * expected, SLOWEST_M_S * SLOWEST_M_S)
    integral = clamp(memory.integral + p.ki * dt * missing * expected / scale, -p.part, p.part)
    bound = p.part * abs(wanted_m_s)
    asked = wanted_m_s * (1.0 + integral) + clamp(p.kp * missing, -bound, bound)
    held = clamp(asked, lowest_m_s, highest_m_s)
    if (asked > held and missing > 0.0) or (asked < held and missing < 0.0):
        integral = memory.integral
    return Memory(acted_on, expected, integral), held
