"""What is wrong with an airplane's airspeed and wind, or with what is told of them."""

from __future__ import annotations

import math
from typing import Any, Final

from sitl.faults.as_shipped import either, fault_of, given_up, staged, tracks_on
from sitl.faults.fault import Action, Fault, Step
from sitl.faults.tampering import Stage, told
from sitl.vehicle import Firmware

PLANES: Final = tuple(firmware for firmware in Firmware if firmware.endswith("-plane"))
AIR: Final = ("VFR_HUD", "WIND", "WIND_COV")


def of_the_air(firmware: Firmware) -> list[Fault]:
    """An airplane's: of airspeed and wind, in a wind and while it changes."""

    def without(*names: str) -> Action:
        return lambda flight: flight.line.vehicle.withhold(*names)

    windy: dict[str, Any] = {"wind_ned_m_s": (-4.0, 3.0, 0.0), "gusts_m_s": 0.8}
    blind = given_up(firmware, 16.0, told=frozenset({"guard_air"}))
    rows = []
    for what, names, still, turns in (
        ("airspeed", AIR[:1], tracks_on(firmware), either(firmware)),
        ("wind", AIR[1:], tracks_on(firmware), either(firmware)),
        # by the last wind alone while that may be late, 10 s, and 5 s more
        ("air", AIR, blind, blind),
    ):
        rows.append(
            fault_of(
                firmware,
                f"no {what} is told any more, in wind",
                still,
                Step(0.0, without(*names)),
                vehicle=windy,
                seconds=40.0,
            )
        )
        rows.append(
            fault_of(
                firmware,
                f"no {what} is told any more, and the wind turns by 8 m/s",
                turns,
                Step(0.0, without(*names)),
                *_front(5.0, (-2.4, 1.8), (4.0, -3.0)),
                vehicle={"wind_ned_m_s": (-2.4, 1.8, 0.0)},
                seconds=60.0,
            )
        )
    for what, value in (
        ("no number", math.nan), ("0", 0.0), ("1e6 m/s", 1e6), ("7 m/s", 7.0), ("30 m/s", 30.0)
    ):  # fmt: skip
        rows.append(
            fault_of(
                firmware,
                f"the airspeed is {what}",
                tracks_on(firmware),
                Step(0.0, staged(told("VFR_HUD", airspeed=value))),
                vehicle=windy,
                seconds=30.0,
            )
        )
    rows += [
        fault_of(
            firmware,
            f"the wind is {what}",
            tracks_on(firmware),
            Step(0.0, staged(_wind(value))),
            seconds=40.0,
        )
        for what, value in (("no number", math.nan), ("1e6 m/s", 1e6), ("90 m/s", 90.0), ("14 m/s", 14.0))
    ]
    return rows


def _front(at_s: float, before: tuple[float, float], after: tuple[float, float]) -> tuple[Step, ...]:
    """The wind turns within 8 s, as in a strong front."""

    def blows(part: float) -> Action:
        north, east = (part * new + (1.0 - part) * old for old, new in zip(before, after, strict=True))
        return lambda flight: flight.line.vehicle.current(flight.line.now_ns, (north, east, 0.0))

    return tuple(Step(at_s + 0.1 * i, blows(i / 80.0)) for i in range(1, 81))


def _wind(speed_m_s: float) -> Stage:
    """From the north, in either message."""
    wind, covariance = told("WIND", speed=speed_m_s, direction=0.0), told("WIND_COV", wind_x=-speed_m_s)

    def both(data: bytes, now_ns: int) -> list[bytes]:
        return [out for first in wind(data, now_ns) for out in covariance(first, now_ns)]

    return both
