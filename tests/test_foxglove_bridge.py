"""The live bridge, seen by a WebSocket client: channels, poses as published, late joiners, refusals."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from types import SimpleNamespace
from typing import Any, Final, NamedTuple

import msgspec
import pytest
import zenoh
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from guidance.bridge import serve
from guidance.cli import app
from guidance.records import LOG_ONLY, TOPICS, Event, Level, Record, Session
from guidance.se3 import Pose, Quaternion, Vec3, from_euler
from guidance.service import new_session
from guidance.telemetry import Sample, foxglove_bridge
from guidance.telemetry.arrivals import Ignored
from guidance.telemetry.foxglove_bridge import CHANNELS, Bridge, BridgeError
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.schema import encoding_schema, json_schema, schema_of
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import ZenohSink, zenoh_config
from tests.foxglove_viewer import DEADLINE_S, viewing
from tests.helpers import make_config
from tests.test_foxglove import ENU_OF_NED, FLU_OF_FRD, ROUNDING, reference, state
from tests.test_se3 import rotation_matrix

Endpoints = Sequence[str]
POSE: Final = Pose(Vec3(3.0, 4.0, -5.0), from_euler(0.1, 0.2, 0.3))
STATE: Final = state(POSE, Vec3(1.0, 0.0, 0.0), 5_000_000_000)


@pytest.fixture(name="endpoint")
def a_free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def session_of(name: str, session_id: str = "first") -> Session:
    session = new_session(make_config(f"vehicle.name={name}"))
    return msgspec.structs.replace(session, t_ns=10**9, unix_offset_ns=10**18, session_id=session_id)


SESSION: Final = session_of("rover1")


def event(number: int) -> Event:
    return Event(t_ns=number, level=Level.INFO, code="test", text=str(number))


class Served(NamedTuple):
    """A bridge that runs: its port, and what it has said."""

    port: int
    said: list[str]


@contextmanager
def serving(*, only: str = "", connect: Endpoints = (), listen: Endpoints = ()) -> Iterator[Served]:
    """The bridge in a thread, as the command runs it."""
    stop = threading.Event()
    said: list[str] = []
    config = zenoh_config(connect=connect, listen=listen)
    with Subscriber(config, only or "*") as subscriber, closing(Bridge("127.0.0.1", 0, only)) as server:

        def say(_: Level, words: str) -> None:
            said.append(words)

        thread = threading.Thread(target=serve, args=[subscriber, server, say, stop.wait])
        thread.start()
        try:
            yield Served(server.port, said)
        finally:
            stop.set()
            thread.join(DEADLINE_S)
            assert not thread.is_alive()


@contextmanager
def publishing(
    *records: Record, connect: Endpoints = (), listen: Endpoints = ()
) -> Iterator[Callable[[Record], None]]:
    """A service's own sink; gives what publishes a record."""
    sink = ZenohSink("rover1", connect=connect, listen=listen)

    def publish(record: Record) -> None:
        sink.offer(Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record)))

    for record in records:
        publish(record)
    sink.start()
    try:
        yield publish
    finally:
        sink.close(DEADLINE_S)


def welcome(bridge: Bridge, subscriptions: int = 1) -> None:
    """A turn of the bridge, once it has heard of so many subscriptions."""
    waiting = threading.Event()
    while len(bridge._listener.joined) < subscriptions:
        waiting.wait(0.005)
    bridge.welcome()


def assert_shows(message: Any, pose: Pose, frame: str) -> None:
    """A foxglove.PoseInFrame, against matrices."""
    assert message["frame_id"] == frame
    position, q = message["pose"]["position"], message["pose"]["orientation"]
    assert_allclose([position[axis] for axis in "xyz"], ENU_OF_NED @ pose.position, atol=ROUNDING)
    turned = rotation_matrix(Quaternion(q["w"], q["x"], q["y"], q["z"]))
    assert_allclose(turned, ENU_OF_NED @ rotation_matrix(pose.attitude) @ FLU_OF_FRD, atol=ROUNDING)


