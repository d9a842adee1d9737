"""The systemd unit: what systemd thinks of it, and that the service and its configurations fit into it."""

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


def setting(name: str) -> str:
    """The value of a setting that the unit has once."""
    (value,) = re.findall(rf"^{name}=(.*)", UNIT, re.MULTILINE)
    return str(value)


@pytest.mark.skipif(
    shutil.which("systemd-analyze") is None, reason="no systemd here; .ci/run installs it and checks the unit"
)
def test_systemd_has_no_complaint_and_finds_little_exposure() -> None:
    found = subprocess.run([ROOT / ".ci" / "unit"], capture_output=True, text=True, timeout=30)
    assert (found.returncode, found.stderr) == (0, "")
    (exposure,) = re.findall(r"exposure level for guidance@i\.service: (\d+\.\d)", found.stdout)
    assert float(exposure) <= 2.0


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
