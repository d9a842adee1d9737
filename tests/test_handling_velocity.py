"""The step of vehicles that take a velocity: what it asks for, its limits, and its heading."""

from __future__ import annotations

from math import cos, hypot, inf, isfinite, pi, radians, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.handling import response
from guidance.handling.copter import ArduPilot, Configured, Px4, ardupilot, px4
from guidance.handling.velocity import (
    UNSTARTED,
    Around,
    Demand,
    Measured,
    Memory,
    Parameters,
    velocity_step,
)
from guidance.law import desired_field
from guidance.se3 import ZERO, Pose, Reference, Twist, Vec3, from_euler, from_yaw, rotate_inverse
from sitl.compiled import compiled
from tests.strategies import properties, reals, vectors

DT = 0.02
PX4 = px4(Px4())
ARDUPILOT = ardupilot(ArduPilot())
#: Asked for is what is wanted: what answers at once, and is not smoothed.
PLAIN = PX4._replace(
    response=response.Parameters(
        response.Axis(0.0, 0.0, 0.0), response.Axis(0.0, 0.0, 0.0), 0.0, 0.0, 0.0, 0.0
    ),
    smoothing=PX4.smoothing._replace(time_constant_s=0.0),
)
STANDING = Reference(ZERO, ZERO, ZERO)


def seen(position: Vec3, yaw: float = 0.0, velocity: Vec3 = ZERO, yaw_rate: float = 0.0) -> Measured:
    attitude = from_yaw(yaw)
    twist = Twist(Vec3(0.0, 0.0, yaw_rate), rotate_inverse(attitude, velocity))
    return Measured(Pose(position, attitude), twist, yaw_rate)


def after(
    parameters: Parameters, measured: Measured, reference: Reference, steps: int
) -> tuple[Memory, Demand, Around]:
    """The last of so many steps with the same input."""
    memory = UNSTARTED
    for _ in range(steps):
        memory, demand, found = velocity_step(parameters, memory, measured, reference, DT)
    return memory, demand, found


def test_what_is_asked_for_is_the_field() -> None:
    moving = Reference(Vec3(1.0, 2.0, -3.0), Vec3(0.5, -0.3, 0.1), ZERO)
    x = Vec3(0.4, 2.5, -3.2)
    memory = after(PLAIN, seen(x), moving, 200)[0]
    for n in range(20):
        x = Vec3(0.4 + 1e-3 * n, 2.5 - 7e-4 * n, -3.2)
        memory, demand, _ = velocity_step(PLAIN, memory, seen(x), moving, DT)
        field = desired_field(PLAIN.gains, x, moving, PLAIN.error_function)
        assert demand.velocity_ned_m_s == pytest.approx(field.Xr)


def test_what_no_limit_changes_is_kept_to_the_bit() -> None:
    """And so is not taken for limited."""
    memory = after(PLAIN, seen(ZERO), STANDING, 2)[0]
    for n in range(20):
        x = Vec3(0.013 * sin(n), 0.011 * cos(2 * n), 0.007 * sin(3 * n))
        memory, _, found = velocity_step(PLAIN, memory, seen(x), STANDING, DT)
        field = desired_field(PLAIN.gains, x, STANDING, PLAIN.error_function)
        assert found.wanted_ned_m_s == field.Xr


def test_speeds_and_their_change_are_bounded_and_keep_the_direction() -> None:
    fast = Reference(ZERO, Vec3(30.0, 40.0, 0.0), ZERO)
    demand = after(PLAIN, seen(ZERO), fast, 2000)[1]
    v = demand.velocity_ned_m_s
    assert hypot(v.x, v.y) == pytest.approx(Px4().MPC_XY_VEL_MAX)
    assert v.y / v.x == pytest.approx(4.0 / 3.0)
    first = after(PLAIN, seen(ZERO), fast, 1)[1].velocity_ned_m_s
    assert hypot(first.x, first.y) == pytest.approx(0.9 * Px4().MPC_ACC_HOR * DT)
    for down, bound in ((30.0, Px4().MPC_Z_VEL_MAX_DN), (-30.0, -Px4().MPC_Z_VEL_MAX_UP)):
        sinking = Reference(ZERO, Vec3(0.0, 0.0, down), ZERO)
        assert after(PLAIN, seen(ZERO), sinking, 2000)[1].velocity_ned_m_s.z == pytest.approx(bound)


