"""Section 4 of the paper: the closed loop behind figures 1 to 4, integrated with the law that flies.

    R' = R hat(u1, u2, u3)        x' = u4 b1                                    (1)

with u from `guidance.law` evaluated in every stage of a Runge-Kutta rule of fourth order, as a law in
continuous time; nothing is held over a step. What (15) asks of an integrator besides:

- Steps end on the corners and on the samples. Up to a corner r' is that of the leg which ends there, in the
  stage at the corner too; from the corner on, and in the sample at the corner, that of the leg which begins.
- At a corner the field stands at a right angle to b1, where (11) divides by zero. What happens is the named
  branch of `guidance.law`: b1 turns towards the field. It does so at 200 rad/s where nothing bounds the
  rates, so a step is shortened in proportion wherever the body turns faster than `FULL_STEP_RATE_RAD_S`.
  Half the step is half of each of these, and the result converges.

Figures 2 to 4 are on SE(2): yaw rate and forward speed alone, errors in the plane, R = -I is the heading pi.
"""

from __future__ import annotations

from math import ceil, inf, isfinite, nextafter, pi, sqrt
from typing import Any, Final, NamedTuple

import msgspec

from guidance.law import Y4_RATIO_MIN, Controls, Gains, Limits, evaluate, planar
from guidance.se3 import (
    IDENTITY,
    Pose,
    Quaternion,
    Reference,
    Vec3,
    body_axes,
    from_yaw,
    normalized,
    subtract,
)
from guidance.trajectory import Helix, Trajectory, Zigzag, sample

#: The step with which the default figures are made; `tests/test_paper_figures.py` says what it is good for.
STEP_S: Final = 0.005
SAMPLE_S: Final = 0.02
#: From the longest step on, halving it still changes no error before the first corner by 1 % or 1 um; with
#: rho = 10 the rule is unstable from 0.28 s. Below the shortest a figure takes more than ten minutes.
STEP_MIN_S: Final = 1e-5
STEP_MAX_S: Final = 0.1
SAMPLE_MIN_S: Final = 1e-3
#: A body that turns faster than this gets shorter steps: none turns it by more than this times the step.
#: Few steps over a flight, and all of them where they matter: a right angle takes some 600 steps of 5 ms.
FULL_STEP_RATE_RAD_S: Final = 0.5


class Problem(NamedTuple):
    """What a figure shows: a law, a reference, and a start. Infinite limits are none.

    `corners_s` are the instants at which r' jumps. On SE(2) (`in_plane`) errors have two components.
    """

    caption: str
    in_plane: bool
    gains: Gains
    limits: Limits
    start: Pose
    reference: Trajectory
    corners_s: tuple[float, ...] = ()
    end_s: float = 100.0


class Sample(NamedTuple):
    """One instant: reference and pose in the world of the paper (m), and what the law says there."""

    t_s: float
    reference: Reference
    pose: Pose
    controls: Controls


_GAINS: Final = Gains(k=1.0, rho2=10.0, rho3=10.0, beta=1.0)
_UNBOUNDED: Final = Limits(-inf, inf, inf, inf, inf)
_BOUNDED: Final = Limits(-5.0, 5.0, 5.0, 5.0, 5.0)
_ZIGZAG_START: Final = Pose(Vec3(20.0, 100.0, 0.0), from_yaw(pi))

