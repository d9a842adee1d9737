"""What a hostile world throws: numbers, texts, bytes and JSON, from one seed."""

from __future__ import annotations

import math
import random
from struct import Struct
from typing import Any, Final

#: Numbers at the edge of what a float32, a float64 or a computation holds.
EDGES: Final = (
    *(0.0, -0.0, 1.0, -1.0, 0.5, 2.0, math.pi, -math.pi, 360.0, 1e-6, 1e-20, 1e20, -1e20),
    *(math.nan, math.inf, -math.inf, 1e-45, -1e-45, 1.17549435e-38, 3.4028235e38, -3.4028235e38),
)
_FLOAT32: Final = Struct("<f")
_TEXTS: Final = (
    *("", " ", "\0", "\x1b[31mred\x1b[0m", "\x1b]0;title\x07", "\r\n", "\u202e", "\ud7ff", "\U0001f681"),
    *("%s%n", "{0}", "${HOME}", "../../etc/passwd", "NaN", "null", "[bold]x[/bold]", "[/]", "x" * 3000),
)
_JSON: Final = (
    *("null", "true", "-1", "0", "1e999", "-1e308", "9223372036854775808", "-9223372036854775809"),
    *(
        "1" * 400,
        '""',
        '"\\u0000"',
        '"\\ud800"',
        '"\\u001b[2J"',
        "[]",
        "{}",
        "[" * 2000,
        '"' + "x" * 3000 + '"',
    ),
    *("1.5", "18446744073709551616", "4611686018427387904", '"tracking"', "[null]", "NaN", "[1,2,3]"),
)


class Dice(random.Random):
    """Random numbers of one seed, with hostile ones among them."""

    def chance(self, probability: float) -> bool:
        """Whether it happens."""
        return self.random() < probability

    def real(self) -> float:
        """Often an edge, sometimes any float32 there is, else an ordinary number."""
        kind = self.random()
        if kind < 0.5:
            return self.choice(EDGES)
        if kind < 0.65:
            return float(_FLOAT32.unpack(self.randbytes(4))[0])
        return self.uniform(-10.0, 10.0)

    def whole(self, low: int, high: int) -> int:
        """An integer of the range: its ends, the middle, something small, or any."""
        kind = self.random()
        if kind < 0.3:
            return self.choice((low, high, low + 1, high - 1, (low + high) // 2))
        if kind < 0.6:
            return min(max(self.randrange(-3, 12), low), high)
        return self.randint(low, high)

    def text(self) -> str:
        """A text that somebody may have meant badly."""
        if self.chance(0.5):
            return self.choice(_TEXTS)
        return "".join(map(chr, self.choices(range(0xD7FF), k=self.randrange(20))))

    def json(self) -> bytes:
        """A JSON value, or nearly one."""
        return b"[" * 5000 if self.chance(0.2) else self.choice(_JSON).encode()

    def mutated(self, data: bytes, times: int = 0) -> bytes:
        """The same with bits flipped, bytes replaced, and pieces cut out, put in, repeated or moved."""
        for _ in range(times or self.choice((1, 1, 1, 2, 4))):
            data = self._mutated(data)
        return data

    def _mutated(self, data: bytes) -> bytes:
        at = self.randrange(len(data) + 1)
        kind = self.randrange(7)
        if kind == 0 and at < len(data):
            return data[:at] + bytes([data[at] ^ 1 << self.randrange(8)]) + data[at + 1 :]
        if kind == 1 and at < len(data):
            return data[:at] + self.choice((b"\0", b"\xff", b"\x7f", b"\x80", b"\xfd")) + data[at + 1 :]
        if kind == 2:
            return data[:at]
        if kind == 3:
            return data[:at] + data[at + self.randrange(1, 17) :]
        if kind == 4:
            return data[:at] + self.randbytes(self.randrange(1, 17)) + data[at:]
        if kind == 5:
            return data[:at] + data[max(at - self.randrange(1, 33), 0) :]
        return data[at:] + data[:at]

    def changed(self, value: Any) -> Any:
        """A decoded JSON value with something in it replaced, left out or added; raw JSON is `Raw`."""
        if isinstance(value, dict) and value and self.chance(0.95):
            fields = dict(value)
            name = self.choice(sorted(fields))
            if self.chance(0.1):
                del fields[name]
            elif self.chance(0.1):
                fields[self.text()] = self.scalar()
            else:
                fields[name] = self.changed(fields[name])
            return fields
        if isinstance(value, list) and value and self.chance(0.8):
            items = list(value)
            index = self.randrange(len(items))
            items[index] = self.changed(items[index])
            return items if self.chance(0.9) else items * self.choice((0, 2, 50))
        if isinstance(value, int | float) and self.chance(0.6):
            return self.choice(
                (-value, value + 1, value * 2, value / 3, value * 1_000_000, 0, 0.0, int(value))
            )
        if isinstance(value, str) and self.chance(0.5):
            return self.text()
        return self.scalar()

    def scalar(self) -> Any:
        """Something that JSON can say."""
        number = self.real()
        choices: tuple[Any, ...] = (
            None,
            True,
            "",
            self.text(),
            self.whole(-(2**63), 2**63 - 1),
            2**63,
            [],
            {},
            0,
            -1,
        )
        return number if math.isfinite(number) and self.chance(0.5) else self.choice(choices)