def test_within_its_acceleration_that_one_is_led_with_and_nothing_is_learned() -> None:
    fast = Reference(ZERO, Vec3(10.0, 0.0, 0.0), ZERO)
    memory, demand, found = after(PX4, seen(ZERO), fast, 20)
    most = PX4.limits.acceleration_m_s2
    wanted = 20 * DT * most
    assert found.wanted_ned_m_s.x == pytest.approx(wanted)
    asked_more = (1.2 * most + 0.5 * wanted) / 1.8
    assert demand.velocity_ned_m_s.x == pytest.approx(wanted + asked_more, rel=0.1)
    assert memory.response.drag_per_s == PX4.drag_per_s
    assert found.law.saturated


def test_the_first_step_begins_with_what_the_vehicle_does() -> None:
    cruising = Reference(ZERO, Vec3(5.0, 0.0, 0.0), ZERO)
    demand = after(PLAIN, seen(ZERO, velocity=Vec3(5.0, 0.0, 0.0)), cruising, 1)[1]
    assert demand.velocity_ned_m_s == pytest.approx((5.0, 0.0, 0.0))


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_nose_turns_along_the_field_whatever_the_velocity(yaw: float) -> None:
    """By the short way, as fast as may be, and not at once."""
    north = Reference(ZERO, Vec3(3.0, 0.0, 0.0), ZERO)
    _, demand, found = after(PLAIN, seen(ZERO, yaw), north, 1)
    if yaw == 0.0:
        assert demand.yaw_rate_rad_s == 0.0
        return
    assert demand.yaw_rate_rad_s * yaw < 0.0
    assert abs(demand.yaw_rate_rad_s) <= PLAIN.limits.yaw_acceleration_rad_s2 * DT + 1e-12
    last = after(PLAIN, seen(ZERO, yaw), north, 500)[1]
    assert abs(last.yaw_rate_rad_s) <= PLAIN.limits.yaw_rate_rad_s
    assert found.law.y5 == pytest.approx(-3.0 * sin(yaw), abs=1e-9)
    assert found.law.y4 == pytest.approx(3.0 * cos(yaw))


def test_on_a_circle_the_nose_turns_with_the_field() -> None:
    """The feed-forward: aligned, the yaw rate is the circle's."""
    w, r = 0.3, 10.0
    reference = Reference(Vec3(r, 0.0, 0.0), Vec3(0.0, w * r, 0.0), Vec3(-w * w * r, 0.0, 0.0))
    measured = seen(Vec3(r, 0.0, 0.0), 0.5 * pi, Vec3(0.0, w * r, 0.0), w)
    assert after(PLAIN, measured, reference, 50)[1].yaw_rate_rad_s == pytest.approx(w)


@pytest.mark.parametrize("follows", [True, False])
def test_where_the_field_is_slow_or_the_heading_is_held_the_nose_stays(follows: bool) -> None:
    held = PLAIN._replace(follows=follows)
    reference = STANDING if follows else Reference(ZERO, Vec3(3.0, 0.0, 0.0), ZERO)
    memory, demand, _ = after(held, seen(Vec3(0.1, 0.05, 0.0), 1.2), reference, 5)
    assert (memory.heading_rad, demand.yaw_rate_rad_s) == pytest.approx((1.2, 0.0))
    # it has drifted off to the right: back
    demand = velocity_step(held, memory, seen(Vec3(0.1, 0.05, 0.0), 1.4), reference, DT)[1]
    assert demand.yaw_rate_rad_s < 0.0


def test_what_stops_keeps_the_heading_it_came_with() -> None:
    going = Reference(ZERO, Vec3(0.0, -2.0, 0.0), ZERO)
    memory = after(PLAIN, seen(ZERO, -1.0), going, 3)[0]
    memory = velocity_step(PLAIN, memory, seen(ZERO, -1.5), STANDING, DT)[0]
    assert memory.heading_rad == pytest.approx(-0.5 * pi)


def test_a_vehicle_that_does_not_move_is_found() -> None:
    away = Reference(Vec3(20.0, 0.0, 0.0), ZERO, ZERO)
    assert not after(PX4, seen(ZERO), away, 100)[2].stuck
    assert after(PX4, seen(ZERO), away, 250)[2].stuck


# --- the answer of the autopilot, the other way round


def asked_for(parameters: response.Parameters, memory: response.Memory, v: Vec3, a: Vec3) -> Vec3:
    return response.response_step(parameters, memory, v, a, ZERO, DT)[1]


