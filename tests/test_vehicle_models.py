"""The built-in vehicle around its models: the estimator's noise, what telemetry says of them, lockstep."""

from __future__ import annotations

import json
import math
import statistics
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import pytest

from sitl.plant import Triple, euler_from_attitude
from sitl.truth import truth_line
from sitl.vehicle import USUAL, Firmware, Noise, Origin, VehicleOptions, fitting
from sitl.vehicle.body import BodyState
from sitl.vehicle.controls import Attitude, Control, Drive, Effect, Velocity
from sitl.vehicle.estimator import PERIOD_NS, Astray, Estimator
from sitl.vehicle.projection import equirectangular
from sitl.vehicle.sample import Sample
from sitl.vehicle.telemetry import wind
from tests.helpers import ROVER, fly_until_tracking, make_flight
from tests.vehicle_peer import Peer, px4_in_offboard, rover_in_guided

BODY: Final = BodyState(
    (1.0, 2.0, 3.0), (1.0, 0.0, 0.0, 0.0), (0.1, 0.2, 0.3), (4.0, 5.0, 6.0), 7.0, 12.0, (3.0, -4.0, 0.0), 0.5
)


# --- the estimator -------------------------------------------------------------------------------------


def estimated(noise: Noise, seed: int, seconds: float) -> list[BodyState]:
    estimator = Estimator(noise, seed, 5)
    return [estimator.estimate(BODY, 5 + tick * PERIOD_NS) for tick in range(round(seconds * 50.0))]


def yaw_of(state: BodyState) -> float:
    return euler_from_attitude(state.attitude_wxyz)[2]


@pytest.mark.parametrize("axis", range(3))
def test_what_is_new_in_every_estimate_has_its_sigma(axis: int) -> None:
    white = Noise(position_m=0.05, attitude_rad=0.005, velocity_m_s=0.07, airspeed_m_s=0.3)
    seen = estimated(white, 4, 60.0)
    of = {
        0.05: [s.position_ned_m[axis] for s in seen],
        0.005: [euler_from_attitude(s.attitude_wxyz)[axis] for s in seen],
        0.07: [s.velocity_ned_m_s[axis] for s in seen],
        0.3: [s.airspeed_m_s for s in seen],
    }
    truth = (BODY.position_ned_m[axis], 0.0, BODY.velocity_ned_m_s[axis], 12.0)
    for (sigma, values), true in zip(of.items(), truth, strict=True):
        assert statistics.fmean(values) == pytest.approx(true, abs=sigma / 10.0)
        assert statistics.stdev(values) == pytest.approx(sigma, rel=0.06)
    assert {s.body_rates_frd_rad_s for s in seen} == {BODY.body_rates_frd_rad_s}


def test_the_bias_wanders_within_its_bound_and_with_its_correlation_time() -> None:
    north = [s.position_ned_m[0] - 1.0 for s in estimated(Noise(position_bias_m=0.1), 1, 9000.0)]
    assert max(map(abs, north)) == pytest.approx(0.1)
    assert statistics.fmean(north) == pytest.approx(0.0, abs=0.01)
    assert statistics.pstdev(north) == pytest.approx(0.048, rel=0.15)
    later = 30 * 50
    product = statistics.fmean(a * b for a, b in zip(north, north[later:], strict=False))
    assert product / statistics.pvariance(north) == pytest.approx(math.exp(-1.0), abs=0.1)


def test_the_heading_is_off_all_the_time_to_the_side_of_the_seed() -> None:
    sides = {yaw_of(s) for seed in range(8) for s in estimated(Noise(heading_bias_rad=0.03), seed, 1.0)}
    assert sorted(sides) == pytest.approx([-0.03, 0.03])
    assert {s.velocity_ned_m_s for s in estimated(Noise(heading_bias_rad=0.03), 0, 1.0)} == {(4.0, 5.0, 6.0)}


