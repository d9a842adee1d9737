"""The other end for tests of the link: packets with any identity and sequence number, and recorded ones."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as dialect

from guidance import records
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.report import link_record
from guidance.mavlink.streams import Stream

RECORDINGS: Final = Path(__file__).parent / "data" / "recordings"
#: SIGNED in the incompatibility flags, and the bytes that it announces.
SIGNATURE_BYTES: Final = 13

SECOND: Final = 1_000_000_000
MS: Final = 1_000_000
OFFBOARD: Final = 6 << 16


class Sender:
    """Packs messages as one component would send them; `sequence` may be set to skip or repeat."""

    def __init__(self, system: int = 1, component: int = 1, *, mavlink1: bool = False) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self._mavlink1 = mavlink1
        self.sequence = 0

    def pack(self, message: Any, sequence: int | None = None) -> bytes:
        """The packet; without `sequence` the next number."""
        self._mav.seq = (self.sequence if sequence is None else sequence) % 256
        if sequence is None:
            self.sequence = (self.sequence + 1) % 256
        return bytes(message.pack(self._mav, force_mavlink1=self._mavlink1))


class Peer:
    """An autopilot of 1/1 at the other end; `now` moves by hand."""

    def __init__(self, *streams: Stream) -> None:
        self.link = AutopilotLink(1, 1, 3.0, streams)
        self.sender = Sender()
        self.now = 100 * SECOND

    def say(self, message: Any, *, after_ms: float = 0.0, sequence: int | None = None) -> list[str]:
        """The names of what the link believed."""
        self.now += round(after_ms * MS)
        return [r.name for r in self.link.receive(self.sender.pack(message, sequence), self.now)]

    def heartbeat(self, mode: int = OFFBOARD, **how: Any) -> list[str]:
        return self.say(dialect.MAVLink_heartbeat_message(12, 12, 0x81, mode, 4, 3), **how)

    def attitude(self, boot_ms: int, **how: Any) -> list[str]:
        return self.say(dialect.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 0, 0, 0), **how)

    def sent(self, wait_ms: float = 0.0) -> list[Any]:
        """What the link sends at a tick after a wait, parsed."""
        self.now += round(wait_ms * MS)
        self.link.tick(self.now)
        return self.drained()

    def drained(self) -> list[Any]:
        parser = dialect.MAVLink(None)
        return [message for packet in self.link.outbox.drain() for message in parser.parse_buffer(packet)]

    def answer_timesync(self, vehicle_ns: int) -> None:
        """Ask, if it is time, and answer at once."""
        for message in self.sent():
            if message.get_type() == "TIMESYNC" and message.tc1 == 0:
                self.say(dialect.MAVLink_timesync_message(vehicle_ns, message.ts1))

    @property
    def counters(self) -> dict[str, int]:
        return {name: count for name, count in self.record().counters.items() if count}

    def record(self) -> records.Link:
        return link_record(self.link, self.now)


def checksum(data: bytes) -> int:
    """CRC-16/MCRF4XX bit by bit, as the MAVLink specification describes it."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc


def frame_by_hand(
    message_id: int,
    payload: bytes,
    extra: int,
    *,
    sequence: int = 0,
    ids: tuple[int, int] = (1, 1),
    flags: int = 0,
) -> bytes:
    """A MAVLink 2 frame by the specification alone; `payload` as it is, zeros not cut; signed if flagged."""
    header = struct.pack("<BBBBBB", len(payload), flags, 0, sequence, *ids) + message_id.to_bytes(3, "little")
    crc = checksum(header + payload + bytes([extra]))
    return (
        b"\xfd"
        + header
        + payload
        + struct.pack("<H", crc)
        + bytes(range(SIGNATURE_BYTES if flags & 1 else 0))
    )


class Recorded(NamedTuple):
    """One packet of a recording, and the companion's Unix time of its receipt."""

    t_ns: int
    packet: bytes


def recorded(name: str) -> Iterator[Recorded]:
    """The packets of an excerpt in `tests/data/recordings`, in order."""
    data = gzip.decompress((RECORDINGS / f"{name}.tlog.gz").read_bytes())
    position = 0
    while position < len(data):
        (t_us,) = struct.unpack_from(">Q", data, position)
        start = position + 8
        position = start + 12 + data[start + 1] + (SIGNATURE_BYTES if data[start + 2] & 1 else 0)
        yield Recorded(t_us * 1000, data[start:position])
