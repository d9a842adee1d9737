"""What `guidance tune` does: plan, consent, flight, identification, report."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from rich.console import Console

from guidance.config import Config, ConfigError, load
from guidance.records import Record
from guidance.replacing import Fill
from guidance.steps_flight import fly
from guidance.steps_log import NoStepsError, read_log, results_of
from guidance.steps_plan import planned, proposed
from guidance.steps_runs import check_steps
from guidance.steps_vehicle import told_by_autopilot
from guidance.telemetry.log import NotALog
from guidance.tune.identify import Identified
from guidance.tune.propose import toml
from guidance.tune.report import as_json as json_of
from guidance.tune.report import show

CONSENT: Final = "yes"
#: Columns of the report's table, at least.
WIDTH: Final = 130


def fly_and_tell(
    path: Path,
    overrides: Sequence[str],
    speed_m_s: float | None,
    wait_s: float,
    output: Fill | None,
    *,
    yes: bool,
    as_json: bool,
) -> int:
    """Of the configuration in a file; the exit status."""
    try:
        config = load(path, overrides)
        check_steps(config)
        plan = planned(config, speed_m_s, told_by_autopilot(config, wait_s))
        _say(plan.text)
        if not (yes or _consents()):
            _say("guidance tune: not flown")
            return 1
        status, conductor = fly(plan.config, wait_s)
    except ConfigError as error:
        _say(f"guidance: {error}")
        return 2
    if conductor.stopped:
        _say("guidance tune: stopped; `guidance tune --log LOG.mcap` identifies what was flown")
        return 130
    if conductor.ended:
        _say(f"guidance tune: the flight ended early: {conductor.ended}")
    if status or not conductor.flew:
        return status or 1
    return told(plan.config, conductor.records(), output, as_json=as_json)


def tell_of_log(path: Path, output: Fill | None, *, as_json: bool) -> int:
    """Of a flight that was logged; the exit status."""
    try:
        config, records = read_log(path)
    except (NotALog, NoStepsError) as error:
        _say(f"guidance: {error}")
        return 2
    return told(config, records, output, as_json=as_json)


def told(config: Config, records: Iterable[Record], output: Fill | None, *, as_json: bool) -> int:
    """Identify and propose: the report on stdout, with JSON there on stderr; 0 if nothing was refused."""
    results = results_of(config, records)
    found = [isinstance(result, Identified) for result in results.values()]
    lines = proposed(config, results) if any(found) else ()
    console = Console(stderr=as_json, soft_wrap=True, highlight=False)
    console.width = max(console.width, WIDTH)  # figures that are cut off are none
    show(results, lines, console)
    if as_json:
        sys.stdout.write(json.dumps(json_of(results, lines)) + "\n")
    if output is not None and lines:
        output(lambda part: part.write_text(toml(lines), encoding="utf-8"))
    return 0 if all(found) else 1


def _consents() -> bool:
    """Anything but the word is no, and so is an end of input."""
    sys.stderr.write(f"Type {CONSENT} to fly it: ")
    sys.stderr.flush()
    return sys.stdin.readline().strip() == CONSENT


def _say(text: str) -> None:
    Console(stderr=True, soft_wrap=True, highlight=False).print(text, markup=False)
