"""UDP: listening, writing first, and finding the autopilot by broadcast."""

from __future__ import annotations

import errno
import socket
import time
from typing import Final

from guidance.connection import Network
from guidance.transport.base import Address, Lost, said, shown
from guidance.transport.diagnosis import users_of_udp_port
from guidance.transport.hanging import in_a_thread
from guidance.transport.peer import Peer

_DATAGRAM_BYTES: Final = 65535
_HEARTBEAT: Final = b"\0\0\0"


class Udp:
    """What all three share: a socket, and what is read from it."""

    dropped = 0

    def __init__(self, opened: socket.socket, words: str) -> None:
        self._socket = opened
        self._recvfrom, self._sendto = opened.recvfrom, opened.sendto
        self.opened = words

    @property
    def address(self) -> Address | None:
        """Where the socket is bound."""
        return self._socket.getsockname()  # type: ignore[no-any-return]

    def fileno(self) -> int:
        """The socket's."""
        return self._socket.fileno()

    def receive(self) -> tuple[bytes, Address] | None:
        """One datagram and its sender."""
        try:
            return self._recvfrom(_DATAGRAM_BYTES)
        except BlockingIOError:
            return None
        except ConnectionError:
            raise  # nobody listens at the other end yet
        except OSError as error:
            raise Lost(said(error)) from None

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class UdpOut(Udp):
    """Writes to one address, and hears only from there."""

    def heard(self, address: Address, now_ns: int) -> str:
        """No other can speak."""
        return ""

    def perhaps(self, address: Address, now_ns: int) -> None:
        """No other can speak."""

    def send(self, packet: bytes) -> None:
        """One datagram."""
        self._socket.send(packet)


class UdpIn(Udp):
    """Answers whoever speaks as the autopilot."""

    def __init__(self, opened: socket.socket, words: str, peer: Peer) -> None:
        super().__init__(opened, words)
        self._peer = peer
        self.heard = peer.heard
        self.perhaps = peer.perhaps

    def send(self, packet: bytes) -> None:
        """One datagram, if there is somebody to send it to."""
        if self._peer.address is not None:
            self._sendto(packet, self._peer.address)


class UdpBroadcast(UdpIn):
    """The same, but while nobody speaks as the autopilot, our heartbeat goes to all."""

    def __init__(self, opened: socket.socket, words: str, peer: Peer, everybody: Address) -> None:
        super().__init__(opened, words, peer)
        self._everybody = everybody

    def send(self, packet: bytes) -> None:
        """A heartbeat to all, or whatever it is to the autopilot; never a setpoint to all."""
        if packet[7:10] == _HEARTBEAT and self._peer.silent(time.monotonic_ns()):
            self._sendto(packet, self._everybody)
        else:
            super().send(packet)


async def open_udp(connection: Network, peer_silent_s: float) -> UdpOut | UdpIn:
    """Open a socket. An autopilot that was silent for `peer_silent_s` may come back from elsewhere.

    Raises:
        Lost: it cannot be opened.
    """
    host, port, scheme = connection.host, connection.port, connection.scheme
    if scheme == "udpbcast":
        host, port = "0.0.0.0", 0  # noqa: S104 - whoever answers a broadcast does so from where it is
    try:
        found = await in_a_thread(lambda: socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM))
    except (OSError, UnicodeError) as error:  # UnicodeError: a host that cannot be a name
        raise Lost(said(error) if isinstance(error, OSError) else str(error)) from None
    found.sort(key=lambda info: info[0] != socket.AF_INET)  # what autopilots speak
    problem: OSError | None = None
    for family, kind, protocol, _, address in found:
        opened = socket.socket(family, kind, protocol)
        try:
            opened.setblocking(False)
            if scheme == "udpout":
                opened.connect(address)
                return UdpOut(opened, f"sending to {shown(opened.getpeername())} (UDP)")
            opened.bind(address)
            if scheme == "udpin":
                words = f"listening on {shown(opened.getsockname())} (UDP)"
                return UdpIn(opened, words, Peer(peer_silent_s))
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
            everybody = (connection.host, connection.port)
            words = f"broadcasting to {shown(everybody)} (UDP) until the autopilot answers"
            return UdpBroadcast(opened, words, Peer(peer_silent_s), everybody)
        except OSError as error:
            opened.close()
            problem = problem or error
    if problem is None:
        raise Lost(f"{host} has no address")
    why = said(problem)
    if problem.errno == errno.EADDRINUSE and (users := users_of_udp_port(port)):
        why = f"{why} by {', '.join(users)}"
    raise Lost(why)
