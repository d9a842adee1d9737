"""Airplanes flown by tracker and handler as the shipped configurations have it, on the built-in models."""

from __future__ import annotations

from math import cos, hypot, inf, nan, pi, radians, sin
from pathlib import Path
from typing import Any, Final

import pytest

from guidance import error_function
from guidance.blending import NO_TURN
from guidance.config import Config, ConfigError, load, profile_of
from guidance.core import Guide
from guidance.flying.airplane import AIRSPEED_S, Airplane
from guidance.guards import GUARDS
from guidance.handling.airplane import Trims, airplane_step
from guidance.handling.airplane_rates import body_rates, turn_rate_rad_s
from guidance.mavlink.air import VfrHud, Wind, WindCov
from guidance.mavlink.profiles import PROFILES
from guidance.mavlink.setpoints import Outgoing
from guidance.se3 import Pose, Reference, Twist, Vec3, compose, exp, from_euler, pitch_of, roll_of, yaw_of
from sitl.models.files import load_airplane
from tests.airplane_loop import Loop, Row, settled
from tests.helpers import make_config

DEPLOY: Final = Path(__file__).parents[1] / "deploy"
#: Profile and the speed of its example.
BOTH: Final = {"px4-plane": 12, "ardupilot-plane": 20}
EACH: Final = pytest.mark.parametrize("name", BOTH)


def shipped(name: str, *settings: str) -> Config:
    return load(DEPLOY / f"{name}.toml", settings)


def loop(name: str, *settings: str, **options: Any) -> Loop:
    speed = BOTH[name]
    body = load_airplane(f"airplane_{speed}")
    return Loop(shipped(name, *settings), body, speed_m_s=float(speed), **options)


def converged_s(rows: list[Row]) -> float:
    return max((row.t_s for row in rows if row.error_m >= 3.0), default=0.0)


@EACH
def test_a_circle_is_flown_as_shipped(name: str) -> None:
    rows = loop(name).fly(40.0)
    assert converged_s(rows) < 8.0
    rms_m, most_m = settled(rows, 20.0)
    assert rms_m < 0.2  # 0.10 and 0.12
    assert most_m < 0.5
    assert not any(row.around.bank_saturated for row in rows if row.t_s > 20.0)
    learned = rows[-1].around.effectiveness
    assert learned == pytest.approx({"px4-plane": 0.95, "ardupilot-plane": 0.74}[name], abs=0.03)


@EACH
@pytest.mark.parametrize("told", [True, False])
def test_in_wind_with_gusts(name: str, told: bool) -> None:
    rows = loop(name, wind_m_s=5.0, wind_told=told).fly(50.0)
    assert settled(rows, 25.0)[0] < 1.0  # 0.71 and 0.50
    assert min(row.airspeed_m_s for row in rows if row.t_s > 5.0) > 10.0
    wind = rows[-1].around.wind_ned_m_s
    assert hypot(wind[0] - 5.0 * cos(pi / 4), wind[1] - 5.0 * sin(pi / 4)) < 1.5


@EACH
def test_from_far_off_facing_away_the_clock_waits(name: str) -> None:
    rows = loop(name, right_m=-150.0, off_rad=radians(-90.0)).fly(32.0)
    assert converged_s(rows) < {"px4-plane": 24.0, "ardupilot-plane": 20.0}[name]
    assert rows[-1].around.waited_s > 5.0
    assert loop(name, "airplane.waits=false").fly(5.0)[-1].around.waited_s == 0.0


def test_a_velocity_that_px4_has_wrong_is_set_right_and_ardupilot_s_is_taken_as_it_is() -> None:
    wrong = Vec3(0.5, -0.3, 0.2)
    for name, found in (("px4-plane", wrong), ("ardupilot-plane", Vec3(0.0, 0.0, 0.0))):
        flight = loop(name, velocity_wrong_m_s=wrong)
        flight.fly(20.0)
        handler = flight.tracker.handler
        assert isinstance(handler, Airplane)
        assert handler._smooth.error == pytest.approx(found, abs=0.15)


