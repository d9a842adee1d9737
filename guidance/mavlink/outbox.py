"""What goes out: packets with our ids, a running sequence number and, with a key, a signature."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import PacketWriter
from guidance.mavlink.profiles import command_long
from guidance.mavlink.signing import Signing
from guidance.printable import printable

#: A refusal says why in so many texts of 50 bytes at most.
TEXT_PARTS: Final = 4
_MAVLINK_VERSION: Final = 3
_TEXT_BYTES: Final = 50
#: This component, as other MAVLink nodes see it.
COMPONENT_ID: Final = dialect.MAV_COMP_ID_ONBOARD_COMPUTER


class Outbox:
    """Packets that wait for the transport, from `system` (the autopilot's and ours) to its `component`.

    `shown` is what HEARTBEAT says of us: custom_mode and system_status.
    """

    def __init__(self, system: int, component: int, signing: Signing | None = None) -> None:
        self.bytes_sent = 0
        self.shown = (0, dialect.MAV_STATE_STANDBY)
        self._text_id = 0
        self._to = (system, component)
        self._signing = signing
        self._writer = PacketWriter(system, COMPONENT_ID)
        self._packets: list[bytes] = []

    def drain(self) -> list[bytes]:
        """The packets to hand to the transport, in order; empty after."""
        packets, self._packets = self._packets, []
        return packets

    def send(self, message: Any) -> None:
        """Queue a `Payload` or one of pymavlink's messages."""
        packet = self._writer.pack(message)
        if self._signing is not None:
            packet = self._signing.sign(packet)
        self.bytes_sent += len(packet)
        self._packets.append(packet)

    def heartbeat(self) -> None:
        """Queue HEARTBEAT (0) of a companion computer."""
        mode, status = self.shown
        kind, flags = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        self.send(
            dialect.MAVLink_heartbeat_message(
                kind, dialect.MAV_AUTOPILOT_INVALID, flags, mode, status, _MAVLINK_VERSION
            )
        )

    def command(self, command: int, *params: float) -> None:
        """Queue COMMAND_LONG (76) to the autopilot."""
        self.send(command_long(*self._to, command, *params))

    def status_text(self, severity: int, text: str) -> None:
        """Queue STATUSTEXT (253), cut to its 50 bytes."""
        self.send(dialect.MAVLink_statustext_message(severity, _plain(text)[:_TEXT_BYTES]))

    def long_text(self, severity: int, text: str) -> None:
        """Queue a text in up to `TEXT_PARTS` STATUSTEXTs, which receivers put together by their id."""
        data = _plain(text)[: TEXT_PARTS * _TEXT_BYTES]
        if len(data) <= _TEXT_BYTES:
            self.status_text(severity, text)
            return
        self._text_id = self._text_id % 0xFFFF + 1  # 0 is for texts of one part
        for number, start in enumerate(range(0, len(data), _TEXT_BYTES)):
            part = data[start : start + _TEXT_BYTES]
            self.send(dialect.MAVLink_statustext_message(severity, part, self._text_id, number))
        if len(data) % _TEXT_BYTES == 0:  # a part that is full says that another follows
            self.send(dialect.MAVLink_statustext_message(severity, b"", self._text_id, number + 1))


def _plain(text: str) -> bytes:
    """In ASCII; words of others in it steer nobody's terminal."""
    return printable(text).encode("ascii", "replace")
