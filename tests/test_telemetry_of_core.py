"""What the core tells while no setpoint flows, what the autopilot says, and the rate that is flown."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance import core
from guidance.core import Guide
from guidance.figures import stream_figures
from guidance.records import Event, Input, Level, Link, Record, State
from sitl.lockstep import Lockstep
from tests.helpers import (
    ROVER,
    events_of,
    fly_until_tracking,
    make_config,
    make_flight,
    records_of,
    setpoints_since,
)
from tests.pilot import Pilot


def say(flight: Lockstep, severity: int, text: bytes, sequence: int = 0) -> None:
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.seq = sequence
    flight.inject(bytes(dialect.MAVLink_statustext_message(severity, text).pack(mav)))


@pytest.mark.parametrize("firmware", [(), ROVER])
def test_the_state_is_told_while_no_setpoint_says_it(firmware: tuple[str, ...]) -> None:
    flight = make_flight(*firmware, "supervisor.engage=pilot", "supervisor.arm=false")
    flight.run(2.0)
    since_ns = flight.now_ns
    flight.run(5.0)
    told = records_of(flight, State, since_ns)
    assert len(told) >= 48
    assert told[-1].position_ned_m == pytest.approx(flight.truth().position_ned_m, abs=1e-3)


def test_after_a_hand_over_the_vehicle_is_still_seen() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    Pilot(flight).switch("hold")
    flight.run(1.0)
    since_ns = flight.now_ns
    flight.run(2.0)
    assert setpoints_since(flight, since_ns) == []
    assert 18 <= len(records_of(flight, State, since_ns)) <= 22


def test_while_setpoints_flow_each_has_one_state() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    since_ns = flight.now_ns
    flight.run(3.0)
    states = [record.t_ns for record in records_of(flight, State, since_ns + 1)]
    assert states == setpoints_since(flight, since_ns)


def test_what_the_autopilot_says_is_an_event() -> None:
    flight = make_flight()
    flight.run(1.0)
    say(flight, 2, b"Failsafe activated")
    said = [event for event in records_of(flight, Event) if event.code == "autopilot"]
    assert (said[-1].text, said[-1].level) == ("autopilot: Failsafe activated", Level.CRITICAL)


def test_a_flood_of_texts_is_cut_and_counted() -> None:
    flight = make_flight()
    flight.run(1.0)
    flight.run(0.9995)
    for i in range(250):
        say(flight, 6, b"\xff\xfe again", i)
    assert 10 <= len(events_of(flight, "autopilot")) <= 20
    assert flight.guide.link.counters["texts_not_shown"] >= 200


@pytest.mark.parametrize("firmware", [(), ROVER])
@pytest.mark.parametrize("rate_hz", [5, 10, 20, 30, 40, 50, 75, 100, 200])
def test_the_configured_rate_is_flown(rate_hz: int, firmware: tuple[str, ...]) -> None:
    gentle = [f"law.rho{i}_per_s={min(4.0, 0.3 * rate_hz)}" for i in (2, 3)]
    old = ("link.attitude_timeout_s=0.5", "link.position_timeout_s=0.5")
    quick = {"SCHED_LOOP_RATE": 400.0} if firmware else {}
    flight = make_flight(*firmware, f"link.rate_hz={rate_hz}", *gentle, *old, parameters=quick)
    fly_until_tracking(flight, 10.0)
    since_ns = flight.now_ns
    flight.run(6.0)
    figures = stream_figures(setpoints_since(flight, since_ns))
    assert figures.rate_hz == pytest.approx(rate_hz, rel=0.05)
    assert figures.max_gap_s is not None
    assert figures.max_gap_s < 1.5 / rate_hz + 1e-9


def test_what_the_autopilot_gives_less_is_told_and_filled_in_from_prediction() -> None:
    flight = make_flight(*ROVER)  # its loop runs at 50 Hz: it denies 50 Hz and gives 40, 20 and 40 ms apart
    fly_until_tracking(flight)
    since_ns = flight.now_ns
    flight.run(6.0)
    attitude = records_of(flight, Link)[-1].streams[0]
    assert (attitude.message, attitude.wanted_hz) == ("ATTITUDE_QUATERNION", 50.0)
    assert attitude.rate_hz == pytest.approx(40.0, rel=0.05)
    figures = stream_figures(setpoints_since(flight, since_ns))
    assert figures.rate_hz == pytest.approx(50.0, rel=0.02)
    assert figures.max_gap_s == pytest.approx(0.03, abs=0.001)


def test_records_are_the_same_whenever_they_are_asked_for() -> None:
    """Those that wait until the packets are out say what was so then, not when somebody asks."""
    flight = make_flight()
    flight.run(6.0)
    inputs = records_of(flight, Input)
    asked_often, asked_late = Guide(make_config()), Guide(make_config())
    often: list[Record] = []
    for event in inputs:
        asked_often.handle(event)
        often += asked_often.records()
        asked_late.handle(event)
    assert often == asked_late.records() == flight.records


def test_a_setpoint_is_out_before_its_records_are_made(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[int] = []

    def setpoint_records(*_: object) -> list[Record]:
        made.append(1)
        return []

    flight = make_flight()
    fly_until_tracking(flight)
    monkeypatch.setattr(core, "setpoint_records", setpoint_records)
    guide = Guide(make_config())
    for event in records_of(flight, Input):
        guide.handle(event)
        if guide.setpoints_sent:
            break
    assert guide.packets()
    assert not made
    guide.records()
    assert made
