"""What an airplane is not engaged with, or reloaded with: airspeed, density, wind, ground and settings; and
what an airspeed that fails in flight does."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from guidance.changing import with_setting, with_trajectory
from guidance.commands import LoadTrajectory, Set
from guidance.config import ConfigError, load
from guidance.core import Guide
from guidance.estimate import AttitudeSample, Estimate, PositionSample
from guidance.flying.airplane import AIRSPEED_S, WIND_S, Airplane
from guidance.flying.airplane_fit import ASKED_FOR, thinness
from guidance.guards import GUARDS
from guidance.mavlink.air import VfrHud, Wind, WindCov
from guidance.mavlink.profiles import PROFILES
from guidance.se3 import IDENTITY, ZERO, Pose, Twist, Vec3
from guidance.supervisor import State
from tests.airplane_loop import Loop, settled
from tests.helpers import fly_until, make_flight
from tests.test_flying_airplane import DEPLOY, loop, shipped

HERE = Vec3(100.0, 0.0, -60.0)
NORTH = Vec3(12.0, 0.0, 0.0)


def estimate(velocity_ned_m_s: Vec3 = NORTH) -> Estimate:
    return Estimate(
        instant_ns=0,
        pose=Pose(HERE, IDENTITY),
        twist=Twist(ZERO, velocity_ned_m_s),
        attitude=AttitudeSample(0, 0, IDENTITY, ZERO, "ATTITUDE"),
        position=PositionSample(0, 0, HERE, velocity_ned_m_s, "LOCAL_POSITION_NED"),
        attitude_age_s=0.0,
        position_age_s=0.0,
        seen=Pose(HERE, IDENTITY),
    )


def plane(*settings: str, airspeed: float = 12.0, alt: float = 0.0, name: str = "px4-plane") -> Airplane:
    handler = Airplane(shipped(name, *settings))
    assert handler.fit({}) is None
    handler.heard(VfrHud(airspeed, alt), 0)
    return handler


def why(handler: Airplane, down_m: float = -60.0, ground_down_m: float | None = 0.0) -> str:
    return handler.unmet(estimate(), Vec3(0.0, 0.0, down_m), ground_down_m) or ""


def test_all_is_well_in_the_air() -> None:
    assert why(plane()) == ""


# Airspeed --------------------------------------------------------------------------------------------


def test_without_an_airspeed_it_is_not_engaged() -> None:
    assert "no airspeed: VFR_HUD tells none" in why(plane(airspeed=0.0))
    handler = plane(airspeed=0.0)
    handler.heard(WindCov(0.5, 0.0, 0.0), 0)
    assert why(handler) == "", "velocity and wind say it"


def test_on_the_ground_it_is_not_engaged() -> None:
    assert why(plane(airspeed=1.5)) == why(plane(airspeed=1.7))
    assert "the airspeed is below 7 m/s, the least 10: take off" in why(plane(airspeed=1.5))
    assert "take off" in why(plane(airspeed=6.9))
    assert "take off" not in why(plane(airspeed=7.1))


def test_near_the_ground_it_is_not_engaged() -> None:
    """PX4's take-off at 0.6 m: it drove on along the ground."""
    handler = plane()
    low = "it is less than 10 m above HOME_POSITION: climb first"
    assert why(handler, ground_down_m=-59.4).startswith(low)
    assert why(handler, ground_down_m=-50.1) == why(handler, ground_down_m=-59.4)
    assert not why(handler, ground_down_m=-49.9).startswith("it is")


def test_a_floor_that_is_set_knows_better_than_home() -> None:
    floored = plane("airplane.floor_down_m=-70")
    assert why(floored).startswith("it is below airplane.floor_down_m = -70: climb first")
    assert not why(plane("airplane.floor_down_m=-50"), ground_down_m=-60.0).startswith("it is")


def test_an_airspeed_that_does_not_fit_velocity_and_wind_is_not_engaged_with() -> None:
    handler = plane(airspeed=18.0)
    handler.heard(Wind(0.0, 1.0, 0.0), 0)  # ahead: 13 m/s through the air
    assert "the airspeed (VFR_HUD) is not that of velocity and wind" in why(handler)