FIGURES: Final = {
    1: Problem(
        "Tracking error r(t) - x(t), SE(3), x(0) = (-10, -30, -5), R(0) = I",
        in_plane=False,
        gains=_GAINS,
        limits=_UNBOUNDED,
        start=Pose(Vec3(-10.0, -30.0, -5.0), IDENTITY),
        reference=Helix(radius_m=1.0, speed_m_s=0.1, down_m_s=0.1),
    ),
    2: Problem(
        "Tracking error r(t) - x(t), SE(2), x(0) = (20, 100), R(0) = -I",
        in_plane=True,
        gains=_GAINS,
        limits=_UNBOUNDED,
        start=_ZIGZAG_START,
        reference=Zigzag(leg_m=30.0, speed_m_s=1.0),
        corners_s=(30.0, 60.0),
    ),
    3: Problem(
        "Tracking error r(t) - x(t), SE(2) with bounded actuators, x(0) = (20, 100), R(0) = -I",
        in_plane=True,
        gains=_GAINS,
        limits=_BOUNDED,
        start=_ZIGZAG_START,
        reference=Zigzag(leg_m=30.0, speed_m_s=1.0),
        corners_s=(30.0, 60.0),
    ),
    4: Problem(
        "Reference and vehicle location, SE(2) with bounded actuators, x(0) = (20, 100), R(0) = -I",
        in_plane=True,
        gains=_GAINS,
        limits=_BOUNDED,
        start=_ZIGZAG_START,
        reference=Zigzag(leg_m=30.0, speed_m_s=1.0),
        corners_s=(30.0, 60.0),
    ),
}


def check(number: int, step_s: float, sample_s: float) -> None:
    """Refuse what cannot be integrated.

    Raises:
        ValueError: naming the option, what it must be and what it is.
    """
    if number not in FIGURES:
        raise ValueError(f"--figure must be 1, 2, 3 or 4, not {number}")
    if not STEP_MIN_S <= step_s <= STEP_MAX_S:
        raise ValueError(f"--step must be {STEP_MIN_S:g} to {STEP_MAX_S:g} s, not {step_s:g}")
    end_s = FIGURES[number].end_s
    if not SAMPLE_MIN_S <= sample_s <= end_s:
        raise ValueError(f"--sample must be {SAMPLE_MIN_S:g} to {end_s:g} s, not {sample_s:g}")


