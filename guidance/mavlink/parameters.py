"""The autopilot's parameters, read by name: PARAM_REQUEST_READ (20) out, PARAM_VALUE (22) in.

Questions and answers may be lost, and neither autopilot answers for a name that it does not know. So each is
asked for again, a few at a time to spare the line, and what was asked for often enough counts as absent.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from math import isnan
from types import MappingProxyType
from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import ParamValue

#: Asked for so often without an answer there is no such parameter (at 30 % of loss each way: 1 in 200).
TIMES_ASKED: Final = 8
_AT_ONCE: Final = 4
_ANSWER_NS: Final = 300_000_000

_REAL32: Final = struct.Struct("<f")
_INTEGERS: Final = {
    dialect.MAV_PARAM_TYPE_UINT8: struct.Struct("<B3x"),
    dialect.MAV_PARAM_TYPE_INT8: struct.Struct("<b3x"),
    dialect.MAV_PARAM_TYPE_UINT16: struct.Struct("<H2x"),
    dialect.MAV_PARAM_TYPE_INT16: struct.Struct("<h2x"),
    dialect.MAV_PARAM_TYPE_UINT32: struct.Struct("<I"),
    dialect.MAV_PARAM_TYPE_INT32: struct.Struct("<i"),
}


def value_of(message: ParamValue, *, bytewise: bool) -> float:
    """The number in a PARAM_VALUE. PX4 puts an integer's bytes there (`bytewise`), ArduPilot its value."""
    layout = _INTEGERS.get(message.param_type, _REAL32) if bytewise else _REAL32
    return float(layout.unpack(message.param_value)[0])


def name_of(message: ParamValue) -> str:
    """The parameter's name: 16 characters are not ended by a zero."""
    return message.param_id.partition(b"\0")[0].decode("ascii", "replace")


def request_read(name: str, system: int, component: int) -> Any:
    """PARAM_REQUEST_READ by name."""
    return dialect.MAVLink_param_request_read_message(system, component, name.encode(), -1)


class ParameterReader:
    """Reads some parameters of one autopilot; `values` are those that were answered.

    Of `partners`, names of one parameter, one answer will do.
    """

    def __init__(
        self,
        names: Iterable[str],
        *,
        bytewise: bool,
        partners: Mapping[str, tuple[str, ...]] = MappingProxyType({}),
    ) -> None:
        self.values: dict[str, float] = {}
        self._bytewise = bytewise
        self._partners = partners
        self._asked = dict.fromkeys(names, 0)
        self._asked_ns: dict[str, int] = {}  # of those whose answer is awaited

    def take(self, message: ParamValue) -> bool:
        """An answer, to us or to somebody else; whether it says anything new."""
        name = name_of(message)
        if name not in self._asked:
            return False
        value = value_of(message, bytewise=self._bytewise)
        before = self.values.get(name)
        self.values[name] = value
        self._asked_ns.pop(name, None)
        return value != before and not (before is not None and isnan(value) and isnan(before))

    def again(self, names: Iterable[str]) -> None:
        """Ask for these as if they had never been asked for."""
        self._asked.update(dict.fromkeys(names, 0))

    def due(self, now_ns: int) -> list[str]:
        """The names to ask for now."""
        for name, asked_ns in list(self._asked_ns.items()):
            if now_ns - asked_ns >= _ANSWER_NS:
                del self._asked_ns[name]
        wanted = [n for n in self._asked if n not in self._asked_ns and self._wanted(n)]
        now = sorted(wanted, key=self._asked.__getitem__)[: _AT_ONCE - len(self._asked_ns)]
        for name in now:
            self._asked[name] += 1
            self._asked_ns[name] = now_ns
        return now

    def _wanted(self, name: str) -> bool:
        known = name in self.values or self._answered_for(name)
        return not known and self._asked[name] < TIMES_ASKED

    def _answered_for(self, name: str) -> bool:
        return any(other in self.values for other in self._partners.get(name, ()))

    @property
    def complete(self) -> bool:
        """Whether each has a value or counts as absent."""
        awaited = (name for name in self._asked_ns if not self._answered_for(name))
        return not any(awaited) and not any(map(self._wanted, self._asked))

    def deadline(self, now_ns: int) -> int | None:
        """When `due` has something new to say, ns; None if never."""
        if any(self._wanted(n) for n in self._asked if n not in self._asked_ns):
            if len(self._asked_ns) < _AT_ONCE:
                return now_ns
        elif not self._asked_ns:
            return None
        return min(self._asked_ns.values()) + _ANSWER_NS
