"""What commands write: whole or not at all, refused before the work, and never in place of a log."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

from guidance.cli import app
from guidance.replacing import LogInTheWayError, replacing
from guidance.report import reading
from tests.flight_asset import ASSET


@pytest.fixture
def log(tmp_path: Path) -> Path:
    return Path(shutil.copy(ASSET, tmp_path / "flight.mcap"))


def call(*arguments: object) -> tuple[int, str, str]:
    """Exit status, stdout and stderr; anything but an orderly exit is raised."""
    outcome = CliRunner().invoke(app, [str(one) for one in arguments], catch_exceptions=False)
    return outcome.exit_code, outcome.stdout, outcome.stderr


def test_a_file_is_replaced_when_the_new_one_is_whole(tmp_path: Path) -> None:
    target, link = tmp_path / "page.html", tmp_path / "newest.html"
    target.write_text("older")
    link.symlink_to(target)
    with replacing(link) as fill:
        fill(lambda part: part.write_text("newer"))
    assert link.is_symlink()
    assert target.read_text() == "newer"

    def fails(part: Path) -> None:
        part.write_text("half")
        raise OSError(28, "No space left on device")

    with replacing(target) as fill, pytest.raises(OSError, match=r"page\.html: cannot be written: No space"):
        fill(fails)
    assert target.read_text() == "newer"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["newest.html", "page.html"]


def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with replacing(pipe) as fill:
        fill(lambda part: part.write_text("said"))
    assert os.read(reader, 9) == b"said"
    os.close(reader)
    assert pipe.is_fifo()


def test_a_log_and_what_leads_to_it_is_refused_at_once(log: Path, tmp_path: Path) -> None:
    link, copied = tmp_path / "link.html", tmp_path / "other.html"
    link.symlink_to(log)
    shutil.copy(log, copied)
    for path in (log, link, copied):
        with pytest.raises(LogInTheWayError, match="is a flight log"), replacing(path):
            pytest.fail("it was let pass")


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("report", "{log}"), "-o"),
        (("replay", "{log}", "--set", "law.k=0.5"), "--report"),
        (("tune", "--log", "{log}"), "--output"),
    ],
    ids=["report", "replay", "tune"],
)
def test_no_command_overwrites_a_log(words: tuple[str, ...], option: str, log: Path) -> None:
    before = log.read_bytes()
    arguments = [word.replace("{log}", str(log)) for word in words]
    status, out, err = call(*arguments, option, log)
    assert (status, out) == (2, "")
    assert f"{log}: is a flight log and is not overwritten" in err
    assert log.read_bytes() == before
    status, out, err = call(*arguments, option, log.parent)
    assert (status, out) == (1, "")
    assert "is a directory, and must be a file" in err
    assert [path.name for path in log.parent.iterdir()] == [log.name]


def test_images_overwrite_no_log_and_are_refused_before_the_work(
    log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    images, page = tmp_path / "png", tmp_path / "x.html"
    images.mkdir()
    shutil.copy(log, images / "timing.png")
    monkeypatch.setattr(reading, "read_flight", lambda *_: pytest.fail("the log was read"))
    for directory, status, why in (
        (images, 2, "timing.png: is a flight log"),
        (log, 1, "cannot be written: File exists"),
    ):
        found, _, err = call("report", log, "-o", page, "--png", directory)
        assert found == status
        assert why in err
        assert not page.exists()
    assert (images / "timing.png").read_bytes() == log.read_bytes() == ASSET.read_bytes()
