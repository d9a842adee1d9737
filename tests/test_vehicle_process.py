"""`sitl vehicle` as a process on loopback, and its command line."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl import cli
from sitl.line import UdpDriver
from sitl.truth import MAX_TRUTH_BACKLOG, TruthWriter
from sitl.vehicle import Truth, Vehicle, VehicleOptions

COMMAND = [sys.executable, "-m", "sitl", "vehicle", "--port", "0"]
PATIENCE_S = 20.0


@contextmanager
def companion() -> Iterator[socket.socket]:
    """A socket that waits, but not for ever."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(PATIENCE_S)
        yield sock


@contextmanager
def process(*arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """The vehicle's process and its port, once it listens; killed at the latest at the end."""
    child = subprocess.Popen(
        [*COMMAND, *arguments], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    with child:
        try:
            assert child.stderr is not None
            line = child.stderr.readline().decode()
            match = re.search(r"on 127\.0\.0\.1:(\d+)", line)
            assert match, line
            yield child, int(match[1])
        finally:
            if child.poll() is None:
                child.kill()


def hear(sock: socket.socket, name: str) -> Any:
    """The next message of a type."""
    parser = mavlink.MAVLink(None)
    for _ in range(10_000):
        for message in parser.parse_buffer(sock.recv(2048)) or []:
            if message.get_type() == name:
                return message
    raise AssertionError(f"no {name} in 10000 datagrams")


def arm() -> bytes:
    data: bytes = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, *[0.0] * 6).pack(
        mavlink.MAVLink(None, 1, 191)
    )
    return data


def test_it_sends_where_it_is_told_obeys_and_tells_the_truth_on_stdout_until_sigterm() -> None:
    with companion() as sock:
        to = f"127.0.0.1:{sock.getsockname()[1]}"
        with process("--to", to, "--truth", "-", "--truth-period", "0.01") as (child, port):
            assert hear(sock, "HEARTBEAT").type == 12
            sock.sendto(arm(), ("127.0.0.1", port))
            assert hear(sock, "COMMAND_ACK").result == 0
            assert child.stdout is not None
            lines = [json.loads(child.stdout.readline()) for _ in range(20)]
            while not lines[-1]["armed"]:
                lines.append(json.loads(child.stdout.readline()))
            child.send_signal(signal.SIGTERM)
            assert child.wait(PATIENCE_S) == 0
    assert set(lines[0]) == set(Truth._fields)
    assert lines[0]["position_ned_m"] == [-10.0, -30.0, -5.0]
    steps = {b["t_ns"] - a["t_ns"] for a, b in pairwise(lines)}
    assert steps == {10_000_000}


def test_it_tells_everybody_whom_it_is_told_to_tell_and_hears_them_all() -> None:
    with companion() as first, companion() as second:
        to = [f"--to=127.0.0.1:{sock.getsockname()[1]}" for sock in (first, second)]
        with process(*to) as (_, port):
            for sock in (first, second):
                sock.sendto(arm(), ("127.0.0.1", port))
                assert [hear(listener, "COMMAND_ACK").result for listener in (first, second)] == [0, 0]


def test_without_a_target_it_answers_who_wrote_last_and_ends_cleanly_on_sigint() -> None:
    with companion() as sock, process("--firmware", "ardupilot-rover") as (child, port):
        sock.sendto(arm(), ("127.0.0.1", port))
        assert hear(sock, "COMMAND_ACK").result == 0
        child.send_signal(signal.SIGINT)
        assert child.wait(PATIENCE_S) == 0


def test_a_model_has_the_firmware_that_fits_and_a_noisy_estimator_if_asked() -> None:
    with companion() as sock:
        to = f"127.0.0.1:{sock.getsockname()[1]}"
        with process("--to", to, "--model", "rover", "--noise", "--wind=-1,2", "--truth", "-") as (child, _):
            assert hear(sock, "HEARTBEAT").type == 10
            seen = hear(sock, "LOCAL_POSITION_NED")
            assert child.stdout is not None
            truth = json.loads(child.stdout.readline())
    assert truth["position_ned_m"] == [-10.0, -30.0, 0.0]
    assert truth["wind_ned_m_s"] == [-1.0, 2.0, 0.0]
    assert 0.0 < abs(seen.x + 10.0) < 0.5


def test_it_ends_when_stdin_closes_if_asked_to() -> None:
    with process("--exit-with-stdin") as (child, _):
        assert child.stdin is not None
        child.stdin.close()
        assert child.wait(PATIENCE_S) == 0


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--firmware", "zeppelin"], "px4-uuv"),
        (["--no-such-option"], "--no-such-option"),
        (["--port", "99999"], "--port"),
        (["--to", "somewhere"], "HOST:PORT"),
        (["--to", "host:0"], "HOST:PORT"),
        (["--position", "1,2"], "--position"),
        (["--position", "1,2,nan"], "finite"),
        (["--home", "95,0,0"], "latitude"),
        (["--max-speed", "0"], "max_speed"),
        (["--rate-lag", "-1"], "rate_lag"),
        (["--truth-period", "0"], "--truth-period"),
        (["--set", "COM_OF_LOSS_T"], "PARAM=NUMBER"),
        (["--set", "COM_OF_LOSS_T=soon"], "PARAM=NUMBER"),
        (["--set", "NO_SUCH=1"], "NO_SUCH"),
        (["--mode", "FLOAT"], "OFFBOARD"),
        (["--model", "zeppelin"], "a model is one of"),
        (["--model", "rover", "--firmware", "px4-uuv"], "it needs ardupilot-rover"),
        (["--wind", "1,2"], "the model ideal has no wind"),
        (["--model", "boat", "--wind", "1"], "--wind must be two numbers"),
        (["--model", "boat", "--wind", "1,inf"], "finite"),
        (["--model", "boat", "--gusts", "1"], "no gusts"),
        (["--model", "uuv", "--max-speed", "2"], "for the ideal body only"),
        (["--position-noise", "-1"], "noise.position_m"),
        (["--truth", "/no/such/folder/truth.jsonl"], "/no/such/folder"),
    ],
)
def test_a_wrong_option_is_one_clear_line_and_status_2(
    arguments: list[str], says: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["sitl", "vehicle", "--port", "0", *arguments])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    error = capsys.readouterr().err
    assert ended.value.code == 2
    assert says in error
    assert error.count("\n") == 1


