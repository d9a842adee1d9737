"""Copters told body rates and thrust: the handler, what it takes of the autopilot, and whole flights."""

from __future__ import annotations

from dataclasses import replace
from math import radians, tan
from pathlib import Path

import msgspec
import pytest

from guidance.commands import Abort, Engage
from guidance.config import Config, ConfigError, load, profile_of
from guidance.estimate import Estimate
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.flying.choice import handler_of
from guidance.flying.copter_rates import CopterRates, Given, led
from guidance.kept_file import open_learned
from guidance.mavlink.codec import Payload
from guidance.mavlink.messages import ExtendedSysState
from guidance.mavlink.profiles import PROFILES, Asked
from guidance.mavlink.setpoints import Demand, outgoing, setpoint_message
from guidance.records import Record, Setpoint, VelocityHandling
from guidance.replay import replay
from guidance.se3 import ZERO, Pose, Quaternion, Reference, Twist, Vec3, from_euler, norm, rotate
from guidance.supervisor import State
from sitl.lockstep import SECOND, Lockstep
from sitl.logbook import LogBook
from sitl.models import copter as model
from sitl.models.files import load_copter
from sitl.models.gusts import Wind
from sitl.scenarios import copter
from sitl.scenarios.flight import Task, configuration, fly
from sitl.scenarios.table import Row
from sitl.vehicle import Vehicle, VehicleOptions

DEPLOY = Path(__file__).parents[1] / "deploy"
PX4 = {
    "MPC_XY_VEL_MAX": 12.0, "MPC_Z_VEL_MAX_UP": 3.0, "MPC_Z_VEL_MAX_DN": 1.5, "MPC_ACC_HOR": 3.0,
    "MPC_THR_HOVER": 0.5, "MPC_THR_MIN": 0.12, "MPC_THR_MAX": 0.9, "MPC_TILTMAX_AIR": 40.0,
    "MC_ROLLRATE_MAX": 100.0, "MC_PITCHRATE_MAX": 220.0,
}  # fmt: skip
ARDUPILOT = {
    "WP_SPD": 10.0, "WP_SPD_UP": 2.5, "WP_SPD_DN": 1.5, "WP_ACC": 2.5, "WP_ACC_Z": 1.0,
    "GUID_OPTIONS": 8.0, "MOT_THST_HOVER": 0.36, "ATC_ANGLE_MAX": 30.0,
}  # fmt: skip
VALUES = {"px4-copter": PX4, "ardupilot-copter": ARDUPILOT}
EACH = pytest.mark.parametrize("profile", VALUES)
REFERENCE = Reference(Vec3(0.0, 0.0, -10.0), ZERO, ZERO)


def shipped(profile: str = "px4-copter", *settings: str) -> Config:
    return load(DEPLOY / f"{profile}.toml", ("copter.output=rates", *settings))


def fitted(profile: str = "px4-copter", *settings: str) -> CopterRates:
    handler = CopterRates(shipped(profile, *settings))
    assert handler.fit(VALUES[profile]) is None
    return handler


def seen(at: Vec3, velocity: Vec3, q: Quaternion, now_ns: int = SECOND, age_s: float = 0.0) -> Estimate:
    pose = Pose(at, q)
    then_ns = now_ns - round(age_s * 1e9)
    return Estimate(
        instant_ns=now_ns,
        pose=pose,
        twist=Twist(ZERO, ZERO),
        attitude=AttitudeSample(then_ns, 0, q, ZERO, "ATTITUDE_QUATERNION"),
        position=PositionSample(then_ns, 0, at, velocity, "LOCAL_POSITION_NED"),
        attitude_age_s=age_s,
        position_age_s=age_s,
        seen=pose,
    )


HOVERS = seen(REFERENCE.position, ZERO, from_euler(0.0, 0.0, 0.0))


# What is asked for ---------------------------------------------------------------------------------------


@EACH
def test_the_profile_sends_rates_and_thrust(profile: str) -> None:
    row = profile_of(shipped(profile))
    assert (row.asked, row.type_mask, row.thrust_min, row.thrust_max) == (
        Asked.RATES_THROTTLE,
        0x80,
        0.0,
        1.0,
    )
    assert isinstance(handler_of(shipped(profile), row), CopterRates)
    assert profile_of(load(DEPLOY / f"{profile}.toml")) is PROFILES[profile]
    out = outgoing(row, Demand(Vec3(0.5, -0.25, 0.125), throttle=-0.5), 1.0)
    message = setpoint_message(row, out, 1, 1, 1000)
    assert isinstance(message, Payload)
    assert out.thrust == 0.0
    assert row.requirements != PROFILES[profile].requirements


