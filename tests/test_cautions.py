"""What forbids no flight and must be known before it: what flies says it, and the service tells it once."""

from __future__ import annotations

import random

import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.cautions import AGAIN_NS, LOOK_NS, Cautions, Jitter, about_sticks
from guidance.config import load, profile_of
from guidance.estimate import PositionSample
from guidance.fleet import Contact, Seen
from guidance.flying import Caution, Handler
from guidance.flying.airplane import Airplane
from guidance.flying.choice import handler_of
from guidance.mavlink.air import VfrHud, Wind
from guidance.mavlink.messages import SysStatus
from guidance.mavlink.profiles import PROFILES
from guidance.records import Status
from guidance.se3 import Vec3
from guidance.supervisor import State
from guidance.watch_view import explanation, line
from sitl.scenarios.rover import ON_A_ZIGZAG
from tests.ground_station import GroundStation, texts_of
from tests.helpers import events_of, fly_until, fly_until_tracking, make_flight, records_of
from tests.test_airplane_refusals import estimate, plane
from tests.test_fitting import SLOW
from tests.test_flying_velocity import ARDUPILOT, PX4
from tests.test_rover_px4 import VALUES
from tests.test_unflyable_loads import DEPLOY, shipped

HOME = 0.0
RECEIVER = dialect.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
FULL_PX4 = PX4 | {
    "MPC_ACC_UP_MAX": 4.0,
    "MPC_ACC_DOWN_MAX": 3.0,
    "MPC_YAWRAUTO_MAX": 60.0,
    "MPC_TILTMAX_AIR": 45.0,
    **{f"MPC_{axis}_VEL_{gain}_ACC": 1.0 for axis in ("XY", "Z") for gain in "PID"},
}


def said(handler: Handler, down_m: float = -60.0, ground_down_m: float | None = HOME) -> dict[str, str]:
    found = handler.cautions(estimate(), Vec3(0.0, 0.0, down_m), ground_down_m)
    assert len({caution.about for caution in found}) == len(found), "one about each thing"
    return {caution.about: caution.text for caution in found}


def known(profile: str, values: dict[str, float], speed_m_s: float, *settings: str) -> Handler:
    config = shipped(profile, speed_m_s, *settings)
    handler = handler_of(config, profile_of(config))
    assert handler.fit(values) is None
    return handler


# Copters ---------------------------------------------------------------------------------------------


def test_all_that_is_known_and_leaves_room_is_worth_no_word() -> None:
    assert said(known("px4-copter", FULL_PX4, 2.0)) == {}


def test_parameters_that_were_not_told_are_named_with_what_is_taken_for_them() -> None:
    values = {
        name: value for name, value in FULL_PX4.items() if name not in ("MPC_ACC_HOR", "MPC_TILTMAX_AIR")
    }
    assert said(known("px4-copter", values, 2.0)) == {
        "parameters": "not told by the autopilot, and taken to be: MPC_ACC_HOR 3, MPC_TILTMAX_AIR 45"
    }
    ardupilot = said(known("ardupilot-copter", ARDUPILOT, 2.0))["parameters"]
    assert ardupilot.endswith("PSC_NE_JERK 5, PSC_D_JERK 5, ATC_ANGLE_MAX 30")


def test_a_speed_that_is_all_of_the_autopilots_leaves_no_room() -> None:
    tight = said(known("px4-copter", FULL_PX4 | {"MPC_XY_VEL_MAX": 2.0}, 2.0))
    assert tight["room"].startswith("little room to catch up: horizontal speed: 2 m/s needed at t = 0 s")
    assert "1.9 m/s available (MPC_XY_VEL_MAX 2 less 5 %): fly at most 1.9 m/s there" in tight["room"]
    assert said(known("px4-copter", FULL_PX4 | {"MPC_XY_VEL_MAX": 2.2}, 2.0)) == {}


