"""Flights through resets of the autopilot's estimator: no setpoint shows them, and the vehicle comes back."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from guidance.blending import blending, spare_speed_m_s
from guidance.estimate import Estimate
from guidance.records import Event, Reference, Setpoint, TrackingError
from guidance.records import State as StateRecord
from guidance.replay import replay
from guidance.se3 import ZERO, Pose, Vec3, add, from_yaw, multiply, norm
from guidance.supervisor import State
from guidance.trajectory import sample
from sitl.lockstep import Channel, Lockstep
from tests.helpers import (
    ROVER,
    events_of,
    fly_until,
    fly_until_tracking,
    make_flight,
    records_of,
    setpoints_since,
    state_of,
)
from tests.pilot import Pilot
from tests.test_flights import error_m
from tests.test_replay import write
from tests.test_source_flights import ALL

SECOND = 1_000_000_000
HELIX = ("trajectory.radius_m=20", "trajectory.speed_m_s=2", "trajectory.down_m_s=0.2")
ON_A_ROVER = (*ROVER, "trajectory.name=circle", "trajectory.speed_m_s=2")
#: A vehicle that only goes forward, and slowly turns.
FORWARD = (
    *HELIX,
    "law.name=global",
    "law.rho2_per_s=4",
    "law.rho3_per_s=4",
    "limits.speed_min_m_s=0",
    "limits.speed_max_m_s=4",
    "limits.roll_rate_max_rad_s=1",
    "limits.pitch_rate_max_rad_s=1",
    "limits.yaw_rate_max_rad_s=1",
)
#: No jump is too large for the guard.
UNGUARDED = ("guards.jump_max_m=1000", "guards.jump_max_deg=180")
Triple = tuple[float, float, float]
STILL: Triple = (0.0, 0.0, 0.0)
SIDEWAYS: Triple = (3.0, -4.0, 0.0)


def settled(*overrides: str, **options: Any) -> Lockstep:
    """A flight that tracks to some millimetres."""
    flight = make_flight(*overrides, **options)
    fly_until_tracking(flight)
    flight.run(20.0)
    assert error_m(flight) < 0.02
    return flight


class Steps(NamedTuple):
    """The largest change from a setpoint to the next, as a part of the limits."""

    rates: float
    speed: float


def steps(flight: Lockstep, since_ns: int) -> Steps:
    limits = flight.guide.config.limits
    pairs = list(pairwise(records_of(flight, Setpoint, since_ns - 100_000_000)))
    return Steps(
        max(math.dist(a.body_rates_frd_rad_s, b.body_rates_frd_rad_s) for a, b in pairs)
        / limits.yaw_rate_max_rad_s,
        max(abs(a.speed_m_s - b.speed_m_s) for a, b in pairs) / limits.speed_max_m_s,
    )


def largest_error_m(flight: Lockstep, since_ns: int) -> float:
    return max(error.norm_m for error in records_of(flight, TrackingError, since_ns))


def from_trajectory_m(flight: Lockstep) -> float:
    """How far the vehicle, by its own newest estimate, is from the trajectory."""
    r, state = records_of(flight, Reference)[-1], records_of(flight, StateRecord)[-1]
    assert r.t_ns == state.t_ns
    origin = flight.guide.tracker.origin_ned_m
    assert origin is not None
    there = sample(flight.guide.config.trajectory, r.trajectory_s).position
    apart = [x - (o + p) for x, o, p in zip(state.position_ned_m, origin, there, strict=True)]
    return math.hypot(*apart[: 2 if flight.guide.profile.planar else 3])


BOTH: Triple = (3.0, -2.0, 3.5)


@pytest.mark.parametrize(
    ("vehicle", "attitude", "position", "moved"),
    [
        (HELIX, "ODOMETRY", "ODOMETRY", SIDEWAYS),
        (HELIX, "ODOMETRY", "ODOMETRY", (0.0, 0.0, 5.0)),
        (HELIX, "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", BOTH),
        (HELIX, "ATTITUDE", "GLOBAL_POSITION_INT", BOTH),
        (FORWARD, "ODOMETRY", "ODOMETRY", BOTH),
        (ON_A_ROVER, "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", SIDEWAYS),
        (ON_A_ROVER, "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", (0.0, 0.0, -5.0)),
        (ON_A_ROVER, "ATTITUDE", "GLOBAL_POSITION_INT", BOTH),
    ],
    ids=["level", "down", "local", "global", "forward", "rover", "rover up", "rover global"],
)
def test_no_setpoint_shows_a_jump_of_5_m_and_the_vehicle_comes_back(
    vehicle: tuple[str, ...], attitude: str, position: str, moved: Triple
) -> None:
    flight = settled(*vehicle, without_messages=tuple(ALL - {attitude, position}))
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, moved)
    flight.run(0.1)
    planar = flight.guide.profile.planar
    jump = (moved[0], moved[1], 0.0) if planar else moved
    assert math.dist(flight.guide.tracker.reference_offset_ned_m, jump) < 0.05
    flight.run(30.0)
    assert len(events_of(flight, "estimator_reset")) == 1
    assert state_of(flight) is State.TRACKING
    assert steps(flight, reset_ns).rates < 0.02
    assert steps(flight, reset_ns).speed < 0.005
    assert largest_error_m(flight, reset_ns) < 0.03, "from the reference that is tracked"
    sizes = [math.hypot(*r.offset_ned_m) for r in records_of(flight, Reference, reset_ns + SECOND)]
    assert all(b <= a + 1e-9 for a, b in pairwise(sizes)), "it only shrinks"
    assert sizes[-1] < 0.05
    assert from_trajectory_m(flight) < 0.06


def test_the_first_setpoint_of_the_jumped_state_has_the_jumped_reference() -> None:
    flight = settled(*HELIX)
    flight.vehicle.reset_estimator(flight.now_ns, SIDEWAYS)
    flight.run(0.1)
    jumped = [s.t_ns for s in records_of(flight, StateRecord) if s.resets == 1]
    references = {r.t_ns: r for r in records_of(flight, Reference)}
    assert math.dist(references[jumped[0]].offset_ned_m, SIDEWAYS) < 0.01
    (event,) = [e for e in records_of(flight, Event) if e.code == "estimator_reset"]
    assert event.t_ns <= jumped[0]
    assert all(r.offset_ned_m == ZERO for t_ns, r in references.items() if t_ns < jumped[0])


@pytest.mark.parametrize("without", [(), ("ODOMETRY",)], ids=["counted", "seen"])
@pytest.mark.parametrize("vehicle", [HELIX, FORWARD], ids=["helix", "forward"])
def test_a_glitch_that_passes_costs_nothing_at_the_end(
    vehicle: tuple[str, ...], without: tuple[str, ...]
) -> None:
    flight = settled(*vehicle, without_messages=without)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, SIDEWAYS)
    flight.run(3.0)
    flight.vehicle.reset_estimator(flight.now_ns)
    flight.run(0.1)
    assert error_m(flight) < 3.0, "at most what was worked off in 3 s"
    flight.run(30.0)
    assert steps(flight, reset_ns).rates < 0.02
    assert steps(flight, reset_ns).speed < 0.005
    assert math.hypot(*flight.guide.tracker.reference_offset_ned_m) < 0.005
    assert error_m(flight) < 0.01, "by the truth"


@pytest.mark.parametrize("without", [(), ("ODOMETRY",)], ids=["counted", "seen"])
def test_50_m_are_shown_at_once_and_followed_no_faster(without: tuple[str, ...]) -> None:
    flight = settled(*HELIX, *UNGUARDED, without_messages=without)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, (30.0, -40.0, 0.0))
    flight.run(0.05)
    assert math.hypot(*flight.guide.tracker.reference_offset_ned_m) == pytest.approx(50.0, abs=0.05)
    flight.run(10.0)
    limits = flight.guide.config.limits
    spare_m_s = spare_speed_m_s(blending(0.0, 5.0, 5.0), sample(flight.guide.config.trajectory, 0.0))
    for a, b in pairwise(records_of(flight, Reference, reset_ns + SECOND)):
        moved_m = math.dist(a.offset_ned_m, b.offset_ned_m)
        assert moved_m <= spare_m_s * (b.t_ns - a.t_ns) * 1e-9 + 1e-6
        assert math.hypot(*b.velocity_ned_m_s) <= limits.speed_max_m_s
    assert steps(flight, reset_ns).rates < 0.02
    assert steps(flight, reset_ns).speed < 0.005


@pytest.mark.parametrize("without", [(), ("ODOMETRY",)], ids=["counted", "seen"])
@pytest.mark.parametrize(("vehicle", "goal"), [(HELIX, 0.04), (FORWARD, 0.07)], ids=["helix", "forward"])
def test_a_turned_heading_is_steered_by_within_a_second_and_the_rates_do_not_jump(
    vehicle: tuple[str, ...], goal: float, without: tuple[str, ...]
) -> None:
    """It goes and passes again: a heading that stays wrong keeps a vehicle off its course."""
    flight = settled(*vehicle, without_messages=without)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, STILL, 0.3)
    flight.run(3.0)
    heading = records_of(flight, Setpoint)[-1].body_rates_frd_rad_s[2]
    assert abs(heading) < 0.5, "it has turned"
    flight.vehicle.reset_estimator(flight.now_ns)
    flight.run(20.0)
    assert steps(flight, reset_ns).rates < goal
    assert steps(flight, reset_ns).speed < 0.005
    assert error_m(flight) < 0.01


def test_even_a_heading_that_turns_about_is_let_in_step_by_step() -> None:
    flight = settled(*HELIX, *UNGUARDED)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, STILL, 3.1)
    flight.run(2.0)
    assert steps(flight, reset_ns).rates < 0.2
    assert steps(flight, reset_ns).speed < 0.1


@pytest.mark.parametrize("without", [(), ("ODOMETRY",)], ids=["counted", "seen"])
def test_a_velocity_that_jumps_is_next_to_nothing(without: tuple[str, ...]) -> None:
    """It only leads from the newest sample to the setpoint's instant."""
    flight = settled(*HELIX, "link.actuation_delay_s=0.02", "law.rho2_per_s=4", "law.rho3_per_s=4")
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, STILL, 0.0, (0.0, 1.5, 0.0))
    flight.run(3.0)
    assert steps(flight, reset_ns).rates < 0.02
    assert steps(flight, reset_ns).speed < 0.01


