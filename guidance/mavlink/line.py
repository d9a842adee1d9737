"""The line to the autopilot beside what it should be: its bytes, the rates on it, and who speaks on it."""

from __future__ import annotations

from collections.abc import Callable

from msgspec.structs import replace

from guidance.connection import Connection
from guidance.mavlink.budget import FULL, Traffic, needed_bytes_per_s, too_slow
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.streams import Stream
from guidance.records import Event, Level, Link


class LineWatch:
    """Looks at the link whenever it is told of, and says once what has come to be wrong.

    `streams_at` gives the streams that setpoints at a rate in Hz need.
    """

    def __init__(
        self, connection: Connection, rate_hz: float, streams_at: Callable[[float], list[Stream]]
    ) -> None:
        self._connection = connection
        self._rate_hz = rate_hz
        self._streams_at = streams_at
        self._needed_bytes_per_s = self._needed_at(rate_hz)
        self._traffic = Traffic()
        self._were_at_rate: set[str] = set()
        self._below: set[str] = set()
        self._lowered: dict[str, float] = {}  # what was denied, and the rate that is asked for instead
        self._twins = False

    def opened(self, now_ns: int) -> list[Event]:
        """The line was opened: whether it can carry what is needed."""
        capacity = self._connection.capacity_bytes_per_s
        slow = None if capacity is None else too_slow(capacity, self._rate_hz, self._needed_at)
        return [] if slow is None else [_warning(now_ns, "slow_line", slow)]

    def measured(self, record: Link, link: AutopilotLink) -> Link:
        """The link's record with what was measured on the line."""
        received, sent = self._traffic.look(link.bytes_received, link.outbox.bytes_sent, record.t_ns)
        return replace(
            record,
            transport=self._connection.scheme,
            received_bytes_per_s=round(received, 1),
            sent_bytes_per_s=round(sent, 1),
            needed_bytes_per_s=round(self._needed_bytes_per_s, 1),
            capacity_bytes_per_s=self._connection.capacity_bytes_per_s,
        )

    def news(self, record: Link, link: AutopilotLink) -> list[Event]:
        """What has come to be wrong since the last record."""
        news = [_warning(record.t_ns, "rate_fell", text) for text in self._fallen(record, link)]
        news += [_warning(record.t_ns, "rate_denied", text) for text in self._denied(record.t_ns, link)]
        before, self._twins = self._twins, link.twins.seen(record.t_ns)
        if self._twins and not before:
            text = (
                f"two senders speak as {link.system}/{link.component}: two vehicles of one id (give each its "
                "own: MAV_SYS_ID on PX4, MAV_SYSID or SYSID_THISMAV on ArduPilot), or one that a router "
                "hears by two ways (close one)"
            )
            news.append(_warning(record.t_ns, "two_autopilots", text))
        news += [
            _warning(record.t_ns, "orders_of_others", f"{who}: not obeyed here, but the autopilot may")
            for who in link.company.newly_ordering()
        ]
        return news

    def _needed_at(self, rate_hz: float) -> float:
        return needed_bytes_per_s(self._streams_at(rate_hz), rate_hz)

    def _denied(self, now_ns: int, link: AutopilotLink) -> list[str]:
        """The needed streams that are asked for at less than is wanted."""
        lowered = {s.message: s.asked_hz for s in link.streams.all() if s.asked_hz < s.wanted_hz}
        before, self._lowered = self._lowered, lowered
        return [
            f"{message}: {link.streams[message].wanted_hz:g} Hz is not granted, {hz:.3g} Hz is asked for"
            for message, hz in lowered.items()
            if before.get(message) != hz and link.streams.needed(link.streams[message], now_ns)
        ]

    def _fallen(self, record: Link, link: AutopilotLink) -> list[str]:
        """The needed streams that came at their rate, and by two records running come below it."""
        capacity = record.capacity_bytes_per_s
        if capacity is not None and record.received_bytes_per_s >= FULL * capacity:
            cause = f"the line is full, with {record.received_bytes_per_s:.0f} bytes/s"
        else:
            cause = "another program may have reset it; it is asked for again"
        streams = (s for s in link.streams.all() if s.insistent)  # PX4 sends CURRENT_MODE as it changes
        needed = {s.message for s in streams if link.streams.needed(s, record.t_ns)}
        below = needed & {s.message for s in record.streams if s.alive and not s.at_rate}
        fallen = below & self._below & self._were_at_rate
        self._below = below
        self._were_at_rate -= fallen
        self._were_at_rate |= {s.message for s in record.streams if s.at_rate}
        return [
            f"{s.message} fell back to {s.rate_hz:.0f} Hz of {s.wanted_hz:.0f}: {cause}"
            for s in record.streams
            if s.message in fallen
        ]


def _warning(now_ns: int, code: str, text: str) -> Event:
    return Event(t_ns=now_ns, level=Level.WARNING, code=code, text=text)
