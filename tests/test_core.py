"""The core's own promises: when a setpoint is due, when there is silence, and what is told of it."""

from __future__ import annotations

from itertools import pairwise

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.commands import Shutdown
from guidance.records import (
    Event,
    Input,
    InputKind,
    Level,
    Link,
    Packet,
    Record,
    Setpoint,
    State,
    Status,
    Timing,
)
from guidance.supervisor import State as Supervisor
from sitl.lockstep import Channel, Lockstep
from tests.helpers import (
    PERFECT,
    events_of,
    fly_until_tracking,
    make_flight,
    records_of,
    setpoints_since,
    state_of,
)
from tests.sent_setpoints import asked, sent_setpoints

LOST = Channel(loss=1.0)
PERIOD_NS = 20_000_000


def tracking(*overrides: str) -> Lockstep:
    """A flight that has tracked for a second."""
    flight = make_flight(*overrides)
    fly_until_tracking(flight)
    flight.run(1.0)
    return flight


def newest_state(flight: Lockstep) -> State:
    return records_of(flight, State)[-1]


def test_a_new_attitude_is_used_at_the_instant_at_which_it_arrives() -> None:
    flight = tracking()
    states = records_of(flight, State, flight.now_ns - 490_000_000)
    assert len(states) == 25
    assert {state.attitude_age_s for state in states} == {0.0}
    assert {b.t_ns - a.t_ns for a, b in pairwise(states)} == {PERIOD_NS}


def test_without_a_new_attitude_prediction_fills_in_after_one_and_a_half_periods() -> None:
    flight = tracking()
    last_ns = flight.setpoint_times_ns[-1]
    flight.to_guide = LOST
    flight.run(0.15)
    gaps = {b - a for a, b in pairwise([last_ns, *setpoints_since(flight, last_ns)])}
    assert gaps == {30_000_000}
    assert newest_state(flight).predicted_s == pytest.approx((newest_state(flight).t_ns - last_ns) * 1e-9)
    assert newest_state(flight).predicted_s > 0.1


@pytest.mark.parametrize(
    ("attitude_s", "position_s", "said"),
    [(0.2, 0.5, "attitude"), (0.5, 0.2, "position"), (0.1, 0.1, "attitude")],
)
def test_silence_begins_when_attitude_or_position_is_older_than_its_time_out(
    attitude_s: float, position_s: float, said: str
) -> None:
    flight = tracking(f"link.attitude_timeout_s={attitude_s}", f"link.position_timeout_s={position_s}")
    seen_ns = newest_state(flight).t_ns
    flight.to_guide = LOST
    flight.run(0.7)
    timeout_ns = round(min(attitude_s, position_s) * 1e9)
    sent = setpoints_since(flight, seen_ns)
    assert len(sent) >= 3
    assert sent[-1] - seen_ns <= timeout_ns
    assert sent[-1] - seen_ns > timeout_ns - 1.5 * PERIOD_NS - 1
    (told,) = events_of(flight, "silent", seen_ns)
    assert told.startswith(f"no setpoint: the {said} is 0.")


def test_after_a_short_silence_the_stream_goes_on_with_the_first_fresh_state() -> None:
    flight = tracking()
    flight.to_guide = LOST
    flight.run(0.4)
    flight.to_guide = PERFECT
    back_ns = flight.now_ns
    flight.run(0.1)
    assert setpoints_since(flight, back_ns)[0] - back_ns <= PERIOD_NS
    assert state_of(flight) is Supervisor.TRACKING
    assert len(events_of(flight, "setpoint_gap", back_ns)) == 1


def test_a_vehicle_whose_clock_is_lost_gets_no_setpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    """Attitude goes on to come, but TIMESYNC is not answered any more: its age is not known."""
    flight = tracking()
    advance = flight.vehicle.advance
    timesync = (111).to_bytes(3, "little")
    monkeypatch.setattr(
        flight.vehicle,
        "advance",
        lambda now_ns: [data for data in advance(now_ns) if data[7:10] != timesync],
    )
    lost_ns = flight.now_ns
    flight.run(8.0)
    sent = setpoints_since(flight, lost_ns)
    assert 0.9e9 < sent[-1] - lost_ns < 1.1e9  # nothing of ours is answered: that it arrives is not known
    assert state_of(flight) is Supervisor.HANDED_OVER
    assert flight.guide.link.counters["ATTITUDE_QUATERNION:before_time_sync"] > 50


