"""A log replays to the bit; whatever was changed or lost in it is found and named."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest

from guidance.records import TOPICS, Input, Lost, Packet, Record, Session, Setpoint
from guidance.replay import ReplayError, replay
from guidance.service import new_session
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


def an_input(flown: list[Record], *, followed_by: type[Record], after: int = 1000) -> tuple[int, Input]:
    """The first input from number `after` on with a record of that type after it; where it is in `flown`."""
    for (index, one), (_, following) in pairwise(enumerate(flown)):
        if isinstance(one, Input) and one.seq >= after and isinstance(following, followed_by):
            return index, one
    raise AssertionError("there is none")


def test_a_missing_input_without_consequence_stops_the_replay_at_the_next(
    flown: list[Record], tmp_path: Path
) -> None:
    index, gone = an_input(flown, followed_by=Input)
    found = replay(write(tmp_path, [*flown[:index], *flown[index + 1 :]]))
    assert not found.identical
    assert found.difference is None
    assert found.stopped == f"input {gone.seq} is missing from the log, {gone.seq + 1} follows"
    assert found.inputs == gone.seq


def test_what_a_missing_input_brought_about_is_a_difference(flown: list[Record], tmp_path: Path) -> None:
    index, gone = an_input(flown, followed_by=Packet)
    found = replay(write(tmp_path, [*flown[:index], *flown[index + 1 :]]))
    assert not found.identical
    assert found.stopped == ""
    assert found.difference is not None
    assert (found.difference.topic, found.difference.replayed) == ("packet", None)
    assert f'"input_seq":{gone.seq},' in str(found.difference.logged)
    assert found.inputs == gone.seq


def test_a_mark_of_the_recorder_that_records_were_dropped_stops_the_replay(
    flown: list[Record], tmp_path: Path
) -> None:
    index, gone = an_input(flown, followed_by=Input)
    marked = [*flown[:index], Lost(t_ns=gone.t_ns, count=5), *flown[index + 5 :]]
    found = replay(write(tmp_path, marked))
    assert not found.identical
    assert found.difference is None
    assert "drop" in found.stopped
    assert found.inputs == gone.seq


def test_a_log_ended_for_lack_of_space_is_not_called_identical(flown: list[Record], tmp_path: Path) -> None:
    """Two thirds of the flight are in it, all as flown and whole to the last input; the rest is nowhere."""
    config = make_config()
    session = new_session(config)
    index, _ = an_input(flown, followed_by=Input, after=2000)
    now_ns = itertools.count(0, 10_000_000)
    ended = threading.Event()
    recorder = Recorder(
        tmp_path,
        vehicle="demo",
        session_id=session.session_id,
        unix_offset_ns=0,
        free_bytes=lambda _: 1 << 40 if len(recorder._queue) and not ended.is_set() else 0,
        clock_ns=lambda: next(now_ns),
        wait=lambda _: ended.set() if "must stay free" in recorder.problem else None,
    )

    def offer(records: list[Record]) -> None:
        for record in records:
            recorder.offer(Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record)))

    offer([session, *flown[:index]])
    recorder.start()
    assert ended.wait(20.0)
    offer(flown[index:])
    assert not recorder.close(20.0)
    assert recorder.dropped == len(flown) - index > 1000
    found = replay(recorder.path)
    assert not found.identical
    assert found.difference is None
    assert found.tracked > 50
    assert "the recorder ended it here: 0 MiB free" in found.stopped


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


def spoilt_last(topic: str, change: Callable[[bytes], bytes], log: Path) -> Callable[[str, bytes], bytes]:
    """A change of the last message of a topic alone."""
    last = sum(1 for found, _ in read_log(log) if found == topic)
    numbers = itertools.count(1)

    def change_one(found: str, payload: bytes) -> bytes:
        return change(payload) if found == topic and next(numbers) == last else payload

    return change_one


@pytest.mark.parametrize("spoilt", [b"7", b"[]", b'{"t_ns":', b"\xff", b"[" * 5000])
def test_a_message_that_is_no_record_any_more_is_a_difference(
    log: Path, tmp_path: Path, spoilt: bytes
) -> None:
    found = replay(rewritten(log, tmp_path, spoilt_last("status", lambda _: spoilt, log)))
    assert found.difference is not None
    assert found.difference.topic == "status"
    assert str(found.difference)


@pytest.mark.parametrize("spoilt", [b"\xff", b"[" * 5000, b'{"session_id":"\xd8"}'])
def test_a_session_that_cannot_be_decoded_is_refused(log: Path, tmp_path: Path, spoilt: bytes) -> None:
    with pytest.raises(ReplayError, match="its session record cannot be used"):
        replay(rewritten(log, tmp_path, lambda topic, payload: spoilt if topic == "session" else payload))


def test_an_input_that_no_service_had_is_refused(tmp_path: Path) -> None:
    def foreign(payload: bytes) -> bytes:
        return payload.replace(b'"tick"', b'"signing_clock"').replace(b'"datagram"', b'"signing_clock"')

    flight = make_flight("link.signing_key_file=signing.key", signing_key=bytes(range(32)))
    flight.run(1.0)
    whole = write(tmp_path / "whole", flight.records, "link.signing_key_file=signing.key")
    with pytest.raises(ReplayError, match=r"no service had input \d+ like this"):
        replay(rewritten(whole, tmp_path / "spoilt", spoilt_last("input", foreign, whole)))


def test_a_packet_of_a_signed_link_that_is_no_record_any_more_is_a_difference(tmp_path: Path) -> None:
    flight = make_flight("link.signing_key_file=signing.key", signing_key=bytes(range(32)))
    flight.run(1.0)
    whole = write(tmp_path / "whole", flight.records, "link.signing_key_file=signing.key")
    found = replay(rewritten(whole, tmp_path / "spoilt", spoilt_last("packet", lambda _: b"7", whole)))
    assert found.difference is not None
    assert found.difference.topic == "packet"