def test_an_estimate_is_of_50_hz_however_often_it_is_asked_for() -> None:
    def at(instants_ns: list[int]) -> list[BodyState]:
        estimator = Estimator(USUAL, 9, 0)
        return [estimator.estimate(BODY, at_ns) for at_ns in instants_ns]

    seldom = at([k * PERIOD_NS for k in range(0, 100, 10)])
    often = at([k * PERIOD_NS // 10 for k in range(1000)])
    noise = [s._replace(wind_ned_m_s=(0.0, 0.0, 0.0)) for s in often]
    assert noise[::100] == [s._replace(wind_ned_m_s=(0.0, 0.0, 0.0)) for s in seldom]
    assert len(set(noise)) == 100


def test_the_wind_that_is_said_follows_the_wind_that_blows_and_knows_no_gust() -> None:
    estimator = Estimator(Noise(), 0, 0)
    assert estimator.estimate(BODY, 0).wind_ned_m_s == BODY.wind_ned_m_s
    turned = BODY._replace(wind_ned_m_s=(-3.0, -4.0, 1.0))
    said = [estimator.estimate(turned, tick * PERIOD_NS).wind_ned_m_s for tick in range(1, 501)]
    assert said[0][0] == pytest.approx(3.0, abs=0.05)
    assert said[249][0] == pytest.approx(-3.0 + 6.0 * math.exp(-1.0), abs=0.01)
    assert said[-1][2] == pytest.approx(1.0 - math.exp(-2.0), abs=0.01)


def test_an_estimator_that_lost_its_heading_turns_the_velocity_with_it() -> None:
    estimator = Estimator(Noise(), 0, 0)
    estimator.astray = Astray(turned_rad=math.pi / 2.0)
    assert estimator.estimate(BODY, 0).velocity_ned_m_s == pytest.approx((-5.0, 4.0, 6.0))


def test_no_airspeed_sensor_has_no_noise() -> None:
    silent = Estimator(USUAL, 0, 0).estimate(BODY._replace(airspeed_m_s=0.0), 0)
    assert silent.airspeed_m_s == 0.0


@pytest.mark.parametrize("name", [name for name in Noise._fields if name != "position_bias_s"])
def test_a_noise_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"noise.{name} must be finite and not negative"):
        VehicleOptions(noise=Noise()._replace(**{name: -0.1}))
    with pytest.raises(ValueError, match=r"noise.position_bias_s must be finite and positive"):
        VehicleOptions(noise=Noise(position_bias_s=0.0))


# --- telemetry -----------------------------------------------------------------------------------------


def test_a_rover_whose_course_is_not_its_heading_says_so() -> None:
    peer = rover_in_guided(model="rover")
    peer.command(511, 32, 100_000)
    peer.stream(6.0, 0x83, thrust=0.4)
    local = peer.last("LOCAL_POSITION_NED")
    heading = euler_from_attitude(peer.vehicle.truth().attitude_wxyz)[2]
    assert math.atan2(local.vy, local.vx) - heading == pytest.approx(0.02, abs=1e-3)


def test_a_px4_airplane_tells_its_airspeed_throttle_and_wind() -> None:
    peer = Peer(Firmware.PX4_PLANE, airborne=True, wind_ned_m_s=(3.0, -4.0, 0.0))
    peer.command(176, 1, 3)  # straight on
    peer.run(10.0)
    hud, said = peer.last("VFR_HUD"), peer.last("WIND_COV")
    truth = peer.vehicle.truth()
    # calibrated: by the root of the standard atmosphere's density at this height
    thinner = (1.0 - 2.25577e-5 * (489.0 - truth.position_ned_m[2])) ** (0.5 * 4.25588)
    assert hud.airspeed == pytest.approx(thinner * truth.airspeed_m_s, abs=0.05)
    assert hud.groundspeed == pytest.approx(math.hypot(*truth.velocity_ned_m_s[:2]), abs=0.05)
    assert hud.groundspeed > hud.airspeed + 1.0
    assert hud.throttle == 100, "less than FW_AIRSPD_TRIM is all that it reaches"
    assert hud.climb == pytest.approx(-truth.velocity_ned_m_s[2], abs=0.05)
    assert (said.wind_x, said.wind_y, said.wind_z) == pytest.approx((3.0, -4.0, 0.0))
    assert len([m for m in peer.heard if m.get_type() == "WIND_COV"]) == pytest.approx(10, abs=1)


def test_an_ardupilot_airplane_tells_where_the_wind_comes_from() -> None:
    peer = Peer(Firmware.ARDUPILOT_PLANE, airborne=True, wind_ned_m_s=(3.0, -4.0, 0.0))
    peer.run(5.0)
    said = peer.last("WIND")
    assert said.speed == pytest.approx(5.0)
    assert said.direction == pytest.approx(math.degrees(math.atan2(4.0, -3.0)))
    assert peer.vehicle.truth().airspeed_m_s == pytest.approx(22.0, abs=2.5), "the larger airplane"
    assert {m.get_type() for m in peer.heard} & {"WIND_COV"} == set()


def test_only_what_flies_tells_of_the_wind() -> None:
    assert not {m.get_type() for m in Peer().run(5.0)} & {"WIND", "WIND_COV"}
    rover = Peer(Firmware.ARDUPILOT_ROVER, model="rover", wind_ned_m_s=(5.0, 0.0, 0.0))
    assert not {m.get_type() for m in rover.run(5.0)} & {"WIND", "WIND_COV"}


def test_a_north_wind_comes_from_0_degrees() -> None:
    body = BODY._replace(wind_ned_m_s=(-2.0, 0.0, 0.0))
    said = wind(Sample(0, body, Origin(), equirectangular))
    assert (abs(said.direction), said.speed) == (0.0, 2.0)


# --- models behind firmware ----------------------------------------------------------------------------


def test_which_firmware_drives_which_model() -> None:
    assert set(fitting("ideal")) == {Firmware.PX4_UUV, Firmware.PX4_ROVER, Firmware.ARDUPILOT_ROVER}
    assert fitting("uuv") == [Firmware.PX4_UUV]
    assert fitting("rover") == fitting("boat") == [Firmware.ARDUPILOT_ROVER, Firmware.PX4_ROVER]
    assert fitting("rover_px4")[0] == Firmware.PX4_ROVER
    assert fitting("copter_ardupilot") == [Firmware.ARDUPILOT_COPTER, Firmware.PX4_COPTER]
    assert fitting("copter")[0] == Firmware.PX4_COPTER


def test_an_airplane_has_the_firmware_that_it_was_recorded_with() -> None:
    assert [fitting(name)[0] for name in ("airplane", "airplane_12", "airplane_20")] == [
        Firmware.PX4_PLANE,
        Firmware.PX4_PLANE,
        Firmware.ARDUPILOT_PLANE,
    ]


def test_the_underwater_vehicle_lags_behind_the_ideal_one() -> None:
    def answer(model: str) -> list[Any]:
        peer = px4_in_offboard(model=model)
        truths = []
        for _ in range(500):
            peer.stream(0.02, rates=(0.0, 0.1, 0.5), thrust=0.4)
            truths.append(peer.vehicle.truth())
        return truths

    ideal, real = answer("ideal"), answer("uuv")
    assert (ideal[0].speed_m_s, real[0].speed_m_s) == (pytest.approx(2.0), 0.0)
    assert real[0].body_rates_frd_rad_s == (0.0, 0.0, 0.0), "still under way"
    assert real[-1].body_rates_frd_rad_s == pytest.approx((0.0, 0.095, 0.475), rel=1e-6)
    # about one axis, later by the delay and the lag
    half = 0.5 * math.hypot(0.095, 0.475) * (10.0 - 0.04 - 0.15)
    part = math.sin(half) / math.hypot(0.095, 0.475)
    wanted = (math.cos(half), 0.0, 0.095 * part, 0.475 * part)
    assert abs(sum(a * b for a, b in zip(wanted, real[-1].attitude_wxyz, strict=True))) == pytest.approx(
        1.0, abs=1e-4
    )
    assert 2.0 < real[-1].speed_m_s < 2.4, "drag grows with the square of speed"
    times = [n * 0.02 for n, truth in enumerate(real) if truth.body_rates_frd_rad_s[2] > 0.3]
    assert times[0] == pytest.approx(0.04 + 0.15, abs=0.04)


def test_full_thrust_holds_the_full_speed_and_no_more() -> None:
    for thrust in (1.0, 7.0):
        peer = px4_in_offboard(model="uuv")
        peer.stream(15.0, thrust=thrust)
        assert peer.vehicle.truth().speed_m_s == pytest.approx(5.0, rel=1e-3)


@pytest.mark.parametrize(
    ("model", "start", "current"),
    # what flows along a boat's heading, its autopilot's loop on ground speed holds
    [("uuv", px4_in_offboard, (0.5, -0.25, 0.1)), ("boat", rover_in_guided, (0.0, -0.25, 0.0))],
)
def test_a_current_carries_a_model_along(model: str, start: Any, current: Triple) -> None:
    still, carried = start(model=model), start(model=model)
    carried.vehicle.current(carried.now_ns, current)
    still.run(4.0)
    carried.run(4.0)
    a, b = still.vehicle.truth(still.now_ns), carried.vehicle.truth(carried.now_ns)
    moved = [y - x for x, y in zip(a.position_ned_m, b.position_ned_m, strict=True)]
    assert moved == pytest.approx([4.0 * part for part in current], abs=0.01)
    faster = [y - x for x, y in zip(a.velocity_ned_m_s, b.velocity_ned_m_s, strict=True)]
    assert faster == pytest.approx(current)


def test_the_wind_turns_for_an_airplane() -> None:
    peer = Peer(Firmware.PX4_PLANE, airborne=True)
    peer.vehicle.current(peer.now_ns, (0.0, 6.0, 0.0))
    peer.run(3.0)
    assert peer.vehicle.truth().wind_ned_m_s == (0.0, 6.0, 0.0)
    assert peer.vehicle.truth().velocity_ned_m_s[1] > 0.5


@pytest.mark.parametrize(
    ("control", "left"),
    [
        (Drive(2.0, 4.0), Drive(-1.0, 1.0)),
        (Attitude(1.0, 2.0, 0.8), Attitude(0.0, 2.0, 0.2)),
        (Velocity((4.0, 8.0, -4.0), 1.0), Velocity((1.0, 2.0, -1.0), -0.5)),
    ],
)
def test_what_is_left_of_an_actuator_holds_for_every_kind_of_control(control: Control, left: Control) -> None:
    assert Effect(roll=0.0, yaw=-0.5, speed=0.25).of(control) == left


def test_an_actuator_that_fails_fails_at_once_not_with_the_next_setpoint() -> None:
    peer = px4_in_offboard()
    peer.setpoint(rates=(0.0, 0.0, 0.3), thrust=0.4)
    peer.run(0.01)
    peer.vehicle.refit(peer.now_ns, effect=Effect(yaw=0.0))
    assert peer.vehicle.truth(peer.now_ns).body_rates_frd_rad_s == (0.0, 0.0, 0.0)


def test_a_model_is_refitted_by_its_file_only() -> None:
    peer = rover_in_guided(model="rover")
    peer.vehicle.refit(peer.now_ns, effect=Effect(yaw=0.0))
    peer.stream(3.0, 0x83, rates=(0.0, 0.0, 1.0), thrust=0.4)
    assert peer.vehicle.truth().body_rates_frd_rad_s[2] == 0.0
    with pytest.raises(ValueError, match="rover has the bounds and lags of its file"):
        peer.vehicle.refit(peer.now_ns, plant=VehicleOptions().plant)


@pytest.mark.parametrize(
    ("overrides", "model"), [((), "uuv"), (ROVER, "rover"), (ROVER, "boat")], ids=["uuv", "rover", "boat"]
)
def test_the_service_flies_a_model_in_lockstep_the_same_every_time(
    overrides: tuple[str, ...], model: str
) -> None:
    def fly() -> bytes:
        flight = make_flight(*overrides, model=model, noise=USUAL, seed=3)
        fly_until_tracking(flight, 10.0)
        flight.run(5.0)
        return truth_line(flight.truth())

    line = fly()
    truth = json.loads(line)
    assert truth["armed"]
    assert math.hypot(*truth["velocity_ned_m_s"]) > 0.01
    assert line == fly()


def test_a_parameter_file_is_a_model(tmp_path: Path) -> None:
    path = tmp_path / "slow.toml"
    shipped = (files("sitl.models") / "rover.toml").read_text()
    path.write_text(shipped.replace("speed_max_m_s = 20.0", "speed_max_m_s = 0.5"))
    assert Firmware.ARDUPILOT_ROVER in fitting(str(path))
    peer = rover_in_guided(model=str(path))
    peer.stream(8.0, 0x83, thrust=1.0)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(0.5, rel=0.05)
    path.write_text("nothing = 1\n")
    with pytest.raises(ValueError, match="no parameter of a model is in it"):
        fitting(str(path))
