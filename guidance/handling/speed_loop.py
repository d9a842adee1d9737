"""The speed that is asked for so that the wanted one is driven: feed-forward, and PI on the measured speed.

A thrust becomes a speed by a map that is never right (WP_SPEED, a battery, a slope). The wanted speed goes
through as it is, and what is missing is added in proportion and over time. What counts as missing is measured
against what the vehicle would show by now if the map were right: the wanted speed after the lag that it is
known to answer with. Without that, each change of speed would fill the integral.

The integral stops where the sum is at its end, and while the vehicle is to stand.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.limits import clamp


class Parameters(NamedTuple):
    """`kp` without unit, `ki` in 1/s, `lag_s` (>= 0); the correction stays within +-`part` of the wanted speed.

    `kp` = `ki` = 0 leaves the feed-forward alone.
    """

    kp: float
    ki: float
    lag_s: float
    part: float


class Memory(NamedTuple):
    """The speed that should show by now and the integral's part of the correction, m/s."""

    expected_m_s: float
    integral_m_s: float


START: Final = Memory(0.0, 0.0)


def speed_step(
    parameters: Parameters,
    memory: Memory,
    wanted_m_s: float,
    measured_m_s: float,
    lowest_m_s: float,
    highest_m_s: float,
    dt: float,
) -> tuple[Memory, float]:
    """The speed to ask for, within [lowest, highest]; all speeds forward, over ground."""
    p = parameters
    expected = memory.expected_m_s + dt / (p.lag_s + dt) * (wanted_m_s - memory.expected_m_s) if dt > 0.0 else 0.0
    missing = expected - measured_m_s
    bound = p.part * abs(wanted_m_s)
    integral = clamp(memory.integral_m_s + p.ki * missing * dt, -bound, bound)
    asked = wanted_m_s + clamp(p.kp * missing + integral, -bound, bound)
    held = clamp(asked, lowest_m_s, highest_m_s)
    if (asked > held and missing > 0.0) or (asked < held and missing < 0.0):
        integral = clamp(memory.integral_m_s, -bound, bound)
    return Memory(expected, integral), held