def test_the_record_s_clock_is_that_of_its_step() -> None:
    rows = loop("px4-plane", right_m=-150.0, off_rad=radians(-90.0)).fly(6.0)
    assert rows[-1].around.waited_s > 1.0
    for row in rows:
        flown_s = row.solution.trajectory_s + row.around.waited_s
        assert flown_s == pytest.approx(row.t_s - rows[0].t_s, abs=1e-6)


def test_by_body_rates_px4_flies_as_well() -> None:
    rows = loop("px4-plane", "airplane.output=rates").fly(40.0)
    assert converged_s(rows) < 8.0
    assert settled(rows, 20.0)[0] < 0.2
    out = rows[-1].solution.outgoing
    assert out.attitude_wxyz == (1.0, 0.0, 0.0, 0.0)
    # a turn to the right: the nose is pulled round
    assert out.body_rates_frd_rad_s[2] > 0.05
    assert out.thrust == pytest.approx(0.8, abs=0.2)
    # what was sent is what it is taken to obey; an attitude says nothing of rates
    assert rows[-1].solution.flown.acting_rates_frd_rad_s == out.body_rates_frd_rad_s
    flight = loop("px4-plane")
    flown = flight.fly(1.0)[-1].solution.flown
    assert flight.estimator.attitude is not None
    assert flown.acting_rates_frd_rad_s == flight.estimator.attitude.body_rates_frd_rad_s


@pytest.mark.parametrize(("age_s", "delay_s"), [(0.06, 0.15), (0.1, 0.2)])
def test_old_telemetry_and_a_late_answer_cost_little(age_s: float, delay_s: float) -> None:
    """Predicted by a constant twist it was 0.76 m RMS at 60 and 150 ms, by the banks under way 0.13 m."""
    rows = loop("ardupilot-plane", f"link.actuation_delay_s={delay_s}", age_s=age_s).fly(45.0)
    assert settled(rows, 25.0)[0] < 0.35


#: As recorded, or as the simulators have them.
PX4: Final = {
    "FW_AIRSPD_MIN": 10.0, "FW_AIRSPD_TRIM": 15.0, "FW_AIRSPD_MAX": 20.0, "FW_R_LIM": 50.0,
    "FW_R_RMAX": 70.0, "FW_P_LIM_MIN": -30.0, "FW_P_LIM_MAX": 30.0, "FW_PSP_OFF": 0.0, "FW_THR_MIN": 0.0,
    "FW_THR_MAX": 1.0, "FW_THR_TRIM": 0.6, "FW_T_CLMB_MAX": 5.0, "FW_T_SINK_MAX": 5.0,
}  # fmt: skip
ARDUPILOT: Final = {
    "AIRSPEED_MIN": 10.0, "AIRSPEED_CRUISE": 22.0, "AIRSPEED_MAX": 30.0, "ROLL_LIMIT_DEG": 65.0,
    "RLL2SRV_RMAX": 90.0, "PTCH_LIM_MIN_DEG": -20.0, "PTCH_LIM_MAX_DEG": 25.0, "THR_MIN": 0.0,
    "THR_MAX": 100.0, "TRIM_THROTTLE": 50.0, "TECS_CLMB_MAX": 5.0, "TECS_SINK_MAX": 5.0,
}  # fmt: skip
VALUES: Final = {"px4-plane": PX4, "ardupilot-plane": ARDUPILOT}


def bare(name: str, tmp_path: Path, *settings: str) -> Config:
    """As shipped, but for [airplane], of which nothing is set."""
    before, _, rest = (DEPLOY / f"{name}.toml").read_text(encoding="utf-8").partition("[airplane]\n")
    _, _, after = rest.partition("# Where the trajectory is put;")
    path = tmp_path / f"{name}.toml"
    path.write_text(f"{before}\n#{after}", encoding="utf-8")
    return load(path, ["limits.speed_max_m_s=30", "vehicle.speed_at_full_thrust_m_s=30", *settings])


