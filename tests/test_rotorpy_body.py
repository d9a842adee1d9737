"""rotorpy's copters as the body behind a firmware: loops, frames, ground, wind, time and refusals."""

from __future__ import annotations

import subprocess
import sys
from math import cos, sin
from typing import Any, Final

import pytest

from sitl.models.files import ROTORPY
from sitl.plant import PlantCommand, Triple, euler_from_attitude, rotation
from sitl.vehicle import VehicleOptions
from sitl.vehicle.bodies.making import body_of, takes
from sitl.vehicle.body import Body, BodyState
from sitl.vehicle.controls import RatesThrust, Velocity

MS: Final = 1_000_000
SECOND: Final = 1000 * MS
START_NS: Final = 7 * SECOND
HIGH: Final = (10.0, 20.0, -30.0)
EACH: Final = pytest.mark.parametrize("vehicle", ROTORPY)


def made(vehicle: str = "hummingbird", at: Triple = HIGH, **options: Any) -> Body:
    chosen = VehicleOptions(model=f"rotorpy:{vehicle}", initial_position_ned_m=at, **options)
    return body_of(chosen, planar=False, start_ns=START_NS)


def heading(state: BodyState) -> float:
    return euler_from_attitude(state.attitude_wxyz)[2]


@EACH
def test_it_hovers_where_it_starts_in_wind_as_well(vehicle: str) -> None:
    body = made(vehicle, initial_yaw_rad=1.0, wind_ned_m_s=(3.0, -1.0, 0.0))
    first, later = body.ahead(START_NS), body.advance(START_NS + 2 * SECOND)
    assert first.position_ned_m == pytest.approx(HIGH, abs=1e-9)
    assert later.position_ned_m == pytest.approx(HIGH, abs=0.15)
    assert later.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.08)
    assert heading(later) == pytest.approx(1.0, abs=1e-3)
    assert later.throttle == pytest.approx(0.5, abs=0.02)
    # it leans into the wind: what pushes points to where that comes from
    rows = rotation(later.attitude_wxyz)
    assert -rows[0][2] < 0.0 < -rows[1][2]


@EACH
@pytest.mark.parametrize("course_rad", [0.0, 2.0])
def test_a_velocity_and_a_yaw_rate_are_flown_whichever_way_the_nose_points(
    vehicle: str, course_rad: float
) -> None:
    body = made(vehicle, initial_yaw_rad=-1.0)
    wanted = (2.0 * cos(course_rad), 2.0 * sin(course_rad), -1.0)
    body.tell(Velocity(wanted, 0.4), START_NS)
    early = body.advance(START_NS + 400 * MS)
    way = sum(v * w for v, w in zip(early.velocity_ned_m_s[:2], wanted[:2], strict=True)) / 2.0
    assert 0.4 < way < 1.6
    late = body.advance(START_NS + 4 * SECOND)
    assert late.velocity_ned_m_s == pytest.approx(wanted, abs=0.3)
    turned = [heading(body.advance(START_NS + n * SECOND)) for n in (4, 5)]
    assert turned[1] - turned[0] == pytest.approx(0.4, abs=0.02)
    forward = sum(
        v * row[0] for v, row in zip(late.velocity_ned_m_s, rotation(late.attitude_wxyz), strict=True)
    )
    assert late.speed_m_s == pytest.approx(forward)


@EACH
@pytest.mark.parametrize("axis", range(3))
def test_body_rates_and_thrust_are_flown_too(vehicle: str, axis: int) -> None:
    body = made(vehicle)
    asked = [0.0, 0.0, 0.0]
    asked[axis] = 0.3
    body.tell(RatesThrust((asked[0], asked[1], asked[2]), 0.6), START_NS)
    state = body.advance(START_NS + SECOND)
    assert state.body_rates_frd_rad_s == pytest.approx(tuple(asked), abs=0.03)
    assert euler_from_attitude(state.attitude_wxyz)[axis] == pytest.approx(0.27, abs=0.05)
    assert state.throttle == pytest.approx(0.6, abs=0.01)
    # a fifth more than the weight, less what the air takes
    assert -2.2 < state.velocity_ned_m_s[2] < -1.0


