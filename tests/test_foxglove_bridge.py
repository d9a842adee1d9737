"""The live bridge, seen by a WebSocket client: channels, poses as published, late joiners, refusals."""

from __future__ import annotations

import json
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Any, Final

import msgspec
import pytest
import zenoh
from numpy.testing import assert_allclose
from typer.testing import CliRunner
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from guidance.cli import app
from guidance.records import LOG_ONLY, TOPICS, Event, Level, Record, Session
from guidance.se3 import Pose, Quaternion, Vec3, from_euler
from guidance.service import new_session
from guidance.telemetry import Sample, foxglove_bridge
from guidance.telemetry.foxglove_bridge import CHANNELS, Arrivals, Bridge, BridgeError, serve
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.schema import json_schema, schema_of
from guidance.telemetry.zenoh_sink import ZenohSink, close_quietly, zenoh_config
from tests.helpers import make_config
from tests.test_foxglove import ENU_OF_NED, FLU_OF_FRD, ROUNDING, reference, state
from tests.test_se3 import rotation_matrix

DEADLINE_S: Final = 20.0
SUBPROTOCOL: Final = Subprotocol("foxglove.sdk.v1")
_MESSAGE: Final = struct.Struct("<BIQ")  # opcode, subscription, log time; the payload follows
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


def event(number: int) -> Event:
    return Event(t_ns=number, level=Level.INFO, code="test", text=str(number))


class Viewer:
    """What a viewer does: learns what is advertised, subscribes, takes messages."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self._messages: list[tuple[str, int, Any]] = []
        self._subscriptions: dict[int, str] = {}
        assert self._json()["op"] == "serverInfo"

    def _json(self) -> Any:
        while isinstance(frame := self._connection.recv(timeout=DEADLINE_S), bytes):
            self._keep(frame)
        return json.loads(frame)

    def _keep(self, frame: bytes) -> None:
        opcode, subscription, time_ns = _MESSAGE.unpack_from(frame)
        assert opcode == 1
        content = json.loads(frame[_MESSAGE.size :])
        self._messages.append((self._subscriptions[subscription], time_ns, content))

    def learn(self, topic: str) -> dict[str, Any]:
        """The channel of `topic`, as soon as it is advertised."""
        while topic not in self.channels:
            told = self._json()
            assert told["op"] == "advertise"
            self.channels |= {channel["topic"]: channel for channel in told["channels"]}
        return self.channels[topic]

    def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            number = len(self._subscriptions) + 1
            self._subscriptions[number] = topic
            wanted.append({"id": number, "channelId": self.learn(topic)["id"]})
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self, topic: str) -> tuple[int, Any]:
        """Log time and content of the next message of `topic`."""
        while True:
            for index, (name, time_ns, content) in enumerate(self._messages):
                if name == topic:
                    del self._messages[index]
                    return time_ns, content
            frame = self._connection.recv(timeout=DEADLINE_S)
            if isinstance(frame, bytes):
                self._keep(frame)
            else:
                self.channels |= {channel["topic"]: channel for channel in json.loads(frame)["channels"]}


@contextmanager
def viewing(port: int) -> Iterator[Viewer]:
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[SUBPROTOCOL]) as connection:
        assert connection.subprotocol == SUBPROTOCOL
        yield Viewer(connection)


@contextmanager
def serving(listen: str, only: str = "") -> Iterator[int]:
    """The bridge in a thread, as the command runs it; gives its port."""
    stop, ready = threading.Event(), threading.Event()
    said: list[str] = []

    def say(text: str) -> None:
        said.append(text)
        ready.set()

    thread = threading.Thread(
        target=serve,
        args=[zenoh_config(listen=[listen])],
        kwargs={"host": "127.0.0.1", "port": 0, "only": only, "say": say, "wait": stop.wait},
    )
    thread.start()
    try:
        assert ready.wait(DEADLINE_S)
        yield int(said[0].split("ws://127.0.0.1:")[1].split(":")[0])
    finally:
        stop.set()
        thread.join(DEADLINE_S)
        assert not thread.is_alive()


@contextmanager
def publishing(name: str, endpoint: str, *records: Record) -> Iterator[Callable[[Record], None]]:
    """A service's own sink, connected to the bridge; gives what publishes a record."""
    sink = ZenohSink(name, connect=[endpoint])

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
    with serving(endpoint) as port, publishing("rover1", endpoint, session_of("rover1")) as publish:
        with viewing(port) as viewer:
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
        with viewing(port) as late:  # it is told what was said before it came
            late.subscribe("/rover1/tf_static", "/rover1/vehicle/pose", "/rover1/session")
            assert len(late.message("/rover1/tf_static")[1]["transforms"]) == 3
            assert_shows(late.message("/rover1/vehicle/pose")[1], POSE, "rover1/map")