def test_a_run_of_resets_adds_up() -> None:
    """As an estimator finds its way back: a jump with every sample, each in another direction."""
    flight = settled(*HELIX)
    reset_ns = flight.now_ns
    moved = [0.0, 0.0, 0.0]
    for n in range(30):
        moved[n % 3] += (-1.0) ** (n // 3) * 0.9**n * 4.0
        flight.vehicle.reset_estimator(flight.now_ns, (moved[0], moved[1], moved[2]))
        flight.run(0.02)
    assert records_of(flight, StateRecord)[-1].resets >= 25
    assert math.dist(flight.guide.tracker.reference_offset_ned_m, moved) < 0.6, "all but what was worked off"
    flight.run(30.0)
    assert steps(flight, reset_ns).rates < 0.03
    assert steps(flight, reset_ns).speed < 0.01
    assert largest_error_m(flight, reset_ns) < 0.02
    assert from_trajectory_m(flight) < 0.01


@pytest.mark.parametrize("seed", [1, 2])
def test_on_a_bad_link_too(seed: int) -> None:
    bad = Channel(delay_s=0.01, jitter_s=0.1, loss=0.3, duplication=0.1)
    gains = ("law.rho2_per_s=4", "law.rho3_per_s=4")
    flight = make_flight(*HELIX, *gains, to_guide=bad, seed=seed)
    fly_until_tracking(flight)
    flight.run(20.0)
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, SIDEWAYS)
    flight.run(20.0)
    assert len(events_of(flight, "estimator_reset")) == 1
    assert steps(flight, reset_ns).rates < 0.03
    assert steps(flight, reset_ns).speed < 0.01
    assert from_trajectory_m(flight) < 0.05


