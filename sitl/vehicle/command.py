"""MAVLink commands as both COMMAND_LONG and COMMAND_INT carry them, and the answers (MAV_RESULT)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

ACCEPTED: Final = 0
TEMPORARILY_REJECTED: Final = 1
DENIED: Final = 2
UNSUPPORTED: Final = 3
FAILED: Final = 4

#: The number that, in param2 of MAV_CMD_COMPONENT_ARM_DISARM, overrides the checks.
FORCE: Final = 21196
#: The bit of HEARTBEAT.base_mode that says so.
ARMED: Final = 128

#: Command -> the method that carries it out.
COMMANDS: Final[Mapping[int, str]] = {
    176: "_do_set_mode",
    179: "_do_set_home",
    246: "_reboot_shutdown",
    400: "_arm_disarm",
    410: "_get_home",
    510: "_get_message_interval",
    511: "_set_message_interval",
    512: "_request_message",
    520: "_request_capabilities",
}


class Command(NamedTuple):
    """A COMMAND_LONG or COMMAND_INT, and who sent it."""

    id: int
    params: tuple[float, float, float, float, float, float, float]
    source_system: int
    source_component: int

    def whole(self, index: int) -> int | None:
        """Parameter `index` (1 to 7) as a whole number; None if it is not finite."""
        value = self.params[index - 1]
        return round(value) if math.isfinite(value) else None

    @classmethod
    def of(cls, message: Any) -> Command:
        """The command in a COMMAND_LONG or COMMAND_INT; of the latter, x and y are parameters 5 and 6."""
        if message.get_type() == "COMMAND_INT":
            last = (float(message.x), float(message.y), message.z)
        else:
            last = (message.param5, message.param6, message.param7)
        params = (message.param1, message.param2, message.param3, message.param4, *last)
        return cls(message.command, params, message.get_srcSystem(), message.get_srcComponent())
