"""The pages' commands on logs are run as they stand, on the log that is kept for tests."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guidance.cli import app
from tests.flight_asset import ASSET
from tests.page_commands import COMPARISONS, REPORTS, words
from tests.pages import ROOT


@pytest.mark.parametrize("command", [*REPORTS, *COMPARISONS])
def test_it_writes_what_it_says(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "deploy").symlink_to(ROOT / "deploy")
    monkeypatch.chdir(tmp_path)
    arguments = words(command)
    for name in (word for word in arguments if word.endswith(".mcap")):
        shutil.copy(ASSET, tmp_path / name)
    outcome = CliRunner().invoke(app, arguments, catch_exceptions=False)
    assert outcome.exit_code == 0, outcome.stderr
    if arguments[0] == "report" and "--output" not in arguments:
        assert (tmp_path / "report.html").exists()
    for option in ("--output", "--png", "--report"):
        if option in arguments:
            assert (tmp_path / arguments[arguments.index(option) + 1]).exists()
    if "--json" in arguments:
        assert json.loads(outcome.stdout.splitlines()[-1])
