"""What each open page is owed. A page that is too slow is owed less, never a backlog."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

import msgspec

from guidance.dashboard.rows import COLUMNS, KEPT_S, ROW, TICK_HZ, WRAP_S

#: So many rows may wait (2 s); then the page begins anew, with all that is kept.
ROWS_MAX: Final = 2 * TICK_HZ
ANSWERS_MAX: Final = 32
#: What is kept goes in pieces: one message of it all, over a slow network, would look like a dead connection.
PIECE_BYTES: Final = 5 * TICK_HZ * ROW.size

_encode: Final = msgspec.json.Encoder().encode


def _new(_: str) -> float:
    return 0.0


class Page:
    """The debts to one page, and the vehicle that it shows; empty is none."""

    def __init__(self) -> None:
        self.vehicle = ""
        self._beginning = False
        self._rows: list[bytes] = []
        self._fleet: bytes | None = None
        self._about: bytes | None = None
        self._plan: bytes | None = None
        self._knows: bytes | None = None  # the plan that it was given last
        self._answers: deque[bytes] = deque(maxlen=ANSWERS_MAX)

    def see(self, vehicle: str) -> None:
        """It shows this one from now on."""
        self.vehicle = vehicle
        self._plan = self._knows = None
        self.begin()

    def begin(self) -> None:
        """It is owed every row that is kept."""
        self._beginning, self._rows = bool(self.vehicle), []
        self._about = None

    def owe_row(self, row: bytes) -> None:
        """A row of its vehicle."""
        if self._beginning:
            return  # in what it is given then
        self._rows.append(row)
        if len(self._rows) > ROWS_MAX:
            self.begin()

    def owe_fleet(self, said: bytes) -> None:
        """The newest is enough."""
        self._fleet = said

    def owe_about(self, said: bytes) -> None:
        """The same, of its vehicle."""
        self._about = said

    def owe_plan(self, said: bytes) -> None:
        """The path that is planned for its vehicle: only another one than it knows."""
        self._plan = None if said is self._knows else said

    def owe_answer(self, said: bytes) -> None:
        """What became of an order of its."""
        self._answers.append(said)

    def take(self, ring: Callable[[str], bytes], age_s: Callable[[str], float] = _new) -> list[str | bytes]:
        """All that it is owed, in order: JSON as text, rows as bytes.

        Args:
            ring: gives every row of a vehicle.
            age_s: how old the newest of them is.
        """
        owed: list[str | bytes] = [answer.decode() for answer in self._answers]
        self._answers.clear()
        if self._fleet is not None:
            owed.append(self._fleet.decode())
            self._fleet = None
        if self._beginning:
            self._beginning = False
            kept = ring(self.vehicle)
            owed.append(begins(self.vehicle, len(kept) // ROW.size, age_s(self.vehicle)))
            owed += [kept[at : at + PIECE_BYTES] for at in range(0, len(kept), PIECE_BYTES)]
        elif self._rows:
            owed.append(b"".join(self._rows))
            self._rows = []
        if self._about is not None:
            owed.append(self._about.decode())
            self._about = None
        if self._plan is not None:
            owed.append(self._plan.decode())
            self._knows, self._plan = self._plan, None
        return owed


def begins(vehicle: str, kept: int, age_s: float) -> str:
    """What is told before every row of a vehicle: what the rows are, and that so many of them are of before,
    the newest of them so old."""
    said = {
        "kind": "begin",
        "vehicle": vehicle,
        "columns": COLUMNS,
        "wrap_s": WRAP_S,
        "rows": KEPT_S * TICK_HZ,
        "kept": kept,
        "age_s": age_s,
    }
    return _encode(said).decode()
