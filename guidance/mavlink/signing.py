"""MAVLink 2 message signing: who holds the key, and that nothing is said twice. No file and no clock here.

A signed packet ends in 13 bytes: the id of the sender's link, a timestamp of 48 bits in 10 us since 2015
(UTC), and the first 6 bytes of SHA-256 over the key, the packet and these two. By the rules of MAVLink's
guide to signing:

- a stream (system, component, link id) says no timestamp twice;
- a stream that is new may be at most a minute behind our own timestamp;
- our own follows the wall clock, grows with every packet, and is moved up to every one that is believed.

In two things this is not that guide. It refuses whatever is older than the newest of its stream; here a
packet that never came before may be late by a second, because packets that overtake each other on the way
(10 ms of jitter are enough) would cost half of them. And the streams are remembered across restarts, so that
not even the last minute of a capture is believed again.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from enum import StrEnum
from hmac import compare_digest
from typing import Final

import msgspec
from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import SIGNATURE_BYTES, SIGNED, Frame
from guidance.mavlink.messages import CRC_EXTRA

KEY_BYTES: Final = 32
#: 2015-01-01 UTC, in Unix time.
EPOCH_UNIX_S: Final = 1_420_070_400
#: Length of a timestamp's unit.
TICK_NS: Final = 10_000
TIMESTAMP_MAX: Final = 2**48 - 1
#: A stream that is new may be so far behind our own timestamp: one minute.
NEW_STREAM_BEHIND: Final = 60 * 1_000_000_000 // TICK_NS
#: A packet may be overtaken on the way by packets that are so much younger: one second.
LATE: Final = 1_000_000_000 // TICK_NS

_HASH_BYTES: Final = 6
_PRUNE: Final = 512
#: Radios put these in by themselves and have no key. Nothing believes them; they only say that there is one.
_UNSIGNED: Final = (dialect.MAVLINK_MSG_ID_RADIO_STATUS, dialect.MAVLINK_MSG_ID_RADIO)


class Refusal(StrEnum):
    """Why a packet is not believed; also the name of its count."""

    UNSIGNED = "unsigned"
    BAD_SIGNATURE = "bad_signature"
    REPLAYED = "signature_replayed"


class SigningClock(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What must outlive a restart: our timestamp, and [system, component, link id, timestamp] per stream."""

    timestamp: int
    streams: tuple[tuple[int, int, int, int], ...] = ()


