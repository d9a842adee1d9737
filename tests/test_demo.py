"""`guidance demo` as a newcomer runs it, watched by a second process's eyes over zenoh."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rich.console import Console

from guidance.demo import goals
from guidance.demo_view import Result, View, show
from guidance.figures import StreamFigures, TrackingFigures
from guidance.fleet import Fleet
from guidance.records import (
    LOG_ONLY,
    TOPICS,
    AirplaneHandling,
    GroundHandling,
    Link,
    Lost,
    Record,
    Setpoint,
    Status,
    Stepping,
    Timing,
    TrackingError,
    VelocityHandling,
)
from guidance.replay import replay
from guidance.telemetry.log import read_records
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import zenoh_config
from tests.helpers import fly_until_tracking, make_config, make_flight

DEMO = [sys.executable, "-m", "guidance", "demo"]
PATIENCE_S = 30.0


@contextmanager
def demo(folder: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """The demo's process, killed at the latest at the end."""
    child = subprocess.Popen(
        [*DEMO, *arguments], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    with child:
        try:
            yield child
        finally:
            if child.poll() is None:
                child.kill()


def wait_for_line(child: subprocess.Popen[str], what: str) -> None:
    assert child.stderr is not None
    lines = []
    for line in child.stderr:
        lines.append(line)
        if what in line:
            return
    raise AssertionError(f"no {what!r} in {''.join(lines)}")


def children_of(process: int) -> list[int]:
    return [int(pid) for pid in Path(f"/proc/{process}/task/{process}/children").read_text().split()]


def running(pids: list[int]) -> list[int]:
    """Those that still run; a process that ended and was not waited for does not."""
    alive = []
    for pid in pids:
        try:
            status = Path(f"/proc/{pid}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        if status.rpartition(")")[2].split()[0] != "Z":
            alive.append(pid)
    return alive


def wait_until_gone(pids: list[int]) -> None:
    end = time.monotonic() + PATIENCE_S
    while running(pids):
        assert time.monotonic() < end, f"still running: {running(pids)}"
        os.sched_yield()


def test_the_demo_tracks_is_seen_over_zenoh_and_leaves_a_log_that_replays(tmp_path: Path) -> None:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    listen = f'zenoh.listen=["{endpoint}"]'
    with demo(tmp_path, "--seconds", "13", "--json", "--set", listen) as child:
        fleet = Fleet()
        with Subscriber(zenoh_config(connect=[endpoint])) as watch:
            out, err = child.communicate(timeout=PATIENCE_S)
            fleet.take(watch.take())
        assert child.returncode == 0, err
        seen = {topic for record, topic in TOPICS.items() if fleet.newest("demo", record) is not None}
        assert fleet.ignored == {}
    assert seen >= {"state", "reference", "setpoint", "error", "status", "link", "timing", "event"}
    figures = json.loads(out.splitlines()[-1])
    assert figures["tracked"] is True
    assert 8.0 < figures["converged_s"] < 12.0
    assert figures["rms_error_m"] is None  # 13 s leave no time to settle, and that is said
    assert "too short: --seconds" in err
    assert figures["setpoint_rate_hz"] == pytest.approx(50.0, rel=0.2)  # a test does not judge the machine
    log = tmp_path / figures["log"]
    found = replay(log)
    assert found.identical, found
    assert {type(record) for record in read_records(log)} == set(TOPICS) - {
        Lost,
        GroundHandling,
        AirplaneHandling,
        VelocityHandling,
        Stepping,
    }
    assert seen.isdisjoint(LOG_ONLY)


def test_ctrl_c_ends_both_processes_and_tells_what_was_flown(tmp_path: Path) -> None:
    with demo(tmp_path, "--json") as child:
        wait_for_line(child, "tracking: ")
        pids = children_of(child.pid)
        assert len(pids) == 2
        child.send_signal(signal.SIGINT)
        out, err = child.communicate(timeout=PATIENCE_S)
        assert child.returncode == 130
        assert running(pids) == []
    assert "finished: " in err  # the service left in order
    assert "interrupted by SIGINT after " in err
    assert json.loads(out)["tracked"] is False


def test_a_demo_that_is_killed_leaves_no_process_behind(tmp_path: Path) -> None:
    with demo(tmp_path) as child:
        wait_for_line(child, "tracking: ")
        pids = children_of(child.pid)
        assert len(pids) == 2
        child.kill()
        wait_until_gone(pids)


def test_a_flight_that_does_not_begin_is_given_up_with_the_reason(tmp_path: Path) -> None:
    with demo(tmp_path, "--json", "--set", "supervisor.engage_max_error_m=1") as child:
        started = time.monotonic()
        out, err = child.communicate(timeout=PATIENCE_S)
        assert child.returncode == 1
        assert time.monotonic() - started < 20.0
    assert "engage_max_error_m is 1: go closer" in err
    found = json.loads(out)
    assert "engage_max_error_m is 1: go closer" in found["error"]
    assert found["converged_s"] is None


def test_a_vehicle_that_dies_in_flight_is_named(tmp_path: Path) -> None:
    with demo(tmp_path) as child:
        wait_for_line(child, "tracking: ")
        pids = children_of(child.pid)
        (vehicle,) = (pid for pid in pids if b"sitl" in Path(f"/proc/{pid}/cmdline").read_bytes())
        os.kill(vehicle, signal.SIGKILL)
        _, err = child.communicate(timeout=PATIENCE_S)
        assert child.returncode == 1
        assert running(pids) == []
    assert "the vehicle was ended by SIGKILL" in err
    assert "log: logs/" in err


def result(tracking: TrackingFigures, last_error_m: float, interrupted_by: int = 0) -> Result:
    return Result(
        tracking=tracking,
        stream=StreamFigures(50.0, 0.021),
        goals=goals(make_config()),
        asked_s=13.0,
        tracked_s=13.0,
        last_error_m=last_error_m,
        time_constant_s=1.0,
        log="logs/a.mcap",
        interrupted_by=interrupted_by,
    )


NONE = TrackingFigures(None, None, None)


@pytest.mark.parametrize(
    ("judged", "says", "status"),
    [
        (result(TrackingFigures(9.5, 0.0004, 0.0007), 0.0005), "tracked\n", 0),
        (result(TrackingFigures(9.5, 0.004, 0.0007), 0.0005), "tracked, but missed a goal: RMS error", 0),
        (result(TrackingFigures(9.5, None, None), 0.0005), "too short: --seconds 16", 0),
        (result(NONE, 0.09), "too short to say it tracks", 1),
        (result(NONE, 3.0), "did NOT track: 3.00 m off after 13.0 s", 1),
        (result(NONE, 3.0, signal.SIGTERM), "interrupted by SIGTERM after 13.0 of 13 s", 143),
    ],
)
def test_the_verdict_is_honest_and_fits_a_terminal(judged: Result, says: str, status: int) -> None:
    console = Console(width=80, record=True, file=open(os.devnull, "w"))  # noqa: SIM115
    with console.file:
        show(judged, console)
        text = console.export_text()
    assert says in text
    assert judged.exit_status == status
    assert max(map(len, text.splitlines())) <= 80
    assert "goal: at most 12 s" in text


def test_goals_are_asked_only_of_the_flights_that_they_are_known_for() -> None:
    assert goals(make_config())[:3] == (12.0, 0.003, 0.01)
    fast = goals(make_config("trajectory.radius_m=20", "trajectory.speed_m_s=4"))
    assert fast[:3] == (None, 0.02, None)
    assert goals(make_config("law.k=0.5"))[:3] == (None, None, None)
    assert goals(make_config("link.rate_hz=25"))[3:] == (25.0, 0.1)


def test_the_live_block_keeps_its_height_and_fits_80_columns() -> None:
    flight = make_flight()
    heights = set()
    view = View(30.0, Console(width=80, record=True, force_terminal=True, file=open(os.devnull, "w")))  # noqa: SIM115
    console = view._console
    with console.file:
        newest: dict[str, Record] = {}

        def look() -> None:
            newest.update({TOPICS[type(record)]: record for record in flight.records})
            with console.capture() as captured:
                console.print(view._block(newest.get))
            lines = captured.get().rstrip("\n").split("\n")
            heights.add(len(lines))
            plain = console.export_text().splitlines()
            assert all(len(line.rstrip()) <= 80 for line in plain), plain

        look()
        flight.run(0.5)
        look()
        fly_until_tracking(flight)
        for _ in range(5):
            flight.run(1.0)
            look()
    assert heights == {5}
    kinds = (Status, TrackingError, Setpoint, Timing, Link)
    assert {TOPICS[kind] for kind in kinds} <= set(newest)
