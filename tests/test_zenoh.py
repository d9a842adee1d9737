"""Records over zenoh, seen by another process; and zenoh that is absent, slow or dying harms nobody.

Real zenoh over TCP on the loopback, endpoints pinned, no scouting. Waiting is left to blocking calls (a pipe,
a zenoh channel, an event), each under the deadline of its test.
"""

from __future__ import annotations

import itertools
import json
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import msgspec
import pytest
import zenoh

from guidance.records import LOG_ONLY, TOPICS, Event, Input, InputKind, Level, Record, Status
from guidance.telemetry import Sample
from guidance.telemetry.zenoh_sink import LAST_RETRY_S, ZenohSink, zenoh_config

DEADLINE_S = 20.0

#: A ground station: tells by JSON lines what it sees of the vehicle, asks for the last status in between.
WATCHER = """
import json, sys, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"peer"')
config.insert_json5("listen/endpoints", json.dumps([sys.argv[1]]))
config.insert_json5("scouting/multicast/enabled", "false")
session = zenoh.open(config)
channel = lambda: zenoh.handlers.FifoChannel(1000)
alive = session.liveliness().declare_subscriber("guidance/*/alive", channel())
records = session.declare_subscriber("guidance/**", channel())
def tell(what, sample):
    print(json.dumps([what, str(sample.kind).rpartition(".")[2], str(sample.key_expr), str(sample.encoding),
        sample.payload.to_string(), str(sample.congestion_control).rpartition(".")[2]]), flush=True)
print("ready", flush=True)
tell("alive", alive.recv())
while not (replies := [reply.ok for reply in session.get("guidance/rover1/status", timeout=1.0) if reply.ok]):
    pass
tell("reply", replies[0])
while True:
    record = records.recv()
    tell("record", record)
    if str(record.key_expr).endswith("/event"):
        break
tell("alive", alive.recv())
"""

STATUS = Status(
    t_ns=1,
    state="tracking",
    reason="engaged",
    since_ns=0,
    armed=None,
    mode="GUIDED",
    intended_mode="GUIDED",
    trajectory_start_ns=None,
    origin_ned_m=None,
    setpoints_sent=3,
)


def sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


def event(number: int) -> Event:
    return Event(t_ns=number, level=Level.INFO, code="test", text="")


@pytest.fixture(name="endpoint")
def a_free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


