"""What the shell asks of a way to the autopilot, and what can go wrong with one."""

from __future__ import annotations

from typing import Any, Protocol

#: Of a socket; empty where there is only one that can speak.
Address = tuple[Any, ...]


class Lost(Exception):  # noqa: N818
    """The way to the autopilot cannot be opened, or is gone; the text says why, and what to do."""


class Transport(Protocol):
    """An open way. Nothing here blocks, and nothing that cannot be sent now is kept to be sent later."""

    @property
    def opened(self) -> str:
        """What was opened, in words."""

    @property
    def address(self) -> Address | None:
        """Where a socket is bound."""

    @property
    def dropped(self) -> int:
        """Packets that the way did not take."""

    def fileno(self) -> int:
        """What to wait on."""

    def receive(self) -> tuple[bytes, Address] | None:
        """What has come, and from where; None if nothing waits.

        Raises:
            Lost: the way is gone.
            OSError: a passing trouble, such as that nobody listens at the other end yet.
        """

    def heard(self, address: Address, now_ns: int) -> str:
        """The autopilot spoke from `address`: answer there. Words if that cannot be right."""

    def perhaps(self, address: Address, now_ns: int) -> None:
        """It may have been the autopilot that spoke from `address`: answer there while no other is known."""

    def send(self, packet: bytes) -> None:
        """One packet, whole, now or never; raises as `receive` does."""

    def close(self) -> None:
        """Give it back; does not wait for what is still to be sent."""


def said(error: OSError) -> str:
    """The system's own words."""
    return error.strerror or str(error)


def shown(address: Address) -> str:
    """HOST:PORT."""
    host, port = address[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
