"""The parameter protocol (PARAM_REQUEST_LIST, PARAM_REQUEST_READ, PARAM_SET, PARAM_VALUE).

PX4 carries integers bytewise in the float field, ArduPilot by value (MAVLink parameter encodings). Values are
kept in float32 or int32 as a real vehicle keeps them, and survive a reboot.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple

from pymavlink.dialects.v20 import all as mavlink

REAL32: Final = 9
INT8: Final = 2
INT16: Final = 4
INT32: Final = 6
_UINT32: Final = 5
_NO_INDEX: Final = 65535
_INTEGER_RANGE: Final = {INT8: 2**7, INT16: 2**15, INT32: 2**31}


class Parameter(NamedTuple):
    """A default and its MAVLink type."""

    default: float
    type: int = REAL32


class ParameterSet:
    """Named numbers of the firmware, and the messages that read and write them.

    Raises:
        ValueError: an override names an unknown parameter or has a value that its type cannot hold.
    """

    def __init__(
        self, defaults: Mapping[str, Parameter], overrides: Mapping[str, float], *, bytewise: bool
    ) -> None:
        self._types = {name: parameter.type for name, parameter in sorted(defaults.items())}
        self._values = {name: _stored(defaults[name].default, kind) for name, kind in self._types.items()}
        self._bytewise = bytewise
        for name, value in overrides.items():
            if name not in self._types:
                raise ValueError(f"unknown parameter {name}; this vehicle has {', '.join(self._types)}")
            if not self.set(name, value):
                raise ValueError(f"parameter {name} cannot be {value}")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> bool:
        """Store `value` if there is such a parameter and its type can hold it."""
        kind = self._types.get(name)
        if kind is None or not math.isfinite(value):
            return False
        if kind == REAL32 and abs(value) > 3.4e38:
            return False
        if kind != REAL32 and not -_INTEGER_RANGE[kind] <= value < _INTEGER_RANGE[kind]:
            return False
        self._values[name] = _stored(value, kind)
        return True

    def answers(self, message: Any) -> list[Any]:
        """What is said to PARAM_REQUEST_LIST, PARAM_REQUEST_READ and PARAM_SET."""
        match message.get_type():
            case "PARAM_REQUEST_LIST":
                return self._all()
            case "PARAM_REQUEST_READ":
                answer = self._read(message)
            case _:
                answer = self._write(message)
        return [] if answer is None else [answer]

    def _all(self) -> list[Any]:
        """The answer to PARAM_REQUEST_LIST; PX4 leads with its hash."""
        messages = [self._message(name) for name in self._values]
        return [self._hash_message(), *messages] if self._bytewise else messages

    def _read(self, request: Any) -> Any | None:
        """The answer to PARAM_REQUEST_READ, by index if that is 0 or more, else by name."""
        if request.param_index >= 0:
            names = list(self._values)
            index = request.param_index
            return self._message(names[index]) if index < len(names) else None
        if self._bytewise and request.param_id == "_HASH_CHECK":
            return self._hash_message()
        return self._message(request.param_id) if request.param_id in self._values else None

    def _write(self, request: Any) -> Any | None:
        """Obey PARAM_SET; the answer carries the value now in force. Unknown name, wrong type: None."""
        name, kind = request.param_id, self._types.get(request.param_id)
        if kind is None:
            return None
        value = request.param_value
        if self._bytewise:
            # PX4 refuses a type that is not the parameter's: the bytes would mean something else.
            if request.param_type != kind:
                return None
            if kind != REAL32:
                value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        self.set(name, value)
        return self._message(name)

    def _message(self, name: str) -> Any:
        kind, value = self._types[name], self._values[name]
        if self._bytewise and kind != REAL32:
            value = struct.unpack("<f", struct.pack("<i", int(value)))[0]
        index = list(self._values).index(name)
        return mavlink.MAVLink_param_value_message(name.encode(), value, kind, len(self._values), index)

    def _hash_message(self) -> Any:
        digest = sum(struct.unpack("<I", struct.pack("<f", value))[0] for value in self._values.values())
        value = float(digest % 2**24)
        return mavlink.MAVLink_param_value_message(
            b"_HASH_CHECK", value, _UINT32, len(self._values), _NO_INDEX
        )


def _stored(value: float, kind: int) -> float:
    """The value as float32 or integer storage keeps it."""
    if kind != REAL32:
        return float(round(value))
    stored: float = struct.unpack("<f", struct.pack("<f", value))[0]
    return stored