@pytest.fixture(name="watcher")
def a_second_process(endpoint: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-c", WATCHER, endpoint]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_a_second_process_sees_the_flight(endpoint: str, watcher: subprocess.Popen[str]) -> None:
    assert watcher.stdout is not None
    assert watcher.stdout.readline() == "ready\n"

    def told() -> list[str]:
        assert watcher.stdout is not None
        line: list[str] = json.loads(watcher.stdout.readline())
        return line

    sink = ZenohSink("rover1", connect=[endpoint])
    sink.offer(sample(STATUS))
    sink.start()
    assert told()[:3] == ["alive", "PUT", sink.liveliness_key]
    reply = told()
    assert reply[:4] == ["reply", "PUT", "guidance/rover1/status", "application/json;guidance.Status/1"]
    assert msgspec.json.decode(reply[4], type=Status) == STATUS

    sink.offer(sample(Input(t_ns=2, seq=0, kind=InputKind.TICK)))  # for the log only
    later = msgspec.structs.replace(STATUS, t_ns=3)
    sink.offer(sample(later))
    sink.offer(sample(event(4)))
    seen = told()
    if seen[4] == reply[4]:  # the first status may have been too early for the subscriber, or not
        seen = told()
    assert seen == [
        "record",
        "PUT",
        "guidance/rover1/status",
        "application/json;guidance.Status/1",
        msgspec.json.encode(later).decode(),
        "DROP",
    ]
    assert told()[1:4] == ["PUT", "guidance/rover1/event", "application/json;guidance.Event/1"]
    assert sink.problem == ""
    assert sink.close(DEADLINE_S)
    assert told()[:3] == ["alive", "DELETE", sink.liveliness_key]


def test_the_last_record_offered_before_the_close_still_arrives(endpoint: str) -> None:
    with zenoh.open(zenoh_config(listen=[endpoint])) as ground:
        alive = ground.liveliness().declare_subscriber("guidance/**", zenoh.handlers.FifoChannel(10))
        records = ground.declare_subscriber("guidance/**", zenoh.handlers.FifoChannel(1000))
        sink = ZenohSink("plane-2.b", connect=[endpoint])
        sink.offer(sample(STATUS))
        sink.start()
        assert str(alive.recv().key_expr) == "guidance/plane-2.b/alive"
        while not any(reply.ok for reply in ground.get("guidance/plane-2.b/**", timeout=1.0)):
            continue
        for number in range(200):
            sink.offer(sample(event(number)))
        assert sink.close(DEADLINE_S)
        seen: list[int] = []
        while not seen or seen[-1] != 199:
            seen.append(msgspec.json.decode(records.recv().payload.to_bytes(), type=dict[str, Any])["t_ns"])
        assert seen[-200:] == list(range(200))


class Opener:
    """Stands in for `zenoh.open`: fails, hangs or works as told; `called` tells that it was asked."""

    def __init__(self, behaviour: Literal["fail", "hang"]) -> None:
        self.behaviour = behaviour
        self.calls = 0
        self.called = threading.Event()
        self.released = threading.Event()

    def __call__(self, config: zenoh.Config) -> zenoh.Session:
        self.calls += 1
        self.called.set()
        if self.behaviour == "hang":
            self.released.wait()
        raise zenoh.ZError("unreachable at /somewhere/in/zenoh.rs:12.")


@pytest.mark.parametrize("behaviour", ["fail", "hang"])
def test_zenoh_out_of_reach_costs_neither_time_nor_memory(behaviour: Literal["fail", "hang"]) -> None:
    opener = Opener(behaviour)
    sink = ZenohSink("rover1", capacity=100, open_session=opener)
    sink.start()
    try:
        assert opener.called.wait(DEADLINE_S)
        for number in range(5000):
            sink.offer(sample(event(number)))  # a block here is a time-out of the test
        assert len(sink._queue) == 100
        assert sink.dropped == 4900
        before_s = time.monotonic()
        assert not sink.close(0.05)
        assert time.monotonic() - before_s < 1.0
    finally:
        opener.released.set()
    assert not sink.close(DEADLINE_S)  # nothing was ever published


def test_opening_is_retried_with_a_growing_pause_that_has_a_limit() -> None:
    now_ns = 0
    opener = Opener("fail")
    sink = ZenohSink("rover1", open_session=opener, clock_ns=lambda: now_ns)
    attempts_s = []
    while now_ns < 40_000_000_000:
        calls = opener.calls
        assert not sink._ready()
        if opener.calls > calls:
            attempts_s.append(now_ns * 1e-9)
        now_ns += 100_000_000
    pauses_s = [round(b - a, 3) for a, b in itertools.pairwise(attempts_s)]
    assert attempts_s[0] == 0
    assert pauses_s == [0.5, 1.0, 2.0, 4.0, 8.0, LAST_RETRY_S, LAST_RETRY_S]
    assert sink.problem == "zenoh: cannot open a session: unreachable; trying again every 10 s"


def test_a_session_that_dies_is_opened_anew(endpoint: str) -> None:
    opened: list[zenoh.Session] = []
    twice = threading.Event()

    def opening(config: zenoh.Config) -> zenoh.Session:
        opened.append(zenoh.open(config))
        if len(opened) == 2:
            twice.set()
        return opened[-1]

    with zenoh.open(zenoh_config(listen=[endpoint])) as ground:
        alive = ground.liveliness().declare_subscriber("guidance/**", zenoh.handlers.FifoChannel(10))
        sink = ZenohSink("rover1", connect=[endpoint], open_session=opening)
        sink.start()
        assert alive.recv().kind == zenoh.SampleKind.PUT
        close: Any = opened[0].close
        close()
        assert alive.recv().kind == zenoh.SampleKind.DELETE
        sink.offer(sample(STATUS))
        assert twice.wait(DEADLINE_S)
        assert alive.recv().kind == zenoh.SampleKind.PUT
        sink.close(DEADLINE_S)


def test_a_router_that_is_not_there_is_named(endpoint: str) -> None:
    sink = ZenohSink("rover1", mode="client", connect=[endpoint])
    assert not sink._ready()
    assert endpoint in sink.problem
    assert "Unable to connect" in sink.problem
    assert ".rs" not in sink.problem


def test_a_peer_that_nobody_answers_says_so(endpoint: str) -> None:
    now_ns = 0
    sink = ZenohSink("rover1", connect=[endpoint], clock_ns=lambda: now_ns)
    assert sink._ready()
    now_ns = 2_000_000_000
    sink._turn()
    assert sink.problem == f"zenoh: nobody answers at {endpoint}; is the router up? trying again all the time"
    assert sink._finish()


def test_raw_traffic_is_not_even_queued() -> None:
    sink = ZenohSink("rover1")
    for topic in LOG_ONLY:
        sink.offer(Sample(topic, 0, b"{}"))
    assert len(LOG_ONLY) >= 3
    assert len(sink._queue) == 0


@pytest.mark.parametrize("vehicle", ["", "a/b", "*", "**", "a b", "$x", "a?b", "#", "/a", ".", "-"])
def test_a_name_that_would_break_the_keys_is_refused(vehicle: str) -> None:
    with pytest.raises(ValueError, match="vehicle = "):
        ZenohSink(vehicle)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"mode": "pear"}, "mode = 'pear' is not accepted"),
        ({"connect": ["192.168.1.2:7447"]}, "connect/endpoints = .* is not accepted"),
        ({"listen": ["rubbish"]}, "Endpoints must be of the form"),
        ({"config_file": Path("/nowhere/zenoh.json5")}, "cannot use the file /nowhere/zenoh.json5"),
        ({"config_file": Path("z.json5"), "connect": ["tcp/a:1"]}, "replaces mode, endpoints and scouting"),
    ],
)
def test_settings_that_zenoh_does_not_take_are_refused_in_words(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words) as refusal:
        zenoh_config(**settings)
    assert ".rs" not in str(refusal.value)
    assert "Message" not in str(refusal.value)


def test_endpoints_are_pinned_and_scouting_is_off_unless_asked_for(tmp_path: Path) -> None:
    config = zenoh_config()
    assert json.loads(config.get_json("listen/endpoints")) == []
    assert json.loads(config.get_json("scouting/multicast/enabled")) is False
    file = tmp_path / "zenoh.json5"
    file.write_text('{mode: "client", connect: {endpoints: ["tls/gcs:7447"]}}')
    assert json.loads(zenoh_config(config_file=file).get_json("mode")) == "client"
