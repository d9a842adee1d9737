"""TCP, as a client: to a simulator, a router, or a radio with a network port."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
from typing import Final

from guidance.connection import Network
from guidance.transport.base import Lost, said, shown
from guidance.transport.hanging import in_a_thread
from guidance.transport.stream import ByteStream

#: An address that has not answered for so long does not.
CONNECT_S: Final = 5.0
#: So much may be on its way unacknowledged: 0.6 s of what is sent at 50 Hz, 0.2 s of it at 200 Hz.
WAITING_MAX_BYTES: Final = 2048

#: A dead peer is found out in seconds, not in the two hours and the quarter of an hour of the defaults. Each
#: where the system knows it: probes when nothing is sent, and a limit for what is sent and not acknowledged.
_OPTIONS: Final = (
    ("TCP_NODELAY", 1),
    ("TCP_KEEPIDLE", 2),
    ("TCP_KEEPINTVL", 1),
    ("TCP_KEEPCNT", 3),
    ("TCP_USER_TIMEOUT", 5000),
)


async def open_tcp(connection: Network) -> ByteStream:
    """Connect, to the first address of the host that answers.

    Raises:
        Lost: nobody can be reached there.
    """
    loop = asyncio.get_running_loop()
    try:
        found = await in_a_thread(
            lambda: socket.getaddrinfo(connection.host, connection.port, type=socket.SOCK_STREAM)
        )
    except (OSError, UnicodeError) as error:  # UnicodeError: a host that cannot be a name
        raise Lost(said(error) if isinstance(error, OSError) else str(error)) from None
    problem = f"{connection.host} has no address"
    for family, kind, protocol, _, address in sorted(found, key=lambda info: info[0] != socket.AF_INET):
        opened = socket.socket(family, kind, protocol)
        try:
            opened.setblocking(False)
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for name, value in _OPTIONS:
                if hasattr(socket, name):
                    opened.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
            async with asyncio.timeout(CONNECT_S):
                await loop.sock_connect(opened, address)
            return ByteStream(
                opened.fileno(),
                f"connected to {shown(opened.getpeername())} (TCP)",
                close=opened.close,
                lost=_lost,
                waiting_max_bytes=WAITING_MAX_BYTES,
            )
        except OSError as error:
            opened.close()
            problem = _refused(error)
        except BaseException:
            opened.close()
            raise
    raise Lost(problem)


def _refused(error: OSError) -> str:
    if isinstance(error, TimeoutError) and error.errno is None:
        return f"no answer within {CONNECT_S:g} s: is the address right, is the network up?"
    why = os.strerror(error.errno) if error.errno else said(error)  # asyncio puts the address in its place
    return f"{why}: nobody listens there" if error.errno == errno.ECONNREFUSED else why


def _lost(error: OSError | None) -> str:
    if error is None:
        return "the other end closed the connection"
    if error.errno == errno.ETIMEDOUT:
        return "the other end does not answer any more"
    return said(error)
