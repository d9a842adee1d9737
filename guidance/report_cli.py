"""The command line of `guidance report`."""

from __future__ import annotations

import json
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from guidance.entry import failed, output_file, refused
from guidance.journal import tell
from guidance.progress import reading
from guidance.records import Level

if TYPE_CHECKING:
    from guidance.replacing import Fill
    from guidance.report.panels import Shown

#: What the extra `report` brings.
EXTRA = frozenset({"numpy", "plotly", "matplotlib"})


def without_extra(error: ModuleNotFoundError) -> typer.Exit:
    """The exit to raise for a module of the extra that is missing; raises the error if it is another."""
    if error.name is None or error.name.partition(".")[0] not in EXTRA:
        raise error
    return refused("guidance", f"{error.name} is missing: pip install 'se3-guidance[report]'")


def report(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG.mcap...", help="Logs that the service wrote, each a flight.")
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="The HTML file to write.")
    ] = Path("report.html"),
    png: Annotated[
        Path | None, typer.Option("--png", metavar="DIR", help="Write the plots here as PNG, too.")
    ] = None,
    converged: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            max=1e6,
            help="Converged is an error below this for good, m; else as its class.",
            show_default=False,
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON on stdout.")] = False,
) -> None:
    """Write what was flown and how well as one HTML file that opens anywhere, without a network.

    Several logs are set side by side. Of a log in several files any one may be named. A log that ends early
    is reported on as far as it goes, and marked.

    Exit status 0 if it was written, 1 if there is no flight in a log or it could not be written, 2 for no log
    of ours. It needs the extra "report".

    Examples:

    \b
    guidance report logs/FLIGHT.mcap
    guidance report logs/MONDAY.mcap logs/TUESDAY.mcap --output compared.html --png plots
    guidance report logs/FLIGHT.mcap --json
    """
    try:
        from guidance.report.judged import as_json as json_of
        from guidance.report.page import page

        if png is not None:
            from guidance.report import plots
    except ModuleNotFoundError as error:
        raise without_extra(error) from None
    with ExitStack() as files:
        fill = files.enter_context(output_file("guidance", output))
        if png is not None:
            _check_images(png)
        shown = flights_of(logs, converged)
        if as_json:
            typer.echo(json.dumps(json_of([(one.flight, one.figures) for one in shown])))
        write(fill, output, page(shown))
    if png is not None:
        try:
            made = plots.write(shown, png)
        except (OSError, ValueError) as error:
            raise failed("guidance", error) from None
        tell(Level.INFO, "guidance", f"{png}: {', '.join(path.name for path in made)}")


def flights_of(logs: list[Path], converged_m: float | None = None) -> list[Shown]:
    """The logs, read and judged; says which are incomplete. Exit 1 where none is flown, 2 for no log."""
    from guidance.report.flight import NoFlightError, ReportError
    from guidance.report.reading import read_all
    from guidance.telemetry.log import NotALog

    try:
        with reading("guidance report") as passed:
            shown = read_all(logs, converged_m, passed)
    except NoFlightError as error:
        raise failed("guidance", error) from None
    except (NotALog, ReportError) as error:
        raise refused("guidance", error) from None
    for one in shown:
        if one.flight.incomplete:
            tell(Level.WARNING, "guidance", f"{one.flight.incomplete}; reporting on what is there")
    return shown


def write(fill: Fill, path: Path, text: str) -> None:
    """The HTML file, and a line on stderr that says where; Exit 1 if it cannot be written."""
    content = text.encode()
    fill(lambda part: part.write_bytes(content))
    tell(Level.INFO, "guidance", f"{path}: {len(content) / 1e6:.1f} MB")


def _check_images(directory: Path) -> None:
    """Exit 1 if no images can be written there, 2 if a log has the name of one; before all the work."""
    from guidance.replacing import LogInTheWayError, refuse_log

    try:
        directory.mkdir(parents=True, exist_ok=True)
        for path in directory.glob("*.png"):
            refuse_log(path)
    except OSError as error:
        raise failed("guidance", f"{directory}: cannot be written: {error.strerror}") from None
    except LogInTheWayError as error:
        raise refused("guidance", error) from None
    except ValueError as error:
        raise failed("guidance", error) from None