def test_a_bridge_that_comes_late_asks_for_the_session(endpoint: str) -> None:
    """The vehicle listens; its session record is long gone when the bridge connects."""
    sink = ZenohSink("rover1", listen=[endpoint])
    sink.offer(Sample("session", 0, msgspec.json.encode(session_of("rover1"))))
    sink.start()
    try:
        ground = zenoh.open(zenoh_config(connect=[endpoint]))
        arrivals = Arrivals(ground)
        found: list[tuple[str, Record]] = []
        waiting = threading.Event()
        while not found:
            found += arrivals.take()
            waiting.wait(0.01)
        close_quietly(ground)
    finally:
        sink.close(DEADLINE_S)
    assert found == [("rover1", session_of("rover1"))]


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


@pytest.mark.parametrize("key", ["guidance/rover1/state", "guidance/rover1/nonsense", "guidance/-x/event"])
@pytest.mark.parametrize("payload", [b"", b"\xff\xfe", b'{"t_ns":1}', b"[" * 10_000])
def test_garbage_on_the_keys_is_passed_over(endpoint: str, key: str, payload: bytes) -> None:
    with zenoh.open(zenoh_config(listen=[endpoint])) as session:
        arrivals = Arrivals(session)
        session.put(key, payload)
        session.put("guidance/-x/event", msgspec.json.encode(event(3)))
        session.put("guidance/rover1/event", msgspec.json.encode(event(3)))
        waiting = threading.Event()
        found: list[tuple[str, Record]] = []
        while not found:
            found += arrivals.take()
            waiting.wait(0.005)
        assert found == [("rover1", event(3))]


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


def call(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["foxglove", *arguments], catch_exceptions=False)
    return result.exit_code, result.stderr


def test_the_command_refuses_in_words() -> None:
    assert call() == (
        2,
        "guidance: where are the vehicles? Name a router or vehicle with --connect, or --listen for them\n",
    )
    status, said = call("--connect", "rubbish")
    assert (status, "connect/endpoints" in said) == (2, True)
    status, said = call("--connect", "tcp/127.0.0.1:1", "--vehicle", "a/*")
    assert (status, "letters, digits" in said) == (2, True)
    with closing(Bridge("127.0.0.1", 0)) as bridge:
        status, said = call("--connect", "tcp/127.0.0.1:1", "--port", str(bridge.port))
    assert (status, "already in use" in said) == (1, True)


def test_without_the_sdk_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    monkeypatch.delitem(sys.modules, "guidance.telemetry.foxglove_bridge")
    assert call("--listen", "tcp/127.0.0.1:0") == (
        2,
        "guidance: the Foxglove SDK is missing: pip install 'se3-guidance[foxglove]'\n",
    )


def test_the_command_bridges_until_it_is_interrupted(endpoint: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}

    def interrupted(config: zenoh.Config, **settings: Any) -> None:
        asked.update(settings, listen=json.loads(config.get_json("listen/endpoints")))
        raise KeyboardInterrupt

    monkeypatch.setattr(foxglove_bridge, "serve", interrupted)
    status, said = call("--listen", endpoint, "--vehicle", "uuv-1", "--port", "0")
    assert (status, said) == (0, "stopped\n")
    assert (asked["listen"], asked["only"], asked["port"]) == ([endpoint], "uuv-1", 0)