@pytest.mark.parametrize("name", ["px4-plane", "ardupilot-plane"])
@pytest.mark.parametrize(
    "failing",
    [
        lambda airspeed, t_s: 0.0,
        lambda airspeed, t_s: 0.3,
        lambda airspeed, t_s: float("nan"),
        lambda airspeed, t_s: 60.0,
        lambda airspeed, t_s: 0.5 * airspeed,
        lambda airspeed, t_s: 1.6 * airspeed,
        lambda airspeed, t_s: airspeed + (8.0 if int(2.0 * t_s) % 2 else -8.0),
    ],
    ids=["0", "blocked", "nan", "60", "half", "more", "jumps"],
)
@pytest.mark.parametrize("told", [True, False])
def test_an_airspeed_that_fails_in_flight_costs_little(
    failing: Callable[[float, float], float], told: bool, name: str
) -> None:
    """Velocity and wind go on to say how fast it is."""
    flight: Loop

    def sensed(airspeed: float) -> float:
        t_s = flight.rows[-1].t_s if flight.rows else 0.0
        return airspeed if t_s < 15.0 else failing(airspeed, t_s)

    flight = loop(name, sensed=sensed, wind_m_s=3.0, wind_told=told)
    rows = flight.fly(40.0)
    late = [row for row in rows if row.t_s > 15.0]
    assert min(row.airspeed_m_s for row in late) > 10.0
    assert not any(row.around.stall_guard for row in late)
    assert settled(rows, 15.0)[0] < 1.2


def test_what_is_doubted_is_told() -> None:
    flight: Loop
    flight = loop("px4-plane", sensed=lambda airspeed: airspeed if len(flight.rows) < 200 else 0.5)
    rows = flight.fly(6.0)
    assert not any(row.around.airspeed_doubted for row in rows[20:200])
    assert rows[-1].around.airspeed_doubted


@pytest.mark.parametrize("told", [True, False])
def test_without_a_wind_an_airspeed_that_is_not_believed_leaves_it_blind(told: bool) -> None:
    flight: Loop

    def sensed(airspeed: float) -> float:
        return airspeed if len(flight.rows) < 200 else 0.5

    flight = loop("px4-plane", sensed=sensed, wind_told=told)
    rows = flight.fly(6.0)
    assert not any(row.around.blind for row in rows[20:200])
    assert rows[-1].around.blind is not told
    air = next(guard for guard in GUARDS if guard.name == "air")
    look = Guide(flight.config).guards._seen("not looked at", flight.now_ns)
    assert air.exceeded(look) is None
    assert (air.exceeded(look._replace(solution=rows[-1].solution)) is None) is told


# Thin air --------------------------------------------------------------------------------------------


def test_calibrated_airspeeds_are_true_ones_in_thin_air() -> None:
    """ICAO's standard atmosphere: 1.0066 kg/m^3 at 2000 m, 1.225 at sea level."""
    assert thinness(2000.0) == pytest.approx((1.225 / 1.0066) ** 0.5, rel=1e-4)
    assert thinness(0.0) == 1.0
    handler = plane("trajectory.speed_m_s=13", airspeed=12.0, alt=2000.0)
    assert why(handler) == ""
    assert handler._airspeed_m_s == pytest.approx(13.24, abs=0.01)
    assert handler._fitted is not None
    assert handler._fitted.cruise_m_s == pytest.approx(13.2)
    assert handler._fitted.parameters.envelope.airspeed_min_m_s == pytest.approx(11.0)
    # at the sea this can be flown; the same wing is faster up there
    slow = ("trajectory.speed_m_s=10.5", "limits.speed_min_m_s=10")
    assert why(plane(*slow)) == ""
    assert "at least 11 m/s available (the least airspeed)" in why(plane(*slow, alt=2000.0))


def test_air_that_was_heard_of_long_ago_is_not_engaged_with() -> None:
    def why_at(at_s: float) -> str:
        at = estimate()._replace(instant_ns=round(at_s * 1e9))
        return handler.unmet(at, Vec3(0.0, 0.0, -60.0), 0.0) or ""

    handler = plane()
    handler.heard(Wind(0.0, 0.5, 0.0), 0)
    assert why_at(AIRSPEED_S + 0.1) == "", "velocity and wind say it"
    assert "no airspeed" in why_at(WIND_S + 0.1)
    handler.heard(VfrHud(12.0, 0.0), round(WIND_S * 1e9))
    assert why_at(WIND_S + 0.1) == ""


# Wind ------------------------------------------------------------------------------------------------


def test_more_wind_than_is_flown_with_is_refused() -> None:
    """What blows more is taken for less, and the airspeed, which then does not fit, is not believed."""
    handler = plane("airplane.wind_max_m_s=4", airspeed=17.0)
    handler.heard(Wind(0.0, 5.0, 0.0), 0)
    assert why(handler) == "the wind is 5.0 m/s, airplane.wind_max_m_s = 4: no flight"


def test_a_circle_that_the_wind_makes_too_fast_is_refused_with_numbers() -> None:
    handler = plane("airplane.waits=false", airspeed=17.0)
    handler.heard(Wind(0.0, 5.0, 0.0), 0)
    refused = why(handler)
    assert refused.startswith("the trajectory: airspeed")
    assert "m/s available" in refused
    waiting = plane(airspeed=17.0)
    waiting.heard(Wind(0.0, 5.0, 0.0), 0)
    assert why(waiting) == "", "its reference waits upwind"
    handler.heard(Wind(0.0, 0.0, 0.0), 0)
    handler.heard(VfrHud(12.0, 0.0), 0)
    assert why(handler) == ""