def test_the_ground_teaches_nothing_of_the_thrust() -> None:
    """Told to sink where it stands, it would take its rotors for too strong, and fall in the next flight."""
    handler = fitted()
    handler.start()
    below = REFERENCE._replace(position=Vec3(0.0, 0.0, -5.0))
    parts = []
    for landed_state in (1, 2):
        handler.heard(ExtendedSysState(landed_state), SECOND)
        for n in range(100):
            handler.step(replace_instant(HOVERS, SECOND + n * 20_000_000), below, 0.02)
        parts.append(msgspec.json.decode(handler.learned)["hover_part"])
    assert parts[0] == 1.0
    assert parts[1] < 0.95


def replace_instant(estimate: Estimate, now_ns: int) -> Estimate:
    return seen(estimate.pose.position, ZERO, estimate.pose.attitude, now_ns)


@pytest.mark.parametrize(
    ("profile", "without", "said"),
    [
        ("px4-copter", "MPC_THR_HOVER", "MPC_THR_HOVER is not told"),
        ("ardupilot-copter", "MOT_THST_HOVER", "MOT_THST_HOVER is not told"),
        ("ardupilot-copter", "GUID_OPTIONS", "GUID_OPTIONS is not told"),
    ],
)
def test_without_what_makes_a_thrust_it_is_refused(profile: str, without: str, said: str) -> None:
    handler = CopterRates(shipped(profile))
    why = handler.fit({name: value for name, value in VALUES[profile].items() if name != without})
    assert why is not None
    assert said in why


def test_a_hover_thrust_beyond_the_ends_is_refused() -> None:
    why = CopterRates(shipped()).fit({**PX4, "MPC_THR_MAX": 0.45})
    assert why == "the hover thrust, 0.5, must be between least and most, 0.12 and 0.45"


def test_the_tighter_of_configuration_and_autopilot_holds() -> None:
    p = fitted()._by_rates
    assert p is not None
    assert p.tilt_max_rad == pytest.approx(radians(40.0))
    assert p.rates_max_rad_s == pytest.approx((radians(100.0), 3.0, radians(60.0)))
    assert (p.thrust_min, p.thrust_max, p.boosts, p.climbs) == (0.12, 0.9, False, False)
    own = fitted("px4-copter", "copter.tilt_max_deg=10")
    assert own._by_rates is not None
    assert own._by_rates.tilt_max_rad == pytest.approx(radians(10.0))
    # what it cannot lean for is not asked of it
    assert own._parameters is not None
    assert own._parameters.limits.acceleration_m_s2 == pytest.approx(0.8 * 9.80665 * tan(radians(10.0)))
    handler = CopterRates(shipped("px4-copter", "copter.tilt_max_deg=5"))
    assert "horizontal acceleration: 0.9 m/s^2 needed" in str(handler.fit(PX4))


def test_a_tilt_that_binds_is_named() -> None:
    able = fitted("px4-copter", "copter.tilt_max_deg=8").abilities()
    assert able is not None
    assert able.acceleration_m_s2.value < 1.2
    assert able.acceleration_m_s2.source == "copter.tilt_max_deg 8"


