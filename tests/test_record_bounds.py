"""No integer of a record is larger than 64 bits hold, whoever wrote it: every door refuses such a record."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest
from msgspec import inspect as types
from msgspec.structs import replace

from guidance.cli import main
from guidance.dashboard.said import fleet_told
from guidance.fleet import Fleet
from guidance.mavlink.clock import VEHICLE_NS_MAX, ClockFilter
from guidance.records import TOPICS, Record
from guidance.replay import ReplayError, replay
from guidance.telemetry.arrivals import Heard, Ignored, read
from guidance.telemetry.schema import RECORDS, encoding_schema
from guidance.watch_view import clock
from tests.dashboard_rig import Flown
from tests.fleet_rig import UNIX_OFFSET_NS, event, session, setpoint, status
from tests.flight_asset import ASSET
from tests.test_replay import rewritten

LEAST: Final = -(1 << 63)
MOST: Final = (1 << 63) - 1
#: As many digits as no type of a database, a viewer or numpy holds, and as no float does.
ENDLESS: Final = 10**400


def unbounded(kind: types.Type, where: str) -> Iterator[str]:
    """The places in a type at which an integer may be of any size."""
    match kind:
        case types.IntType(ge=least, le=most):
            if (least, most) != (LEAST, MOST):
                yield where
        case types.StructType(fields=fields):
            for field in fields:
                yield from unbounded(field.type, f"{where}.{field.name}")
        case types.UnionType(types=choices):
            for choice in choices:
                yield from unbounded(choice, where)
        case types.VarTupleType(item_type=item) | types.DictType(value_type=item):
            yield from unbounded(item, f"{where}[]")
        case types.TupleType(item_types=items):
            for item in items:
                yield from unbounded(item, f"{where}[]")


@pytest.mark.parametrize("topic", RECORDS)
def test_every_integer_of_every_record_has_bounds(topic: str) -> None:
    assert list(unbounded(types.type_info(RECORDS[topic]), topic)) == []


def came(record: Record) -> Heard | Ignored:
    """A record as it comes over zenoh."""
    topic = TOPICS[type(record)]
    encoding = f"application/json;{encoding_schema(topic)}"
    return read(0, f"guidance/uuv-1/{topic}", encoding, as_json(record))


def as_json(record: Record) -> bytes:
    """Python's own writes integers of any size."""
    return json.dumps(msgspec.structs.asdict(record)).encode()


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    "change",
    [
        lambda huge: setpoint(0, huge),
        lambda huge: setpoint(huge, 1),
        lambda huge: status(huge),
        lambda huge: status(0, since_ns=huge),
        lambda huge: event(huge, "x"),
        lambda huge: replace(session("aa"), unix_offset_ns=huge),
    ],
    ids=["seq", "instant", "status", "since", "event", "offset"],
)
def test_what_comes_with_an_endless_integer_is_no_record(change: Callable[[int], Record], sign: int) -> None:
    for huge in (sign * ENDLESS, sign * (1 << 63) + (sign < 0) * -1):
        found = came(change(huge))
        assert isinstance(found, Ignored)
        assert found.what == "garbage"
        assert "Expected `int`" in found.detail
    assert isinstance(came(change(MOST if sign > 0 else LEAST)), Heard)


def test_the_largest_that_are_taken_end_neither_the_dashboard_nor_watch() -> None:
    flown = Flown()
    for huge in (MOST, LEAST):
        flown.turn(*flown.heard(setpoint(0, 1), setpoint(1, huge), setpoint(huge, 2), setpoint(huge, MOST)))
        flown.turn(*flown.heard(replace(session("aa"), unix_offset_ns=huge), event(huge, "x")))
        flown.turn(*flown.heard(status(huge, since_ns=-huge - 1)))
        msgspec.json.encode(flown.hub.about("uuv-1", flown.now_ns))
        told = fleet_told(flown.hub.fleet, flown.hub.seen, "", 1, UNIX_OFFSET_NS)
        json.loads(msgspec.json.encode(told), parse_constant=pytest.fail)
        assert all(clock(note, UNIX_OFFSET_NS) for note in flown.hub.fleet.notes)


def test_an_event_of_no_time_does_not_end_watch() -> None:
    fleet = Fleet()
    fleet.take([came(event(10**30, "x")), came(event(1, "y"))])
    assert [note.text for note in fleet.notes] == ["y"]
    assert clock(fleet.notes[0], UNIX_OFFSET_NS)


def enlarged(topic: str, field: str, after: int = 0) -> Callable[[str, bytes], bytes]:
    """A change of every message of the topic that follows `after` others."""
    passed = 0

    def change(found: str, payload: bytes) -> bytes:
        nonlocal passed
        passed += found == topic
        if found != topic or passed <= after:
            return payload
        record: dict[str, Any] = json.loads(payload)
        assert field in record
        return json.dumps({**record, field: ENDLESS}).encode()

    return change


@pytest.mark.parametrize("verb", ["report", "replay"])
def test_a_log_that_begins_with_an_endless_integer_is_refused_in_one_line(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = rewritten(ASSET, tmp_path / "log", enlarged("session", "unix_offset_ns"))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["guidance", verb, str(log)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert "its session record cannot be used: Expected `int` <= 9223372036854775807" in said
    assert "Traceback" not in said


def test_an_input_at_no_instant_is_refused_by_the_replay(tmp_path: Path) -> None:
    log = rewritten(ASSET, tmp_path, enlarged("input", "t_ns", after=100))
    with pytest.raises(ReplayError, match="input 100 cannot be read: Expected `int` <= 9223372036854775807"):
        replay(log)


@pytest.mark.parametrize("topic", ["status", "event", "setpoint", "input"])
def test_a_report_ends_where_a_record_is_at_no_instant(
    topic: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    count = {"status": 60, "event": 60, "setpoint": 120, "input": 1500}[topic]
    log = rewritten(ASSET, tmp_path / "log", enlarged(topic, "t_ns", after=count))
    monkeypatch.setattr(
        sys, "argv", ["guidance", "report", str(log), "-o", str(tmp_path / "x.html"), "--json"]
    )
    with pytest.raises(SystemExit) as ended:
        main()
    out, err = capsys.readouterr()
    assert ended.value.code == 0, err
    assert "Traceback" not in err
    assert "cannot be read (Expected `int` <= 9223372036854775807" in json.loads(out)["logs"][0]["incomplete"]


def test_an_answer_from_before_all_clocks_is_not_believed() -> None:
    """Its offset would be none that the link's record can tell."""
    followed = ClockFilter()
    for vehicle_ns in (LEAST, -VEHICLE_NS_MAX - 1, VEHICLE_NS_MAX + 1, MOST):
        assert not followed.update(0, vehicle_ns, 1_000_000)
    assert (followed.accepted, followed.rejected) == (0, 4)
    assert followed.update(0, VEHICLE_NS_MAX, 1_000_000)
    assert LEAST < followed.offset_ns(0) < MOST