def test_a_reset_that_comes_while_the_attitude_is_silent_is_blended_when_it_is_back() -> None:
    flight = settled(*HELIX, without_messages=("ODOMETRY", "ATTITUDE"))
    reset_ns = flight.now_ns
    flight.vehicle.withhold("ATTITUDE_QUATERNION")
    flight.run(0.3)
    flight.vehicle.reset_estimator(flight.now_ns, SIDEWAYS)
    flight.run(0.05)
    assert "no setpoint" in events_of(flight, "silent", reset_ns)[0]
    assert flight.guide.tracker.reference_offset_ned_m == ZERO
    flight.vehicle.withhold()
    flight.run(0.1)
    assert math.dist(flight.guide.tracker.reference_offset_ned_m, SIDEWAYS) < 0.05
    assert state_of(flight) is State.TRACKING
    assert setpoints_since(flight, flight.now_ns - 50_000_000)
    assert largest_error_m(flight, reset_ns) < 0.1


def test_the_next_flight_knows_nothing_of_it() -> None:
    flight = settled("supervisor.engage_max_error_m=100", *HELIX)
    flight.vehicle.reset_estimator(flight.now_ns, SIDEWAYS)
    flight.run(1.0)
    pilot = Pilot(flight)
    pilot.switch("hold")
    fly_until(flight, State.HANDED_OVER)
    assert flight.guide.tracker.reference_offset_ned_m == ZERO
    flight.vehicle.reset_estimator(flight.now_ns)
    flight.run(1.0)
    assert flight.guide.tracker.reference_offset_ned_m == ZERO, "nothing was flown in the frame before"
    flight.guide.tracker.start(flight.now_ns, ZERO)
    assert flight.guide.tracker.reference_offset_ned_m == ZERO


