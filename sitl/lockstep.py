"""The service's core against the built-in vehicle on virtual time: no sockets, no sleeps, no threads.

Both are sans-IO, so a hundred seconds of flight take about one, and two runs with the same seed are the same
to the bit. The link between them can delay, lose, repeat, reorder and corrupt datagrams, each way on its own.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable, Iterable
from typing import Final, NamedTuple, Protocol

from guidance.config import Config
from guidance.core import Guide
from guidance.mavlink.signing import Signing, SigningClock, wall_timestamp
from guidance.records import Packet, Record
from sitl.vehicle import Truth, Vehicle

SECOND: Final = 1_000_000_000


class Channel(NamedTuple):
    """One way of the link. Delays in s; probabilities per datagram; `jitter_s` reorders, too.

    A corrupted datagram has one byte changed, anywhere.
    """

    delay_s: float = 0.0
    jitter_s: float = 0.0
    loss: float = 0.0
    duplication: float = 0.0
    corruption: float = 0.0


PERFECT: Final = Channel()


class Tap(Protocol):
    """Sees what arrives at either end; `sent_ns` is when it was sent."""

    def arrived(self, data: bytes, sent_ns: int, now_ns: int, *, to_guide: bool) -> None: ...


class Lockstep:
    """A guide and a vehicle, and the virtual clock between them.

    `now_ns` starts at `start_ns` so that nothing relies on a clock that begins at zero. Records go to
    `on_record` in the order in which the core made them. `signing_key` is the guide's, for a configuration
    that names one; its `signing_clock` shows the vehicle's time unless given.
    """

    def __init__(
        self,
        config: Config,
        vehicle: Vehicle,
        *,
        start_ns: int = SECOND,
        to_guide: Channel = PERFECT,
        to_vehicle: Channel = PERFECT,
        seed: int = 0,
        on_record: Callable[[Record], object] | None = None,
        signing_key: bytes | None = None,
        signing_clock: SigningClock | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.now_ns = start_ns
        self._config = config
        self._signing_key = signing_key
        self.guide = self._new_guide(signing_clock)
        self.records: list[Record] = []
        self.setpoint_times_ns: list[int] = []
        self.to_guide = to_guide
        self.to_vehicle = to_vehicle
        self.on_record: Callable[[Record], object] = self.records.append if on_record is None else on_record
        self._dice = random.Random(seed)
        self._order = 0
        self._in_flight: list[tuple[int, int, bool, bytes, int]] = []
        #: What becomes of a datagram of the vehicle's before the link takes it: nothing, another, several.
        self.on_the_way: Callable[[bytes, int], Iterable[bytes]] | None = None
        self.tap: Tap | None = None

    def restart_guide(self) -> None:
        """The process was killed and starts again: it knows its configuration and nothing else."""
        self.guide = self._new_guide(None)

    def _new_guide(self, clock: SigningClock | None) -> Guide:
        key = self._signing_key
        signing = None if key is None else Signing(key, self._config.link.signing_link_id)
        guide = Guide(self._config, signing)
        if signing is not None:
            wall = wall_timestamp(self.vehicle.options.unix_at_zero_ns + self.now_ns)
            guide.signing_clock(SigningClock(wall) if clock is None else clock, self.now_ns)
        return guide

    def run(self, seconds: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; True as soon as `until` holds, False if it did not within `seconds`."""
        end_ns = self.now_ns + round(seconds * SECOND)
        if until is not None and until():
            return True
        while True:
            next_ns = min(self.vehicle.deadline(), self.guide.deadline())
            if self._in_flight:
                next_ns = min(next_ns, self._in_flight[0][0])
            if next_ns > end_ns:
                self.now_ns = end_ns
                return False
            self.now_ns = max(self.now_ns, next_ns)
            self._step()
            if until is not None and until():
                return True

    def truth(self) -> Truth:
        """The plant at this instant."""
        return self.vehicle.truth(self.now_ns)

    def inject(self, data: bytes) -> None:
        """Hand the guide bytes that the vehicle did not send, now."""
        self.guide.receive(data, self.now_ns)
        self._drain()

    def _step(self) -> None:
        now_ns = self.now_ns
        while self._in_flight and self._in_flight[0][0] <= now_ns:
            _, _, to_guide, data, sent_ns = heapq.heappop(self._in_flight)
            if self.tap is not None:
                self.tap.arrived(data, sent_ns, now_ns, to_guide=to_guide)
            if to_guide:
                self.guide.receive(data, now_ns)
                self._drain()
            else:
                self.vehicle.receive(data, now_ns)
        for data in self.vehicle.advance(now_ns):
            for datagram in (data,) if self.on_the_way is None else self.on_the_way(data, now_ns):
                self._send(datagram, self.to_guide, to_guide=True)
        if self.guide.deadline() <= now_ns and not self._arriving(now_ns):
            self.guide.tick(now_ns)
            self._drain()

    def _arriving(self, now_ns: int) -> bool:
        """Whether the guide has datagrams to read at this instant, as a socket is read before a timer."""
        return any(at_ns <= now_ns and to_guide for at_ns, _, to_guide, *_ in self._in_flight[:1])

    def _drain(self) -> None:
        for data in self.guide.packets():
            self._send(data, self.to_vehicle, to_guide=False)
        for record in self.guide.records():
            if isinstance(record, Packet) and record.data[7:10] == _SET_ATTITUDE_TARGET:
                self.setpoint_times_ns.append(record.t_ns)
            self.on_record(record)

    def _send(self, data: bytes, channel: Channel, *, to_guide: bool) -> None:
        copies = 1
        if channel.loss and self._dice.random() < channel.loss:
            copies = 0
        elif channel.duplication and self._dice.random() < channel.duplication:
            copies = 2
        if channel.corruption and self._dice.random() < channel.corruption:
            data = self._corrupted(data)
        for _ in range(copies):
            delay_s = channel.delay_s
            if channel.jitter_s:
                delay_s += channel.jitter_s * self._dice.random()
            self._order += 1
            at_ns = self.now_ns + round(delay_s * SECOND)
            heapq.heappush(self._in_flight, (at_ns, self._order, to_guide, data, self.now_ns))

    def _corrupted(self, data: bytes) -> bytes:
        place = self._dice.randrange(len(data))
        changed = data[place] ^ self._dice.randrange(1, 256)
        return data[:place] + bytes([changed]) + data[place + 1 :]


_SET_ATTITUDE_TARGET: Final = (82).to_bytes(3, "little")