@EACH
def test_the_autopilots_own_parameters_are_enough(name: str, tmp_path: Path) -> None:
    speed = BOTH[name]
    flight = Loop(bare(name, tmp_path), load_airplane(f"airplane_{speed}"), speed_m_s=float(speed))
    assert flight.tracker.handler.fit(VALUES[name]) is None
    assert settled(flight.fly(50.0), 30.0)[0] < 0.25


@EACH
def test_without_airspeeds_it_is_not_flown(name: str, tmp_path: Path) -> None:
    handler = Airplane(bare(name, tmp_path))
    for missing in list(VALUES[name])[:4]:
        values = {key: value for key, value in VALUES[name].items() if key != missing}
        why = handler.fit(values)
        assert why is not None
        assert missing in why
        assert "set airplane." in why
    handler = Airplane(shipped(name))
    assert handler.fit({}) is None, "all of that is in the configuration"


def parameters(config: Config, values: dict[str, float]) -> Any:
    handler = Airplane(config)
    assert handler.fit(values) is None
    assert handler._fitted is not None
    return handler._fitted.parameters


def test_what_cannot_be_flown_changes_nothing_in_flight() -> None:
    flight = loop("px4-plane")
    flight.fly(1.0)
    handler = flight.tracker.handler
    before = getattr(handler, "_fitted", None)
    assert "must be 0 < min < cruise" in str(handler.fit({"FW_AIRSPD_MIN": 13.0}))
    flight.fly(0.1)
    assert getattr(handler, "_fitted", None) == before


def test_a_turn_of_the_estimator_is_blended_in_what_was_seen(
    quiet: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    handler = quiet.tracker.handler
    assert isinstance(handler, Airplane)
    quiet.tracker._turn = NO_TURN._replace(angle_rad=Vec3(0.0, 0.0, 0.3))
    told = measured(handler, monkeypatch, quiet)
    now = quiet.estimator.attitude
    assert now is not None
    assert yaw_of(told.pose.attitude) - yaw_of(now.attitude) == pytest.approx(0.3, abs=0.02)


def test_the_tighter_of_configuration_and_autopilot_holds() -> None:
    config = shipped("px4-plane", "trajectory.speed_m_s=12.5")
    own = parameters(config, {})
    assert (own.envelope.airspeed_min_m_s, own.envelope.airspeed_max_m_s) == (10.0, 14.0)
    tighter = {"FW_AIRSPD_MIN": 10.5, "FW_AIRSPD_MAX": 13.0, "FW_R_LIM": 40.0, "FW_R_RMAX": 60.0}
    tighter |= {"FW_P_LIM_MIN": -10.0, "FW_P_LIM_MAX": 12.0, "FW_THR_MAX": 0.9, "FW_T_CLMB_MAX": 1.5}
    held = parameters(config, tighter)
    assert (held.envelope.airspeed_min_m_s, held.envelope.airspeed_max_m_s) == (10.5, 13.0)
    assert held.envelope.bank_max_rad == pytest.approx(radians(40.0))
    assert held.roll_rate_rad_s == pytest.approx(radians(60.0))
    assert (held.pitch.lowest_rad, held.pitch.highest_rad) == pytest.approx((radians(-10.0), radians(12.0)))
    assert (held.throttle.highest, held.envelope.climb_max_m_s) == (0.9, 1.5)
    looser = {"FW_AIRSPD_MIN": 8.0, "FW_AIRSPD_MAX": 30.0, "FW_R_LIM": 60.0, "FW_T_CLMB_MAX": 9.0}
    assert parameters(config, looser) == own
    assert parameters(shipped("ardupilot-plane"), {"LIM_ROLL_CD": 5500.0}).envelope.bank_max_rad == (
        pytest.approx(radians(55.0))
    )


def test_the_law_s_keys_are_the_handling_s() -> None:
    p = parameters(shipped("px4-plane", "law.k=0.8", "law.beta=2", "law.rho3_per_s=1.2"), {})
    assert (p.k_per_s, p.rho_per_s) == (0.4, 1.2)
    bounds = ("law.error_function.name=bounded", "law.error_function.approach_m_s=9")
    p = parameters(shipped("px4-plane", *bounds), {})
    assert (p.approach_m_s, p.approach_up_m_s) == (9.0, pytest.approx(1.875))
    apart = ("name=bounded-apart", "horizontal_m_s=9", "vertical_m_s=1")
    p = parameters(shipped("px4-plane", *(f"law.error_function.{setting}" for setting in apart)), {})
    assert (p.approach_m_s, p.approach_up_m_s) == (9.0, 1.0)
    p = parameters(shipped("px4-plane", "airplane.k_up_per_s=0.5", "airplane.load_max=1.45"), {})
    assert (p.k_up_per_s, p.envelope.load_max) == (0.5, 1.45)
    p = parameters(shipped("px4-plane", "airplane.learns=false"), {})
    assert (p.bank.per_s, p.pitch.trim_per_s, p.throttle.integral_per_m) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("value", [nan, inf, -1.0, 0.0])
@pytest.mark.parametrize("key", sorted(PX4))
def test_absurd_parameters_never_become_a_flight(key: str, value: float, tmp_path: Path) -> None:
    """They are refused, or bounded by what is not absurd."""
    handler = Airplane(bare("px4-plane", tmp_path))
    if handler.fit(PX4 | {key: value}) is None:
        assert handler._fitted is not None
        p = handler._fitted.parameters
        assert p.envelope.airspeed_min_m_s >= 3.0
        assert 0.0 < p.roll_rate_rad_s <= 1.5
        assert -0.53 < p.pitch.lowest_rad < p.pitch.highest_rad < 0.5
        assert 0.0 <= p.throttle.lowest < p.throttle.highest <= 1.0
        assert 0.0 < p.envelope.bank_max_rad < 1.4
        assert p.envelope.climb_max_m_s < inf


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (["trajectory.radius_m=15"], "bank: 44.4 deg needed at t = 0 s"),
        (
            ["trajectory.speed_m_s=13.9", "airplane.throttle_cruise=0.9"],
            "13.015 m/s available (what full throttle holds)",
        ),
        (
            ["trajectory.speed_m_s=10.6", "trajectory.radius_m=16"],
            "at least 10 m/s available (the least airspeed)",
        ),
    ],
)
def test_what_it_cannot_fly_is_refused_with_numbers(settings: list[str], text: str) -> None:
    why = Airplane(shipped("px4-plane", *settings)).fit({})
    assert why is not None
    assert text in why


