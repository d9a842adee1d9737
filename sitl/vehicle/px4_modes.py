"""PX4's modes: custom_mode encodings and what each shows in HEARTBEAT and CURRENT_MODE."""

from __future__ import annotations

from typing import Final


def custom(main: int, sub: int = 0) -> int:
    """PX4's custom_mode: main mode in bits 16 to 23, sub-mode in bits 24 to 31."""
    return main << 16 | sub << 24


MANUAL: Final = custom(1)
ALTCTL: Final = custom(2)
POSCTL: Final = custom(3)
TAKEOFF: Final = custom(4, 2)
LOITER: Final = custom(4, 3)
MISSION: Final = custom(4, 4)
RTL: Final = custom(4, 5)
LAND: Final = custom(4, 6)
ACRO: Final = custom(5)
OFFBOARD: Final = custom(6)
STABILIZED: Final = custom(7)

NAMES: Final = {
    MANUAL: "MANUAL",
    ALTCTL: "ALTCTL",
    POSCTL: "POSCTL",
    TAKEOFF: "AUTO.TAKEOFF",
    LOITER: "AUTO.LOITER",
    MISSION: "AUTO.MISSION",
    RTL: "AUTO.RTL",
    LAND: "AUTO.LAND",
    ACRO: "ACRO",
    OFFBOARD: "OFFBOARD",
    STABILIZED: "STABILIZED",
}
#: base_mode without the armed bit: custom, and what the mode enables.
AUTO: Final = 1 | 4 | 8 | 16
_STICKS: Final = 1 | 16 | 64
BASE_MODES: Final = {
    MANUAL: 1 | 64,
    ALTCTL: _STICKS,
    POSCTL: _STICKS,
    ACRO: 1 | 64,
    STABILIZED: _STICKS,
    OFFBOARD: 1 | 16,
}
#: MAV_STANDARD_MODE in CURRENT_MODE; everything else is 0, non-standard.
STANDARD_MODES: Final = {RTL: 5, MISSION: 6, LAND: 7, TAKEOFF: 8}
#: Commands that the commander takes as a change of mode (`Commander.cpp`), and what it says then. What flies
#: in these modes is the navigator, which this vehicle does not have: it stands still.
COMMANDED: Final = {
    20: (RTL, "Returning to launch"),
    21: (LAND, "Landing at current position"),
    22: (TAKEOFF, ""),
}
#: COM_OBL_RC_ACT -> the mode that the loss of OFFBOARD leads to (7 disarms, 6 terminates: it stands still).
LOSS_MODES: Final = {0: POSCTL, 1: ALTCTL, 2: MANUAL, 3: RTL, 4: LAND, 5: LOITER}
