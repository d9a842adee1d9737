"""A log opens in a viewer: what was flown is in it as Foxglove knows it, and costs little."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema
from numpy.testing import assert_allclose

from guidance.records import TOPICS, Event, Record, Reference, State
from guidance.replay import replay
from guidance.se3 import Quaternion
from guidance.telemetry import Sample
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.log import read_log, read_metadata, read_records
from guidance.telemetry.schema import RECORDS
from sitl.logbook import LogBook
from tests.helpers import make_config, make_flight
from tests.recorder_rig import CLOSE_S, OFFSET_NS, SmallDisk, as_messages, readable, record_all, recorder
from tests.test_foxglove import ENU_OF_NED, FLU_OF_FRD, ROUNDING, rotation, vector
from tests.test_se3 import rotation_matrix

LAYOUT: Final = Path(__file__).parents[1] / "deploy" / "foxglove-layout.json"
FLIGHT_S: Final = 12.0
#: A path has two digits.
PATH_ROUNDING_M: Final = 0.006

Found = tuple[Schema | None, Channel, Message]


@pytest.fixture(scope="module", name="flown")
def a_flight() -> list[Record]:
    flight = make_flight()
    flight.run(FLIGHT_S)
    return flight.records


def write(directory: Path, records: list[Record], *overrides: str) -> Path:
    with LogBook(make_config(*overrides), directory) as book:
        for record in records:
            book.add(record)
    return book.path


@pytest.fixture(scope="module", name="log")
def a_log(flown: list[Record], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("log"), flown)


@pytest.fixture(scope="module", name="found")
def the_messages(log: Path) -> list[Found]:
    """All of the log as the library reads it, in file order."""
    with log.open("rb") as file:
        return list(make_reader(file, validate_crcs=True).iter_messages(log_time_order=False))


def contents(found: list[Found], topic: str) -> Iterator[tuple[int, Any]]:
    """Log time and message, decoded as its well-known class."""
    for _, channel, message in found:
        if channel.topic == f"/{topic}":
            yield message.log_time, msgspec.json.decode(message.data, type=SHOWN[topic])


def test_the_channels_carry_the_well_known_names(found: list[Found]) -> None:
    schemas = {channel.topic: schema for schema, channel, _ in found}
    for topic, kind in SHOWN.items():
        schema = schemas[f"/{topic}"]
        assert schema is not None
        assert (schema.name, schema.encoding) == (f"foxglove.{kind.__name__}", "jsonschema")
        assert json.loads(schema.data)["type"] == "object"
    encodings = {channel.message_encoding for _, channel, _ in found}
    assert encodings == {"json"}


def test_the_vehicle_is_shown_where_its_records_say(found: list[Found], flown: list[Record]) -> None:
    states = {record.t_ns: record for record in flown if isinstance(record, State)}
    shown = list(contents(found, "vehicle/pose"))
    assert len(shown) > 9 * FLIGHT_S
    for time_ns, message in shown:
        assert message.frame_id == "map"
        assert (
            message.timestamp.sec * 10**9 + message.timestamp.nsec == time_ns
        )  # of the message, not the log's
        state = states[time_ns]
        assert_allclose(vector(message.pose.position), ENU_OF_NED @ state.position_ned_m, atol=ROUNDING)
        attitude = rotation_matrix(Quaternion(*state.attitude_wxyz))
        assert_allclose(rotation(message.pose.orientation), ENU_OF_NED @ attitude @ FLU_OF_FRD, atol=ROUNDING)


def test_both_paths_are_where_vehicle_and_reference_were(found: list[Found], flown: list[Record]) -> None:
    for topic, kind in (("vehicle/path", State), ("reference/path", Reference)):
        places = {record.t_ns: record.position_ned_m for record in flown if isinstance(record, kind)}
        time_ns, path = list(contents(found, topic))[-1]
        assert len(path.poses) > 50
        assert path.timestamp.sec * 10**9 + path.timestamp.nsec == time_ns
        assert time_ns > max(places) - 1_100_000_000
        end = ENU_OF_NED @ places[time_ns]
        assert_allclose(vector(path.poses[-1].position), end, atol=PATH_ROUNDING_M)
        was = {tuple(round(float(x), 2) for x in ENU_OF_NED @ place) for place in places.values()}
        assert {(p.position.x, p.position.y, p.position.z) for p in path.poses} <= was


def test_events_are_in_the_log_panel(found: list[Found], flown: list[Record]) -> None:
    lines = [message.message for _, message in contents(found, "log")]
    assert lines == [record.text for record in flown if isinstance(record, Event)]
    assert len(lines) > 3


def test_readers_of_ours_see_the_records_alone_and_in_full(
    log: Path, flown: list[Record], found: list[Found], tmp_path: Path
) -> None:
    assert list(read_records(log))[1:] == flown
    assert {topic for topic, _ in read_log(log)} <= set(RECORDS)
    bare = write(tmp_path, flown, "log.foxglove=false")
    assert list(read_log(bare))[1:] == list(read_log(log))[1:]  # but for the session's own configuration
    assert read_metadata(bare).keys() == read_metadata(log).keys()
    assert [message.sequence for _, _, message in found] == list(range(1, len(found) + 1))
    assert replay(log).identical
    assert replay(bare).identical


def test_a_log_grows_by_little(log: Path, flown: list[Record], tmp_path: Path) -> None:
    bare = write(tmp_path, flown, "log.foxglove=false").stat().st_size
    assert 1.02 < log.stat().st_size / bare < 1.15


def test_without_them_there_is_no_trace_of_them(flown: list[Record], tmp_path: Path) -> None:
    with write(tmp_path, flown[:100], "log.foxglove=false").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {f"/{topic}" for topic in RECORDS}


def samples_of(records: list[Record]) -> list[Sample]:
    return [Sample(TOPICS[type(r)], r.t_ns, msgspec.json.encode(r)) for r in records]


@pytest.mark.parametrize("chunk_bytes", [200, 3000])
def test_whatever_the_chunks_no_record_is_lost_or_out_of_order(
    flown: list[Record], tmp_path: Path, chunk_bytes: int
) -> None:
    samples = samples_of(flown[:2000])
    assert list(read_log(record_all(tmp_path, samples, chunk_bytes=chunk_bytes))) == as_messages(samples)


def test_on_a_full_disk_the_records_alone_are_counted(flown: list[Record], tmp_path: Path) -> None:
    class Disk(SmallDisk):
        room = 60_000

    samples = samples_of(flown)
    sink = recorder(tmp_path, open_file=Disk, chunk_bytes=2000)
    for item in samples:
        sink.offer(item)
    sink.start()
    assert not sink.close(CLOSE_S)
    messages, damage = readable(sink.path)
    assert damage is not None
    assert messages == as_messages(samples)[: len(messages)]
    assert len(messages) > 500
    assert sink.dropped == len(samples) - len(messages)


def test_times_are_unix_times(flown: list[Record], tmp_path: Path) -> None:
    path = record_all(tmp_path, samples_of(flown[:500]))
    with path.open("rb") as file:
        found = list(make_reader(file).iter_messages(topics=["/vehicle/pose"]))
    for _, _, message in found:
        stamp = msgspec.json.decode(message.data)["timestamp"]
        assert stamp["sec"] * 10**9 + stamp["nsec"] == message.log_time > OFFSET_NS
    assert found


def paths_in(layout: Any) -> Iterator[str]:
    """Every topic and message path that a layout names, wherever it stands."""
    if isinstance(layout, dict):
        for key, value in layout.items():
            yield from paths_in(key)
            yield from paths_in(value)
    elif isinstance(layout, list):
        for value in layout:
            yield from paths_in(value)
    elif isinstance(layout, str) and layout.startswith("/"):
        yield layout


def panels_of(node: Any) -> Iterator[str]:
    """The panels that the layout's tree places."""
    if isinstance(node, str):
        yield node
    else:
        yield from panels_of(node["first"])
        yield from panels_of(node["second"])