def test_a_viewer_decodes_the_pose_that_was_published_over_zenoh(endpoint: str) -> None:
    with serving(listen=[endpoint]) as served, publishing(SESSION, connect=[endpoint]) as publish:
        with viewing(served.port) as viewer:
            viewer.subscribe("/rover1/vehicle/pose", "/rover1/state", "/rover1/tf_static", "/rover1/session")
            assert viewer.message("/rover1/session")[1]["vehicle"] == "rover1"
            publish(STATE)
            time_ns, pose = viewer.message("/rover1/vehicle/pose")
            assert time_ns == STATE.t_ns + 10**18
            assert pose["timestamp"] == {"sec": 10**9 + 5, "nsec": 0}
            assert_shows(pose, POSE, "rover1/map")
            assert viewer.message("/rover1/state") == (
                time_ns,
                msgspec.json.decode(msgspec.json.encode(STATE)),
            )
            children = {t["child_frame_id"] for t in viewer.message("/rover1/tf_static")[1]["transforms"]}
            assert children == {"rover1/map", "rover1/map_ned", "rover1/base_link_frd"}
            for topic in CHANNELS:
                viewer.learn(f"/rover1/{topic}")
            assert len(viewer.channels) == len(CHANNELS)
        with viewing(served.port) as late:  # it is told what was said before it came
            late.subscribe("/rover1/tf_static", "/rover1/vehicle/pose", "/rover1/session")
            assert len(late.message("/rover1/tf_static")[1]["transforms"]) == 3
            assert_shows(late.message("/rover1/vehicle/pose")[1], POSE, "rover1/map")


def test_a_bridge_that_comes_late_learns_the_session_and_shows_nothing_old(endpoint: str) -> None:
    with (
        publishing(SESSION, event(1), listen=[endpoint]) as publish,  # to nobody
        serving(connect=[endpoint], only="rover1") as served,
        viewing(served.port) as viewer,
    ):
        viewer.subscribe("/session", "/event")
        assert viewer.message("/session")[1]["session_id"] == SESSION.session_id
        publish(event(2))
        assert viewer.message("/event")[1]["text"] == "2"
    assert served.said == ["rover1 is here"]


def test_the_channels_have_their_schemas() -> None:
    with closing(Bridge("127.0.0.1", 0, "rover1")) as bridge:
        bridge.take("rover1", session_of("rover1"))
        with viewing(bridge.port) as viewer:
            for topic in CHANNELS:
                channel = viewer.learn(f"/{topic}")
                assert (channel["encoding"], channel["schemaEncoding"]) == ("json", "jsonschema")
                kind = SHOWN.get(topic)
                schema = json_schema(topic) if kind is None else schema_of(kind)
                assert channel["schema"] == schema.decode()
    assert {f"foxglove.{kind.__name__}" for kind in SHOWN.values()} < {name for name, _ in CHANNELS.values()}
    assert CHANNELS.keys() == SHOWN.keys() | (set(TOPICS.values()) - LOG_ONLY)


def test_one_vehicle_alone_has_the_topics_and_frames_of_a_log() -> None:
    with closing(Bridge("127.0.0.1", 0, "rover1")) as bridge, viewing(bridge.port) as viewer:
        for name in ("rover1", "rover2"):
            bridge.take(name, session_of(name))
            bridge.take(name, STATE)
        assert bridge._vehicles.keys() == {"rover1"}
        viewer.subscribe("/vehicle/pose")
        welcome(bridge)
        assert_shows(viewer.message("/vehicle/pose")[1], POSE, "map")
        for topic in CHANNELS:
            viewer.learn(f"/{topic}")
        assert len(viewer.channels) == len(CHANNELS)


