"""Quick packing of the few messages that leave at 30 Hz and more.

pymavlink stays the oracle (a test compares byte by byte) and packs everything else; here the fields are given
in wire order, which saves three quarters of the time of a lockstep flight's telemetry.
"""

from __future__ import annotations

from hashlib import sha256
from struct import Struct
from typing import Any, Final

from fastcrc.crc16 import mcrf4xx

_HEADER: Final = Struct("<BBBBBBBHB")
_MAGIC: Final = 0xFD
_SIGNED: Final = 0x01
_TIMESTAMP_MAX: Final = 2**48 - 1


class FrameType:
    """How one message of pymavlink's dialect is packed."""

    __slots__ = ("_crc_extra", "_id_high", "_id_low", "_pack")

    def __init__(self, message_class: Any) -> None:
        self._id_low = message_class.id & 0xFFFF
        self._id_high = message_class.id >> 16
        self._crc_extra = bytes([message_class.crc_extra])
        self._pack = message_class.unpacker.pack

    def __call__(self, *wire_values: float) -> Frame:
        """A message from its fields in wire order, arrays spread out."""
        return Frame(self, self._pack(*wire_values))

    def frame(self, payload: bytes, mav: Any) -> bytes:
        """The packet as `mav` (identity and sequence number) would send it."""
        payload = payload.rstrip(b"\0") or b"\0"
        header = _HEADER.pack(
            _MAGIC,
            len(payload),
            _SIGNED if mav.signing.sign_outgoing else 0,
            0,
            mav.seq,
            mav.srcSystem,
            mav.srcComponent,
            self._id_low,
            self._id_high,
        )
        crc: int = mcrf4xx(header[1:] + payload + self._crc_extra)
        packet = header + payload + crc.to_bytes(2, "little")
        return _signed(packet, mav.signing) if mav.signing.sign_outgoing else packet


def _signed(packet: bytes, signing: Any) -> bytes:
    timestamp = min(signing.timestamp, _TIMESTAMP_MAX)  # moved there by another holder of the key
    packet += bytes([signing.link_id]) + timestamp.to_bytes(6, "little")
    signing.timestamp = timestamp + 1
    return packet + sha256(signing.secret_key + packet).digest()[:6]


class Frame:
    """A message ready to be packed; it stands where pymavlink's message objects stand."""

    __slots__ = ("_payload", "_type")

    def __init__(self, frame_type: FrameType, payload: bytes) -> None:
        self._type = frame_type
        self._payload = payload

    def pack(self, mav: Any) -> bytes:
        """The MAVLink 2 packet."""
        return self._type.frame(self._payload, mav)
