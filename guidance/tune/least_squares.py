"""Least squares for a handful of unknowns, by Levenberg and Marquardt, in plain Python.

The vehicle has no array library, and four to six unknowns need none.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf, isfinite, sqrt
from typing import Final, NamedTuple

MOST_STEPS: Final = 40
#: An improvement by less than this part ends it.
ENOUGH: Final = 1e-5
DAMPING: Final = 1e-3
DAMPING_MOST: Final = 1e8
LEAST_EFFECT: Final = 1e-9
#: A pivot that is no more than this part of the largest number.
SINGULAR: Final = 1e-14
#: Difference of each unknown for the derivatives; all unknowns are of the order of 0.01 to 10.
DIFFERENCE: Final = 1e-4

Model = Callable[[Sequence[float]], list[float]]


class Fit(NamedTuple):
    """The unknowns, the sum of squares, and the standard error of each (inf: the data does not tell)."""

    unknowns: tuple[float, ...]
    squares: float
    errors: tuple[float, ...]


def fitted(
    model: Model,
    measured: Sequence[float],
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    most_steps: int = MOST_STEPS,
) -> Fit:
    """The unknowns within `bounds` for which `model` comes closest to `measured`, from this start.

    The errors take the residuals as independent, with their own variance.
    """
    x = [min(max(value, low), high) for value, (low, high) in zip(start, bounds, strict=True)]
    residuals = _residuals(model, measured, x)
    squares = _dot(residuals, residuals)
    damping = DAMPING
    normal, slope = _normal_equations(model, measured, x, residuals, bounds)
    for _ in range(most_steps):
        # an unknown without effect here, such as a limit that is not reached, stays where it is
        floor = LEAST_EFFECT * max(row[i] for i, row in enumerate(normal))
        damped = [
            [value + (damping * max(row[i], floor) if i == j else 0.0) for j, value in enumerate(row)]
            for i, row in enumerate(normal)
        ]
        step = _solved(damped, slope)
        tried = [
            min(max(value + change, low), high)
            for value, change, (low, high) in zip(x, step, bounds, strict=True)
        ]
        left = _residuals(model, measured, tried)
        now = _dot(left, left)
        if now < squares:
            better = squares - now
            x, residuals, squares = tried, left, now
            damping *= 0.2
            if better < ENOUGH * squares:
                break
            normal, slope = _normal_equations(model, measured, x, residuals, bounds)
        else:
            damping *= 5.0
            if damping > DAMPING_MOST or max(map(abs, step)) < 1e-7:
                break
    normal, _ = _normal_equations(model, measured, x, residuals, bounds)
    return Fit(tuple(x), squares, _errors(normal, squares, len(measured)))


def _residuals(model: Model, measured: Sequence[float], x: Sequence[float]) -> list[float]:
    return [m - y for m, y in zip(measured, model(x), strict=True)]


def _normal_equations(
    model: Model,
    measured: Sequence[float],
    x: Sequence[float],
    residuals: Sequence[float],
    bounds: Sequence[tuple[float, float]],
) -> tuple[list[list[float]], list[float]]:
    """J'J and J'r, with differences that stay within the bounds."""
    columns = []
    for i, (_, high) in enumerate(bounds):
        h = DIFFERENCE if x[i] + DIFFERENCE <= high else -DIFFERENCE
        moved = [*x[:i], x[i] + h, *x[i + 1 :]]
        other = _residuals(model, measured, moved)
        columns.append([(r - o) / h for r, o in zip(residuals, other, strict=True)])
    return [[_dot(a, b) for b in columns] for a in columns], [_dot(a, residuals) for a in columns]


def _errors(normal: Sequence[Sequence[float]], squares: float, count: int) -> tuple[float, ...]:
    """Square roots of the diagonal of the covariance."""
    size = len(normal)
    variance = squares / max(count - size, 1)
    errors = []
    for i in range(size):
        unit = [1.0 if j == i else 0.0 for j in range(size)]
        inverse = _solved(normal, unit)[i]
        errors.append(sqrt(variance * inverse) if isfinite(inverse) and inverse > 0.0 else inf)
    return tuple(errors)


def _solved(matrix: Sequence[Sequence[float]], right: Sequence[float]) -> list[float]:
    """By Gauss with pivots; of a singular matrix, inf."""
    size = len(right)
    least = SINGULAR * max(abs(value) for row in matrix for value in row)
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for i in range(size):
        pivot = max(range(i, size), key=lambda j: abs(rows[j][i]))
        rows[i], rows[pivot] = rows[pivot], rows[i]
        if abs(rows[i][i]) <= least:
            return [inf] * size
        for j in range(i + 1, size):
            part = rows[j][i] / rows[i][i]
            for k in range(i, size + 1):
                rows[j][k] -= part * rows[i][k]
    solution = [0.0] * size
    for i in reversed(range(size)):
        left = sum(rows[i][k] * solution[k] for k in range(i + 1, size))
        solution[i] = (rows[i][size] - left) / rows[i][i]
    return solution


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))
