"""Flights on each source of state, on sources that die and come back, and through resets of the estimator."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import MESSAGE_IDS
from guidance.records import Event, Packet, Setpoint
from guidance.records import State as StateRecord
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.vehicle import Noise
from tests.helpers import ROVER, events_of, fly_until_tracking, make_flight, records_of, state_of
from tests.test_flights import error_m, fly

ALL = frozenset({"ODOMETRY", "ATTITUDE_QUATERNION", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"})
GLOBAL = "GLOBAL_POSITION_INT"
SECOND = 1_000_000_000


def on(flight: Lockstep) -> tuple[str, str]:
    """The sources of the newest state."""
    state = records_of(flight, StateRecord)[-1]
    return state.attitude_source, state.position_source


def largest_step(flight: Lockstep, since_ns: int) -> tuple[float, float]:
    """From one setpoint to the next: rates (rad/s) and speed (m/s)."""
    sent = records_of(flight, Setpoint, since_ns)
    pairs = list(pairwise(sent))
    return (
        max(math.dist(a.body_rates_frd_rad_s, b.body_rates_frd_rad_s) for a, b in pairs),
        max(abs(a.speed_m_s - b.speed_m_s) for a, b in pairs),
    )


def settled(*overrides: str, **options: Any) -> Lockstep:
    """A flight that tracks to a fraction of a millimetre."""
    flight = make_flight(*overrides, **options)
    fly_until_tracking(flight)
    flight.run(20.0)
    assert error_m(flight) < 0.02
    return flight


@pytest.mark.parametrize(
    ("attitude", "position", "rms_m"),
    [
        ("ODOMETRY", "ODOMETRY", 2e-4),
        ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", 2e-4),
        ("ATTITUDE", "LOCAL_POSITION_NED", 2e-4),
        ("ATTITUDE", GLOBAL, 0.015),  # steps of 11 mm
    ],
)
def test_each_source_alone_is_enough(attitude: str, position: str, rms_m: float) -> None:
    flight = make_flight(without_messages=tuple(ALL - {attitude, position}))
    figures = fly(flight, 25.0)
    assert figures.converged_s is not None
    assert figures.converged_s < 12.0
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < rms_m
    assert on(flight) == (attitude, position)
    assert records_of(flight, StateRecord)[-1].resets == 0
    assert largest_step(flight, flight.now_ns - 5 * SECOND)[0] < 0.1


@pytest.mark.parametrize(
    ("attitude", "position"), [("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"), ("ATTITUDE", GLOBAL)]
)
def test_a_rover_flies_on_what_ardupilot_has(attitude: str, position: str) -> None:
    flight = make_flight(*ROVER, "trajectory.name=circle", without_messages=tuple(ALL - {attitude, position}))
    figures = fly(flight, 25.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.02
    assert on(flight) == (attitude, position)


@pytest.mark.parametrize(
    ("lost", "left", "step_rad_s"),
    [
        (("ODOMETRY",), ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"), 0.001),
        (("ODOMETRY", "ATTITUDE_QUATERNION"), ("ATTITUDE", "LOCAL_POSITION_NED"), 0.001),
        (("ODOMETRY", "LOCAL_POSITION_NED"), ("ATTITUDE_QUATERNION", GLOBAL), 0.06),
    ],
    ids=["ODOMETRY", "quaternions too", "local positions too"],
)
def test_odometry_dies_and_comes_back_and_no_setpoint_shows_it(
    lost: tuple[str, ...], left: tuple[str, str], step_rad_s: float
) -> None:
    flight = settled()
    assert on(flight) == ("ODOMETRY", "ODOMETRY")
    died_ns = flight.now_ns
    flight.vehicle.withhold(*lost)
    flight.run(0.2)
    assert on(flight) == left
    flight.run(5.0)
    flight.vehicle.withhold()
    flight.run(0.9)
    assert on(flight) != ("ODOMETRY", "ODOMETRY"), "not before it is steady"
    flight.run(3.0)
    assert on(flight) == ("ODOMETRY", "ODOMETRY")
    rates_rad_s, speed_m_s = largest_step(flight, died_ns)
    assert rates_rad_s < step_rad_s
    assert speed_m_s < 0.001
    assert error_m(flight) < 0.005
    assert events_of(flight, "estimator_reset") == []
    assert events_of(flight, "silent", died_ns) == []
    sent = records_of(flight, Setpoint, died_ns)
    assert max(b.t_ns - a.t_ns for a, b in pairwise(sent)) < 50_000_000
    told = events_of(flight, "source", died_ns)
    assert told[0] == f"attitude from {left[0]} instead of ODOMETRY"
    assert sorted(text.split(" instead")[0] for text in told[-2:]) == [
        "attitude from ODOMETRY",
        "position from ODOMETRY",
    ]


@pytest.mark.parametrize("at_the_end", ["ODOMETRY", "ATTITUDE_QUATERNION"])
def test_of_what_is_read_all_at_once_only_the_source_that_stands_is_told(at_the_end: str) -> None:
    """The process stood still for some seconds while ODOMETRY came back and, in one case, died again."""
    flight = settled()
    flight.vehicle.withhold("ODOMETRY")
    flight.run(3.0)
    assert on(flight)[0] == "ATTITUDE_QUATERNION"
    resumed_ns = flight.now_ns + 4 * SECOND
    waiting: list[bytes] = []
    for now_ns in range(flight.now_ns, resumed_ns, SECOND // 200):
        dies = at_the_end != "ODOMETRY" and now_ns > resumed_ns - SECOND
        flight.vehicle.withhold(*(["ODOMETRY"] if dies else []))
        waiting += flight.vehicle.advance(now_ns)
    for data in waiting:
        flight.guide.receive(data, resumed_ns)
    flight.guide.tick(resumed_ns)
    told = [r.text for r in flight.guide.records() if isinstance(r, Event) and r.code == "source"]
    back = ["attitude from ODOMETRY instead of", "position from ODOMETRY instead of"]
    assert [text.rpartition(" ")[0] for text in told] == (back if at_the_end == "ODOMETRY" else [])


def test_it_dies_where_nothing_else_is_sent_and_the_others_are_asked_for_in_time() -> None:
    """As on a line that carries only what was asked for."""
    flight = settled()
    for name in ALL - {"ODOMETRY"}:
        flight.vehicle._pilot.streams.set(MESSAGE_IDS[name], 0, 0)
    flight.run(2.0)
    assert on(flight) == ("ODOMETRY", "ODOMETRY")
    flight.vehicle.withhold("ODOMETRY")
    flight.run(1.0)
    assert on(flight) == ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")
    assert state_of(flight) is State.TRACKING
    assert events_of(flight, "estimator_reset") == []


def test_the_lesser_messages_are_not_asked_for_while_odometry_comes() -> None:
    flight = settled()
    asked = {name for name, _ in _requests(flight)}
    assert asked == {"ODOMETRY", "CURRENT_MODE"}


def _requests(flight: Lockstep) -> list[tuple[str, int]]:

    names = {number: name for name, number in MESSAGE_IDS.items()}
    parser = dialect.MAVLink(None)
    found = []
    for packet in records_of(flight, Packet):
        for message in parser.parse_buffer(packet.data) or []:
            if message.get_type() == "COMMAND_LONG" and message.command == 511:
                found.append((names[int(message.param1)], packet.t_ns))
    return found


def test_an_autopilot_without_odometry_is_asked_for_the_rest_at_once() -> None:
    flight = make_flight(without_messages=("ODOMETRY",))
    fly_until_tracking(flight)
    asked = dict(reversed(_requests(flight)))
    assert asked["LOCAL_POSITION_NED"] - asked["ODOMETRY"] < 0.5 * SECOND


@pytest.mark.parametrize("without", [(), ("ODOMETRY",)], ids=["counted", "seen"])
@pytest.mark.parametrize(
    ("moved", "turned_rad"), [((2.0, -1.0, 0.5), 0.0), ((0.0, 0.0, 0.0), 0.3)], ids=["moved", "turned"]
)
def test_a_reset_in_flight_is_found_by_the_next_sample(
    without: tuple[str, ...], moved: tuple[float, float, float], turned_rad: float
) -> None:
    flight = settled(without_messages=without)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, moved, turned_rad)
    flight.run(1.0)
    (event,) = [e for e in records_of(flight, Event) if e.code == "estimator_reset"]
    assert event.t_ns - reset_ns <= 40_000_000
    assert f"{math.hypot(*moved):.2f} m and {math.degrees(turned_rad):.1f} deg" in event.text
    assert ("counter" if not without else "jump") in event.text
    assert records_of(flight, StateRecord)[-1].resets == 1
    assert state_of(flight) is State.TRACKING
    states = [s for s in records_of(flight, StateRecord, reset_ns) if s.resets == 1]
    truth = flight.truth().position_ned_m
    wanted = [a + b for a, b in zip(truth, moved, strict=True)]
    assert math.dist(states[-1].position_ned_m, wanted) < 0.1, "taken at once"


@pytest.mark.parametrize("seed", [1, 2, 9])
def test_loss_jitter_and_noise_are_no_reset(seed: int) -> None:
    """30 % of loss, 100 ms of jitter (samples overtake each other), repetition, and a noisy estimator."""
    channel = Channel(delay_s=0.01, jitter_s=0.1, loss=0.3, duplication=0.1)
    flight = make_flight(to_guide=channel, seed=seed, noise=Noise(position_m=0.03, attitude_rad=0.005))
    flight.run(40.0)
    assert events_of(flight, "estimator_reset") == []
    assert records_of(flight, StateRecord)[-1].resets == 0