# What is heard ---------------------------------------------------------------------------------------


def measured(handler: Airplane, monkeypatch: pytest.MonkeyPatch, flight: Loop) -> Any:
    """What the handling is told at the next step."""
    seen: list[Any] = []

    def spy(p: Any, memory: Any, told: Any, reference: Reference, dt: float) -> Any:
        seen.append(told)
        return airplane_step(p, memory, told, reference, dt)

    monkeypatch.setattr("guidance.flying.airplane.airplane_step", spy)
    flight.fly(0.02)
    return seen[-1]


@pytest.fixture
def quiet() -> Loop:
    """In flight, and nothing tells of the air."""
    flight = loop("px4-plane", sensed=None, wind_told=False)
    flight.fly(0.2)
    return flight


@pytest.mark.parametrize(
    ("body", "wind"),
    [
        (Wind(270.0, 4.0, 0.0), (0.0, 4.0)),  # from the west, towards the east
        (Wind(-180.0, 4.0, 0.0), (4.0, 0.0)),
        (WindCov(1.0, -2.0, 0.0), (1.0, -2.0)),
    ],
)
def test_winds_blow_where_they_say(
    body: Wind | WindCov, wind: tuple[float, float], quiet: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    handler = quiet.tracker.handler
    assert isinstance(handler, Airplane)
    handler.heard(body, quiet.now_ns)
    told = measured(handler, monkeypatch, quiet)
    assert told.wind_given
    assert told.wind_ned_m_s[:2] == pytest.approx(wind)


@pytest.mark.parametrize(
    "body", [Wind(nan, 1.0, 0.0), Wind(0.0, nan, 0.0), Wind(0.0, 1e9, 0.0), WindCov(nan, 0.0, 0.0)]
)
def test_a_wind_that_cannot_be_is_not_flown_with(
    body: Wind | WindCov, quiet: Loop, monkeypatch: pytest.MonkeyPatch
) -> None:
    handler = quiet.tracker.handler
    assert isinstance(handler, Airplane)
    handler.heard(body, quiet.now_ns)
    assert not measured(handler, monkeypatch, quiet).wind_given


def test_an_airspeed_is_used_while_it_is_young(quiet: Loop, monkeypatch: pytest.MonkeyPatch) -> None:
    handler = quiet.tracker.handler
    assert isinstance(handler, Airplane)
    for bad in (nan, inf, -1.0):
        handler.heard(VfrHud(bad, 0.0), quiet.now_ns)
    assert measured(handler, monkeypatch, quiet).airspeed_m_s == 0.0
    handler.heard(VfrHud(12.5, 0.0), quiet.now_ns)
    assert measured(handler, monkeypatch, quiet).airspeed_m_s == 12.5
    quiet.fly(AIRSPEED_S)
    assert measured(handler, monkeypatch, quiet).airspeed_m_s == 0.0


# What is learned -------------------------------------------------------------------------------------


def test_the_next_flight_starts_with_what_this_one_learned() -> None:
    flight = loop("ardupilot-plane")
    flight.fly(20.0)
    handler = flight.tracker.handler
    assert isinstance(handler, Airplane)
    learned = handler.trims
    assert learned.effectiveness < 0.8
    handler.start()
    assert handler.trims == learned
    assert handler.waited_s == 0.0
    other = Airplane(flight.config)
    assert other.recall(handler.learned) is None
    assert other.trims == learned
    assert Airplane(flight.config).trims == Trims(1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "[" * 100_000,
        '{"effectiveness":0.1,"pitch_rad":0,"throttle":0}',
        '{"effectiveness":1,"pitch_rad":0.5,"throttle":0}',
        '{"effectiveness":1,"pitch_rad":0,"throttle":-9}',
        '{"effectiveness":NaN,"pitch_rad":0,"throttle":0}',
        '{"effectiveness":1,"pitch_rad":0,"throttle":0,"more":1}',
    ],
)
def test_absurd_trims_are_refused(text: str) -> None:
    handler = Airplane(shipped("px4-plane"))
    assert handler.recall(text)
    assert handler.trims == Trims(1.0, 0.0, 0.0)


