"""JSBSim's airplanes as the body behind a firmware: told at instants, looked at, in weather, refused."""

from __future__ import annotations

import math
import sys
from typing import Final

import pytest

from sitl.models.files import JSBSIM
from sitl.plant import PlantCommand, euler_from_attitude
from sitl.vehicle import Origin, VehicleOptions
from sitl.vehicle.bodies.making import body_of, takes
from sitl.vehicle.body import Body, BodyState
from sitl.vehicle.controls import Attitude, RatesThrottle

MS: Final = 1_000_000
SECOND: Final = 1000 * MS
START_NS: Final = 7 * SECOND


def made(aircraft: str = "c172p", **options: object) -> Body:
    chosen = VehicleOptions(model=f"jsbsim:{aircraft}", **options)  # type: ignore[arg-type]
    return body_of(chosen, planar=False, start_ns=START_NS)


@pytest.mark.parametrize("aircraft", JSBSIM)
def test_it_flies_level_from_the_start_and_banks_when_it_is_told_to(aircraft: str) -> None:
    body = made(aircraft, initial_yaw_rad=1.0, wind_ned_m_s=(0.0, 3.0, 0.0))
    first = body.ahead(START_NS)
    assert first.position_ned_m[2] == pytest.approx(-60.0, abs=0.01)
    assert euler_from_attitude(first.attitude_wxyz)[2] == pytest.approx(1.0, abs=1e-6)
    level = body.advance(START_NS + 2 * SECOND)
    assert level.airspeed_m_s == pytest.approx(first.airspeed_m_s, abs=0.1)
    assert level.wind_ned_m_s == (0.0, 3.0, 0.0)
    assert level.throttle > 0.3
    body.tell(
        Attitude(0.4, euler_from_attitude(level.attitude_wxyz)[1], level.throttle), START_NS + 2 * SECOND
    )
    turning = body.advance(START_NS + 6 * SECOND)
    assert euler_from_attitude(turning.attitude_wxyz)[0] == pytest.approx(0.4, abs=0.02)
    body.tell(RatesThrottle((-0.2, 0.0, 0.5), level.throttle), START_NS + 6 * SECOND)
    rolling = body.advance(START_NS + 7 * SECOND)
    assert rolling.body_rates_frd_rad_s[0] == pytest.approx(-0.2, abs=0.05)


def test_how_often_it_is_looked_at_changes_nothing() -> None:
    def fly(look_ns: int) -> BodyState:
        body = made(gusts_m_s=0.8, wind_ned_m_s=(2.0, 1.0, 0.0), seed=3)
        for n in range(20):
            at_ns = START_NS + n * 47_123_457
            body.tell(Attitude(0.03 * n, 0.05, 0.7), at_ns)
            for moment in range(at_ns, at_ns + 47_123_457, look_ns):
                body.ahead(moment + 30 * MS)
                body.advance(moment)
        return body.advance(START_NS + SECOND)

    assert fly(3_000_001) == fly(SECOND)


def test_between_its_steps_it_is_seen_to_fly_on() -> None:
    body = made()
    before = body.advance(START_NS + SECOND)
    after = body.advance(START_NS + SECOND + 2 * MS)
    moved = [b - a for a, b in zip(before.position_ned_m, after.position_ned_m, strict=True)]
    assert moved == pytest.approx([0.002 * v for v in before.velocity_ned_m_s], abs=1e-9)


def test_the_air_may_begin_to_move_and_gusts_are_those_of_the_seed() -> None:
    body = made()
    body.carry((0.0, 0.0, -2.0), START_NS + SECOND)
    assert body.advance(START_NS + 5 * SECOND).velocity_ned_m_s[2] < -1.5
    winds = [made(gusts_m_s=1.0, seed=seed).advance(START_NS + 5 * SECOND).wind_ned_m_s for seed in (1, 1, 2)]
    assert winds[0] == winds[1] != winds[2]
    assert 0.0 < math.hypot(*winds[0]) < 5.0
    body = made(gusts_m_s=1.0)
    blown = [body.advance(START_NS + ms * MS).wind_ned_m_s for ms in (5, 20, 25)]
    assert blown[0] == blown[1] != blown[2]


def test_it_takes_what_an_airplane_takes() -> None:
    assert takes("jsbsim:J3Cub") == (Attitude, RatesThrottle)
    with pytest.raises(TypeError, match="an airplane takes"):
        made().tell(PlantCommand((0.0, 0.0, 0.0), 1.0), START_NS)


@pytest.mark.parametrize(
    ("aircraft", "options", "why"),
    [
        ("zeppelin", {}, "JSBSim's 'zeppelin' has no inner loops here; those that do: J3Cub, c172p"),
        ("c172p", {"initial_speed_m_s": 0.0}, "JSBSim's c172p cannot fly level at 0.0 m/s and 549 m"),
        ("c172p", {"origin": Origin(0.0, 0.0, 30000.0)}, "cannot fly level at 45.0 m/s and 30060 m"),
    ],
)
def test_what_cannot_fly_is_refused(aircraft: str, options: dict[str, object], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        made(aircraft, **options)


def test_without_jsbsim_the_command_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jsbsim", None)
    with pytest.raises(ValueError, match="needs JSBSim: pip install 'se3-guidance"):
        made()