def test_what_px4_is_asked_for_is_what_its_loop_needs() -> None:
    """P q = (1 + D) a + c v at first; what stands is held by the integral after P/I."""
    r = PX4.response
    v, a = Vec3(2.0, -1.0, 0.5), Vec3(0.6, 0.3, -0.4)
    first = asked_for(r, response.unstarted(0.8), v, a)
    assert first.x == pytest.approx(2.0 + (1.2 * 0.6 + 0.8 * 2.0) / 1.8, rel=0.01)
    assert first.y == pytest.approx(-1.0 + (1.2 * 0.3 - 0.8 * 1.0) / 1.8, rel=0.01)
    assert first.z == pytest.approx(0.5 + (1.0 * -0.4 + 0.8 * 0.5) / 4.0, rel=0.01)
    memory = response.unstarted(0.8)
    for _ in range(round(4.5 / DT)):
        memory, asked = response.response_step(r, memory, v, ZERO, ZERO, DT)
    assert asked.x == pytest.approx(2.0 + 0.8 * 2.0 / 1.8 * 0.37, rel=0.02)


def test_what_arducopter_is_asked_for_leads_by_its_shaping() -> None:
    asked = asked_for(ARDUPILOT.response, response.unstarted(0.0), Vec3(2.0, 0.0, 1.0), Vec3(0.6, 0.0, 0.5))
    assert asked == pytest.approx((2.0 + 0.6 * 2.5 / 5.0, 0.0, 1.0 + 0.5 * 1.0 / 5.0))


def test_the_drag_is_learned_from_what_is_short_along_the_way_and_bounded() -> None:
    r = PX4.response
    memory = response.unstarted(0.5)
    north = Vec3(3.0, 0.0, 0.0)
    for short, grows in ((Vec3(0.1, 0.0, 0.0), 1), (Vec3(-0.1, 0.0, 0.0), -1), (Vec3(0.0, 0.1, 0.0), 0)):
        c = response.response_step(r, memory, north, ZERO, short, DT)[0].drag_per_s
        assert (c > 0.5) - (c < 0.5) == grows
    still = response.response_step(r, memory, ZERO, ZERO, Vec3(0.5, 0.0, 0.0), DT)[0]
    assert still.drag_per_s == 0.5
    for _ in range(5000):
        memory = response.response_step(r, memory, north, ZERO, Vec3(1.0, 0.0, 0.0), DT)[0]
    assert memory.drag_per_s == r.drag_max_per_s


def test_what_is_short_is_asked_for_on_top_and_bounded() -> None:
    r = PX4.response
    memory = response.unstarted(0.0)
    for short, more in ((0.2, 0.2 * r.kp), (50.0, r.bound_m_s), (-50.0, -r.bound_m_s)):
        asked = response.response_step(r, memory, ZERO, ZERO, Vec3(0.0, 0.0, short), DT)[1]
        assert asked.z == pytest.approx(more)


# --- from the autopilot's parameters


def test_the_tighter_of_autopilot_and_configuration_holds() -> None:
    free = px4(Px4(), Configured(speed_max_m_s=100.0, up_max_m_s=100.0, acceleration_m_s2=100.0))
    assert (free.limits.speed_max_m_s, free.up_max_m_s) == (12.0, 3.0)
    assert free.limits.acceleration_m_s2 == pytest.approx(0.9 * 3.0)
    tight = px4(
        Px4(),
        Configured(
            speed_max_m_s=4.0,
            up_max_m_s=1.0,
            down_max_m_s=0.5,
            acceleration_m_s2=1.0,
            vertical_acceleration_m_s2=0.7,
            yaw_rate_rad_s=0.4,
        ),
    )
    assert (tight.limits.speed_max_m_s, tight.up_max_m_s, tight.down_max_m_s) == (4.0, 1.0, 0.5)
    assert tight.limits.acceleration_m_s2 == pytest.approx(0.9)
    assert tight.vertical_acceleration_m_s2 == pytest.approx(0.63)
    assert tight.limits.yaw_rate_rad_s == 0.4
    assert px4(Px4(MPC_YAWRAUTO_MAX=10.0)).limits.yaw_rate_rad_s == pytest.approx(radians(10.0))
    ardu = ardupilot(ArduPilot(WP_SPD=3.0), Configured(down_max_m_s=1.0))
    assert (ardu.limits.speed_max_m_s, ardu.up_max_m_s, ardu.down_max_m_s) == (3.0, 2.5, 1.0)