def test_a_copter_above_no_floor_is_told_where_the_ground_is_not_known_or_above_the_way() -> None:
    handler = known("px4-copter", FULL_PX4, 2.0)
    assert "HOME_POSITION" in said(handler, ground_down_m=None)["ground"]
    assert said(handler, down_m=20.0)["ground"] == "the trajectory is 20 m below home at t = 0 s"
    fenced = known("px4-copter", FULL_PX4, 2.0, "guards.fence_down_max_m=1")
    assert said(fenced, ground_down_m=None) == {}


# Rovers ----------------------------------------------------------------------------------------------


def test_a_rovers_whole_wp_speed_leaves_no_room() -> None:
    values = {"WP_SPEED": 2.0, "ATC_ACCEL_MAX": 1.0, "ATC_STR_ACC_MAX": 120.0, "ATC_TURN_MAX_G": 0.6}
    assert "(WP_SPEED 2 less 5 %)" in said(known("ardupilot-rover", values, 2.0))["room"]
    assert said(known("ardupilot-rover", values | {"WP_SPEED": 5.0}, 2.0)) == {}
    assert "(WP_SPEED 2 less 5 %)" in said(known("boat", values, 2.0))["room"]
    assert (
        "(RO_SPEED_LIM 1.5 less 5 %)" in said(known("px4-rover", VALUES | {"RO_SPEED_LIM": 1.5}, 1.5))["room"]
    )


def test_a_limit_that_nobody_sets_is_named() -> None:
    text = said(known("ardupilot-rover", {"WP_SPEED": 5.0}, 2.0))["parameters"]
    assert text.endswith("none is kept: ground.lateral_acceleration_max_m_s2")


def test_a_corner_is_told_with_how_far_the_reference_runs_away() -> None:
    config = load(DEPLOY / "ardupilot-rover.toml", ON_A_ZIGZAG)
    text = said(handler_of(config, profile_of(config)))["corner"]
    assert text.startswith("corner: 90 deg at once at t = ")
    assert "the reference runs away by" in text


# Airplanes -------------------------------------------------------------------------------------------


def test_a_wind_that_makes_the_reference_wait_is_told_with_where_and_how_long() -> None:
    handler: Airplane = plane("airplane.waits=true", airspeed=17.0)
    handler.heard(Wind(0.0, 5.0, 0.0), 0)
    assert handler.unmet(estimate(), Vec3(0.0, 0.0, -60.0), HOME) is None
    text = " ".join(said(handler).values())
    assert "the reference runs at 0." in text
    assert "s of each round" in text
    assert "wind" not in said(handler)


def test_an_airplane_is_told_of_a_wind_and_a_ground_that_nobody_tells() -> None:
    handler = plane(airspeed=12.0)
    handler.heard(VfrHud(12.0, 0.0), 0)
    assert "no wind is told" in said(handler)["wind"]
    assert "no floor" in said(handler, ground_down_m=None)["ground"]
    floored = plane("airplane.floor_down_m=-20")
    assert "ground" not in said(floored, ground_down_m=None)
    assert "FW_THR_MAX 1" in said(handler)["parameters"]


# The service -----------------------------------------------------------------------------------------


def test_each_is_told_once_stands_in_the_status_and_nothing_is_told_in_flight() -> None:
    flight = make_flight(*SLOW, parameters={"WP_SPEED": 1.02})
    fly_until_tracking(flight)
    flight.run(5.0)
    (event,) = [text for text in events_of(flight, "caution") if "little room" in text]
    assert event.startswith("before you fly: little room to catch up: speed: 1 m/s needed")
    status = records_of(flight, Status)[-1]
    assert status.state == State.TRACKING
    assert any("little room" in text for text in status.cautions)


def test_a_ground_station_hears_it() -> None:
    flight = make_flight(*SLOW, "supervisor.engage=pilot", parameters={"WP_SPEED": 1.02})
    ground = GroundStation(flight)
    flight.run(6.0)
    heard = [text for text in texts_of(ground.hear()) if text.startswith("before you fly: little room")]
    assert len(heard) == 1


