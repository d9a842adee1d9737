"""Who else is heard on the link: ground stations, radios, other vehicles.

None of them is obeyed by what it says to the autopilot. What those who may command this component say to it
is kept in `asked` for `guidance.ground`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.asking import asks
from guidance.mavlink.codec import Frame
from guidance.mavlink.interference import order_of
from guidance.mavlink.messages import DECODERS, Heartbeat

AUTOPILOT: Final = "an autopilot"
RADIO: Final = "a telemetry radio"
GROUND_STATION: Final = "a ground station"

#: Of so many senders it is known what they are; the rest are only counted.
_KNOWN_MAX: Final = 16
_RADIO_COMPONENTS: Final = (
    dialect.MAV_COMP_ID_TELEMETRY_RADIO,
    dialect.MAV_COMP_ID_UDP_BRIDGE,
    dialect.MAV_COMP_ID_UART_BRIDGE,
)


class Company:
    """Every sender but the autopilot of `system`: `frames` counts their good frames.

    `component` is ours: what is addressed to it is no order to the autopilot. `asked` are the frames that
    systems of `commands_from` addressed to it, not looked at yet; those of others are only counted. `beats`
    are the ground stations of those systems of which a HEARTBEAT came, not looked at yet either.
    """

    def __init__(self, system: int, component: int) -> None:
        self.frames = 0
        self.commands_from: frozenset[int] = frozenset()
        self.asked: list[Frame] = []
        self.beats: list[tuple[int, int]] = []
        self.counters: Counter[str] = Counter()
        self._own = (system, component)
        self._roles: dict[tuple[int, int], str] = {}
        self._orders: dict[tuple[int, int], str] = {}
        self._orders_told = 0

    @property
    def roles(self) -> Mapping[tuple[int, int], str]:
        """What each is, by system and component; as far as it has said so."""
        return self._roles

    def heard(self, frame: Frame, *, believed: bool = True) -> bool:
        """A frame of another sender; whether it tells the autopilot what to do.

        One of an unknown id cannot be checked and proves nothing. One whose signature does not hold
        (`believed`) says nothing of its sender, but that the autopilot is told something is so.
        """
        if not frame.known:
            return False
        sender = (frame.system, frame.component)
        order = order_of(frame, *self._own)
        if order is not None and len(self._orders) < _KNOWN_MAX:
            self._orders.setdefault(sender, order)
        if not believed:
            return order is not None
        self.frames += 1
        if asks(frame, *self._own):
            if frame.system in self.commands_from:
                self.asked.append(frame)
            else:
                self.counters["asks_not_heeded"] += 1
        role = _ROLES.get(frame.message_id)
        if role is not None and (sender in self._roles or len(self._roles) < _KNOWN_MAX):
            self._roles[sender] = role(frame)
            if self._roles[sender] == GROUND_STATION and frame.system in self.commands_from:
                self.beats.append(sender)
        return order is not None

    def newly_ordering(self) -> list[str]:
        """Who has begun to tell the autopilot what to do, and by what; each is told once."""
        new = list(self._orders.items())[self._orders_told :]
        self._orders_told = len(self._orders)
        return [
            f"{self._roles.get(sender, 'somebody')} ({sender[0]}/{sender[1]}) sent {order}"
            for sender, order in new
        ]

    def __str__(self) -> str:
        return ", ".join(
            f"{role} ({system}/{component})" for (system, component), role in sorted(self._roles.items())
        )


def _role(frame: Frame) -> str:
    """What the sender of a heartbeat is."""
    beat = DECODERS[frame.message_id](frame.payload)
    assert isinstance(beat, Heartbeat)
    if frame.component in _RADIO_COMPONENTS:
        return RADIO
    if beat.type == dialect.MAV_TYPE_GCS:
        return GROUND_STATION
    if beat.autopilot != dialect.MAV_AUTOPILOT_INVALID:
        return AUTOPILOT
    kind = dialect.enums["MAV_TYPE"].get(beat.type)
    if kind is None:
        return f"type {beat.type}"
    return str(kind.name).removeprefix("MAV_TYPE_").replace("_", " ").lower()


#: What tells them apart. Radios of SiK's kind (51/68) send no heartbeat, only the state of the radio link.
_ROLES: Final[dict[int, Callable[[Frame], str]]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _role,
    dialect.MAVLINK_MSG_ID_RADIO_STATUS: lambda frame: RADIO,
    dialect.MAVLINK_MSG_ID_RADIO: lambda frame: RADIO,
}