def test_before_the_first_setpoint_of_a_flight_nothing_is_blended() -> None:
    flight = make_flight("supervisor.engage=pilot")
    flight.run(3.0)
    flight.vehicle.reset_estimator(flight.now_ns, SIDEWAYS)
    flight.run(1.0)
    assert len(events_of(flight, "estimator_reset")) == 1
    assert flight.guide.tracker.reference_offset_ned_m == ZERO
    estimate = flight.guide.steering.estimate(flight.now_ns)
    assert isinstance(estimate, Estimate)
    tracker = flight.guide.tracker
    tracker.start(estimate.instant_ns, ZERO)
    tracker.estimator_reset(estimate)
    assert tracker.solve(estimate).offset_ned_m == ZERO


def test_allocating_anew_in_the_middle_of_it_changes_only_how_fast() -> None:
    flight = settled(*HELIX, "limits.roll_rate_max_rad_s=0.5")
    reset_ns = flight.now_ns
    flight.vehicle.reset_estimator(reset_ns, SIDEWAYS)
    flight.run(2.0)
    assert flight.guide.tracker.allocate("roll-pitch") is None
    flight.run(10.0)
    offsets = [Vec3(*r.offset_ned_m) for r in records_of(flight, Reference, reset_ns + 100_000_000)]
    assert max(math.dist(a, b) for a, b in pairwise(offsets)) < 0.03


def test_a_flight_with_resets_replays_identically_and_its_log_has_the_offset(tmp_path: Path) -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(2.0)
    flight.vehicle.reset_estimator(flight.now_ns, SIDEWAYS, 0.2)
    flight.run(1.0)
    flight.vehicle.reset_estimator(flight.now_ns)
    flight.run(1.0)
    found = replay(write(tmp_path, flight.records))
    assert found.identical
    assert math.hypot(*records_of(flight, Reference)[-60].offset_ned_m) > 4.5


def test_a_jump_that_is_found_twice_before_a_setpoint_is_blended_once() -> None:
    """As where a position and then an attitude tell of one reset, each in a message of its own."""
    flight = settled(*HELIX)
    estimate = flight.guide.steering.estimate(flight.now_ns)
    assert isinstance(estimate, Estimate)
    tracker = flight.guide.tracker
    before_m = records_of(flight, TrackingError)[-1].norm_m
    moved = add(estimate.pose.position, Vec3(*SIDEWAYS))
    jumped = estimate._replace(pose=Pose(moved, multiply(from_yaw(0.4), estimate.pose.attitude)))
    tracker.estimator_reset(jumped)
    tracker.estimator_reset(jumped)
    assert math.dist(tracker.reference_offset_ned_m, SIDEWAYS) < 1e-3
    solution = tracker.solve(jumped)
    assert norm(solution.evaluation.e) == pytest.approx(before_m, abs=1e-3)
    sent, last = solution.outgoing.body_rates_frd_rad_s, records_of(flight, Setpoint)[-1]
    assert math.dist(sent, last.body_rates_frd_rad_s) < 0.01
