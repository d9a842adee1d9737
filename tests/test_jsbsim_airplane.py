"""JSBSim's airplanes behind an autopilot's inner loops: start, wind, loops, frame, time and refusals."""

from __future__ import annotations

import subprocess
import sys
from math import cos, degrees, hypot, radians, sin
from typing import Final

import pytest

from sitl.models.files import JSBSIM, load_jsbsim
from sitl.models.gusts import CALM, Wind
from sitl.models.jsbsim_airplane import JsbsimAirplane, Place, State

WIND: Final = Wind(3.0, -4.0, 0.0)
START: Final = (100.0, 200.0, -300.0)
EACH: Final = pytest.mark.parametrize("aircraft", JSBSIM)


def made(aircraft: str, wind: Wind = CALM, heading_rad: float = 0.5, **place: Place) -> JsbsimAirplane:
    parameters = load_jsbsim(aircraft)
    return JsbsimAirplane(
        aircraft, parameters, START, heading_rad, parameters.trim_speed_m_s, wind=wind, **place
    )


def flown(body: JsbsimAirplane, seconds: float) -> list[State]:
    """Its states every 20 ms."""
    states = []
    for _ in range(round(seconds / 0.02)):
        body.advance(0.02)
        states.append(body.state())
    return states


@EACH
def test_it_starts_in_level_flight_where_it_is_told_to(aircraft: str) -> None:
    body = made(aircraft, WIND)
    speed = load_jsbsim(aircraft).trim_speed_m_s
    first = body.state()
    assert (first.north_m, first.east_m, first.down_m) == pytest.approx(START, abs=0.01)
    assert first.airspeed_m_s == pytest.approx(speed)
    assert first.heading_rad == pytest.approx(0.5)
    assert first.velocity_north_m_s == pytest.approx(speed * cos(0.5) + 3.0, abs=0.01)
    assert first.velocity_east_m_s == pytest.approx(speed * sin(0.5) - 4.0, abs=0.01)
    last = flown(body, 5.0)[-1]
    assert last.time_s == pytest.approx(5.0)
    assert last.north_m == pytest.approx(START[0] + 5.0 * first.velocity_north_m_s, abs=0.2)
    assert last.east_m == pytest.approx(START[1] + 5.0 * first.velocity_east_m_s, abs=0.2)
    assert last.down_m == pytest.approx(START[2], abs=0.2)
    assert last.throttle == pytest.approx(first.throttle)


@EACH
def test_bank_and_pitch_follow_what_is_told(aircraft: str) -> None:
    body = made(aircraft)
    first = body.state()
    body.tell(radians(30.0), first.pitch_rad, first.throttle)
    states = flown(body, 6.0)
    # the nose is held up while the turn begins
    assert max(abs(degrees(state.pitch_rad - first.pitch_rad)) for state in states) < 0.8
    banks = [degrees(state.roll_rad) for state in states]
    assert banks[40] > 15.0
    assert banks[100] == pytest.approx(30.0, abs=2.0)
    assert banks[-1] == pytest.approx(30.0, abs=0.3)
    assert max(banks) < 31.0
    turned = body.state()
    # a coordinated turn: the nose comes round as g tan(phi)/V
    assert turned.body_rates_frd_rad_s[2] == pytest.approx(
        9.80665 * sin(radians(30.0)) / turned.airspeed_m_s, rel=0.04
    )
    body.tell(0.0, first.pitch_rad + radians(3.0), first.throttle)
    states = flown(body, 6.0)
    assert degrees(states[-1].pitch_rad - first.pitch_rad) == pytest.approx(3.0, abs=0.3)
    assert degrees(states[-1].roll_rad) == pytest.approx(0.0, abs=0.3)
    assert states[-1].velocity_down_m_s < -0.5


def test_a_climbing_turn_keeps_its_bank() -> None:
    """The turn rolls a nose that points up out of the bank."""
    body = made("c172p")
    body.tell(radians(30.0), 0.2, 1.0)
    assert degrees(flown(body, 8.0)[-1].roll_rad) == pytest.approx(30.0, abs=0.3)


