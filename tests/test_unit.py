"""The systemd units: what systemd thinks of them, and that what they start fits into them."""

from __future__ import annotations

import asyncio
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from guidance.config import load
from guidance.service import LEAVE_AT_THE_LATEST_S
from guidance.telemetry.log import read_log
from guidance.view import SILENCE_S
from tests.manager_rig import listening
from tests.service_rig import PATIENCE_S, Bell

ROOT: Final = Path(__file__).parents[1]
UNIT: Final = (ROOT / "deploy" / "guidance@.service").read_text(encoding="utf-8")
EXAMPLES: Final = sorted((ROOT / "deploy").glob("*.toml"))


DASHBOARD_UNIT: Final = (ROOT / "deploy" / "guidance-dashboard.service").read_text(encoding="utf-8")


def setting(name: str, unit: str = UNIT) -> str:
    """The value of a setting that the unit has once."""
    (value,) = re.findall(rf"^{name}=(.*)", unit, re.MULTILINE)
    return str(value)


@pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="no systemd here; .ci/run installs it and checks the unit"
)
def test_systemd_has_no_complaint_and_finds_little_exposure() -> None:
    found = subprocess.run([ROOT / ".ci" / "unit"], capture_output=True, text=True, timeout=30)
    assert (found.returncode, found.stderr) == (0, "")
    exposures = dict(re.findall(r"exposure level for (\S+)\.service: (\d+\.\d)", found.stdout))
    assert exposures.keys() == {"guidance@i", "guidance-dashboard"}
    assert max(map(float, exposures.values())) <= 2.0


def test_the_unit_waits_longer_than_the_service_takes() -> None:
    assert float(setting("TimeoutStopSec").removesuffix("s")) > LEAVE_AT_THE_LATEST_S
    watchdog_s = float(setting("WatchdogSec").removesuffix("ms")) * 1e-3
    assert watchdog_s >= SILENCE_S  # shorter stalls the supervisor may fly through


def test_it_is_started_again_for_ever() -> None:
    assert (setting("Restart"), setting("StartLimitIntervalSec")) == ("always", "0")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_each_configuration_writes_only_where_the_unit_lets_it(path: Path) -> None:
    config = load(path)
    assert not Path(config.log.directory).is_absolute()
    assert setting("WorkingDirectory") == f"%L/{setting('LogsDirectory')}"
    assert config.zenoh.config_file == ""


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_what_it_starts_becomes_ready_in_its_directory_and_environment(path: Path, tmp_path: Path) -> None:
    """ExecStart by hand, with another Python and any free port."""
    config = path.read_text()
    (port,) = re.findall(r"^connection = .*:(\d+)\"", config, re.MULTILINE)
    (tmp_path / "guidance").mkdir()
    (tmp_path / "guidance" / "it.toml").write_text(config.replace(port, "0"))
    program, *arguments = shlex.split(setting("ExecStart").replace("%E", str(tmp_path)).replace("%i", "it"))
    assert program.endswith("/bin/guidance")
    logs = tmp_path / "logs-directory"
    logs.mkdir()

    async def main() -> None:
        bell = Bell()
        async with listening(bell) as manager:
            name, value = setting("Environment").split("=")
            service = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "guidance", *arguments),
                cwd=logs,
                env={name: value, "NOTIFY_SOCKET": manager.named, "PYTHONPATH": str(ROOT)},
                stderr=subprocess.PIPE,
            )
            await bell.until(lambda: manager.all("READY"), "READY")
            service.send_signal(signal.SIGTERM)
            _, said = await asyncio.wait_for(service.communicate(), PATIENCE_S)
        assert service.returncode == 0, said

    asyncio.run(main())
    (log,) = (logs / "logs").glob("*.mcap")
    assert next(topic for topic, _ in read_log(log)) == "session"


@pytest.mark.parametrize("options", ["", "--host 127.0.0.2 --commands"])
def test_the_dashboard_that_is_stopped_has_not_failed(options: str, tmp_path: Path) -> None:
    """ExecStart by hand, with another Python, any free port and no home."""
    name, empty = setting("Environment", DASHBOARD_UNIT).strip('"').split("=", 1)
    assert empty == ""  # as it ships: this machine alone, and only to look
    started = setting("ExecStart", DASHBOARD_UNIT).replace(f"${name}", options)
    program, *arguments = shlex.split(started)
    assert program.endswith("/bin/guidance")
    command = [sys.executable, "-m", "guidance", *arguments, "--port", "0", "--no-multicast"]
    with subprocess.Popen(
        command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr is not None
        said = process.stderr.readline()
        assert re.search(r"http://127\.0\.0\.[12]:\d+/", said), said
        process.terminate()
        stopped = process.wait(PATIENCE_S)
    assert stopped == int(setting("SuccessExitStatus", DASHBOARD_UNIT))
    assert list(tmp_path.iterdir()) == []


def test_a_dashboard_with_a_wrong_option_is_not_started_again() -> None:
    command = [sys.executable, "-m", "guidance", "dashboard", "--port", "no"]
    wrong = subprocess.run(command, capture_output=True, timeout=PATIENCE_S, cwd=ROOT)
    assert wrong.returncode == int(setting("RestartPreventExitStatus", DASHBOARD_UNIT))


def test_the_dashboard_stands_behind_what_flies() -> None:
    for unit, flies in ((UNIT, True), (DASHBOARD_UNIT, False)):
        assert (int(setting("Nice", unit)) < 0) is flies
        assert (int(setting("OOMScoreAdjust", unit)) < 0) is flies