def test_ardupilot_s_thrust_means_what_guid_options_says() -> None:
    p = fitted("ardupilot-copter")._by_rates
    assert p is not None
    assert (p.climbs, p.boosts, p.hover_thrust) == (False, True, 0.36)
    handler = CopterRates(shipped("ardupilot-copter"))
    assert handler.fit({**ARDUPILOT, "GUID_OPTIONS": 7.0, "ATC_ANGLE_BOOST": 0.0}) is None
    p = handler._by_rates
    assert p is not None
    assert (p.climbs, p.boosts, p.climb_up_m_s, p.climb_down_m_s) == (True, False, 2.5, 1.5)
    handler.start()
    assert handler.step(HOVERS, REFERENCE, 0.02).demand.throttle == pytest.approx(0.5)
    assert handler.neutral(HOVERS).throttle == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (["limits.roll_rate_max_rad_s=0.1"], r"limits\.roll_rate_max_rad_s = 0\.1: must be at least 0\.5"),
        (["link.rate_hz=20"], r"copter\.attitude_gain_per_s = 6: must be at most 3"),
    ],
)
def test_what_no_copter_leans_with_is_refused(settings: list[str], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        shipped("px4-copter", *settings)
    load(DEPLOY / "px4-copter.toml", settings)


# Steps ---------------------------------------------------------------------------------------------------


def test_a_step_leans_to_the_reference_and_says_why() -> None:
    handler = fitted()
    handler.start()
    flown = handler.step(seen(Vec3(-3.0, 0.0, -10.0), ZERO, HOVERS.pose.attitude), REFERENCE, 0.02)
    assert flown.demand.body_rates_frd_rad_s.y < -0.1  # nose down, to the north
    assert flown.demand.throttle == pytest.approx(0.5, abs=0.01)
    assert flown.acting_rates_frd_rad_s == flown.demand.body_rates_frd_rad_s
    assert flown.is_finite()
    assert isinstance(flown.around, VelocityHandling)
    assert flown.around.hover_part == 1.0


def test_the_velocity_goes_on_at_the_accelerations_under_way() -> None:
    estimate = seen(ZERO, Vec3(2.0, 0.0, 0.0), from_euler(0.3, 0.1, 1.0), age_s=0.1)
    began = Given(estimate.instant_ns - 500_000_000, Vec3(0.0, 1.0, -0.5))
    found = led(estimate, (began,))
    assert found.pose.position == pytest.approx((0.2, 0.005, -0.0025))
    assert rotate(found.pose.attitude, found.twist.linear) == pytest.approx((2.0, 0.1, -0.05))
    # one that acts later holds from then on, one after the instant not at all
    later = (
        Given(estimate.instant_ns - 50_000_000, ZERO),
        Given(estimate.instant_ns + 1, Vec3(9.0, 0.0, 0.0)),
    )
    found = led(estimate, (began, *later))
    assert rotate(found.pose.attitude, found.twist.linear) == pytest.approx((2.0, 0.05, -0.025))
    assert led(estimate, ()).pose.position == pytest.approx((0.2, 0.0, 0.0))


def test_the_hover_thrust_outlives_the_flight_and_the_process(tmp_path: Path) -> None:
    handler = fitted()
    handler.start()
    sinks = seen(REFERENCE.position, Vec3(0.0, 0.0, 0.2), HOVERS.pose.attitude)
    for n in range(200):
        handler.step(sinks._replace(instant_ns=SECOND + n * 20_000_000), REFERENCE, 0.02)
    kept = handler.learned
    part = msgspec.json.decode(kept)["hover_part"]
    assert 1.03 < part < 1.2
    handler.start()
    assert handler.learned == kept
    other = fitted()
    assert other.recall(kept) is None
    other.start()
    thrust = other.step(HOVERS, REFERENCE, 0.02).demand.throttle
    assert thrust == pytest.approx(0.5 * part, rel=0.01)
    for absurd in ('{"hover_part": 7.0}', "{}", "no", '{"hover_part": 1.0, "more": 1}'):
        assert other.recall(absurd) is not None
    assert other.learned == kept
    file = open_learned(shipped("px4-copter", f"copter.hover_file={tmp_path / 'hover.json'}"))
    assert file is not None
    assert open_learned(shipped()) is None


def test_before_it_is_known_it_asks_for_nothing_that_falls() -> None:
    assert CopterRates(shipped()).neutral(HOVERS) == Demand(throttle=0.5)


def test_what_is_learned_may_be_switched_off() -> None:
    handler = fitted("px4-copter", "copter.learns=false")
    handler.start()
    sinks = seen(REFERENCE.position, Vec3(0.0, 0.0, 0.2), HOVERS.pose.attitude)
    for n in range(100):
        handler.step(sinks._replace(instant_ns=SECOND + n * 20_000_000), REFERENCE, 0.02)
    assert msgspec.json.decode(handler.learned) == {"hover_part": 1.0}


@EACH
def test_neutral_brakes_and_stands_in_wind(profile: str) -> None:
    handler = fitted(profile)
    name = profile.replace("-copter", "")
    body = load_copter(f"copter_{name}")
    wind = Wind(3.0, -4.0, 0.0)
    state = model.hovering(body, (0.0, 0.0, -20.0), 0.5, wind)._replace(velocity_ned_m_s=(3.0, 0.0, 0.0))
    fastest = 0.0
    for n in range(1000):
        estimate = seen(
            Vec3(*state.position_ned_m),
            Vec3(*state.velocity_ned_m_s),
            Quaternion(*state.attitude_wxyz),
            SECOND + n * 20_000_000,
        )
        demand = handler.neutral(estimate)
        (p, q, r), thrust = demand.body_rates_frd_rad_s, demand.throttle
        if profile == "ardupilot-copter":  # as its own boost
            _, x, y, _ = state.attitude_wxyz
            thrust /= 1.0 - 2.0 * (x * x + y * y)
        state = model.told_rates(body, state, (p, q, r), thrust)
        for _ in range(5):
            state = model.step(body, state, wind, 0.004)
        if n > 500:
            fastest = max(fastest, norm(Vec3(*state.velocity_ned_m_s)))
    assert fastest < 0.3
    assert abs(state.position_ned_m[2] + 20.0) < 1.0


# Flights -------------------------------------------------------------------------------------------------


def flight_of(task: Task, records: list[Record], *settings: str) -> Lockstep:
    config = configuration(replace(task, settings=(*task.settings, *settings)))
    options = VehicleOptions(**task.vehicle, noise=task.noise)
    vehicle = Vehicle(options, boot_ns=SECOND)
    flight = Lockstep(config, vehicle, start_ns=SECOND, on_record=records.append)
    engagement = flight.guide.engagement
    assert flight.run(20.0, until=lambda: engagement.state is State.READY)
    flight.guide.command(Engage(), flight.now_ns)
    assert flight.run(20.0, until=lambda: engagement.state is State.TRACKING)
    return flight


ROWS = {
    (row.task.profile, row.name.rsplit(", ", 1)[1]): row
    for row in copter.rows()
    if row.name.startswith("circle") and ", by " in row.name
}
BY = pytest.mark.parametrize("row", ROWS.values(), ids=lambda row: f"{row.task.profile}, {row.name}")


@BY
def test_it_replays_to_the_bit(row: Row, tmp_path: Path) -> None:
    records: list[Record] = []
    flight = flight_of(row.task, records)
    flight.run(4.0)
    with LogBook(flight.guide.config, tmp_path) as book:
        for record in records:
            book.add(record)
    found = replay(book.path)
    assert found.identical, found.difference
    assert found.tracked > 150


@BY
def test_the_takeover_and_the_way_back_are_smooth(row: Row) -> None:
    """In wind: it does not drop when the service takes over, nor when the autopilot takes it back."""
    records: list[Record] = []
    task = replace(row.task, vehicle={**row.task.vehicle, "wind_ned_m_s": (3.0, -4.0, 0.0)})
    flight = flight_of(task, records)
    height = flight.truth().position_ned_m[2]
    flight.run(0.5)
    assert abs(flight.truth().position_ned_m[2] - height) < 0.25
    setpoints = [record for record in records if isinstance(record, Setpoint)]
    assert all(0.0 <= setpoint.thrust <= 1.0 for setpoint in setpoints)
    assert max(norm(Vec3(*setpoint.body_rates_frd_rad_s)) for setpoint in setpoints) < 3.5
    flight.run(10.0)
    height = flight.truth().position_ned_m[2]
    flight.guide.command(Abort(), flight.now_ns)
    flight.run(12.0)
    truth = flight.truth()
    assert flight.guide.engagement.state is not State.TRACKING
    assert norm(Vec3(*truth.velocity_ned_m_s)) < 0.5
    assert abs(truth.position_ned_m[2] - height) < 1.5


def test_a_later_flight_starts_with_the_hover_thrust_of_the_one_before() -> None:
    row = ROWS["px4-copter", "by rates and thrust"]
    wrong = replace(row.task, vehicle={**row.task.vehicle, "parameters": {"MPC_THR_HOVER": 0.4}})
    records: list[Record] = []
    flight = flight_of(wrong, records)
    flight.run(15.0)
    kept = flight.guide.tracker.handler.learned
    assert msgspec.json.decode(kept)["hover_part"] == pytest.approx(1.25, rel=0.05)
    # what was off at first is not, the next time
    drops = [around.hover_part for around in records if isinstance(around, VelocityHandling)]
    assert drops[0] == pytest.approx(1.0, abs=0.02)


def test_a_slow_link_makes_no_limit_cycle() -> None:
    name = "leg at 3 m/s, stop and hold, by rates and thrust"
    row = next(r for r in copter.rows() if (r.task.profile, r.name) == ("ardupilot-copter", name))
    assert fly(replace(row.task, link_delay_s=0.08)).rms_m < 0.15