def test_what_was_away_for_long_is_told_again(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = make_flight("supervisor.engage=pilot")
    flight.run(3.0)
    guide = flight.guide
    stands = {0: "ab", 20: "", 50: "a", 60: "", 130: "a"}
    standing: list[Caution] = []
    monkeypatch.setattr(guide.tracker.handler, "cautions", lambda *_: tuple(standing))
    cautions, told = Cautions(), []
    for second in range(200):
        standing[:] = [Caution(c, c) for c in stands[second]] if second in stands else standing
        state = guide.steering.basis(flight.now_ns)
        told += [
            (second, new.text) for new in cautions.look(guide.tracker, guide.link, state, second * LOOK_NS)
        ]
    assert told == [(0, "a"), (0, "b"), (130, "a")]
    assert AGAIN_NS == 60 * LOOK_NS


@pytest.mark.parametrize(("sigma_m", "worth"), [(0.05, False), (0.3, True)])
@pytest.mark.parametrize("speed_m_s", [0.0, 20.0])
def test_noise_beyond_what_is_smoothed_is_found_whatever_the_speed(
    sigma_m: float, worth: bool, speed_m_s: float
) -> None:
    dice, jitter = random.Random(1), Jitter()
    now_ns = 0
    for n in range(200):
        now_ns += 40_000_000 + 20_000_000 * (n % 2)
        north = speed_m_s * now_ns * 1e-9 + (7.0 if n > 170 else 0.0)
        at = Vec3(north + dice.gauss(0.0, sigma_m), dice.gauss(0.0, sigma_m), 0.0)
        velocity = Vec3(speed_m_s + dice.gauss(0.0, 0.05), 0.0, 0.0)
        for _ in range(2):
            jitter.take(PositionSample(now_ns, 0, at, velocity, "LOCAL_POSITION_NED"))
    assert jitter.sigma_m == pytest.approx(sigma_m, rel=0.25)
    assert (jitter.sigma_m > 0.15) is worth


def test_watch_shows_them() -> None:
    seen = Seen(vehicle="a", contact=Contact.LIVE, state="ready", reason="go", cautions=("mind the gap",))
    assert "caution: mind the gap" in explanation(seen)
    assert "caution: mind the gap" in line(seen)


# Sticks ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["px4-copter", "px4-plane"])
@pytest.mark.parametrize(
    ("action", "mode", "present", "says"),
    [
        (
            0,
            3,
            0,
            "no sticks are heard (SYS_STATUS has no receiver present), and COM_OBL_RC_ACT = 0, position",
        ),
        (0, 4, RECEIVER, "no sticks are heard (COM_RC_IN_MODE = 4)"),
        (2, 4, None, "COM_OBL_RC_ACT = 2, stabilized, needs them"),
        (0, 3, RECEIVER, None),
        (0, 3, None, None),
        (5, 4, 0, None),
        (3, 3, 0, None),
    ],
)
def test_a_mode_by_hand_without_hands(
    profile: str, action: int, mode: int, present: int | None, says: str | None
) -> None:
    health = None if present is None else SysStatus(present, RECEIVER, 0, -1)
    answers = {"COM_OBL_RC_ACT": float(action), "COM_RC_IN_MODE": float(mode)}
    found = [one.text for one in about_sticks(PROFILES[profile], answers, health)]
    assert bool(found) == (says is not None)
    assert says is None or says in found[0]
    assert says is None or found[0].endswith("set COM_OBL_RC_ACT to 5 (hold)")
    assert not about_sticks(PROFILES["px4-rover"], answers, health)


def test_missing_sticks_are_told_before_a_flight() -> None:
    """The built-in copter has neither sticks nor a receiver, as recorded."""
    flight = make_flight(config=load(DEPLOY / "px4-copter.toml", ('flight.origin="engage"',)), airborne=True)
    fly_until(flight, State.READY, 12.0)
    flight.run(2.0)
    assert sum("no sticks are heard" in text for text in events_of(flight, "caution")) == 1
    assert "sticks" in {caution.about for caution in flight.guide.cautions.standing}