def test_vehicles_side_by_side_do_not_mix() -> None:
    with closing(Bridge("127.0.0.1", 0)) as bridge, viewing(bridge.port) as viewer:
        places = {"rover1": 1.0, "rover2": 2.0}
        for name, north_m in places.items():
            bridge.take(name, session_of(name))
            bridge.take(name, state(Pose(Vec3(north_m, 0.0, 0.0), POSE.attitude)))
        viewer.subscribe("/rover1/vehicle/pose", "/rover2/vehicle/pose")
        welcome(bridge, 2)
        for name, north_m in places.items():
            _, message = viewer.message(f"/{name}/vehicle/pose")
            assert message["frame_id"] == f"{name}/map"
            assert message["pose"]["position"]["y"] == north_m


def test_what_comes_before_the_session_is_not_shown_and_a_new_session_begins_anew() -> None:
    with closing(Bridge("127.0.0.1", 0)) as bridge, viewing(bridge.port) as viewer:
        bridge.take("rover1", event(1))
        assert not bridge._vehicles
        bridge.take("rover1", session_of("rover1"))
        bridge.take("rover1", STATE)
        bridge.take("rover1", reference(POSE.position, Vec3(1.0, 0.0, 0.0), STATE.t_ns))
        viewer.subscribe("/rover1/event", "/rover1/reference")
        bridge.take("rover1", session_of("rover1", "second"))
        assert {channel.topic() for channel, _, _ in bridge._last.values()} == {"/rover1/session"}
        welcome(bridge, 2)
        bridge.take("rover1", event(2))
        assert viewer.message("/rover1/event")[1]["text"] == "2"  # nothing of the run before


def test_what_is_no_record_is_passed_over_and_named_once(endpoint: str) -> None:
    with (
        serving(listen=[endpoint]) as served,
        publishing(SESSION, connect=[endpoint]) as publish,
        viewing(served.port) as viewer,
        zenoh.open(zenoh_config(connect=[endpoint])) as stranger,
    ):
        viewer.subscribe("/rover1/event")
        newer = zenoh.Encoding.APPLICATION_JSON.with_schema("guidance.Event/2")
        waiting = threading.Event()
        while sum("passed over" in text for text in served.said) < 3:
            stranger.put("guidance/rover1/event", b"\xff", encoding=encoding("event"))
            stranger.put("guidance/rover1/event", b"{}", encoding=newer)
            stranger.put("guidance/-x/event", b"{}", encoding=newer)
            waiting.wait(0.01)
        publish(event(7))
        assert viewer.message("/rover1/event")[1]["text"] == "7"
    said = [text for text in served.said if "passed over" in text]
    assert len(said) == 3, served.said
    assert sum("schema version 2" in text for text in said) == 1
    assert sum("garbage" in text for text in said) == 1


@pytest.mark.parametrize("t_ns", [-(10**30), -1, 2**63, 10**30])
def test_an_absurd_time_stops_nothing(t_ns: int) -> None:
    with closing(Bridge("127.0.0.1", 0)) as bridge, viewing(bridge.port) as viewer:
        bridge.take("rover1", session_of("rover1"))
        viewer.subscribe("/rover1/event")
        welcome(bridge)
        bridge.take("rover1", event(t_ns))
        bridge.take("rover1", state(POSE, t_ns=t_ns))
        assert viewer.message("/rover1/event")[1]["text"] == str(t_ns)


def test_a_port_in_use_is_named() -> None:
    with (
        closing(Bridge("127.0.0.1", 0)) as bridge,
        pytest.raises(BridgeError, match=rf"port {bridge.port}: Address already in use; choose .* --port"),
    ):
        Bridge("127.0.0.1", bridge.port)


def encoding(topic: str) -> zenoh.Encoding:
    return zenoh.Encoding.APPLICATION_JSON.with_schema(encoding_schema(topic))


def call(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["foxglove", *arguments], catch_exceptions=False)
    return result.exit_code, result.stderr