def test_every_topic_and_message_path_of_the_layout_is_in_a_log(found: list[Found]) -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    assert set(panels_of(layout["layout"])) == layout["configById"].keys()
    last = {channel.topic: msgspec.json.decode(message.data) for _, channel, message in found}
    named = set(paths_in(layout))
    assert {"/vehicle/pose", "/vehicle/path", "/reference/pose", "/reference/path", "/log"} <= named
    assert {"/error.norm_m", "/status.state", "/status"} <= named
    for path in named:
        assert re.fullmatch(r"/[a-z_/]+(\.[a-z_]+|\[\d+\])*", path)
        topic, *steps = re.findall(r"[a-z_/]+|\d+", path)
        value = last[topic]
        for step in steps:
            value = value[int(step) if step.isdigit() else step]


def test_every_frame_of_the_layout_is_in_a_log(found: list[Found]) -> None:
    scene = json.loads(LAYOUT.read_text(encoding="utf-8"))["configById"]["3D!scene"]
    frames = {"map"}
    for topic in ("tf", "tf_static"):
        for _, message in contents(found, topic):
            frames |= {transform.child_frame_id for transform in message.transforms}
    named = {key.removeprefix("frame:") for key in scene["transforms"]}
    assert named == frames
    assert scene["followTf"] in frames
    drawn = {f"/{topic}" for topic in SHOWN if "/" in topic}
    assert {topic for topic, settings in scene["topics"].items() if settings["visible"]} == drawn
