"""Hypothesis strategies and other states to start from, and the settings of the property tests."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

from hypothesis import settings
from hypothesis import strategies as st

from guidance.law import Gains, Limits
from guidance.se3 import IDENTITY, ZERO, Pose, Quaternion, Reference, Twist, Vec3, subtract

INF = float("inf")
UNBOUNDED = Limits(-INF, INF, INF, INF, INF)
#: Section 4: |u_i| <= 5.
SECTION_4_BOUNDS = Limits(-5.0, 5.0, 5.0, 5.0, 5.0)
#: Section 4: beta = k = 1, both rho 10.
SECTION_4_GAINS = Gains(k=1.0, rho2=10.0, rho3=10.0, beta=1.0)

#: The same examples in every run, and few enough for the suite to stay quick.
properties = settings(derandomize=True, max_examples=60, deadline=None, database=None)


def reals(bound: float) -> st.SearchStrategy[float]:
    """Finite numbers in [-bound, bound], zero and denormals among them."""
    return st.floats(-bound, bound, allow_nan=False, allow_infinity=False)


def angles() -> st.SearchStrategy[float]:
    """Angles in rad over more than one turn."""
    return reals(2.0 * pi)


def vectors(bound: float = 100.0) -> st.SearchStrategy[Vec3]:
    """Vectors with components in [-bound, bound]."""
    return st.builds(Vec3, reals(bound), reals(bound), reals(bound))


def _uniform_quaternion(s: float, angle_1: float, angle_2: float) -> Quaternion:
    a, b = sqrt(1.0 - s), sqrt(s)
    return Quaternion(a * sin(angle_1), a * cos(angle_1), b * sin(angle_2), b * cos(angle_2))


def quaternions() -> st.SearchStrategy[Quaternion]:
    """Unit quaternions over all of S^3."""
    return st.builds(_uniform_quaternion, st.floats(0.0, 1.0), angles(), angles())


def poses(bound: float = 100.0) -> st.SearchStrategy[Pose]:
    """Any attitude, position components in [-bound, bound]."""
    return st.builds(Pose, vectors(bound), quaternions())


def twists(bound: float = 5.0) -> st.SearchStrategy[Twist]:
    """Rates and velocities with components in [-bound, bound]."""
    return st.builds(Twist, vectors(bound), vectors(bound))


def references() -> st.SearchStrategy[Reference]:
    """Positions to 100 m, velocities to 10 m/s, accelerations to 5 m/s^2."""
    return st.builds(Reference, vectors(100.0), vectors(10.0), vectors(5.0))


def gains() -> st.SearchStrategy[Gains]:
    """Positive gains around the paper's, beta != 1 and rho2 != rho3 among them."""
    return st.builds(
        Gains, st.floats(0.1, 3.0), st.floats(0.5, 12.0), st.floats(0.5, 12.0), st.floats(0.2, 5.0)
    )


def limits() -> st.SearchStrategy[Limits]:
    """Vehicles with and without reverse, each control clamped on its own."""
    positive = st.floats(0.01, 10.0)
    return st.tuples(st.floats(-5.0, 0.0), positive, positive, positive, positive).map(lambda t: Limits(*t))


def facing(sine: float, side: float, speed: float = 1.0, a: Vec3 = ZERO) -> tuple[Pose, Reference]:
    """A body at the origin with b1 north, and a reference there whose field has y4 = speed * sine.

    `side` turns the rest of the field about b1: 0 is to the right, pi/2 is down. `a` is the paper's a. Both
    for beta = k = 1.
    """
    across = speed * sqrt(1.0 - sine * sine)
    v = Vec3(speed * sine, across * cos(side), across * sin(side))
    return Pose(ZERO, IDENTITY), Reference(ZERO, v, subtract(a, v))
