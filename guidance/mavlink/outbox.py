"""What goes out: packets with our ids, a running sequence number and, with a key, a signature."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import PacketWriter
from guidance.mavlink.profiles import command_long
from guidance.mavlink.signing import Signing

#: This component, as other MAVLink nodes see it.
COMPONENT_ID: Final = dialect.MAV_COMP_ID_ONBOARD_COMPUTER


class Outbox:
    """Packets that wait for the transport, from `system` (the autopilot's and ours) to its `component`."""

    def __init__(self, system: int, component: int, signing: Signing | None = None) -> None:
        self.bytes_sent = 0
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
        kind, state = dialect.MAV_TYPE_ONBOARD_CONTROLLER, dialect.MAV_STATE_ACTIVE
        self.send(dialect.MAVLink_heartbeat_message(kind, dialect.MAV_AUTOPILOT_INVALID, 0, 0, state, 3))

    def command(self, command: int, *params: float) -> None:
        """Queue COMMAND_LONG (76) to the autopilot."""
        self.send(command_long(*self._to, command, *params))

    def status_text(self, severity: int, text: str) -> None:
        """Queue STATUSTEXT (253), cut to its 50 bytes."""
        self.send(dialect.MAVLink_statustext_message(severity, text.encode("ascii", "replace")[:50]))
