"""`guidance watch` as a process, and its subscriber: real zenoh over TCP on the loopback, no scouting."""

from __future__ import annotations

import json
import os
import pty
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest
import zenoh
from typer.testing import CliRunner

from guidance.cli import app
from guidance.fleet import Fleet
from guidance.records import TOPICS, Record, Status
from guidance.telemetry import Sample
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import LAST_RETRY_S, ZenohSink, zenoh_config
from tests.fleet_rig import error, event, session, setpoint, status

PATIENCE_S: Final = 20.0
ENVIRONMENT: Final = {**os.environ, "TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
WATCH: Final = [sys.executable, "-m", "guidance", "watch", "--no-multicast"]


@pytest.fixture(name="endpoint")
def a_free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


class Flying(threading.Thread):
    """Offers a status and an error at 10 Hz to a sink until told to stop."""

    def __init__(self, sink: ZenohSink) -> None:
        super().__init__(daemon=True)
        self._sink = sink
        self._ended = threading.Event()

    def run(self) -> None:
        while not self._ended.wait(0.1):
            now_ns = time.monotonic_ns()
            self._sink.offer(sample(status(now_ns)))
            self._sink.offer(sample(error(now_ns, 0.25)))
            self._sink.offer(sample(setpoint(now_ns, now_ns // 100_000_000)))

    def stop(self) -> None:
        self._ended.set()
        self.join()


@contextmanager
def service(vehicle: str, endpoint: str) -> Iterator[tuple[ZenohSink, Flying]]:
    sink = ZenohSink(vehicle, listen=[endpoint])
    sink.offer(sample(session("abcd" * 8)))
    sink.offer(sample(event(1, "engaged")))
    sink.start()
    flying = Flying(sink)
    flying.start()
    try:
        yield sink, flying
    finally:
        flying.stop()
        sink.close(PATIENCE_S)


@contextmanager
def watching(*arguments: str, stdout: int = subprocess.PIPE) -> Iterator[subprocess.Popen[str]]:
    with subprocess.Popen(
        [*WATCH, *arguments], stdout=stdout, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT
    ) as child:
        killer = threading.Timer(3 * PATIENCE_S, child.kill)
        killer.start()
        try:
            yield child
        finally:
            killer.cancel()
            child.kill()


def lines_until(child: subprocess.Popen[str], holds: Callable[[Any], object]) -> list[Any]:
    """The JSON objects up to the first for which it holds."""
    assert child.stdout is not None
    seen = []
    for text in child.stdout:
        seen.append(json.loads(text))
        if holds(seen[-1]):
            return seen
    raise AssertionError(f"it ended before: {seen}")


def test_a_vehicle_is_seen_falls_silent_and_goes(endpoint: str) -> None:
    with watching("--connect", endpoint, "--json") as child, service("uuv-1", endpoint) as (sink, flying):
        live = lines_until(child, lambda seen: seen["contact"] == "live" and seen["setpoint_rate_hz"])
        flying.stop()
        silent = lines_until(child, lambda seen: seen["contact"] == "silent")
        assert sink.close(PATIENCE_S)
        gone = lines_until(child, lambda seen: seen["contact"] == "gone")
        child.send_signal(signal.SIGINT)
        assert child.wait(PATIENCE_S) == 130
    newest = live[-1]
    assert (newest["vehicle"], newest["state"], newest["error_m"]) == ("uuv-1", "tracking", 0.25)
    assert newest["setpoint_rate_hz"] == pytest.approx(10.0, rel=0.5)
    assert newest["session_id"] == "abcd" * 8  # published before anybody was connected: it was asked for
    assert newest["ignored"] == {}
    told = [event["text"] for seen in (*live, *silent, *gone) for event in seen["events"]]
    said = [text.partition(":")[0] for text in told]
    assert (said[0], said[-2:]) == ("engaged", ["silent", "gone"])


def test_lines_for_a_pipe_and_a_stranger_on_the_keys(endpoint: str) -> None:
    with (
        zenoh.open(zenoh_config(listen=[endpoint])) as stranger,
        watching("--connect", endpoint, "--seconds", "60") as child,
    ):
        assert child.stdout is not None
        later = zenoh.Encoding("application/json;guidance.Status/9")
        for text in child.stdout:
            if "schema 9" in text:
                break
            stranger.put("guidance/uuv-2/status", b"{}", encoding=later)
            stranger.put("guidance/uuv-2/status", b"noise")
        assert "uuv-2 schema 9: publishes schema version 9, this reads 1" in text
        child.send_signal(signal.SIGTERM)
        assert child.wait(PATIENCE_S) == 143


def test_it_ends_by_itself_and_says_that_nobody_was_there(endpoint: str) -> None:
    with watching("--connect", endpoint, "--seconds", "1.5", "--json") as child:
        out, err = child.communicate(timeout=PATIENCE_S)
    assert child.returncode == 0
    assert out == ""
    assert f"no vehicle yet; connected to nobody yet (connect {endpoint})" in err


def test_a_reader_that_has_enough_ends_it_quietly(endpoint: str) -> None:
    with service("uuv-1", endpoint), watching("--connect", endpoint, "--json") as child:
        assert child.stdout is not None
        child.stdout.readline()
        child.stdout.close()
        assert child.wait(PATIENCE_S) == 0
        assert child.stderr is not None
        assert "Traceback" not in child.stderr.read()


def test_on_a_terminal_it_is_a_screen_that_is_given_back(endpoint: str) -> None:
    ours, theirs = pty.openpty()
    with watching("--connect", endpoint, stdout=theirs) as child:
        os.close(theirs)
        shown = b""
        while b"connected to nobody yet" not in shown:
            shown += os.read(ours, 4096)
        assert b"\x1b[?1049h" in shown
        assert b"no vehicle yet" in shown
        child.send_signal(signal.SIGINT)
        with suppress(OSError):  # EIO: nobody has the other end any more
            while more := os.read(ours, 4096):
                shown += more
        assert b"\x1b[?1049l" in shown
        assert child.wait(PATIENCE_S) == 130
    os.close(ours)


def test_a_terminal_that_is_closed_ends_it_quietly(endpoint: str) -> None:
    ours, theirs = pty.openpty()
    with watching("--connect", endpoint, stdout=theirs) as child:
        os.close(theirs)
        shown = b""
        while b"no vehicle yet" not in shown:
            shown += os.read(ours, 4096)
        os.close(ours)
        assert child.wait(PATIENCE_S) == 0
        assert child.stderr is not None
        assert child.stderr.read() == ""


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--connect", "rubbish"), "connect/endpoints = "),
        (("--connect", "tcp/192.168.1.2"), "'tcp/192.168.1.2' names no port: PROTOCOL/HOST:PORT"),
        (("--listen", "tcp/1.2.3.4:x"), "'tcp/1.2.3.4:x' names no port"),
        (("--config", "no/such.json5"), "cannot use the file no/such.json5"),
        (("--config", "z.json5", "--connect", "tcp/a:1"), "a configuration file replaces"),
        (("--config", "z.json5", "--multicast"), "a configuration file replaces"),
        (("--vehicle", "*"), "--vehicle '*': a name has"),
    ],
)
def test_wrong_settings_are_refused_in_one_line(arguments: tuple[str, ...], says: str) -> None:
    outcome = CliRunner().invoke(app, ["watch", *arguments])
    assert (outcome.exit_code, outcome.stdout) == (2, "")
    assert says in outcome.stderr
    assert outcome.stderr.count("\n") == 1


def until(subscriber: Subscriber, fleet: Fleet, holds: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end
        fleet.take(subscriber.take())
        time.sleep(0.01)


def test_the_subscriber_finds_who_was_there_before_and_who_comes_later(endpoint: str) -> None:
    fleet = Fleet()
    with service("uuv-1", endpoint), Subscriber(zenoh_config(connect=[endpoint]), "uuv-1") as subscriber:
        until(subscriber, fleet, lambda: fleet.newest("uuv-1", Status))
        until(subscriber, fleet, lambda: [note.text for note in fleet.notes] == ["engaged"])
        until(subscriber, fleet, lambda: subscriber.neighbours == 1)
        assert subscriber.trouble == ""
        with zenoh.open(zenoh_config(connect=[endpoint])) as other:
            other.put("guidance/uuv-2/status", b"not of the one that was asked for")
    with service("uuv-1", endpoint) as (sink, _):  # zenoh itself connects again
        pass
    assert sink.problem == ""
    assert [seen.vehicle for seen in fleet.look(time.monotonic_ns())] == ["uuv-1"]


def test_a_session_that_cannot_be_opened_is_tried_again_ever_more_slowly(endpoint: str) -> None:
    now_ns = 0
    asked_ns = []

    def refusing(config: zenoh.Config) -> zenoh.Session:
        asked_ns.append(now_ns)
        raise zenoh.ZError("address in use at /somewhere/in/zenoh.rs:12.")

    config = zenoh_config(listen=[endpoint])
    subscriber = Subscriber(config, open_session=refusing, clock_ns=lambda: now_ns)
    assert subscriber.trouble == "opening a session"
    while now_ns < 60_000_000_000:
        subscriber._turn()
        now_ns += 50_000_000
    assert [ns // 1_000_000_000 for ns in asked_ns] == [0, 0, 1, 3, 7, 15, 25, 35, 45, 55]
    assert subscriber.trouble == f"no session: address in use; trying again every {LAST_RETRY_S:g} s"


def test_a_taker_that_sleeps_gets_the_newest(endpoint: str) -> None:
    fleet = Fleet()
    with (
        zenoh.open(zenoh_config(listen=[endpoint])) as stranger,
        Subscriber(zenoh_config(connect=[endpoint]), capacity=10) as subscriber,
    ):
        until(subscriber, fleet, lambda: subscriber.neighbours == 1)
        for k in range(100):
            stranger.put(f"guidance/v{k}/status", b"")
        end = time.monotonic() + PATIENCE_S
        while not subscriber._arrivals or subscriber._arrivals[-1].vehicle != "v99":
            assert time.monotonic() < end
        assert [arrival.vehicle for arrival in subscriber.take()] == [f"v{k}" for k in range(90, 100)]


def test_without_a_place_it_looks_on_this_machine_and_around(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[dict[str, Any]] = []

    def stop(**settings: Any) -> zenoh.Config:
        asked.append(settings)
        raise ValueError("enough")

    monkeypatch.setattr("guidance.watch.zenoh_config", stop)
    for arguments in ((), ("--no-multicast",), ("--connect", "tcp/a:1"), ("--config", "z.json5")):
        CliRunner().invoke(app, ["watch", *arguments])
    here = ("tcp/127.0.0.1:7447",)
    assert [(tuple(a["connect"]), a["multicast_scouting"], a["config_file"]) for a in asked] == [
        (here, True, None),
        (here, False, None),
        (("tcp/a:1",), False, None),
        ((), False, Path("z.json5")),
    ]
