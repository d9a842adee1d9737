"""Fewer points for a display, so that no peak is lost: of each bucket, about a pixel wide, the extremes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from guidance.report.columns import Floats

#: So many buckets for the width of a plot: about its pixels.
BUCKETS: Final = 1200
#: A line is broken where nothing came for so long, s, for this part of all, or for so many usual steps.
_GAP_S: Final = 0.5
_GAP_PART: Final = 1.0 / 500.0
_GAP_STEPS: Final = 3.0


def thin(x: Floats, y: Floats, buckets: int = BUCKETS) -> tuple[Floats, Floats]:
    """A line of at most about 2 `buckets` points with the minimum and maximum of each; NaN breaks it at gaps.

    `x` rises and is in s.
    """
    if not len(x):
        return x, y
    gap_s = max(
        _GAP_S, (x[-1] - x[0]) * _GAP_PART, _GAP_STEPS * float(np.median(np.diff(x))) if len(x) > 1 else 0.0
    )
    parts = np.split(np.arange(len(x)), np.flatnonzero(np.diff(x) > gap_s) + 1)
    xs: list[Floats] = []
    ys: list[Floats] = []
    for part in parts:
        rows = part[extremes(y[part][:, None], max(buckets * len(part) // len(x), 1))]
        xs += [x[rows], x[rows[-1:]]]
        ys += [y[rows], np.array([np.nan])]
    return np.concatenate(xs[:-1]), np.concatenate(ys[:-1])


def thin_path(places: Floats, buckets: int = BUCKETS) -> Floats:
    """A path (n, d) of at most 2 d `buckets` points: the extremes of each coordinate in each bucket."""
    kept: Floats = places[extremes(places, buckets)]
    return kept


def extremes(values: Floats, buckets: int) -> NDArray[np.int64]:
    """The rows, in order, where a column of `values` (n, d) is least or most in a bucket; first and last."""
    count = len(values)
    width = -(-count // buckets)
    if width <= 2 or not count:
        return np.arange(count)
    padded = np.full((-(-count // width) * width, values.shape[1]), np.nan)
    padded[:count] = values
    folded = padded.reshape(-1, width, values.shape[1])
    starts = np.arange(len(folded))[:, None] * width
    least = np.where(np.isnan(folded), np.inf, folded).argmin(axis=1) + starts
    most = np.where(np.isnan(folded), -np.inf, folded).argmax(axis=1) + starts
    return np.unique(np.concatenate((least.ravel(), most.ravel(), [0, count - 1])))