@EACH
def test_body_rates_are_held_too_and_limits_are_its_own(aircraft: str) -> None:
    body = made(aircraft)
    throttle = body.state().throttle
    body.tell_rates(0.2, 0.0, throttle)
    states = flown(body, 1.5)
    assert states[-1].body_rates_frd_rad_s[0] == pytest.approx(0.2, abs=0.04)
    assert degrees(states[-1].roll_rad) == pytest.approx(degrees(0.3), abs=5.0)
    body.tell(2.0, 0.0, 7.0)
    last = flown(body, 5.0)[-1]
    assert last.roll_rad < load_jsbsim(aircraft).roll_max_rad + 0.1
    assert last.throttle == 1.0


@EACH
def test_throttle_makes_it_faster(aircraft: str) -> None:
    fast, slow = made(aircraft), made(aircraft)
    first = fast.state()
    fast.tell(0.0, first.pitch_rad, 1.0)
    slow.tell(0.0, first.pitch_rad, 0.0)
    assert flown(fast, 6.0)[-1].airspeed_m_s > first.airspeed_m_s + 1.5
    assert flown(slow, 6.0)[-1].airspeed_m_s < first.airspeed_m_s - 1.5


def test_the_wind_carries_it() -> None:
    body = made("c172p")
    flown(body, 1.0)
    body.blow(Wind(0.0, 0.0, -2.0))
    risen = flown(body, 4.0)
    assert risen[-1].velocity_down_m_s < -1.5
    body.blow(Wind(-8.0 * cos(0.5), -8.0 * sin(0.5), 0.0))
    assert flown(body, 0.02)[-1].airspeed_m_s == pytest.approx(risen[-1].airspeed_m_s + 8.0, abs=1.0)


def test_its_velocity_is_the_change_of_its_position() -> None:
    """In a climbing turn, across the date line and far north."""
    place = Place(64.0, 179.999, 50.0)
    body = made("c172p", heading_rad=1.5, place=place)
    body.tell(0.4, 0.12, 1.0)
    before = body.state()
    for state in flown(body, 12.0):
        mean = [0.5 * (a + b) for a, b in zip(before[4:7], state[4:7], strict=True)]
        change = [(b - a) / 0.02 for a, b in zip(before[1:4], state[1:4], strict=True)]
        assert change == pytest.approx(mean, abs=0.03)
        before = state
    # it did cross, 48 m east of the origin
    assert before.east_m > 300.0


def test_how_it_is_advanced_changes_nothing() -> None:
    one, other = made("J3Cub", WIND), made("J3Cub", WIND)
    for body in (one, other):
        body.tell(0.3, 0.05, 0.7)
    one.advance(1.2)
    for _ in range(400):
        other.advance(0.003)

    assert hypot(*(a - b for a, b in zip(one.state()[1:7], other.state()[1:7], strict=True))) < 1e-9
    # between two steps of JSBSim it moves on
    at = other.state()
    other.advance(0.002)
    assert other.state().north_m - at.north_m == pytest.approx(0.002 * at.velocity_north_m_s, rel=1e-6)
    assert other.state().roll_rad == at.roll_rad


def test_what_cannot_fly_is_refused() -> None:
    parameters = load_jsbsim("c172p")
    with pytest.raises(ValueError, match="has no aircraft 'c999'"):
        JsbsimAirplane("c999", parameters, START, 0.0, 45.0)
    with pytest.raises(ValueError, match=r"JSBSim's c172p cannot fly level at 12\.0 m/s and 789 m"):
        JsbsimAirplane("c172p", parameters, START, 0.0, 12.0)
    with pytest.raises(ValueError, match="'c999' has no inner loops here; those that do: J3Cub, c172p"):
        load_jsbsim("c999")


def test_without_jsbsim_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "jsbsim", None)
    with pytest.raises(ModuleNotFoundError, match=r"jsbsim:c172p needs JSBSim: pip install 'se3-guidance\[j"):
        made("c172p")


def test_jsbsim_is_imported_only_when_it_is_chosen() -> None:
    code = "import sys, sitl.cli, sitl.vehicle, sitl.jsbsim_flight; sys.exit('jsbsim' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_it_says_nothing_on_standard_output(capfd: pytest.CaptureFixture[str]) -> None:
    flown(made("c172p"), 0.1)
    with pytest.raises(ValueError, match="has no aircraft"):
        made_unknown()
    assert capfd.readouterr() == ("", "")


def made_unknown() -> JsbsimAirplane:
    return JsbsimAirplane("c999", load_jsbsim("c172p"), START, 0.0, 45.0)
