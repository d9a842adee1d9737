"""What an airplane can do of a trajectory: what airframe and autopilot leave it, with a margin."""

from __future__ import annotations

from typing import Final

from guidance.abilities import FREE, AirplaneAbilities, Bound
from guidance.handling import airplane, airplane_throttle
from guidance.se3 import ZERO, Vec3
from guidance.shortfall import shortfalls
from guidance.trajectory import Trajectory

#: Of bank and load, so much is kept for errors and gusts.
MARGIN: Final = 0.1
#: A clock that waits may be hurried so much by a tail wind, whatever its own bound (`airplane_clock`).
HURRIED: Final = 2.0


def abilities_of(
    p: airplane.Parameters, trims: airplane.Trims, floor_down_m: Bound = FREE
) -> AirplaneAbilities:
    """Of the parameters as they were fitted, above a floor that is relative to the trajectory's origin."""
    envelope = p.envelope
    fastest = airplane_throttle.fastest_m_s(p.throttle, trims.throttle, 1.0, 0.0)
    waits = p.waiting.fastest > 1.0
    return AirplaneAbilities(
        airspeed_least_m_s=Bound(envelope.airspeed_min_m_s, "the least airspeed"),
        airspeed_m_s=min(
            Bound(envelope.airspeed_max_m_s, "the highest airspeed"),
            Bound(fastest, "what full throttle holds"),
        ),
        bank_rad=Bound(envelope.bank_max_rad, "the highest bank").less(MARGIN),
        # level flight is no load to keep a margin of
        load=Bound(
            1.0 + (1.0 - MARGIN) * (envelope.load_max - 1.0), "the highest load less 10 % of what is above 1"
        ),
        climb_m_s=Bound(envelope.climb_max_m_s, "the highest climb"),
        sink_m_s=Bound(envelope.sink_max_m_s, "the highest sink"),
        roll_rate_rad_s=Bound(p.roll_rate_rad_s, "the highest roll rate"),
        floor_down_m=floor_down_m,
        effectiveness=trims.effectiveness,
        clock_least=p.waiting.slowest if waits else 1.0,
        clock_most=HURRIED if waits else 1.0,
    )


def cannot_fly(
    trajectory: Trajectory,
    p: airplane.Parameters,
    trims: airplane.Trims,
    wind_ned_m_s: Vec3 = ZERO,
    floor_down_m: Bound = FREE,
) -> str | None:
    """What the trajectory first asks for and the airplane has not: where, how much, what would do."""
    found = shortfalls(trajectory, abilities_of(p, trims, floor_down_m), wind_ned_m_s)
    return next((f"the trajectory: {short.text}" for short in found if short.refuses), None)
