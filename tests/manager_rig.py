"""A fake service manager: the socket that NOTIFY_SOCKET names, and what came there."""

from __future__ import annotations

import asyncio
import socket
import uuid
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from typing import Final

from guidance.notify import Notifier
from tests.service_rig import Bell

#: The process that the notifiers made here believe to be.
PID: Final = 4711

Message = dict[str, str]


class Manager:
    """The service manager's end: what it was told, a message for each datagram."""

    def __init__(self, address: str) -> None:
        self.named = address
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(f"\0{address[1:]}" if address.startswith("@") else address)
        self.socket.setblocking(False)
        self.told: list[Message] = []

    def read(self) -> list[Message]:
        """The messages that have come since the last call."""
        new: list[Message] = []
        with suppress(BlockingIOError):
            while True:
                lines = self.socket.recv(4096).decode().split("\n")
                new.append(dict(line.split("=", 1) for line in lines))
        self.told += new
        return new

    def all(self, name: str) -> list[str]:
        """The values of one assignment so far."""
        return [message[name] for message in self.told if name in message]

    def notifier(self, watchdog_usec: int = 0) -> Notifier:
        return Notifier({"NOTIFY_SOCKET": self.named, "WATCHDOG_USEC": str(watchdog_usec)}, PID)


@contextmanager
def a_manager(address: str = "") -> Iterator[Manager]:
    made = Manager(address or f"@{uuid.uuid4().hex}")
    try:
        yield made
    finally:
        made.socket.close()


@asynccontextmanager
async def listening(bell: Bell) -> AsyncIterator[Manager]:
    """A manager that is read by the running loop as messages come."""
    with a_manager() as manager:

        def read() -> None:
            manager.read()
            bell.ring()

        loop = asyncio.get_running_loop()
        loop.add_reader(manager.socket, read)
        try:
            yield manager
        finally:
            loop.remove_reader(manager.socket)
