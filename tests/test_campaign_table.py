"""The table: hard starts are hard, `global` keeps its promise, and the figures say what was flown."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from guidance.law import Gains, desired_field
from guidance.se3 import body_axes, dot, norm, subtract
from guidance.trajectory import Helix, sample
from sitl.campaign.flight import OUTCOMES
from sitl.campaign.plan import Plan
from sitl.campaign.presets import hard_starts, table
from sitl.campaign.report import summary
from sitl.campaign.run import Result, load, run, save

pytestmark = pytest.mark.timeout(120)  # the first of these compiles, and other work may keep the machine busy

HARD: Final = [plan for plan in table(1) if plan.starts]


@pytest.mark.parametrize("plan", HARD, ids=[plan.name for plan in HARD])
def test_hard_starts_are_as_hard_as_their_names(plan: Plan) -> None:
    reference = sample(plan.trajectory, 0.0)
    gains = Gains(plan.k[0], 10.0, 10.0, plan.beta[0])
    seen = set()
    for start in plan.starts:
        field = desired_field(gains, start.position_ned_m, reference).Xr
        b1, b2, b3 = body_axes(start.attitude)
        y = (dot(b1, field), dot(b2, field), dot(b3, field))
        kind, _, size = start.name.partition(",")
        if size.endswith("m/s"):
            assert norm(field) == pytest.approx(float(size.split()[-2]))
        seen.add(kind)
        if kind == "exactly opposite":
            assert y[0] < 0.0
            assert y[1] == y[2] == 0.0
        elif kind == "field zero":
            assert norm(field) < 1e-15
        elif kind == "field orthogonal":
            assert abs(y[0]) < 1e-12 * norm(field)
        elif kind == "on the reference":
            assert start.position_ned_m == reference.position
            assert y[0] == pytest.approx(-norm(reference.velocity))
        elif kind == "ahead on the axis":
            assert start.position_ned_m[:2] == (0.0, 0.0)
            assert (y[0] < 0.0) == ("away" in start.name)
        else:
            assert kind == "ahead on the tangent"
            ahead = subtract(start.position_ned_m, reference.position)
            assert dot(ahead, reference.velocity) == pytest.approx(norm(ahead) * norm(reference.velocity))
            assert y[0] == pytest.approx(-norm(field))
    assert seen >= {"exactly opposite", "field zero", "field orthogonal", "ahead on the axis"}


def test_exactly_opposite_is_so_in_compiled_arithmetic_too() -> None:
    for plan in (plan for plan in HARD if plan.law == "global"):
        singular = run(plan, threads=1).outcome("singular_steps")
        for start, steps in zip(plan.starts, singular, strict=True):
            assert steps > 0.0 or "opposite" not in start.name, (plan.name, start.name)


def test_hard_starts_know_of_the_gains() -> None:
    gains = Gains(0.7, 10.0, 10.0, 1.9)
    reference = sample(Helix(), 0.0)
    for start in hard_starts(Helix(), gains.k, gains.beta):
        field = desired_field(gains, start.position_ned_m, reference).Xr
        b1, b2, b3 = body_axes(start.attitude)
        if start.name.startswith("exactly opposite"):
            assert dot(b1, field) == pytest.approx(-norm(field))
            assert math.hypot(dot(b2, field), dot(b3, field)) < 1e-14 * norm(field)


def test_in_the_table_global_converges_from_everywhere_and_paper_without_reverse_does_not() -> None:
    found = {}
    for plan in table(flights=200):
        result = run(plan, threads=1)
        found[plan.name] = summary(result)
    for name, figures in found.items():
        assert figures["not_finite"] == 0
        if "forward only" in name:
            assert 0.2 < figures["converged"] < 0.8
            assert figures["not_converged"]
        else:
            assert figures["converged"] == 1.0, name
            assert figures["in_time"] == 1.0, name
            assert figures["not_converged"] == []
            # Only a reference that flees on a line has longer than the 20 s of all others.
            assert (figures["due_s"] > 20.0) == ("line" in name)
    assert found["global, random"]["flights"] == found["global, 100 ms of lag"]["flights"] == 200
    assert found["global, helix at 0.9 v_max"]["flights"] == 20


def test_behind_a_reference_that_flees_the_law_is_as_fast_as_the_margin_of_speed_lets_it() -> None:
    (plan,) = (plan for plan in table(3000) if "line" in plan.name)
    result = run(plan)
    settled_s, distance_m = result.outcome("settled_s"), result.outcome("start_error_m")
    # Aligned, |e|' <= -min(k |e|, 5 m/s - 4.5 m/s); to turn round takes 0.7 s and loses 3 m.
    chase_m = distance_m + 3.0
    assert np.all(settled_s <= 0.7 + np.maximum(0.0, chase_m - 0.5) / 0.5 + math.log(0.5 / 0.01))
    assert settled_s.max() <= plan.due_s
    # Nobody is there before |d - v t| = v_max t, d being the way to the reference at the start.
    along = -result.parameters["north_m"]
    least_s = (4.5 * along + np.sqrt((4.5 * along) ** 2 + (5.0**2 - 4.5**2) * distance_m**2)) / (
        5.0**2 - 4.5**2
    )
    assert np.all(settled_s >= least_s - 0.02 - 0.02)
    assert np.mean(least_s > 20.0) > 0.3


def synthetic() -> Result:
    """Four flights: one that settled at 5 s, one at 25 s, one that left again, one that never came."""
    outcomes = np.zeros((4, len(OUTCOMES)))
    columns = {
        "entered_s": [5.0, 5.0, 5.0, np.nan],
        "settled_s": [5.0, 25.0, np.nan, np.nan],
        "final_error_m": [0.001, 0.002, 1.0, 40.0],
        "excursion_m": [0.009, 0.5, 2.0, np.nan],
        "finite": [1.0, 1.0, 1.0, 1.0],
        "start_error_m": [1.0, 10.0, 20.0, 40.0],
        "start_heading_error_rad": [0.0, 1.0, 2.0, math.pi],
    }
    for name, values in columns.items():
        outcomes[:, OUTCOMES.index(name)] = values
    return Result(Plan(flights=4), {"north_m": np.arange(4.0)}, outcomes)


def test_the_summary_counts_what_converged_what_was_in_time_and_what_left() -> None:
    found = summary(synthetic())
    assert found["converged"] == 0.5
    assert found["in_time"] == 0.25
    assert found["due_s"] == 20.0
    assert summary(replace(synthetic(), plan=Plan(flights=4, due_s=25.0)))["in_time"] == 0.5
    assert found["entered"] == 0.75
    assert found["left"] == 0.25
    assert found["not_converged"] == [2, 3]
    assert found["settled_s"]["median"] == 15.0
    assert found["settled_s"]["max"] == 25.0
    assert found["final_error_m"]["max"] == 40.0
    assert found["excursion_m"]["max"] == 2.0
    json.dumps(found, allow_nan=False)


def test_a_file_holds_the_plan_and_a_value_per_flight(tmp_path: Path) -> None:
    path = tmp_path / "campaign.npz"
    plan = Plan(flights=50, seed=7, duration_s=3.0, law="global", k=(0.5, 2.0))
    result = run(plan, threads=1)
    save([result, replace(synthetic(), plan=replace(plan, name="other, with / in it", flights=4))], path)
    found = load(path)
    assert set(found) == {"campaign", "other, with / in it"}
    assert json.loads(str(found["campaign"]["plan"]))["seed"] == 7
    assert_array_equal(found["campaign"]["settled_s"], result.outcome("settled_s"))
    assert found["campaign"]["k"].shape == (50,)
    assert "beta" not in found["campaign"]
