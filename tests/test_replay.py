"""A log replays to the bit; whatever was changed or lost in it is found and named."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from guidance.records import Input, Lost, Record, Session, Setpoint
from guidance.replay import ReplayError, replay
from guidance.telemetry import Sample
from guidance.telemetry.log import NotALog, read_log, read_records
from guidance.telemetry.recorder import Recorder
from sitl.logbook import LogBook
from tests.helpers import make_config, make_flight

FLIGHT_S = 6.0


def write(directory: Path, records: list[Record], *overrides: str) -> Path:
    """A log of these records, under the demo's configuration with overrides."""
    with LogBook(make_config(*overrides), directory) as book:
        for record in records:
            book.add(record)
    return book.path


@pytest.fixture(scope="module")
def flown() -> list[Record]:
    flight = make_flight()
    flight.run(FLIGHT_S)
    return flight.records


@pytest.fixture(scope="module")
def log(flown: list[Record], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write(tmp_path_factory.mktemp("logs"), flown)


def test_a_flight_replays_identically(log: Path) -> None:
    found = replay(log)
    assert found.difference is None
    assert found.stopped == ""
    assert found.identical
    assert found.tracked > 150
    assert found.flight_s == pytest.approx(FLIGHT_S, abs=0.1)


def test_everything_that_entered_and_left_the_core_is_in_the_log(log: Path, flown: list[Record]) -> None:
    logged = list(read_records(log))
    assert isinstance(logged[0], Session)
    assert logged[1:] == flown


def changed(
    records: list[Record], kind: type[Record], change: Callable[[Record], Record | None]
) -> list[Record]:
    """The records with `change` made to the last one of a type; None takes it out."""
    index = max(i for i, record in enumerate(records) if isinstance(record, kind))
    new = change(records[index])
    return [*records[:index], *([] if new is None else [new]), *records[index + 1 :]]


def test_a_setpoint_that_differs_in_the_last_bit_is_found(flown: list[Record], tmp_path: Path) -> None:
    def nudge(record: Record) -> Record:
        assert isinstance(record, Setpoint)
        return msgspec.structs.replace(record, thrust=record.thrust * (1.0 + 2.3e-16))

    found = replay(write(tmp_path, changed(flown, Setpoint, nudge)))
    assert not found.identical
    assert found.difference is not None
    assert (found.difference.topic, found.difference.field) == ("setpoint", "thrust")
    assert found.difference.time_s == pytest.approx(FLIGHT_S, abs=0.1)
    assert "setpoint.thrust" in str(found.difference)


def test_a_record_that_is_missing_from_the_log_is_found(flown: list[Record], tmp_path: Path) -> None:
    found = replay(write(tmp_path, changed(flown, Setpoint, lambda _: None)))
    assert found.difference is not None
    assert not found.identical


def test_another_configuration_is_found(flown: list[Record], tmp_path: Path) -> None:
    found = replay(write(tmp_path, flown, "law.k=1.0000001"))
    assert found.difference is not None
    assert found.difference.topic in ("setpoint", "error")


def test_lost_input_stops_the_replay_and_is_reported(flown: list[Record], tmp_path: Path) -> None:
    index = [i for i, record in enumerate(flown) if isinstance(record, Input)][1000]
    gap = [*flown[:index], *flown[index + 1 :]]
    found = replay(write(tmp_path, gap))
    assert not found.identical
    assert "missing" in found.stopped or found.difference is not None
    marked = [*flown[:index], Lost(t_ns=flown[index].t_ns, count=5), *flown[index + 5 :]]
    found = replay(write(tmp_path / "marked", marked))
    assert not found.identical
    assert "drop" in found.stopped
    assert found.inputs == 1000


def test_a_log_that_is_cut_off_replays_up_to_the_cut(log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    found = replay(cut)
    assert found.difference is None
    assert found.stopped != ""
    assert found.tracked > 0
    assert not found.identical


def test_a_replay_that_never_tracked_fails(tmp_path: Path) -> None:
    flight = make_flight("supervisor.engage=pilot")
    flight.run(3.0)
    found = replay(write(tmp_path, flight.records, "supervisor.engage=pilot"))
    assert found.difference is None
    assert found.tracked == 0
    assert not found.identical


def test_what_is_no_log_of_ours_is_refused(tmp_path: Path) -> None:
    foreign = tmp_path / "foreign.mcap"
    foreign.write_bytes(b"not a log at all")
    with pytest.raises(NotALog):
        replay(foreign)
    with pytest.raises((NotALog, OSError)):
        replay(tmp_path / "absent.mcap")


def test_a_log_that_does_not_begin_with_a_session_is_refused(flown: list[Record], tmp_path: Path) -> None:
    recorder = Recorder(tmp_path, vehicle="demo", session_id="0" * 32, unix_offset_ns=0)
    recorder.offer(Sample("input", 0, msgspec.json.encode(flown[0])))
    recorder.start()
    assert recorder.close(10.0)
    with pytest.raises(ReplayError, match="session"):
        replay(recorder.path)


def rewritten(source: Path, directory: Path, change: Callable[[str, bytes], bytes]) -> Path:
    """A log with the same messages, each payload changed."""
    recorder = Recorder(directory, vehicle="demo", session_id="0" * 32, unix_offset_ns=0)
    for topic, payload in read_log(source):
        recorder.offer(Sample(topic, 0, change(topic, payload)))
    recorder.start()
    assert recorder.close(10.0)
    return recorder.path


def test_a_log_of_another_schema_is_refused_with_the_version_that_wrote_it(log: Path, tmp_path: Path) -> None:
    old = b'"schema_version":1'
    assert any(old in payload for topic, payload in read_log(log) if topic == "session")
    path = rewritten(log, tmp_path, lambda _, payload: payload.replace(old, b'"schema_version":99'))
    with pytest.raises(ReplayError, match="schema version 99, not 1: use guidance"):
        replay(path)


def test_an_input_that_cannot_be_read_is_refused(log: Path, tmp_path: Path) -> None:
    def spoil(topic: str, payload: bytes) -> bytes:
        return payload.replace(b'"tick"', b'"tock"') if topic == "input" else payload

    with pytest.raises(ReplayError, match="input 24 cannot be read: Invalid enum value 'tock'"):
        replay(rewritten(log, tmp_path, spoil))