def test_an_autopilot_without_an_integral_washes_nothing_out() -> None:
    bare = px4(Px4(MPC_XY_VEL_I_ACC=0.0, MPC_Z_VEL_I_ACC=0.0)).response
    assert (bare.level.washout_s, bare.vertical.washout_s) == (0.0, 0.0)
    memory = response.unstarted(1.0)
    for _ in range(1000):
        memory, asked = response.response_step(bare, memory, Vec3(1.8, 0.0, 0.0), ZERO, ZERO, DT)
    assert asked.x == pytest.approx(2.8)


# --- in every state


def flat(value: object) -> list[float]:
    """All numbers of nested tuples."""
    if isinstance(value, tuple):
        return [number for item in value for number in flat(item)]
    assert isinstance(value, int | float)
    return [float(value)]


@properties
@given(
    vectors(1e3),
    vectors(50.0),
    vectors(50.0),
    vectors(50.0),
    vectors(20.0),
    reals(3.1),
    st.sampled_from([PX4, ARDUPILOT, PX4._replace(follows=False)]),
)
def test_all_is_finite_and_within_its_limits(
    x: Vec3, r: Vec3, v: Vec3, a: Vec3, w: Vec3, yaw: float, parameters: Parameters
) -> None:
    measured = Measured(Pose(x, from_euler(0.3 * w.x / 20.0, 0.2, yaw)), Twist(w, v), w.z)
    memory = UNSTARTED
    for _ in range(3):
        memory, demand, found = velocity_step(parameters, memory, measured, Reference(r, v, a), DT)
        assert all(isfinite(number) for number in flat((memory, demand, found)))
        asked = demand.velocity_ned_m_s
        assert hypot(asked.x, asked.y) <= parameters.limits.speed_max_m_s * (1.0 + 1e-12)
        assert -parameters.up_max_m_s <= asked.z <= parameters.down_max_m_s
        assert abs(demand.yaw_rate_rad_s) <= parameters.limits.yaw_rate_rad_s


@pytest.mark.timeout(120)  # it compiles
def test_compiled_it_is_the_same() -> None:
    fast = compiled(velocity_step)
    memory = same = UNSTARTED
    for n in range(200):
        measured = seen(Vec3(3.0 - 0.02 * n, 1.0, -1.0), 0.01 * n, Vec3(0.5, 0.3, 0.1), 0.1)
        reference = Reference(Vec3(0.0, 0.03 * n, 0.0), Vec3(0.0, 1.5, 0.0), Vec3(-0.2, 0.0, 0.0))
        memory, *found = velocity_step(PX4, memory, measured, reference, DT)
        same, *others = fast(PX4, same, measured, reference, DT)
        assert flat(tuple(others)) == pytest.approx(flat(tuple(found)), abs=1e-12)


def test_nothing_is_unbounded_by_default() -> None:
    for parameters in (PX4, ARDUPILOT):
        assert parameters.limits.speed_max_m_s < inf
        assert parameters.limits.acceleration_m_s2 < inf
        assert parameters.vertical_acceleration_m_s2 < inf


def test_only_px4_s_velocity_is_taken_to_be_wrong() -> None:
    assert PX4.smoothing.error_s > 0.0
    assert ARDUPILOT.smoothing.error_s == 0.0


@pytest.mark.parametrize("period_s", [inf, 15.0])
def test_a_velocity_that_is_measured_wrong_leads_nowhere(period_s: float) -> None:
    """PX4's estimator has the velocity 0.4 m/s wrong for seconds in PX4's own simulator, and flies that."""
    position, flown, memory, worst = ZERO, ZERO, UNSTARTED, 0.0
    for n in range(2000):
        t = n * DT
        wrong = Vec3(0.4 * cos(2.0 * pi * t / period_s), -0.3, 0.2)
        memory, demand, _ = velocity_step(PX4, memory, seen(position, 0.0, _sum(flown, wrong)), STANDING, DT)
        # the autopilot makes the velocity that it sees what was asked for
        flown = _sum(demand.velocity_ned_m_s, wrong, -1.0)
        position = _sum(position, flown, DT)
        if t > 15.0:
            worst = max(worst, hypot(position.x, position.y, position.z))
    assert worst < 0.15


def _sum(a: Vec3, b: Vec3, scale: float = 1.0) -> Vec3:
    return Vec3(a.x + scale * b.x, a.y + scale * b.y, a.z + scale * b.z)