def simulate(problem: Problem, step_s: float = STEP_S, sample_s: float = SAMPLE_S) -> list[Sample]:
    """The closed loop from `problem.start`, sampled at 0, `sample_s`, ... up to `problem.end_s` (s).

    `step_s` is the longest step, both are positive. `sample_s` counts in whole nanoseconds, so that no
    rounding accumulates in the times.
    """
    sample_ns = round(sample_s * 1e9)
    times = [n * sample_ns / 1e9 for n in range(int(round(problem.end_s * 1e9) // sample_ns) + 1)]
    samples = []
    pose, now = problem.start, 0.0
    for t in times:
        for corner in problem.corners_s:
            if now < corner < t:
                pose, now = _advance(problem, pose, now, corner, step_s), corner
        pose, now = _advance(problem, pose, now, t, step_s), t
        samples.append(Sample(t, sample(problem.reference, t), pose, controls(problem, pose, t)))
    return samples


def controls(problem: Problem, pose: Pose, t_s: float) -> Controls:
    """The law at one instant, after the limits: the one place where the figures call `guidance.law`."""
    reference = sample(problem.reference, t_s)
    if problem.in_plane:
        pose, reference = planar(pose, reference)
    return evaluate(problem.gains, problem.limits, pose, reference).controls


def error(problem: Problem, at: Sample) -> Vec3:
    """r - x in m, as the paper plots it; on SE(2) the third component is zero."""
    difference = subtract(at.reference.position, at.pose.position)
    return difference._replace(z=0.0) if problem.in_plane else difference


def report(number: int, step_s: float = STEP_S, sample_s: float = SAMPLE_S) -> dict[str, Any]:
    """Figure `number` as numbers, ready for JSON: `t`, `error`, `controls`, `parameters`; see docs/law.md.

    Vectors have three components on SE(3) and two on SE(2), `controls` always four. Without a limit,
    a limit is None. Figure 4 has `reference` and `position` too.

    Raises:
        ValueError: of `check`.
    """
    check(number, step_s, sample_s)
    problem = FIGURES[number]
    samples = simulate(problem, step_s, sample_s)
    size = 2 if problem.in_plane else 3
    numbers: dict[str, Any] = {
        "figure": number,
        "t": [at.t_s for at in samples],
        "error": [error(problem, at)[:size] for at in samples],
        "controls": [at.controls for at in samples],
        "parameters": _parameters(problem, step_s, sample_s),
    }
    if number == 4:
        numbers["reference"] = [at.reference.position[:size] for at in samples]
        numbers["position"] = [at.pose.position[:size] for at in samples]
    return numbers


def _parameters(problem: Problem, step_s: float, sample_s: float) -> dict[str, Any]:
    size = 2 if problem.in_plane else 3
    limits = dict(zip(Limits._fields[:5], problem.limits, strict=False))  # section 4 has no others
    return {
        "caption": problem.caption,
        "space": "SE(2)" if problem.in_plane else "SE(3)",
        "gains": problem.gains._asdict(),
        "limits": {name: value if isfinite(value) else None for name, value in limits.items()},
        "start": {
            "position_m": problem.start.position[:size],
            "R": list(zip(*(axis[:size] for axis in body_axes(problem.start.attitude)[:size]), strict=True)),
        },
        "reference": msgspec.to_builtins(problem.reference),
        "corners_s": problem.corners_s,
        "end_s": problem.end_s,
        "controls": ["u1_rad_s", "u2_rad_s", "u3_rad_s", "u4_m_s"],
        "y4_ratio_min": Y4_RATIO_MIN,
        "step_s": step_s,
        "sample_s": sample_s,
    }


def _advance(problem: Problem, pose: Pose, now: float, end: float, step_s: float) -> Pose:
    """The pose at `end`, with no corner between `now` and `end`; one at `end` is met from before."""
    latest = nextafter(end, 0.0) if end in problem.corners_s else end
    while now < end:
        first = _rate(problem, pose, now)
        turn_rate = 2.0 * sqrt(first[3] ** 2 + first[4] ** 2 + first[5] ** 2 + first[6] ** 2)
        longest = step_s / max(1.0, turn_rate / FULL_STEP_RATE_RAD_S)
        steps = ceil((end - now) / longest * (1.0 - 1e-9))
        dt = (end - now) / steps
        after = end if steps == 1 else now + dt
        second = _rate(problem, _moved(pose, first, 0.5 * dt), now + 0.5 * dt)
        third = _rate(problem, _moved(pose, second, 0.5 * dt), now + 0.5 * dt)
        fourth = _rate(problem, _moved(pose, third, dt), min(after, latest))
        mean = tuple(
            (a + 2.0 * b + 2.0 * c + d) / 6.0 for a, b, c, d in zip(first, second, third, fourth, strict=True)
        )
        pose, now = _moved(pose, mean, dt), after
    return pose


def _rate(problem: Problem, pose: Pose, t_s: float) -> tuple[float, ...]:
    """(1) under the law: x' and q' = 1/2 q (0, u1, u2, u3)."""
    u1, u2, u3, u4 = controls(problem, pose, t_s)
    w, x, y, z = pose.attitude
    b1 = body_axes(pose.attitude)[0]
    return (
        u4 * b1.x,
        u4 * b1.y,
        u4 * b1.z,
        -0.5 * (x * u1 + y * u2 + z * u3),
        0.5 * (w * u1 + y * u3 - z * u2),
        0.5 * (w * u2 + z * u1 - x * u3),
        0.5 * (w * u3 + x * u2 - y * u1),
    )


def _moved(pose: Pose, rate: tuple[float, ...], dt: float) -> Pose:
    """A step along `rate`, back onto the unit quaternions."""
    p, q = pose
    return Pose(
        Vec3(p.x + dt * rate[0], p.y + dt * rate[1], p.z + dt * rate[2]),
        normalized(
            Quaternion(q.w + dt * rate[3], q.x + dt * rate[4], q.y + dt * rate[5], q.z + dt * rate[6])
        ),
    )
