"""How often a viewer is shown what, and where paths begin, end and thin out."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import msgspec
import pytest

from guidance.records import TOPICS, Event, Level, Record, Reference, State
from guidance.se3 import IDENTITY, Pose, Vec3
from guidance.telemetry import Sample
from guidance.telemetry.foxglove_view import (
    PATH_POSES,
    PATH_SPACING_MAX_NS,
    SHOWN,
    SHOWN_HZ,
    Path,
    View,
)
from tests.test_foxglove import reference, state, tracking_error

OFFSET_NS = 1_700_000_000_000_000_000
S = 1_000_000_000


def sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


def at(t_ns: int, north_m: float, speed_m_s: float = 1.0) -> State:
    return state(Pose(Vec3(north_m, 0.0, 0.0), IDENTITY), Vec3(speed_m_s, 0.0, 0.0), t_ns)


def ahead(t_ns: int, trajectory_s: float) -> Reference:
    return reference(Vec3(trajectory_s, 1.0, 0.0), Vec3(1.0, 0.0, 0.0), t_ns, trajectory_s)


def shown(view: View, *records: Record) -> list[tuple[str, Any]]:
    """Topic and content of all that the records give rise to, each at its instant and of its class."""
    made = []
    for record in records:
        for message in view.of(sample(record)):
            kind = SHOWN[message.topic.removeprefix("rover1/")]
            assert message.t_ns == record.t_ns
            made.append((message.topic, msgspec.json.decode(message.payload, type=kind)))
    return made


def northings(path: Any) -> list[float]:
    return [pose.position.y for pose in path.poses]


def paths(made: list[tuple[str, Any]], topic: str = "vehicle/path") -> list[list[float]]:
    return [northings(message) for name, message in made if name == topic]


def flight(until_s: float, rate_hz: int = 50, start_s: float = 0.0) -> list[Record]:
    """North at 1 m/s, and the reference with it: the records of each setpoint, as the service emits them."""
    made: list[Record] = []
    for tick in range(round(start_s * rate_hz), round(until_s * rate_hz)):
        t_ns = tick * S // rate_hz
        made += [
            at(t_ns, t_ns / S),
            ahead(t_ns, t_ns / S - start_s),
            tracking_error(Vec3(1.0, 0.0, 0.0), t_ns),
        ]
    return made


@pytest.mark.parametrize("rate_hz", [25, 50, 200])
def test_poses_are_shown_at_their_rate_and_paths_once_a_second(rate_hz: int) -> None:
    made = shown(View(OFFSET_NS), *flight(5.0, rate_hz))
    count = {topic: sum(name == topic for name, _ in made) for topic in SHOWN}
    assert count == {
        "tf": 5 * SHOWN_HZ + 1,  # the first state cannot know that a reference follows
        "tf_static": 1,
        "vehicle/pose": 5 * SHOWN_HZ,
        "vehicle/field": 5 * SHOWN_HZ,
        "reference/pose": 5 * SHOWN_HZ,
        "vehicle/path": 5,
        "reference/path": 5,
        "log": 0,
    }
    assert made[0][0] == "tf_static"  # before whatever needs it


def test_vehicle_and_reference_are_shown_for_the_same_instants() -> None:
    made = shown(View(OFFSET_NS), *flight(3.0, 50))
    stamps = {
        topic: [message.timestamp for name, message in made if name == topic]
        for topic in ("vehicle/pose", "reference/pose", "vehicle/field")
    }
    assert stamps["vehicle/pose"] == stamps["reference/pose"] == stamps["vehicle/field"]
    first, second = stamps["vehicle/pose"][:2]
    assert (first.sec, first.nsec) == (OFFSET_NS // S, 0)
    assert (second.sec, second.nsec) == (OFFSET_NS // S, S // SHOWN_HZ)


def test_every_event_is_a_line_of_the_log() -> None:
    view = View(OFFSET_NS)
    events = [Event(t_ns=7, level=Level.INFO, code="x", text=str(number)) for number in range(5)]
    assert [message.message for _, message in shown(view, *events)] == list("01234")


def test_several_vehicles_share_no_topic_and_no_frame() -> None:
    made = shown(View(OFFSET_NS, "rover1"), *flight(1.0))
    assert {topic for topic, _ in made} == {f"rover1/{topic}" for topic in SHOWN if topic != "log"}
    frames = {message.frame_id for _, message in made if hasattr(message, "frame_id")}
    assert frames == {"rover1/map", "rover1/base_link"}
    children = {t.child_frame_id for topic, m in made if topic == "rover1/tf" for t in m.transforms}
    assert children == {"rover1/base_link", "rover1/reference"}


def test_the_reference_has_a_frame_while_there_is_one() -> None:
    view = View(OFFSET_NS)

    def children(record: Record) -> set[str]:
        return {t.child_frame_id for topic, m in shown(view, record) if topic == "tf" for t in m.transforms}

    assert children(at(0, 0.0)) == {"base_link"}
    assert children(ahead(0, 0.0)) == {"base_link", "reference"}
    assert children(at(S // 10, 0.0)) == set()  # its reference follows
    made = shown(view, ahead(S // 10, 0.1))
    (stamps,) = [[t.timestamp.nsec for t in m.transforms] for topic, m in made if topic == "tf"]
    assert stamps == [S // 10, S // 10]
    assert children(at(4 * S // 10, 0.0)) == {"base_link"}  # it did not: tracking is over


@pytest.mark.parametrize(
    "payload", [b"", b"{}", b"\xff", b'{"t_ns":"x"}', b'{"t_ns":1e999}', b"[" * 5000, b"null"]
)
@pytest.mark.parametrize("topic", [*TOPICS.values(), "stranger"])
def test_what_is_no_record_is_shown_as_nothing(topic: str, payload: bytes) -> None:
    assert View(OFFSET_NS).of(Sample(topic, 0, payload)) == []


def test_a_path_leads_from_the_start_to_where_the_vehicle_is() -> None:
    before = shown(View(OFFSET_NS), *[at(n * S // 50, n / 50) for n in range(101)])
    first, *_, last = paths(before)
    assert first == [0.0, 0.0]  # a line has two ends
    assert last[0] == 0.0
    assert last[-1] == 2.0
    assert last == sorted(last)
    assert len(last) == 22


def test_both_paths_begin_with_the_trajectory_and_again_with_the_next() -> None:
    view = View(OFFSET_NS)
    shown(view, *[at(n * S // 50, n / 50) for n in range(500)])  # ten seconds before it engages
    made = shown(view, *flight(13.0, start_s=10.0))
    assert paths(made)[-1][0] == pytest.approx(10.0, abs=0.11)
    assert paths(made, "reference/path")[-1][0] == 0.0
    made = shown(view, *flight(23.0, start_s=20.0))
    assert paths(made)[-1][0] == pytest.approx(20.0, abs=0.11)
    assert paths(made, "reference/path")[-1][0] == 0.0


@pytest.mark.parametrize("resets", [0, 1])
def test_a_path_begins_anew_where_the_estimator_was_reset(resets: int) -> None:
    view = View(OFFSET_NS)
    shown(view, *[at(n * S // 10, 0.0) for n in range(10)])
    later = [msgspec.structs.replace(at(S + n * S // 10, 3.0), resets=resets) for n in range(11)]
    assert paths(shown(view, *later))[-1][0] == (3.0 if resets else 0.0)


def test_a_long_flight_is_thinned_out_evenly_and_its_path_stays_bounded() -> None:
    path = Path()
    longest = 0
    for tick in range(10 * 3600):
        path.add(tick * S // 10, (tick / 10, 0.0, 0.0))
        longest = max(longest, len(path))
        if tick == 10 * 60:
            places = [msgspec.json.decode(raw)["position"]["y"] for raw in path.poses((60.0, 0.0, 0.0))]
            gaps = {round(b - a, 3) for a, b in pairwise(places[:-1])}
            assert places[0] == 0.0
            assert len(gaps) == 1
            assert len(places) > PATH_POSES / 2
    assert longest <= PATH_POSES
    places = [msgspec.json.decode(raw)["position"]["y"] for raw in path.poses((3600.0, 0.0, 0.0))]
    assert places[-1] == 3600.0
    assert {round(b - a, 3) for a, b in pairwise(places[:-1])} == {PATH_SPACING_MAX_NS / S}
    assert places[0] == pytest.approx(3600.0 - PATH_POSES * PATH_SPACING_MAX_NS / S, abs=1.0)


def test_a_path_of_a_vehicle_that_never_moves_is_bounded_too() -> None:
    view = View(OFFSET_NS)
    made = shown(view, *[at(n * S // 10, 0.0, 0.0) for n in range(5000)])
    assert max(map(len, paths(made))) <= PATH_POSES + 1
    assert paths(made, "reference/path") == []
