"""Bits of the setpoint messages' type masks as ArduPilot reads them (`GCS_MAVLink`)."""

from __future__ import annotations

from typing import Final

IGNORE_ROLL_RATE: Final = 1
IGNORE_PITCH_RATE: Final = 2
IGNORE_YAW_RATE: Final = 4
IGNORE_THROTTLE: Final = 64
IGNORE_ATTITUDE: Final = 128
#: Bits of SET_POSITION_TARGET_LOCAL_NED.type_mask: any of a group ignores the group.
IGNORE_POSITION: Final = 0b111
IGNORE_VELOCITY: Final = 0b111 << 3
IGNORE_ACCELERATION: Final = 0b111 << 6
IGNORE_YAW: Final = 1 << 10
IGNORE_TARGET_YAW_RATE: Final = 1 << 11
#: MAV_FRAME_LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED.
LOCAL_FRAMES: Final = frozenset({1, 7, 8, 9})
BODY_FRAMES: Final = frozenset({8, 9})