def test_without_learning_the_trims_stay() -> None:
    flight = loop("ardupilot-plane", "airplane.learns=false")
    flight.fly(10.0)
    handler = flight.tracker.handler
    assert isinstance(handler, Airplane)
    assert handler.trims == Trims(1.0, 0.0, 0.0)


# What is told ----------------------------------------------------------------------------------------


@EACH
def test_neutral_is_level_flight(name: str) -> None:
    flight = loop(name)
    flight.fly(20.0)
    estimate = flight.estimator.at(flight.now_ns)
    assert estimate is not None
    demand = flight.tracker.handler.neutral(estimate)
    assert roll_of(demand.attitude) == pytest.approx(0.0, abs=1e-9)
    assert yaw_of(demand.attitude) == pytest.approx(yaw_of(estimate.pose.attitude))
    assert abs(pitch_of(demand.attitude)) < 0.1
    assert demand.throttle == pytest.approx({"px4-plane": 0.8, "ardupilot-plane": 0.36}[name], abs=0.06)


def test_neutral_by_body_rates_levels_the_wings() -> None:
    flight = loop("px4-plane", "airplane.output=rates")
    flight.fly(20.0)
    estimate = flight.estimator.at(flight.now_ns)
    assert estimate is not None
    bank = roll_of(estimate.pose.attitude)
    assert bank > 0.1
    rates = Vec3(*flight.tracker.neutral(estimate).body_rates_frd_rad_s)
    assert rates.x == pytest.approx(-4.0 * bank, rel=0.2)
    assert rates.z > 0.0, "as long as it banks, it turns"


