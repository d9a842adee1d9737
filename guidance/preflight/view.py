"""What was found, on one screen or as JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from rich.console import Console
from rich.table import Table
from rich.text import Text

from guidance.preflight.findings import Finding, Verdict
from guidance.printable import printable

_STYLES: Final = {
    Verdict.OK: "green",
    Verdict.WARN: "yellow",
    Verdict.FAIL: "bold red",
    Verdict.SKIP: "dim",
}

Findings = Sequence[tuple[str, Finding]]


def passed(findings: Findings) -> bool:
    """Whether nothing fails."""
    return all(finding.verdict is not Verdict.FAIL for _, finding in findings)


def screen(findings: Findings) -> Table:
    """One line a finding, and below it what to do."""
    table = Table(box=None, show_header=False, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column(no_wrap=True)
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    last = ""
    for group, finding in findings:
        verdict = finding.verdict.upper() if finding.verdict is Verdict.FAIL else finding.verdict
        style = _STYLES[finding.verdict]
        name = "" if group == last else group
        table.add_row(name, Text(verdict, style), finding.check, Text(printable(finding.found)))
        if finding.todo:
            table.add_row("", "", "", Text(f"-> {printable(finding.todo)}", style))
        last = group
    return table


def summary(findings: Findings, seconds: float) -> str:
    """The last line."""
    counts = Counter(finding.verdict for _, finding in findings)
    verdict = "passed" if passed(findings) else "FAILED"
    return (
        f"{verdict}: {counts[Verdict.OK]} ok, {counts[Verdict.WARN]} warned, {counts[Verdict.FAIL]} failed, "
        f"{counts[Verdict.SKIP]} skipped, in {seconds:.1f} s"
    )


def show(findings: Findings, seconds: float, console: Console) -> None:
    """Print both."""
    console.print(screen(findings))
    console.print(summary(findings, seconds), markup=False, soft_wrap=True)


def as_json(findings: Findings, vehicle: str, seconds: float) -> dict[str, Any]:
    """The same for a script."""
    return {
        "vehicle": vehicle,
        "passed": passed(findings),
        "seconds": round(seconds, 3),
        "findings": [
            {
                "group": group,
                "check": finding.check,
                "verdict": str(finding.verdict),
                "found": finding.found,
                "todo": finding.todo,
            }
            for group, finding in findings
        ],
    }