def test_it_stands_takes_off_and_comes_down_again() -> None:
    body = made(at=(1.0, 2.0, 0.0), wind_ned_m_s=(3.0, 0.0, 0.0))
    body.tell(RatesThrust((0.5, 0.5, 0.5), 0.4), START_NS)
    standing = body.advance(START_NS + SECOND)
    assert standing.position_ned_m == pytest.approx((1.0, 2.0, 0.0), abs=0.05)
    assert euler_from_attitude(standing.attitude_wxyz) == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    body.tell(Velocity((0.0, 0.0, -1.0), 0.0), START_NS + SECOND)
    assert body.advance(START_NS + 3 * SECOND).position_ned_m[2] < -1.0
    body.tell(Velocity((0.0, 0.0, 1.0), 0.0), START_NS + 3 * SECOND)
    body.advance(START_NS + 7 * SECOND)
    body.tell(RatesThrust(), START_NS + 7 * SECOND)
    down = body.advance(START_NS + 8 * SECOND)
    assert down.position_ned_m[2] == 0.0
    assert down.velocity_ned_m_s == pytest.approx((0.0, 0.0, 0.0), abs=1e-3)
    assert down.throttle == pytest.approx(0.0, abs=1e-6)


def test_more_than_there_is_tilts_no_further_than_it_may_and_keeps_the_height() -> None:
    body = made("crazyflie")
    body.tell(Velocity((12.0, 0.0, 0.0), 0.0), START_NS)
    states = [body.advance(START_NS + n * 50 * MS) for n in range(1, 41)]
    up = [-rotation(state.attitude_wxyz)[2][2] for state in states]
    assert min(-u for u in up) > 0.62  # 45 degrees, and what it overshoots
    assert all(state.position_ned_m[2] == pytest.approx(-30.0, abs=0.7) for state in states)
    assert states[-1].velocity_ned_m_s[0] > 8.0


def test_of_what_there_is_the_height_comes_first() -> None:
    body = made("crazyflie")
    body.tell(Velocity((12.0, 0.0, -3.0), 0.0), START_NS)
    soon = body.advance(START_NS + 400 * MS).velocity_ned_m_s
    assert soon[2] < -2.0
    assert soon[0] < 1.0
    assert body.advance(START_NS + SECOND).velocity_ned_m_s[0] > 5.0


def test_how_often_it_is_looked_at_changes_nothing() -> None:
    def fly(look_ns: int) -> BodyState:
        body = made(wind_ned_m_s=(2.0, 1.0, 0.0))
        for n in range(6):
            at_ns = START_NS + n * 47_123_457
            body.tell(Velocity((0.2 * n, 1.0, -0.1), 0.1), at_ns)
            for moment in range(at_ns, at_ns + 47_123_457, look_ns):
                body.ahead(moment + 3 * MS)
                body.advance(moment)
        return body.advance(START_NS + 300 * MS)

    assert fly(9_000_001) == fly(SECOND)


def test_the_air_may_begin_to_move() -> None:
    body = made()
    body.carry((0.0, 4.0, 0.0), START_NS + 100 * MS)
    after = body.advance(START_NS + SECOND)
    assert after.velocity_ned_m_s[1] > 0.2
    assert after.wind_ned_m_s == (0.0, 4.0, 0.0)


def test_it_takes_what_a_copter_takes_and_one_has_the_short_name() -> None:
    assert takes("rotorpy:crazyflie") == takes("rotorpy") == (Velocity, RatesThrust)
    short = VehicleOptions(model="rotorpy", initial_position_ned_m=HIGH)
    at_ns = START_NS + 100 * MS
    one = body_of(short, planar=False, start_ns=START_NS).advance(at_ns)
    assert one == made("hummingbird").advance(at_ns)
    with pytest.raises(TypeError, match="a copter takes"):
        made().tell(PlantCommand((0.0, 0.0, 0.0), 1.0), START_NS)


@pytest.mark.parametrize(
    ("vehicle", "options", "why"),
    [
        (
            "zeppelin",
            {},
            "rotorpy's 'zeppelin' has no inner loops here; those that do: hummingbird, crazyflie",
        ),
        ("crazyflie", {"at": (0.0, 0.0, 1.0)}, "on the ground or above, not 1 m below"),
        ("crazyflie", {"gusts_m_s": 1.0}, "has no gusts_m_s"),
    ],
)
def test_what_cannot_fly_is_refused(vehicle: str, options: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        made(vehicle, **options)


def test_without_rotorpy_the_command_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rotorpy.vehicles.multirotor", None)
    with pytest.raises(ValueError, match="needs rotorpy: pip install 'se3-guidance"):
        made()


def test_another_body_loads_neither_rotorpy_nor_what_it_needs() -> None:
    code = (
        "import sys; from sitl.vehicle.bodies.making import takes; takes('rotorpy'); "
        "print(*(m for m in ('rotorpy', 'scipy', 'numpy') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