def test_the_evaluation_is_the_field_s() -> None:
    rows = loop("px4-plane", right_m=30.0).fly(3.0)
    for row in rows[::20]:
        found = row.solution.evaluation
        e, r = found.e, row.solution.reference
        phi = error_function.bounded_apart(12.0, 1.875)
        level = error_function.derivatives(phi, 0.65, 1.0, e._replace(z=0.0), r).phi
        p = parameters(shipped("px4-plane"), {})
        up = error_function.derivatives(phi, p.k_up_per_s, 1.0, Vec3(0.0, 0.0, e.z), r).phi
        assert pytest.approx(level + up, rel=1e-6) == found.V1
        assert pytest.approx(0.5 * (found.y5**2 + found.y6**2)) == found.V2
        assert found.y5 == pytest.approx(hypot(found.y4, found.y5) * sin(row.around.course_off_rad), abs=1.0)
        assert found.controls.u4 == row.around.airspeed_asked_m_s
    assert rows[-1].solution.flown.is_finite()


def test_body_rates_of_a_steady_turn() -> None:
    """A small step along them turns the attitude about the vertical alone."""
    roll, pitch, turn = 0.6, 0.1, turn_rate_rad_s(0.6, 12.0, 1.0)
    assert turn == pytest.approx(9.80665 * 0.684137 / 12.0, rel=1e-5)
    rates = body_rates(roll, pitch, 0.0, 0.0, turn)
    before = Pose(Vec3(0.0, 0.0, 0.0), from_euler(roll, pitch, 0.3))
    after = compose(before, exp(Twist(rates, Vec3(0.0, 0.0, 0.0)), 0.1)).attitude
    assert (roll_of(after), pitch_of(after)) == pytest.approx((roll, pitch), abs=1e-6)
    assert yaw_of(after) - 0.3 == pytest.approx(0.1 * turn)
    assert body_rates(0.0, 0.0, 0.2, 0.3, 0.0) == Vec3(0.2, 0.3, 0.0)


# Configuration and guards -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (
            ["airplane.airspeed_min_m_s=13"],
            "airplane.airspeed_min_m_s = 13: must be below airplane.airspeed_cr",
        ),
        (["airplane.airspeed_cruise_m_s=14.5"], "must be below airplane.airspeed_max_m_s = 14"),
        (["airplane.airspeed_max_m_s=15"], "must be below limits.speed_max_m_s = 14"),
        (["airplane.bank_max_deg=90"], "airplane.bank_max_deg"),
        (["airplane.bank=90"], "airplane.bank"),
    ],
)
def test_airspeeds_that_do_not_rise_are_refused(settings: list[str], text: str) -> None:
    with pytest.raises(ConfigError, match=text.replace("(", r"\(")):
        shipped("px4-plane", *settings)


def test_only_px4_is_asked_by_rates_and_only_airplanes_have_the_section() -> None:
    with pytest.raises(ConfigError, match="ardupilot-plane takes none"):
        shipped("ardupilot-plane", "airplane.output=rates")
    with pytest.raises(ConfigError, match="px4-uuv is no airplane"):
        make_config("airplane.waits=false")
    assert profile_of(shipped("px4-plane")) is PROFILES["px4-plane"]
    assert profile_of(shipped("px4-plane", "airplane.output=rates")).type_mask == 0x80


def test_a_bank_without_effect_is_noticed() -> None:
    flight = loop("ardupilot-plane")
    row = flight.fly(10.0)[-1]
    estimate = flight.estimator.at(flight.now_ns)
    assert estimate is not None
    effect = next(guard for guard in GUARDS if guard.name == "effect")
    guide = Guide(flight.config)
    look = guide.guards._seen(estimate, flight.now_ns)._replace(solution=row.solution)
    assert effect.exceeded(look) is None
    level = estimate._replace(pose=Pose(estimate.pose.position, from_euler(0.0, 0.0, 1.0)))
    said = effect.exceeded(look._replace(state=level))
    assert said is not None
    assert "banks by 0 of " in said
    w, x, y, z = from_euler(radians(9.0), 0.0, 0.0)
    gentle = row.solution._replace(outgoing=Outgoing(attitude_wxyz=(w, x, y, z)))
    assert effect.exceeded(look._replace(state=level, solution=gentle)) is None
