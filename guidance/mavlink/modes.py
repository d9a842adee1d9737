"""Flight modes: PX4's are one table, ArduPilot's one for each vehicle class.

Sources: PX4 `src/modules/commander/px4_custom_mode.h`; ArduPilot `Rover/mode.h`, `ArduPlane/mode.h`,
`ArduCopter/mode.h`.
"""

from __future__ import annotations

from typing import Final, NamedTuple


class Mode(NamedTuple):
    """A flight mode: the operator's name, HEARTBEAT's `custom_mode`, and DO_SET_MODE's param2 and param3."""

    name: str
    custom_mode: int
    main: int
    sub: int = 0


def _px4(name: str, main: int, sub: int = 0) -> Mode:
    return Mode(name, main << 16 | sub << 24, main, sub)


def _ardupilot(**numbers: int) -> tuple[Mode, ...]:
    return tuple(Mode(name, number, number) for name, number in numbers.items())


PX4_MODES: Final = (
    _px4("manual", 1),
    _px4("altitude", 2),
    _px4("position", 3),
    _px4("takeoff", 4, 2),
    _px4("hold", 4, 3),
    _px4("mission", 4, 4),
    _px4("return", 4, 5),
    _px4("land", 4, 6),
    _px4("acro", 5),
    _px4("offboard", 6),
    _px4("stabilized", 7),
)
ROVER_MODES: Final = _ardupilot(
    manual=0,
    acro=1,
    steering=3,
    hold=4,
    loiter=5,
    follow=6,
    simple=7,
    dock=8,
    circle=9,
    auto=10,
    rtl=11,
    smart_rtl=12,
    guided=15,
    initialising=16,
)
PLANE_MODES: Final = _ardupilot(
    manual=0,
    circle=1,
    stabilize=2,
    training=3,
    acro=4,
    fbwa=5,
    fbwb=6,
    cruise=7,
    autotune=8,
    auto=10,
    rtl=11,
    loiter=12,
    takeoff=13,
    guided=15,
    initialising=16,
    thermal=24,
)
COPTER_MODES: Final = _ardupilot(
    stabilize=0,
    acro=1,
    alt_hold=2,
    auto=3,
    guided=4,
    loiter=5,
    rtl=6,
    circle=7,
    land=9,
    drift=11,
    sport=13,
    flip=14,
    autotune=15,
    poshold=16,
    brake=17,
    throw=18,
    guided_nogps=20,
    smart_rtl=21,
    flowhold=22,
    follow=23,
    zigzag=24,
    auto_rtl=27,
)
