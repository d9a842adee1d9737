"""MAVLink frames of any content with every checksum right, and the payloads of messages, field by field.

Written beside guidance's own codec and on purpose without it: it would refuse to write most of this.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from struct import Struct
from typing import Any, Final, NamedTuple

from fastcrc import crc16
from pymavlink.dialects.v20 import all as dialect

from sitl.fuzzing.dice import Dice

_BITS: Final = {"b": 8, "h": 16, "i": 32, "q": 64}
#: Lowest and highest number of each integer code.
_RANGES: Final = {code: (-(1 << bits - 1), (1 << bits - 1) - 1) for code, bits in _BITS.items()} | {
    code.upper(): (0, (1 << bits) - 1) for code, bits in _BITS.items()
}
#: Every message that the dialect knows.
IDS: Final = tuple(sorted(dialect.mavlink_map))


class Field(NamedTuple):
    """One field of a message in the order of the wire; `length` numbers or, for code `s`, bytes."""

    name: str
    code: str
    length: int


class Signer(NamedTuple):
    """Who signs: the key, the link id and the timestamp (10 us since 2015)."""

    key: bytes
    link_id: int
    timestamp: int


def fields(message_id: int) -> tuple[Field, ...]:
    """Those of a message of the dialect."""
    message: Any = dialect.mavlink_map[message_id]
    places = re.findall(r"(\d*)([a-zA-Z])", message.unpacker.format)
    names = message.ordered_fieldnames
    return tuple(
        Field(name, code, int(count or 1)) for name, (count, code) in zip(names, places, strict=True)
    )


LAYOUTS: Final = {message_id: fields(message_id) for message_id in IDS}
_PACK: Final[dict[int, Callable[..., bytes]]] = {
    message_id: Struct(dialect.mavlink_map[message_id].unpacker.format).pack for message_id in IDS
}


def payload(message_id: int, dice: Dice, known: dict[str, list[Any]], hostility: float) -> bytes:
    """A payload: each field is what is `known` of it (its numbers), or, as likely as `hostility`, hostile."""
    values: list[Any] = []
    for name, code, count in LAYOUTS[message_id]:
        if name in known and not dice.chance(hostility):
            values += known[name]
        elif code == "s":
            values.append(dice.text().encode("utf-8", "replace")[:count])
        elif code == "c":
            values += [dice.randbytes(1) for _ in range(count)]
        elif code in "fd":
            values += [dice.real() for _ in range(count)]
        else:
            values += [dice.whole(*_RANGES[code]) for _ in range(count)]
    return _PACK[message_id](*values)


def fitting(message_id: int, known: dict[str, Any]) -> dict[str, list[Any]]:
    """Of what is known (numbers, tuples, bytes) what the message has a field for, as the field has it."""
    fits: dict[str, list[Any]] = {}
    for name, code, count in LAYOUTS[message_id]:
        value = known.get(name)
        if code == "s" and isinstance(value, bytes):
            fits[name] = [value]
        elif value is not None and code not in "sc" and not isinstance(value, bytes):
            values = list(value) if isinstance(value, tuple) else [value]
            if len(values) == count:
                fits[name] = values if code in "fd" else [int(number) for number in values]
    return fits


def frame(
    message_id: int,
    content: bytes,
    sequence: int,
    *,
    system: int = 1,
    component: int = 1,
    version: int = 2,
    signer: Signer | None = None,
) -> bytes:
    """A packet with a right checksum (and signature), whatever is in it; MAVLink 1 if its id allows that."""
    content = content[:255]
    extra = bytes([dialect.mavlink_map[message_id].crc_extra]) if message_id in LAYOUTS else b"\0"
    if version == 1 and message_id < 256:
        body = bytes([len(content), sequence % 256, system, component, message_id]) + content
        return b"\xfe" + body + crc16.mcrf4xx(body + extra).to_bytes(2, "little")
    flags = 0 if signer is None else 1
    head = bytes([len(content), flags, 0, sequence % 256, system, component])
    body = head + message_id.to_bytes(3, "little") + content
    packet = b"\xfd" + body + crc16.mcrf4xx(body + extra).to_bytes(2, "little")
    if signer is None:
        return packet
    packet += bytes([signer.link_id]) + signer.timestamp.to_bytes(6, "little")
    return packet + hashlib.sha256(signer.key + packet).digest()[:6]