def test_every_setpoint_is_computed_for_the_instant_at_which_it_is_sent_and_none_is_repeated() -> None:
    """Never repeated: each is of a later instant, its own, and so of another state and another demand.

    Sequence numbers and `time_boot_ms` differ in any case; the rates and the thrust must as well, while the
    vehicle approaches and turns and the commands are not all at their limits.
    """
    jittery = Channel(delay_s=0.01, jitter_s=0.03, loss=0.3, duplication=0.3)
    flight = make_flight(to_guide=jittery, seed=4)
    fly_until_tracking(flight, 10.0)
    flight.run(10.0)
    sent = sent_setpoints(flight.records)
    inputs = {one.seq: one for one in records_of(flight, Input)}
    begin_ns = inputs[0].t_ns
    for packet, message in sent:
        assert inputs[packet.input_seq].kind is InputKind.TICK
        assert inputs[packet.input_seq].t_ns == packet.t_ns
        assert message.time_boot_ms == (packet.t_ns - begin_ns) // 1_000_000
    instants = [packet.t_ns for packet, _ in sent]
    assert all(b > a for a, b in pairwise(instants))

    setpoints = records_of(flight, Setpoint)
    assert all(b.t_ns > a.t_ns for a, b in pairwise(setpoints))
    # It acts when it arrives; this link is late in one direction, which cannot be told from half in each.
    on_the_way_s = [(s.t_ns - t_ns) * 1e-9 for s, t_ns in zip(setpoints, instants, strict=True)]
    assert 0.002 < min(on_the_way_s) < max(on_the_way_s) < 0.03
    assert [s.seq for s in setpoints] == list(range(1, len(setpoints) + 1))
    states = {state.t_ns: state for state in records_of(flight, State)}
    used = [states[setpoint.t_ns] for setpoint in setpoints]
    newest = [state.t_ns - round(state.predicted_s * 1e9) for state in used]
    assert all(b >= a for a, b in pairwise(newest))
    assert len({state.predicted_s for state in used}) > 50  # lost and late data: much of it is predicted

    law = [(s, asked(message)) for s, (_, message) in zip(setpoints, sent, strict=True) if not s.neutral]
    assert len(law) > 400
    for (a, before), (b, after) in pairwise(law):
        assert before != after
        assert a.demanded_body_rates_frd_rad_s != b.demanded_body_rates_frd_rad_s


def test_receiving_decides_nothing_and_a_burst_makes_one_setpoint_due() -> None:
    flight = tracking()
    guide = flight.guide
    last_ns = flight.setpoint_times_ns[-1]
    burst: list[bytes] = []
    while flight.vehicle.deadline() < last_ns + 100_000_000:
        burst += flight.vehicle.advance(flight.vehicle.deadline())
    now_ns = last_ns + 100_000_000
    flight._drain()
    for data in burst:
        guide.receive(data, now_ns)
    assert [type(r) for r in guide.records() if not isinstance(r, Input)] == []
    assert guide.deadline() <= now_ns
    guide.tick(now_ns)
    made = guide.records()
    assert sum(isinstance(r, Setpoint) for r in made) == 1
    (state,) = (r for r in made if isinstance(r, State))
    assert state.attitude_age_s < 0.021
    assert guide.deadline() > now_ns


def test_periodic_records_keep_their_cadence() -> None:
    flight = tracking()
    start_ns = flight.now_ns
    flight.run(10.0)
    kinds: tuple[tuple[type[Record], int], ...] = ((Status, 50), (Link, 20), (Timing, 10))
    for kind, count in kinds:
        assert len(records_of(flight, kind, start_ns)) == pytest.approx(count, abs=3), kind


def test_every_input_is_recorded_with_a_number_that_counts_without_gaps_and_packets_name_theirs() -> None:
    flight = tracking()
    inputs = records_of(flight, Input)
    assert [one.seq for one in inputs] == list(range(len(inputs)))
    assert {one.kind for one in inputs} == {InputKind.DATAGRAM, InputKind.TICK}
    seq = -1
    for record in flight.records:
        if isinstance(record, Input):
            seq = record.seq
        elif isinstance(record, Packet):
            assert record.input_seq == seq


def test_changes_of_state_are_told_by_statustext_with_a_severity() -> None:
    flight = tracking()
    flight.guide.command(Shutdown(), flight.now_ns)
    flight.run(1.5)
    parser = mavlink.MAVLink(None)
    told = [
        (message.text, message.severity)
        for packet in records_of(flight, Packet)
        for message in parser.parse_buffer(packet.data) or []
        if message.get_type() == "STATUSTEXT"
    ]
    words = [text.split(": ")[1] for text, _ in told]
    assert words == [
        "connected",
        "ready",
        "streaming",
        "switching",
        "arming",
        "tracking",
        "leaving",
        "finished",
    ]
    assert {severity for _, severity in told} == {mavlink.MAV_SEVERITY_NOTICE}
    events = [e for e in records_of(flight, Event) if e.code.startswith("state_")]
    assert [e.code.removeprefix("state_") for e in events] == words


def test_a_hand_over_is_told_as_a_warning() -> None:
    flight = tracking()
    flight.to_guide = LOST
    flight.run(1.5)
    (event,) = [e for e in records_of(flight, Event) if e.code == "state_handed-over"]
    assert event.level is Level.WARNING


def test_a_note_and_a_lost_link_are_events_of_the_log() -> None:
    flight = make_flight()
    flight.guide.note(InputKind.LINK_DOWN, "the port is in use", flight.now_ns)
    flight.guide.note(InputKind.LINK_UP, "listening", flight.now_ns)
    events = [r for r in flight.guide.records() if isinstance(r, Event)]
    assert [(e.level, e.code, e.text) for e in events] == [
        (Level.WARNING, "link_down", "the port is in use"),
        (Level.INFO, "link_up", "listening"),
    ]
