"""Flights of the core against the built-in vehicle on virtual time, judged by the plant's own truth."""

from __future__ import annotations

import math

import msgspec
import pytest

from guidance.figures import TrackingFigures, stream_figures, tracking_figures
from guidance.records import Event, Level, Setpoint, Timing
from guidance.se3 import Vec3, add, norm, subtract
from guidance.trajectory import sample
from sitl.lockstep import Channel, Lockstep
from sitl.vehicle import Noise
from tests.helpers import ROVER, fly_until_tracking, make_flight, records_of, setpoints_since
from tests.sent_setpoints import asked, float32, ranges, sent_setpoints, within

SET_ATTITUDE_TARGET = (82).to_bytes(3, "little")
DIRTY = Channel(delay_s=0.004, jitter_s=0.003, loss=0.05, duplication=0.05)


def error_m(flight: Lockstep) -> float:
    """|x - r| of the plant at this instant; in the plane for a rover."""
    tracker = flight.guide.tracker
    assert tracker.start_ns is not None
    assert tracker.origin_ned_m is not None
    time_s = (flight.now_ns - tracker.start_ns) * 1e-9
    r = add(tracker.origin_ned_m, sample(flight.guide.config.trajectory, time_s).position)
    e = subtract(Vec3(*flight.truth().position_ned_m), r)
    return math.hypot(e.x, e.y) if flight.guide.profile.planar else norm(e)


def fly(flight: Lockstep, seconds: float) -> TrackingFigures:
    """Track for `seconds` and judge, looking at odd instants so that nothing hides between two ticks."""
    fly_until_tracking(flight)
    flight.run(1.0, until=lambda: flight.guide.tracker.start_ns is not None)
    start_ns = flight.guide.tracker.start_ns
    assert start_ns is not None
    errors = []
    while flight.now_ns < start_ns + seconds * 1e9:
        flight.run(0.0137)
        errors.append(((flight.now_ns - start_ns) * 1e-9, error_m(flight)))
    law = flight.guide.config.law
    return tracking_figures(errors, law.beta / law.k)


def test_bounded_helix_converges_within_12_s_and_then_stays_within_3_mm() -> None:
    figures = fly(make_flight(), 40.0)
    assert figures.converged_s is not None
    assert figures.converged_s < 12.0
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 1e-4  # the goal is 3 mm; on virtual time next to nothing is left
    assert figures.max_error_m is not None
    assert figures.max_error_m < 1e-3


