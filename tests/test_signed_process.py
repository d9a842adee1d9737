"""`guidance run` and `sitl vehicle` with a key, as processes; a bad key file is an exit status of 2."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path
from typing import Final

import pytest
from typer.testing import CliRunner

import guidance.cli
import sitl.cli
from guidance.records import Packet
from guidance.replay import replay
from guidance.telemetry.log import read_records
from tests.helpers import DEMO
from tests.service_rig import PATIENCE_S, a_socket

KEY: Final = bytes(range(1, 33))


def key_file(directory: Path, mode: int = 0o600) -> Path:
    path = directory / "signing.key"
    path.write_text(KEY.hex() + "\n", encoding="ascii")
    path.chmod(mode)
    return path


def test_service_and_vehicle_fly_by_one_key_and_the_log_replays_without_it(tmp_path: Path) -> None:
    key = key_file(tmp_path)
    with a_socket() as sock:
        port = sock.getsockname()[1]
    settings = [f"link.connection=udpin://127.0.0.1:{port}", f"link.signing_key_file={key}"]
    settings += [f"log.directory={tmp_path}", "zenoh.enabled=false"]
    run = ["-m", "guidance", "run", "--config", str(DEMO), *(w for s in settings for w in ("--set", s))]
    fly = ["-m", "sitl", "vehicle", "--to", f"127.0.0.1:{port}", "--port", "0", "--signing-key", str(key)]
    environ = {**os.environ, "STATE_DIRECTORY": str(tmp_path)}

    async def both() -> int:
        pipe = asyncio.subprocess.PIPE
        vehicle = await asyncio.create_subprocess_exec(sys.executable, *fly, stderr=pipe, env=environ)
        service = await asyncio.create_subprocess_exec(sys.executable, *run, stderr=pipe, env=environ)
        try:
            assert service.stderr is not None
            async with asyncio.timeout(PATIENCE_S):
                said = ""
                while "tracking: " not in said:
                    line = await service.stderr.readline()
                    assert line, said
                    said += line.decode()
                await asyncio.sleep(0.5)
                service.send_signal(signal.SIGTERM)
                await service.communicate()
        finally:
            for process in (vehicle, service):
                if process.returncode is None:
                    process.kill()
                    await process.wait()
        return service.returncode or 0

    assert asyncio.run(both()) == 0
    clock = tmp_path / "signing-demo.json"
    kept = json.loads(clock.read_text(encoding="utf-8"))
    assert [stream[:3] for stream in kept["streams"]] == [[1, 1, 0]]
    (log,) = tmp_path.glob("*.mcap")
    assert replay(log).identical
    last = [r for r in read_records(log) if isinstance(r, Packet)][-1]
    assert kept["timestamp"] >= int.from_bytes(last.data[-12:-6], "little")
    content = log.read_bytes()
    assert KEY not in content
    assert KEY.hex().encode() not in content


@pytest.mark.parametrize("command", ["run", "check"])
def test_a_key_that_others_can_read_is_refused_at_once(command: str, tmp_path: Path) -> None:
    key = key_file(tmp_path, 0o644)
    words = [command, "--config", str(DEMO), "--set", f"link.signing_key_file={key}"]
    outcome = CliRunner().invoke(guidance.cli.app, words)
    assert outcome.exit_code == 2
    assert f"chmod 600 {key}" in outcome.output


@pytest.mark.parametrize("content", [b"", b"short", b"zz" * 32])
def test_the_vehicle_refuses_what_is_no_key(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_bytes(content)
    outcome = CliRunner().invoke(sitl.cli.app, ["vehicle", "--port", "0", "--signing-key", str(path)])
    assert outcome.exit_code == 2