def test_the_command_refuses_in_words() -> None:
    status, said = call("--connect", "rubbish")
    assert (status, "connect/endpoints" in said) == (2, True)
    status, said = call("--vehicle", "a/*")
    assert (status, said) == (2, "guidance: --vehicle 'a/*': a name has 1 to 64 letters, digits and _.-\n")
    with closing(Bridge("127.0.0.1", 0)) as bridge:
        status, said = call("--connect", "tcp/127.0.0.1:1", "--port", str(bridge.port))
    assert (status, "already in use" in said) == (1, True)


def test_without_the_sdk_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    for module in ("guidance.bridge", "guidance.telemetry.foxglove_bridge"):
        monkeypatch.delitem(sys.modules, module)
    assert call() == (2, "guidance: the Foxglove SDK is missing: pip install 'se3-guidance[foxglove]'\n")


def test_the_command_bridges_until_a_signal_comes(endpoint: str) -> None:
    """As a process, which ends in order and at once."""
    command = [sys.executable, "-m", "guidance", "foxglove", "--listen", endpoint, "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            port = int(process.stderr.readline().split("ws://127.0.0.1:")[1].split(":")[0])
            with viewing(port):
                process.send_signal(signal.SIGTERM)
                process.stderr.read()
            assert process.wait(DEADLINE_S) == 128 + signal.SIGTERM
        finally:
            process.kill()


def test_trouble_with_zenoh_is_told_when_it_comes_and_when_it_goes() -> None:
    troubles = iter(["opening a session", "", "", "no session: refused", "no session: refused", "", ""])
    subscriber: Any = SimpleNamespace(trouble=next(troubles), take=list)

    def stopping(_: float) -> bool:
        trouble = next(troubles, None)
        subscriber.trouble = trouble
        return trouble is None

    said: list[tuple[Level, str]] = []
    with closing(Bridge("127.0.0.1", 0)) as bridge:
        serve(subscriber, bridge, lambda *words: said.append(words), stopping)
    assert said == [
        (Level.WARNING, "zenoh: no session: refused"),
        (Level.NOTICE, "zenoh: a session is open again"),
    ]


def test_a_stranger_who_thinks_of_ever_new_things_fills_no_screen() -> None:
    ignored = [Ignored(0, "rover1", f"schema version {number}") for number in range(1000)]
    subscriber: Any = SimpleNamespace(trouble="", take=lambda: ignored)
    said: list[str] = []
    with closing(Bridge("127.0.0.1", 0)) as bridge:
        serve(subscriber, bridge, lambda _, words: said.append(words), lambda _: bool(said))
    assert 3 < len(said) < 50


def test_who_is_there_already_is_told_nothing_twice() -> None:
    with closing(Bridge("127.0.0.1", 0)) as bridge, viewing(bridge.port) as first:
        bridge.take("rover1", SESSION)
        bridge.take("rover1", event(1))
        first.subscribe("/rover1/event")
        welcome(bridge)
        with viewing(bridge.port) as second:
            second.subscribe("/rover1/event")
            welcome(bridge)
            assert second.message("/rover1/event")[1]["text"] == "1"
        bridge.take("rover1", event(2))
        assert [first.message("/rover1/event")[1]["text"] for _ in range(2)] == ["1", "2"]


def test_memory_has_a_limit_whoever_publishes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foxglove_bridge, "VEHICLES_MAX", 3)
    with closing(Bridge("127.0.0.1", 0)) as bridge:
        for k in range(10):
            bridge.take("v0", session_of("v0"))  # is heard all the time
            bridge.take("v0", event(k))
            bridge.take(f"v{k}", session_of(f"v{k}"))
            bridge.take(f"v{k}", STATE)
        assert sorted(bridge._vehicles) == ["v0", "v8", "v9"]
        channels = [channel for shown in bridge._vehicles.values() for channel in shown.channels.values()]
        assert bridge._last.keys() <= {channel.id() for channel in channels}