def test_a_speed_that_varies_too_much_is_answered_with_the_eight(tmp_path: Path) -> None:
    text = (DEPLOY / "px4-plane.toml").read_text(encoding="utf-8")
    before, _, after = text.partition('name = "circle"')
    keys = 'name = "lemniscate"\nlength_m = 400.0\nwidth_m = 200.0\nspeed_m_s = 13.0\n'
    _, _, after = after.partition("# --- line ---")
    path = tmp_path / "varies.toml"
    path.write_text(before + keys + after, encoding="utf-8")
    with pytest.raises(ConfigError, match=r'at least 10\.5 m/s .+, or "eight", which keeps its speed'):
        load(path)


# The ground ------------------------------------------------------------------------------------------


def test_a_trajectory_below_home_is_refused() -> None:
    """The autopilot's origin is anywhere: what counts is home, or the floor that is configured."""
    assert why(plane(), down_m=-10.0, ground_down_m=0.0) == ""
    refused = why(plane(), down_m=5.0, ground_down_m=0.0)
    assert "height: sinks to the floor (HOME_POSITION; airplane.floor_down_m may say otherwise)" in refused
    assert "start at least 5 m higher" in refused
    assert why(plane(), down_m=5.0, ground_down_m=30.0) == ""
    assert why(plane(), down_m=5.0, ground_down_m=None) == "", "nobody knows where the ground is"
    assert why(plane("airplane.floor_down_m=30"), down_m=5.0) == ""
    refused = why(plane("airplane.floor_down_m=-50"), down_m=-40.0)
    assert "sinks to the floor (airplane.floor_down_m)" in refused
    assert "start at least 10 m higher" in refused


def test_in_flight_the_ground_is_the_floor_and_a_restart_keeps_it() -> None:
    handler = plane()
    assert why(handler, ground_down_m=2.0) == ""
    handler.configure(handler._config, HERE, "pitch-yaw")
    handler.start()
    assert handler._fitted is not None
    assert handler._fitted.parameters.envelope.floor_down_m == 2.0


# Settings --------------------------------------------------------------------------------------------


def test_settings_that_cannot_be_flown_change_nothing() -> None:
    handler = plane()
    before = handler._fitted
    config = with_setting(shipped("px4-plane"), "limits.speed_max_m_s", 14.0)
    assert handler.configure(config, ZERO, "pitch-yaw") is None
    tight = with_trajectory(config, {"name": "circle", "radius_m": 15.0, "speed_m_s": 12.0})
    refused = handler.configure(tight, ZERO, "pitch-yaw")
    assert refused is not None
    assert "bank: 44.4 deg needed" in refused
    assert handler._fitted == before
    assert handler._config == config


def test_orders_that_cannot_be_flown_are_refused_with_the_reason() -> None:
    guide = Guide(shipped("px4-plane", "log.enabled=false"))
    before = guide.orders.config
    event, answer = guide.orders.carry_out(
        LoadTrajectory(trajectory={"name": "circle", "radius_m": 15.0, "speed_m_s": 12.0}), 0
    )
    assert event is not None
    assert not answer.accepted
    assert "bank: 44.4 deg needed" in answer.reason
    assert guide.orders.config is before
    # the autopilot allows less than the file: nobody flies below its cruise
    assert guide.tracker.fit({"FW_AIRSPD_TRIM": 12.0, "FW_AIRSPD_MIN": 10.0}) is None
    _, answer = guide.orders.carry_out(Set(key="limits.speed_max_m_s", value=11.9), 0)
    assert not answer.accepted
    assert guide.orders.config is before


def test_all_that_is_taken_of_the_autopilot_is_asked_for() -> None:
    """What PX4 has a name for (`airplane_fit._NAMES`) is of use only if its profile has a row for it."""
    rows = {name for row in PROFILES["px4-plane"].requirements for name in row.names}
    assert {name for name in ASKED_FOR if name.startswith("FW_")} <= rows


def test_over_the_link_it_waits_for_an_airspeed() -> None:
    flight = make_flight(
        config=shipped("px4-plane", "log.enabled=false"),
        model="airplane_12",
        initial_position_ned_m=(0.0, 0.0, -200.0),
        initially_armed=True,
        initial_mode="AUTO.LOITER",
    )
    flight.vehicle.withhold("VFR_HUD")
    flight.run(6.0)
    assert flight.guide.engagement.state is State.CONNECTED
    assert "no VFR_HUD: an airplane is not flown without its airspeed" in flight.guide.engagement.reason
    flight.vehicle.withhold()
    fly_until(flight, State.READY, 6.0)
