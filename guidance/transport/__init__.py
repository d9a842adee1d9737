"""The ways to the autopilot, one small class a kind behind one Protocol, all of them non-blocking."""

from __future__ import annotations

from guidance.connection import Connection, SerialLine
from guidance.transport.base import Address as Address
from guidance.transport.base import Lost as Lost
from guidance.transport.base import Transport as Transport
from guidance.transport.base import said as said
from guidance.transport.base import shown as shown
from guidance.transport.serial import open_serial
from guidance.transport.tcp import open_tcp
from guidance.transport.udp import open_udp


async def open_transport(connection: Connection, peer_silent_s: float) -> Transport:
    """Open what the configuration names.

    Over UDP, an autopilot that was silent for `peer_silent_s` may come back from another address.

    Raises:
        Lost: it cannot be opened; the text says why, and what to do.
    """
    if isinstance(connection, SerialLine):
        return await open_serial(connection)
    if connection.scheme == "tcp":
        return await open_tcp(connection)
    return await open_udp(connection, peer_silent_s)