def test_helix_of_20_m_at_4_m_s_stays_within_20_mm() -> None:
    figures = fly(make_flight("trajectory.radius_m=20", "trajectory.speed_m_s=4"), 40.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 1e-3


def test_setpoints_come_at_50_hz_without_a_gap_over_50_ms() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    start_ns = flight.now_ns
    flight.run(20.0)
    figures = stream_figures(setpoints_since(flight, start_ns))
    assert figures.rate_hz == pytest.approx(50.0, rel=0.01)
    assert figures.max_gap_s is not None
    assert figures.max_gap_s < 0.05
    timing = records_of(flight, Timing)[-1]
    assert timing.setpoint_rate_hz == pytest.approx(50.0, rel=0.01)
    assert timing.setpoint_gap_max_s < 0.05


@pytest.mark.parametrize("name", ["helix", "circle", "line", "zigzag", "lemniscate", "eight"])
def test_every_trajectory_is_flown(name: str) -> None:
    figures = fly(make_flight(f"trajectory.name={name}"), 28.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.01


@pytest.mark.parametrize("name", ["helix", "circle", "line", "lemniscate", "eight"])
def test_the_rover_tracks_in_the_plane(name: str) -> None:
    figures = fly(make_flight(*ROVER, f"trajectory.name={name}"), 28.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.03


def test_the_corner_of_the_zigzag_is_found_again() -> None:
    flight = make_flight("trajectory.name=zigzag")
    fly_until_tracking(flight)
    flight.run(29.9)
    assert error_m(flight) < 0.01
    worst = 0.0
    for _ in range(40):
        flight.run(0.05)
        worst = max(worst, error_m(flight))
    assert 0.05 < worst < 1.0  # the field turns by 90 degrees: it cannot stay on
    flight.run(6.0)
    assert error_m(flight) < 0.02


def test_loss_delay_jitter_and_repetition_are_survived() -> None:
    figures = fly(make_flight(to_guide=DIRTY, to_vehicle=DIRTY, seed=3), 30.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.01


def test_a_vehicle_clock_that_drifts_as_a_simulators_does_costs_nothing() -> None:
    flight = make_flight(
        "trajectory.radius_m=20",
        "trajectory.speed_m_s=4",
        clock_drift_ppm=-5000.0,
        clock_offset_ns=3 * 10**12,
    )
    figures = fly(flight, 40.0)
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 0.02


def test_measurement_noise_is_not_amplified() -> None:
    flight = make_flight(noise=Noise(position_m=0.02, attitude_rad=0.002), seed=5)
    fly_until_tracking(flight)
    flight.run(20.0)
    errors = []
    for _ in range(400):
        flight.run(0.05)
        errors.append(error_m(flight))
    assert math.sqrt(sum(e * e for e in errors) / len(errors)) < 0.02


def test_two_runs_with_one_seed_are_identical_to_the_bit() -> None:
    runs = []
    for _ in range(2):
        flight = make_flight(to_guide=DIRTY, to_vehicle=DIRTY, seed=7, noise=Noise(position_m=0.01))
        flight.run(8.0)
        runs.append([msgspec.json.encode(record) for record in flight.records])
    assert len(runs[0]) > 1000
    assert runs[0] == runs[1]


def test_another_seed_is_another_flight() -> None:
    first, second = (make_flight(to_guide=DIRTY, seed=seed) for seed in (1, 2))
    first.run(4.0)
    second.run(4.0)
    assert first.records != second.records


SLOW = (
    "limits.speed_min_m_s=-0.2",
    "limits.speed_max_m_s=2",
    "limits.roll_rate_max_rad_s=0.3",
    "limits.pitch_rate_max_rad_s=0.4",
    "limits.yaw_rate_max_rad_s=0.5",
)


@pytest.mark.parametrize(
    ("start_ned_m", "reached"),
    [
        # Behind the helix: dives at the pitch limit, turns right, is fast.
        ((-10.0, -30.0, -5.0), {"pitch-", "yaw+", "thrust+"}),
        # Ahead of it: turns left, and backs as slowly as it may.
        ((5.0, 0.0, 0.0), {"yaw-", "thrust-"}),
    ],
)
def test_the_bytes_of_every_setpoint_keep_limits_below_those_of_the_vehicle(
    start_ned_m: tuple[float, float, float], reached: set[str]
) -> None:
    flight = make_flight(*SLOW, to_guide=DIRTY, seed=9, initial_position_ned_m=start_ned_m)
    fly_until_tracking(flight)
    flight.run(20.0)
    config = flight.guide.config
    sent = sent_setpoints(flight.records)
    assert len(sent) > 900
    assert all(within(message, config) for _, message in sent)
    at_limit = set()
    for _, message in sent:
        for name, value, (low, high) in zip(
            ("roll", "pitch", "yaw", "thrust"), asked(message), ranges(config), strict=True
        ):
            at_limit |= {f"{name}-"} if value == low else {f"{name}+"} if value == high else set()
    assert at_limit == reached  # the limits were what held it
    assert ranges(config)[3] == (float32(-0.2 / 5.0), float32(2.0 / 5.0))
    setpoints = records_of(flight, Setpoint)
    assert [s.seq for s in setpoints] == list(range(1, len(sent) + 1))
    for setpoint, (packet, message) in zip(setpoints, sent, strict=True):
        assert 2e6 < setpoint.t_ns - packet.t_ns < 8e6  # it acts when it arrives
        assert asked(message) == tuple(map(float32, (*setpoint.body_rates_frd_rad_s, setpoint.thrust)))
        assert setpoint.speed_m_s == pytest.approx(5.0 * setpoint.thrust)


def test_a_quiet_flight_raises_no_alarm() -> None:
    flight = make_flight()
    flight.run(20.0)
    alarms = [e for e in records_of(flight, Event) if e.level not in (Level.INFO, Level.NOTICE)]
    assert alarms == []


def late_actuators(flight: Lockstep, delay_s: float, monkeypatch: pytest.MonkeyPatch) -> Lockstep:
    """What the vehicle is asked for it does so much later; all else it hears at once."""
    send, late = flight._send, Channel(delay_s=delay_s)

    def send_late(data: bytes, channel: Channel, *, to_guide: bool) -> None:
        setpoint = data[7:10] == SET_ATTITUDE_TARGET
        send(data, late if setpoint and not to_guide else channel, to_guide=to_guide)

    monkeypatch.setattr(flight, "_send", send_late)
    return flight


def test_the_configured_delay_of_the_actuators_is_predicted(monkeypatch: pytest.MonkeyPatch) -> None:
    """State and reference are those of the instant at which the setpoint acts, not of its arrival."""
    quick = ("trajectory.name=lemniscate", "trajectory.speed_m_s=3")
    told, untold = (
        fly(late_actuators(make_flight(*quick, delay), 0.05, monkeypatch), 30.0)
        for delay in ("link.actuation_delay_s=0.05", "link.actuation_delay_s=0")
    )
    assert told.rms_error_m is not None
    assert untold.rms_error_m is not None
    assert told.rms_error_m < 0.003
    assert untold.rms_error_m > 5 * told.rms_error_m