def wall_timestamp(unix_ns: int) -> int:
    """The timestamp of a wall clock's time; 0 for one before 2015, which is a clock that was never set."""
    return min(max(unix_ns // TICK_NS - EPOCH_UNIX_S * (1_000_000_000 // TICK_NS), 0), TIMESTAMP_MAX)


class _Stream:
    """The timestamps of one sender on one link: each is taken once, and at first only what is newer."""

    def __init__(self, newest: int) -> None:
        self.newest = newest
        self._floor = newest
        self._seen: set[int] = set()
        self._prune_at = _PRUNE

    @property
    def heard(self) -> bool:
        """Whether anything was taken, and not only remembered from an earlier run."""
        return bool(self._seen)

    def take(self, timestamp: int) -> bool:
        """Whether it is new, and not too late."""
        if timestamp <= max(self._floor, self.newest - LATE) or timestamp in self._seen:
            return False
        self._seen.add(timestamp)
        self.newest = max(self.newest, timestamp)
        if len(self._seen) > self._prune_at:
            self._seen = {seen for seen in self._seen if seen > self.newest - LATE}
            self._prune_at = 2 * len(self._seen) + _PRUNE
        return True


class Signing:
    """Signs what goes out, and says of what comes in whether it is from a holder of the key, and fresh.

    `key` is None only in a replay, which has none: then signatures are zeros, and the caller says which of
    the packets had a bad one.
    """

    def __init__(self, key: bytes | None, link_id: int) -> None:
        self._keyed = None if key is None else hashlib.sha256(key)
        self._link_id = bytes([link_id])
        self._streams: dict[tuple[int, int, int], _Stream] = {}
        self._timestamp = 0
        self.refused = 0  # packets
        self.forged = ""  # which of the newest packets had a bad signature: their numbers, from 0
        self._set = (0, 0)  # a timestamp, and the ns at which it held

    @property
    def clock(self) -> SigningClock:
        """What to keep."""
        return SigningClock(
            self._timestamp, tuple((*who, stream.newest) for who, stream in self._streams.items())
        )

    @property
    def signers(self) -> list[tuple[int, int]]:
        """Systems and components whose signed packets came, and were believed."""
        return sorted({who[:2] for who, stream in self._streams.items() if stream.heard})

    def set(self, clock: SigningClock, now_ns: int) -> None:
        """It is at least so late; nothing that is known already is forgotten."""
        for system, component, link_id, last in clock.streams:
            who = (system, component, link_id)
            if who not in self._streams or self._streams[who].newest < last:
                self._streams[who] = _Stream(last)
        self.advance(now_ns)
        if clock.timestamp > self._timestamp:
            self._timestamp = clock.timestamp
            self._set = (clock.timestamp, now_ns)

    def advance(self, now_ns: int) -> None:
        """Time passed."""
        timestamp, then_ns = self._set
        if timestamp:
            timestamp += (now_ns - then_ns) // TICK_NS
            self._timestamp = max(self._timestamp, min(timestamp, TIMESTAMP_MAX))

    def sign(self, packet: bytes) -> bytes:
        """A MAVLink 2 packet without a signature, with one."""
        self._timestamp = min(self._timestamp + 1, TIMESTAMP_MAX)
        body = packet[1:2] + bytes([packet[2] | SIGNED]) + packet[3:-2]
        message_id = int.from_bytes(body[6:9], "little")
        checksum = crc16.mcrf4xx(body + bytes([CRC_EXTRA[message_id]]))
        signed = b"".join(
            (
                packet[:1],
                body,
                checksum.to_bytes(2, "little"),
                self._link_id,
                self._timestamp.to_bytes(6, "little"),
            )
        )
        return signed + self._signature(signed)

    def refusals(self, frames: Sequence[Frame], now_ns: int, forged: str = "") -> dict[int, Refusal]:
        """Which of the frames that came are not to be believed, by their number, and why.

        `forged` is asked only without a key: it is what `self.forged` was with one.
        """
        self.advance(now_ns)
        recalled = forged.split()
        refused: dict[int, Refusal] = {}
        for number, frame in enumerate(frames):
            refusal = self._refusal(frame, bool(recalled) and str(number) in recalled)
            if refusal is not None:
                refused[number] = refusal
        self.refused += len(refused)
        bad = [str(number) for number, why in refused.items() if why is Refusal.BAD_SIGNATURE]
        self.forged = " ".join(bad)
        return refused

    def _refusal(self, frame: Frame, forged: bool) -> Refusal | None:
        # The signature first: nothing is learnt from the time of a packet that anybody may have made.
        packet = frame.signed
        if not packet:
            return None if frame.message_id in _UNSIGNED else Refusal.UNSIGNED
        if self._keyed is not None:
            forged = not compare_digest(self._signature(packet[:-_HASH_BYTES]), packet[-_HASH_BYTES:])
        if forged:
            return Refusal.BAD_SIGNATURE
        timestamp = int.from_bytes(packet[-12:-6], "little")
        who = (frame.system, frame.component, packet[-SIGNATURE_BYTES])
        stream = self._streams.get(who)
        if stream is None:
            stream = _Stream(self._timestamp - NEW_STREAM_BEHIND - 1)
        if not stream.take(timestamp):
            return Refusal.REPLAYED
        self._streams[who] = stream
        self._timestamp = max(self._timestamp, timestamp)
        return None

    def _signature(self, signed: bytes) -> bytes:
        if self._keyed is None:
            return bytes(_HASH_BYTES)
        digest = self._keyed.copy()
        digest.update(signed)
        return digest.digest()[:_HASH_BYTES]


def without_hash(packet: bytes) -> bytes:
    """A signed packet as a replay makes it, which has no key: what the key put in is zeros."""
    return packet[:-_HASH_BYTES] + bytes(_HASH_BYTES)
