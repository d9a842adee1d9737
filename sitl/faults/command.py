"""`sitl faults`: which faults, flown how, shown where."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Final, Protocol, TypeVar

import typer
from rich.console import Console

from guidance.entry import refused
from guidance.progress import stepped

if TYPE_CHECKING:  # the service's core is slow to import: only who flies waits for it
    from rich.table import Table


class _Titled(Protocol):
    @property
    def title(self) -> str: ...


_Row = TypeVar("_Row", bound=_Titled)
#: Wide enough for a row in one line, where no terminal says how wide it is.
PLAIN_WIDTH: Final = 170
_ONLY: Final = "Faults whose title holds this; repeatable. Default: all."


def faults(
    only: Annotated[list[str] | None, typer.Option(metavar="TITLE", help=_ONLY)] = None,
    ships: Annotated[
        bool, typer.Option("--ships", help="Every profile as it ships, on its own body, instead: minutes.")
    ] = False,
    seed: Annotated[int, typer.Option(help="Of the dice; the same seed gives the same bytes.")] = 0,
    real: Annotated[
        bool, typer.Option("--real", help="Those over real sockets and processes instead: a minute.")
    ] = False,
    list_only: Annotated[
        bool, typer.Option("--list", help="Say what there is and what is expected; fly nothing.")
    ] = False,
    as_object: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Let everything fail, in flight, and see that the outcome is the safe one.

    Flown on virtual time against the built-in vehicle, in less than a minute. Whatever fails, no setpoint may
    be outside the limits, made of an old state, sent twice, or sent after a hand-over. `--only` takes a
    profile's name, too.

    Exit status 0 only if every outcome is as expected, 1 if one is not, 2 if no title holds TITLE.

    Examples:

    \b
    sitl faults --list
    sitl faults --only reboot --only "lost" --seed 3
    sitl faults --real --json
    """
    try:
        rows, shown, words = (
            _real(only or [], list_only) if real else _flown(only or [], seed, list_only, ships)
        )
    except ValueError as error:
        raise refused("sitl faults", error) from None
    passed = all(row["passed"] for row in rows if "passed" in row)
    if as_object:
        typer.echo(json.dumps({"passed": passed, "faults": rows}))
    else:
        # A pipe has no width: there the table is as wide as it needs to be.
        console = Console()
        console = console if console.is_terminal else Console(width=PLAIN_WIDTH)
        console.print(shown)
        console.print(words, highlight=False)
    raise typer.Exit(0 if passed else 1)


def _flown(
    only: Sequence[str], seed: int, list_only: bool, ships: bool
) -> tuple[list[dict[str, Any]], Table, str]:
    """Rows for JSON, the table, and a last line."""
    from sitl.faults.profile_faults import PROFILE_FAULTS
    from sitl.faults.report import as_json, listed, table
    from sitl.faults.run import fly
    from sitl.faults.table import TABLE

    chosen = _chosen(PROFILE_FAULTS if ships else TABLE, only)
    titles = f"{len(chosen)} flights of {len({fault.title for fault in chosen})} faults"
    if list_only:
        return (
            [{"title": fault.title, "firmware": fault.vehicle_name} for fault in chosen],
            listed(chosen),
            titles,
        )
    outcomes = [fly(fault, seed) for fault in _watched(chosen)]
    rows = [as_json(fault, outcome, seed) for fault, outcome in zip(chosen, outcomes, strict=True)]
    failed = sum(not outcome.passed for outcome in outcomes)
    return rows, table(chosen, outcomes), f"{titles}: {f'{failed} FAILED' if failed else 'all passed'}"


def _real(only: Sequence[str], list_only: bool) -> tuple[list[dict[str, Any]], Table, str]:
    from sitl.faults import real

    chosen = _chosen(real.TABLE, only)
    if list_only:
        return [{"title": fault.title} for fault in chosen], real.table(chosen, []), f"{len(chosen)} faults"
    outcomes = [real.fly(fault) for fault in _watched(chosen)]
    failed = sum(bool(outcome.problems) for outcome in outcomes)
    verdict = f"{failed} FAILED" if failed else "all passed"
    return (
        [outcome.as_json() for outcome in outcomes],
        real.table(chosen, outcomes),
        f"{len(chosen)} faults over real sockets: {verdict}",
    )


def _chosen(rows: Sequence[_Row], only: Sequence[str]) -> list[_Row]:
    """Those whose title holds one of the texts, in any case, or of the profile of that name.

    Raises:
        ValueError: no title holds one of them.
    """
    for text in only:
        if not any(_holds(row, text) for row in rows):
            raise ValueError(f"no fault's title holds {text!r}: see sitl faults --list")
    return [row for row in rows if not only or any(_holds(row, text) for text in only)]


def _holds(row: _Titled, text: str) -> bool:
    return text.casefold() in row.title.casefold() or text == getattr(row, "firmware", "")


def _watched(chosen: Sequence[_Row]) -> Iterator[_Row]:
    """With what somebody who waits wants to know."""
    return stepped("sitl faults", "faults", chosen, len(chosen))
