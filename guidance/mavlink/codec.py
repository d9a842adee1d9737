"""Bytes to MAVLink frames and back: framing, checksums, sequence gaps; no decision about their content.

The reader is written for hostile input. Its invariant, which the tests hold against arbitrary bytes:

- it raises nothing, keeps less than one frame of bytes between calls and none of a datagram, and its work
  is linear in what arrives;
- a frame of a known id is handed out only if its checksum holds;
- every byte is part of exactly one frame, counted as garbage, or kept for the next call. So a frame that
  follows garbage is lost only where the garbage claims to be a frame of an id that the dialect does not
  know, because its checksum cannot be computed; it is taken for one only up to another start byte.

It resynchronises at the next start byte after a bad checksum instead of skipping the frame's claimed length,
so that a damaged frame costs only itself. pymavlink's own parser is the oracle in the tests.
"""

from __future__ import annotations

import re
from collections import Counter
from struct import Struct
from typing import Any, Final, NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import CRC_EXTRA

START_V1: Final = 0xFE
START_V2: Final = 0xFD
_START: Final = re.compile(rb"[\xfd\xfe]")
#: Of the incompatibility flags: a signature follows.
SIGNED: Final = 0x01
SIGNATURE_BYTES: Final = 13
#: MAVLink 2 between the start byte and the payload; the message id has three bytes.
_HEADER: Final = Struct("<6BHB")
_EXTRA: Final = {message_id: bytes([extra]) for message_id, extra in CRC_EXTRA.items()}


class Frame(NamedTuple):
    """One MAVLink packet with a checksum that holds (or an id that the dialect does not know).

    `signed` is the whole packet if a signature follows it, which nobody has looked at yet; else empty.
    """

    message_id: int
    system: int
    component: int
    sequence: int
    payload: bytes
    known: bool
    signed: bytes = b""


class FrameReader:
    """Splits a byte stream (serial, TCP) or datagrams (UDP) into frames.

    With `stream=False` a frame never spans two calls: a cut datagram cannot swallow the next one. A stream
    may hold a frame back until as many bytes have come as the garbage before it claims, at most 280.
    `counters` holds `garbage_bytes`, the `unknown_message` frames, and, for each start byte that begins no
    frame, why: `bad_checksum`, `truncated` or `unsupported_flags`.
    """

    def __init__(self, *, stream: bool = False) -> None:
        self.counters: Counter[str] = Counter()
        self._stream = stream
        self._rest = b""

    def forget(self) -> None:
        """The stream was interrupted: what was kept of a frame has no end any more."""
        if self._rest:
            self.counters["garbage_bytes"] += len(self._rest)
            self._rest = b""

    def feed(self, data: bytes) -> list[Frame]:
        """The frames completed by `data`, in order."""
        buffer = self._rest + data if self._rest else data
        self._rest = b""
        frames: list[Frame] = []
        position, end = 0, len(buffer)
        while position < end:
            length = self._length(buffer, position)
            if length is None:
                position = self._skip(buffer, position)
            elif end - position < length:
                if self._stream:
                    self._rest = buffer[position:]
                    break
                # A start byte in garbage may claim more than there is; a whole frame may stand behind it.
                self.counters["truncated"] += 1
                position = self._skip(buffer, position)
            else:
                frame = _frame(buffer, position)
                after = position + length
                if frame is not None and not frame.known:
                    if after == end and self._stream:  # the next byte tells
                        self._rest = buffer[position:]
                        break
                    if after < end and buffer[after] not in (START_V1, START_V2):
                        frame = None
                    else:
                        self.counters["unknown_message"] += 1
                if frame is None:
                    self.counters["bad_checksum"] += 1
                    position = self._skip(buffer, position)
                else:
                    frames.append(frame)
                    position = after
        return frames

    def _length(self, buffer: bytes, position: int) -> int | None:
        """Bytes of the frame that seems to start here, None if none can; a cut header counts as too long."""
        left = len(buffer) - position
        if buffer[position] == START_V1:
            return 8 + buffer[position + 1] if left > 1 else 8
        if buffer[position] != START_V2:
            return None
        if left < 3:
            return 12
        flags = buffer[position + 2]
        if flags & ~SIGNED:  # by the specification, flags that are not understood discard the packet
            self.counters["unsupported_flags"] += 1
            return None
        return 12 + buffer[position + 1] + (SIGNATURE_BYTES if flags & SIGNED else 0)

    def _skip(self, buffer: bytes, position: int) -> int:
        found = _START.search(buffer, position + 1)
        following = len(buffer) if found is None else found.start()
        self.counters["garbage_bytes"] += following - position
        return following


def _frame(buffer: bytes, position: int) -> Frame | None:
    """The frame at `position` if its checksum holds; an unknown id cannot be checked and comes marked."""
    if buffer[position] == START_V2:
        header = 10
        sequence, system, component = buffer[position + 4 : position + 7]
        message_id = int.from_bytes(buffer[position + 7 : position + 10], "little")
    else:
        header = 6
        sequence, system, component, message_id = buffer[position + 2 : position + 6]
    body_end = position + header + buffer[position + 1]
    signed = b""
    if header == 10 and buffer[position + 2] & SIGNED:
        signed = buffer[position : body_end + 2 + SIGNATURE_BYTES]
    payload = buffer[position + header : body_end]
    extra = _EXTRA.get(message_id)
    if extra is None:
        return Frame(message_id, system, component, sequence, payload, False, signed)
    checksum = crc16.mcrf4xx(buffer[position + 1 : body_end] + extra)
    if checksum != buffer[body_end] | buffer[body_end + 1] << 8:
        return None
    return Frame(message_id, system, component, sequence, payload, True, signed)


class Payload(NamedTuple):
    """A message as the bytes of its payload, for what goes out too often to be packed by pymavlink."""

    message_id: int
    payload: bytes


class PacketWriter:
    """Packs messages with this component's ids and a running sequence number."""

    def __init__(self, system: int, component: int) -> None:
        self._mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)

    def pack(self, message: Any) -> bytes:
        """The wire bytes of a `Payload` or of one of pymavlink's message objects (MAVLink 2, unsigned)."""
        packet = self._frame(*message) if isinstance(message, Payload) else bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return packet

    def _frame(self, message_id: int, payload: bytes) -> bytes:
        payload = payload.rstrip(b"\0") or payload[:1]
        mav = self._mav
        header = _HEADER.pack(
            len(payload),
            0,
            0,
            mav.seq,
            mav.srcSystem,
            mav.srcComponent,
            message_id & 0xFFFF,
            message_id >> 16,
        )
        checksum = crc16.mcrf4xx(header + payload + _EXTRA[message_id])
        return b"\xfd" + header + payload + checksum.to_bytes(2, "little")
