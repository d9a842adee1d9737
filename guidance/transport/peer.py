"""Whom a datagram socket answers: the address from which the configured autopilot speaks."""

from __future__ import annotations

from guidance.transport.base import Address, shown


class Peer:
    """The autopilot's address. Another one is taken for it only when this one has fallen silent."""

    def __init__(self, silent_s: float) -> None:
        self.address: Address | None = None
        self._silent_ns = round(silent_s * 1e9)
        self._heard_ns = 0

    def silent(self, now_ns: int) -> bool:
        """Whether nobody is known who still speaks."""
        return self.address is None or now_ns - self._heard_ns > self._silent_ns

    def heard(self, address: Address, now_ns: int) -> str:
        """The autopilot spoke from `address`; words if another one still speaks in its name."""
        if address != self.address:
            if not self.silent(now_ns):
                assert self.address is not None
                return (
                    f"the autopilot's id is used from {shown(address)} as well as from "
                    f"{shown(self.address)}, who gets the setpoints: are there two vehicles of one id?"
                )
            self.address = address
        self._heard_ns = now_ns
        return ""

    def perhaps(self, address: Address, now_ns: int) -> None:
        """It may have been the autopilot: answer there for as long as nobody is known to be it."""
        if self.silent(now_ns):
            self.address = address
