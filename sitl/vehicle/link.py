"""Packing and parsing for one link of the vehicle, with pymavlink's generated dialect and no socket."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

#: A datagram that holds several packets stays below the smallest common MTU.
MAX_DATAGRAM: Final = 1200
#: Parsers kept at a time: one a peer, so that half a packet of one never meets half a packet of another.
MAX_PEERS: Final = 8
_SIGNING_EPOCH_NS: Final = 1_420_070_400_000_000_000  # 2015-01-01 UTC


class Link:
    """Sequence numbers and datagrams out, messages in.

    PX4 hands every message to the socket on its own; ArduPilot fills a datagram with what one loop sent
    (`batch`). With a `signing_key` packets out are signed, and only such are taken in.
    """

    def __init__(self, system_id: int, component_id: int, *, batch: bool, signing_key: bytes = b"") -> None:
        self._mav = mavlink.MAVLink(None, system_id, component_id)
        if signing_key:
            self._mav.signing.secret_key = signing_key
            self._mav.signing.sign_outgoing = True
        self._batch = batch
        self._open = False
        self._outbox: list[bytes] = []
        self._parsers: dict[Hashable, Any] = {}
        self.bad_packets = 0

    def restart(self) -> None:
        """What a reboot does: sequence numbers from zero, half-received packets gone."""
        self._mav.seq = 0
        self._parsers.clear()
        self._open = False

    def set_time(self, unix_ns: int) -> None:
        """What the clock shows, for signatures; it never goes back, and may run ahead with the others'."""
        timestamp = (unix_ns - _SIGNING_EPOCH_NS) // 10_000
        self._mav.signing.timestamp = max(self._mav.signing.timestamp, timestamp)

    def send(self, message: Any) -> None:
        """Pack one pymavlink message and queue it."""
        data: bytes = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        if self._open and len(self._outbox[-1]) + len(data) <= MAX_DATAGRAM:
            self._outbox[-1] += data
        else:
            self._outbox.append(data)
            self._open = self._batch

    def end_of_loop(self) -> None:
        """What is sent from here on goes into a datagram of its own."""
        self._open = False

    @property
    def pending(self) -> bool:
        """Whether anything waits to be taken."""
        return bool(self._outbox)

    def take(self) -> list[bytes]:
        """The datagrams queued so far, in order; the queue is empty afterwards."""
        taken, self._outbox = self._outbox, []
        self._open = False
        return taken

    def parse(self, data: bytes, peer: Hashable) -> list[Any]:
        """The good messages that `data` completes; the rest is counted in `bad_packets`, never raised."""
        parser = self._parsers.get(peer)
        if parser is None:
            parser = mavlink.MAVLink(None)
            parser.robust_parsing = True
            parser.signing = self._mav.signing  # one key, one clock, and each stream of packets only once
            if len(self._parsers) >= MAX_PEERS:
                del self._parsers[next(iter(self._parsers))]
            self._parsers[peer] = parser
        try:
            messages = parser.parse_buffer(data) or []
        except (mavlink.MAVError, ValueError, TypeError, IndexError, KeyError, ArithmeticError):
            # Whatever a hostile packet does to the parser, the next datagram starts afresh.
            del self._parsers[peer]
            self.bad_packets += 1
            return []
        good = [message for message in messages if message.get_msgId() >= 0]
        self.bad_packets += len(messages) - len(good)
        return good
