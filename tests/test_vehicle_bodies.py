"""The bodies behind the built-in vehicle: what they do when told, and that looking changes nothing."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import pytest

from sitl.plant import PlantCommand, PlantParameters, euler_from_attitude, rotation
from sitl.vehicle import Firmware, VehicleOptions
from sitl.vehicle.bodies.making import body_of
from sitl.vehicle.body import Body, BodyState
from sitl.vehicle.controls import Attitude, Control, Drive, RatesThrottle
from tests.vehicle_peer import SECOND, Peer, rover_in_guided

MS: Final = 1_000_000
#: What holds either airplane level at the speed of its name.
CRUISE: Final = {"airplane_12": Attitude(0.0, 0.0, 0.8), "airplane_20": Attitude(0.0, 0.0, 0.36)}
AIRPLANES: Final = pytest.mark.parametrize("name", CRUISE)


def made(model: str, **options: object) -> Body:
    if model.startswith("airplane"):
        options = {"initial_position_ned_m": (0.0, 0.0, -100.0), **options}
    return body_of(VehicleOptions(model=model, **options), planar=False, start_ns=0)  # type: ignore[arg-type]


def flown(body: Body, control: Control, seconds: float, from_ns: int = 0) -> BodyState:
    body.tell(control, from_ns)
    return body.advance(from_ns + round(seconds * SECOND))


TOLD: Final[dict[str, Callable[[int], Control]]] = {
    "ideal": lambda n: PlantCommand((0.1, 0.0, 0.05 * n), 2.0),
    "uuv": lambda n: PlantCommand((0.1, 0.2, 0.05 * n), 2.0),
    "rover": lambda n: Drive(0.05 * n, 2.0),
    "boat": lambda n: Drive(0.05 * n, 2.0),
    "airplane_12": lambda n: Attitude(0.03 * n, 0.05, 0.7),
    "airplane_20": lambda n: RatesThrottle((0.1 - 0.01 * n, 0.0, 0.0), 0.4),
}


def weather(model: str) -> dict[str, object]:
    wind: dict[str, object] = {} if model in ("ideal", "uuv") else {"wind_ned_m_s": (2.0, 1.0, 0.0)}
    return wind | ({"gusts_m_s": 0.8} if model.startswith("airplane") else {})


@pytest.mark.parametrize("model", TOLD)
def test_how_often_a_body_is_looked_at_changes_nothing(model: str) -> None:
    def fly(look_ns: int) -> BodyState:
        body = made(model, **weather(model))
        for n in range(20):
            at_ns = n * 47_123_457
            body.tell(TOLD[model](n), at_ns)
            for moment in range(at_ns, at_ns + 47_123_457, look_ns):
                body.ahead(moment + 30 * MS)
                if model != "ideal":  # whose steps are exact, but each with its own rounding
                    body.advance(moment)
        return body.advance(SECOND)

    assert fly(3_000_001) == fly(SECOND)


@pytest.mark.parametrize("model", TOLD)
def test_looking_ahead_is_what_comes(model: str) -> None:
    body = made(model, **weather(model))
    body.tell(TOLD[model](3), 1_234_567)
    seen = body.ahead(777_777_777)
    lived = body.advance(777_777_777)
    assert seen == lived


def test_the_rover_has_the_delay_the_slew_and_the_gain_of_its_file() -> None:
    body = made("rover")
    flown(body, Drive(0.0, 2.0), 10.0)
    body.tell(Drive(1.0, 2.0), 10 * SECOND)
    rates = [body.advance(10 * SECOND + n * MS).body_rates_frd_rad_s[2] for n in range(1000)]
    assert rates[67] == 0.0
    assert rates[90] > 0.0
    assert rates[-1] == pytest.approx(0.927, abs=1e-3)
    assert max(b - a for a, b in zip(rates[70:300:10], rates[80:310:10], strict=True)) <= 1.95 * 0.0121


@pytest.mark.parametrize("model", ["uuv", "rover", "boat", "airplane_20"])
@pytest.mark.parametrize("late_ns", [0, 10, 1_500_000, 3_999_990])
def test_a_delay_runs_from_the_instant_of_the_command(model: str, late_ns: int) -> None:
    """It acts from the first grid point that is a delay later, to the nanosecond; the model's clock stays."""
    delay_ns = {"uuv": 40, "rover": 68, "boat": 100, "airplane_20": 86}[model] * MS
    body, untold = made(model), made(model)
    body.tell(Attitude(0.3, 0.1, 0.7) if model == "airplane_20" else TOLD[model](10), 400 * MS + late_ns)
    acts_ns = 400 * MS + -(-(late_ns + delay_ns) // (4 * MS)) * 4 * MS
    assert body.advance(acts_ns) == untold.advance(acts_ns)
    assert body.advance(acts_ns + MS) != untold.advance(acts_ns + MS)


def test_the_wind_pushes_a_boat_by_the_part_of_its_file() -> None:
    still, pushed = made("boat"), made("boat", wind_ned_m_s=(0.0, 5.0, 0.0))
    drift = pushed.advance(10 * SECOND).position_ned_m[1] - still.advance(10 * SECOND).position_ned_m[1]
    assert drift == pytest.approx(0.03 * 5.0 * 10.0)


def test_gusts_change_at_50_hz_and_are_the_same_for_one_seed() -> None:
    def winds(seed: int) -> list[float]:
        body = made("airplane_12", gusts_m_s=1.0, seed=seed)
        return [body.advance(n * 4 * MS).wind_ned_m_s[0] for n in range(1, 101)]

    assert len(set(winds(1))) == 20
    assert winds(1) == winds(1) != winds(2)


def test_the_same_words_again_do_not_push_the_older_out() -> None:
    """A model remembers 32 commands; a firmware repeats itself every few milliseconds."""
    body = made("boat")
    body.tell(Drive(0.0, 2.0), 0)
    for n in range(100):
        body.tell(Drive(0.0, 2.0), n * MS)
    assert body.advance(99 * MS).speed_m_s == 0.0
    assert body.advance(400 * MS).speed_m_s > 0.0


def test_the_rover_stands_while_disarmed_and_turns_only_when_it_drives() -> None:
    peer = rover_in_guided(model="rover")
    peer.stream(3.0, 0x83, rates=(0.0, 0.0, 1.0), thrust=0.0)
    assert peer.vehicle.truth().attitude_wxyz == (1.0, 0.0, 0.0, 0.0)
    peer.stream(3.0, 0x83, rates=(0.0, 0.0, 0.3), thrust=0.4)
    assert euler_from_attitude(peer.vehicle.truth().attitude_wxyz)[2] > 0.3
    peer.command(400, 0)
    peer.run(6.0)
    assert peer.vehicle.truth().speed_m_s == pytest.approx(0.0, abs=0.05)


@AIRPLANES
def test_an_airplane_flies_level_and_turns_by_banking(name: str) -> None:
    speed = float(name.removeprefix("airplane_"))
    body = made(name, initial_speed_m_s=speed)
    trimmed = body.ahead(0)
    assert trimmed.airspeed_m_s == speed
    cruise = CRUISE[name]
    level = flown(body, cruise._replace(pitch_rad=euler_from_attitude(trimmed.attitude_wxyz)[1]), 5.0)
    assert level.airspeed_m_s == pytest.approx(speed, rel=0.1)
    body.tell(cruise._replace(roll_rad=0.5), 5 * SECOND)
    seen = [body.advance(8 * SECOND + n * 20 * MS) for n in range(50)]
    headings = [euler_from_attitude(s.attitude_wxyz)[2] for s in seen]
    turned = math.remainder(headings[-1] - headings[0], 2.0 * math.pi)
    assert turned > 0.15
    # gyroscopes agree with the attitude: R' = R hat(w), here its third row and the heading's rate
    middle = seen[25]
    rows = rotation(middle.attitude_wxyz)
    change = [
        (b - a) / 0.04
        for a, b in zip(rotation(seen[24].attitude_wxyz)[0], rotation(seen[26].attitude_wxyz)[0], strict=True)
    ]
    p, q, r = middle.body_rates_frd_rad_s
    x, y, z = rows[0]
    assert change == pytest.approx([r * y - q * z, p * z - r * x, q * x - p * y], abs=5e-3)


@AIRPLANES
def test_an_airplane_follows_rates_as_it_follows_angles(name: str) -> None:
    body = made(name, initial_speed_m_s=float(name.removeprefix("airplane_")))
    flown(body, RatesThrottle((0.2, 0.0, 0.0), CRUISE[name].throttle), 2.0)
    rates = [body.advance((200 + n) * 10 * MS).body_rates_frd_rad_s for n in range(100)]
    assert [sum(axis) / len(rates) for axis in zip(*rates, strict=True)][:2] == pytest.approx(
        [0.2, 0.0], abs=0.02
    )


@AIRPLANES
def test_an_airplane_without_power_glides_lands_and_stays_on_the_ground(name: str) -> None:
    body = made(name, initial_position_ned_m=(0.0, 0.0, -20.0))
    body.tell(Attitude(), 0)
    heights = [-body.advance(n * SECOND).position_ned_m[2] for n in range(1, 90)]
    assert min(heights) == 0.0
    rest = body.advance(90 * SECOND)
    assert rest.velocity_ned_m_s == (0.0, 0.0, 0.0)
    assert rest.position_ned_m == body.advance(100 * SECOND).position_ned_m
    assert euler_from_attitude(rest.attitude_wxyz)[2] == pytest.approx(0.0, abs=0.01)


@AIRPLANES
def test_an_airplane_takes_off_from_the_ground(name: str) -> None:
    start = (0.0, 0.0, 0.0)
    body = made(name, initial_position_ned_m=start, initial_speed_m_s=0.0, initial_yaw_rad=1.0)
    assert body.advance(5 * SECOND).position_ned_m == start
    climbed = flown(body, Attitude(0.0, 0.12, 1.0), 20.0, 5 * SECOND)
    assert climbed.position_ned_m[2] < -10.0
    assert euler_from_attitude(climbed.attitude_wxyz)[2] == pytest.approx(1.0, abs=0.05)


def test_wind_carries_an_airplane_and_gusts_have_their_sigma() -> None:
    body = made("airplane_20", wind_ned_m_s=(0.0, 5.0, 0.0), gusts_m_s=1.0, initial_speed_m_s=20.0, seed=3)
    winds = [flown(body, CRUISE["airplane_20"], 1.0, n * SECOND).wind_ned_m_s for n in range(600)]
    east = [w[1] for w in winds]
    mean = sum(east) / len(east)
    assert mean == pytest.approx(5.0, abs=0.5)
    assert math.sqrt(sum((e - mean) ** 2 for e in east) / len(east)) == pytest.approx(1.0, rel=0.25)


def test_a_firmware_and_a_body_that_do_not_fit_are_refused_with_what_would() -> None:
    with pytest.raises(ValueError, match="rover does not fit the firmware px4-uuv: it needs ardupilot-rover"):
        Peer(model="rover")
    with pytest.raises(ValueError, match="model airplane_12 does not fit the firmware ardupilot-rover"):
        Peer(Firmware.ARDUPILOT_ROVER, model="airplane_12")


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"model": "zeppelin"}, "zeppelin: No such file or directory; a model is one of rover, boat"),
        (
            {"model": "airplane_12", "initial_position_ned_m": (0.0, 0.0, 1.0)},
            "above the ground at 8 m/s or",
        ),
        (
            {"model": "airplane_12", "initial_speed_m_s": 5.0, "initial_position_ned_m": (0.0, 0.0, -60.0)},
            "not at a height of 60 m and 5 m/s",
        ),
        ({"model": "ideal", "initial_speed_m_s": 1.0}, "the model ideal has no initial_speed_m_s"),
        ({"model": "uuv", "wind_ned_m_s": (1.0, 0.0, 0.0)}, "the model uuv has no wind_ned_m_s"),
        ({"model": "boat", "gusts_m_s": 1.0}, "the model boat has no gusts_m_s"),
        ({"model": "uuv", "plant": PlantParameters(max_speed_m_s=1.0)}, "chosen for the ideal body only"),
        ({"model": "rover", "gusts_m_s": -1.0}, "gusts_m_s must be finite and not negative"),
        ({"model": "rover", "wind_ned_m_s": (math.nan, 0.0, 0.0)}, "wind and origin must be finite"),
    ],
)
def test_a_start_that_is_none_is_refused(options: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        made(**options)  # type: ignore[arg-type]