def test_a_port_in_use_is_one_clear_line_and_status_2(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with companion() as sock:
        monkeypatch.setattr(sys, "argv", ["sitl", "vehicle", "--port", str(sock.getsockname()[1])])
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert ended.value.code == 2
    assert "in use" in capsys.readouterr().err


def test_a_reader_that_does_not_read_costs_lines_of_truth_and_no_time() -> None:
    reader, pipe = os.pipe()
    os.set_blocking(pipe, False)
    try:
        writer = TruthWriter(pipe)
        line = b"x" * 999 + b"\n"
        for _ in range(2 * MAX_TRUTH_BACKLOG // len(line)):
            writer.write(line)
            writer.flush()
        assert writer.dropped > 0
        read = os.read(reader, 100_000)
        assert set(read.split(b"\n")) - {b""} <= {line[:-1], read.rsplit(b"\n", 1)[-1]}
    finally:
        os.close(reader)
    writer.write(b"nobody reads this\n")
    writer.flush()
    assert writer.dropped > 0
    os.close(pipe)


def test_a_datagram_that_nobody_takes_is_no_error() -> None:
    async def send() -> bool:
        driver = UdpDriver((), Vehicle(VehicleOptions()), None, 0.02)
        driver.error_received(ConnectionRefusedError())
        driver.close()
        return True

    assert asyncio.run(send())
