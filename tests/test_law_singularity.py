"""y4 = 0, where (11) divides by zero: the branch, the bound on the rates, and no field at all."""

from __future__ import annotations

from math import isfinite, pi, sqrt

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from guidance import se3
from guidance.law import Y4_RATIO_MIN, Evaluation, Gains, evaluate
from guidance.se3 import IDENTITY, ZERO, Pose, Reference, Twist, Vec3
from tests.strategies import (
    SECTION_4_GAINS,
    UNBOUNDED,
    angles,
    facing,
    gains,
    poses,
    properties,
    references,
    vectors,
)


def turn_towards_field(result: Evaluation) -> float:
    """d/dt of y4 by the turn alone: b1' = u3 b2 - u2 b3."""
    return result.demanded.u3 * result.y5 - result.demanded.u2 * result.y6


@properties
@given(
    st.floats(-0.99 * Y4_RATIO_MIN, 0.99 * Y4_RATIO_MIN), angles(), st.floats(1e-6, 100.0), vectors(1000.0)
)
@example(0.0, 0.0, 1.0, ZERO)
@example(-0.0, pi, 1.0, Vec3(0.0, 1e3, 0.0))
@example(5e-324, 1.0, 1.0, ZERO)
@example(-5e-324, 1.0, 1.0, ZERO)
def test_close_to_y4_zero_the_branch_turns_to_the_side_of_the_field_at_a_bounded_rate(
    sine: float, side: float, speed: float, a: Vec3
) -> None:
    result = evaluate(SECTION_4_GAINS, UNBOUNDED, *facing(sine, side, speed, a))
    assert result.singular
    assert turn_towards_field(result) > 0.0
    rate = sqrt(result.demanded.u2**2 + result.demanded.u3**2)
    bound = SECTION_4_GAINS.rho2 / Y4_RATIO_MIN
    assert 0.99 * bound < rate <= bound * (1.0 + 1e-12)
    assert result.demanded.u1 == 0.0


@properties
@given(angles())
def test_the_branch_joins_11_on_the_forward_side(side: float) -> None:
    inside = evaluate(SECTION_4_GAINS, UNBOUNDED, *facing(Y4_RATIO_MIN * (1.0 - 1e-9), side))
    outside = evaluate(SECTION_4_GAINS, UNBOUNDED, *facing(Y4_RATIO_MIN * (1.0 + 1e-9), side))
    assert inside.singular
    assert not outside.singular
    assert_allclose(inside.demanded, outside.demanded, rtol=1e-6, atol=1e-4)


def test_behind_the_branch_11_turns_the_back_to_the_field_and_reverses() -> None:
    result = evaluate(SECTION_4_GAINS, UNBOUNDED, *facing(-0.1, 0.0))
    assert not result.singular
    assert turn_towards_field(result) < 0.0
    assert result.controls.u4 < 0.0


@properties
@given(gains(), poses(), references(), st.sampled_from([1.0, 1e-3, 1e-9, 1e-100, 1e-200, 0.0]))
def test_demanded_rates_never_exceed_their_bound(g: Gains, pose: Pose, r: Reference, size: float) -> None:
    # A field of any size against an acceleration that does not shrink with it.
    v = se3.scale(size, r.velocity)
    near = Reference(pose.position, v, r.acceleration)
    for reference in (r, near):
        result = evaluate(g, UNBOUNDED, pose, reference)
        rate = sqrt(result.demanded.u2**2 + result.demanded.u3**2)
        assert rate <= max(g.rho2, g.rho3) / Y4_RATIO_MIN * (1.0 + 1e-9)
        assert all(isfinite(u) for u in (*result.demanded, result.V1, result.V2))


@properties
@given(gains(), poses(), vectors(10.0))
def test_without_a_field_the_heading_is_held(g: Gains, pose: Pose, acceleration: Vec3) -> None:
    result = evaluate(g, UNBOUNDED, pose, Reference(pose.position, ZERO, acceleration))
    assert result.demanded == (0.0, 0.0, 0.0, 0.0)
    assert result.singular


@pytest.mark.parametrize("magnitude", [5e-324, 1e-160, 1e-30, 1e30, 1e70])
def test_numbers_of_any_size_give_finite_controls(magnitude: float) -> None:
    m = magnitude
    for attitude in (IDENTITY, se3.from_euler(1.0, 2.0, 3.0)):
        pose = Pose(Vec3(m, -m, m), attitude)
        for r in (
            Reference(Vec3(-m, m, m), Vec3(m, m, -m), Vec3(m, 0.0, m)),
            Reference(pose.position, Vec3(1.0 / m if m > 1.0 else m, 0.0, 0.0), Vec3(0.0, 1e70, -1e70)),
        ):
            result = evaluate(SECTION_4_GAINS, UNBOUNDED, pose, r)
            assert all(isfinite(u) for u in result.demanded)
            assert max(abs(result.demanded.u2), abs(result.demanded.u3)) <= 10.0 / Y4_RATIO_MIN + 1e-9


@pytest.mark.parametrize("sine", [-0.6, 0.6])
def test_a_field_that_turns_faster_than_the_bound_keeps_the_direction_of_11_and_is_told(sine: float) -> None:
    g = SECTION_4_GAINS
    speed, a = 1e-3, Vec3(0.0, 3.0, -4.0)
    result = evaluate(g, UNBOUNDED, *facing(sine, 0.0, speed, a))
    u2 = -(g.rho2 * result.y6 + a.z) / result.y4
    u3 = (g.rho3 * result.y5 + a.y) / result.y4
    bound = g.rho2 / Y4_RATIO_MIN
    length = sqrt(u2 * u2 + u3 * u3)
    assert length > 10.0 * bound
    assert_allclose(result.demanded[1:3], (u2 * bound / length, u3 * bound / length), rtol=1e-9)
    assert result.singular


def test_y4_falls_to_zero_in_flight_against_the_claim_after_13_and_the_branch_leads_out() -> None:
    # The body is ahead of an eastbound reference, so that the field is small and a outweighs the alignment:
    # y4 a4 + y5 (rho3 y5 + a5) < 0.
    h = 2e-4
    pose = Pose(Vec3(-0.02, 1.03, 0.0), IDENTITY)
    flight = []
    for n in range(round(5.0 / h)):
        r = Reference(Vec3(0.0, n * h, 0.0), Vec3(0.0, 1.0, 0.0), ZERO)
        flight.append(evaluate(SECTION_4_GAINS, UNBOUNDED, pose, r))
        u = flight[-1].controls
        pose = se3.compose(pose, se3.exp(Twist(Vec3(u.u1, u.u2, u.u3), Vec3(u.u4, 0.0, 0.0)), h))
    assert flight[0].y4 > 0.0
    assert not flight[0].singular
    first = next(n for n, result in enumerate(flight) if result.singular)
    last = max(n for n, result in enumerate(flight) if result.singular)
    assert 0.005 < first * h < last * h < 0.05
    assert all(result.y4 > 0.0 for result in flight)
    assert flight[-1].controls.u4 == pytest.approx(1.0, abs=0.01)
    assert se3.norm(flight[-1].e) < 0.01
