"""The arc length of a lemniscate and its inverse: the phase at which a point of constant speed is.

The length of (A sin p, B/2 sin 2p) is an elliptic integral. It is tabulated once for a shape, over panels
that are halved towards where a long or a wide one bends, with ten points of Gauss in each; its inverse is
Newton's. Both are exact to rounding for every proportion, which no series of a fixed length is.
"""

from __future__ import annotations

from bisect import bisect_right
from functools import lru_cache
from itertools import pairwise
from math import cos, floor, pi, sqrt
from typing import Final, NamedTuple

#: Nodes and weights of Gauss and Legendre on [-1, 1], of the positive nodes.
_GAUSS: Final = (
    (0.1488743389816312, 0.2955242247147529),
    (0.4333953941292472, 0.2692667193099963),
    (0.6794095682990244, 0.2190863625159820),
    (0.8650633666889845, 0.1494513491505806),
    (0.9739065285171717, 0.0666713443086881),
)
#: Newton's steps at most; four are enough but where a panel bends most.
_STEPS: Final = 12


class _Quarter(NamedTuple):
    """The first quarter of an eight: phases (rad, 0 to pi/2), and the arc (m) from 0 to each."""

    phases: tuple[float, ...]
    arcs_m: tuple[float, ...]


def stretch_m(phase: float, half_m: float, width_m: float) -> float:
    """|dr/dp| of (half sin p, width/2 sin 2p), m per rad."""
    return sqrt((half_m * cos(phase)) ** 2 + (width_m * cos(2.0 * phase)) ** 2)


def quarter_m(half_m: float, width_m: float) -> float:
    """The length of a quarter of the eight, from its crossing to an end."""
    return _quarter(half_m, width_m).arcs_m[-1]


def phase_at(arc_m: float, half_m: float, width_m: float) -> float:
    """The phase (rad) that is `arc_m` along the eight from its crossing (either way, any number of turns)."""
    quarter = _quarter(half_m, width_m)
    half_turn_m = 2.0 * quarter.arcs_m[-1]
    turns = floor(arc_m / half_turn_m)
    rest_m = arc_m - turns * half_turn_m
    if rest_m > quarter.arcs_m[-1]:  # the way back to the crossing is the way out, mirrored
        return (turns + 1) * pi - _inverse(quarter, max(half_turn_m - rest_m, 0.0), half_m, width_m)
    return turns * pi + _inverse(quarter, rest_m, half_m, width_m)


def _inverse(quarter: _Quarter, arc_m: float, half_m: float, width_m: float) -> float:
    """Within the first quarter."""
    i = min(bisect_right(quarter.arcs_m, arc_m), len(quarter.arcs_m) - 1) - 1
    low, high = quarter.phases[i], quarter.phases[i + 1]
    missing_m = arc_m - quarter.arcs_m[i]
    phase = low + (high - low) * missing_m / (quarter.arcs_m[i + 1] - quarter.arcs_m[i])
    for _ in range(_STEPS):
        off_m = _arc_m(low, phase, half_m, width_m) - missing_m
        change = off_m / stretch_m(phase, half_m, width_m)
        phase = min(max(phase - change, low), high)
        if abs(change) < 1e-7 * (high - low):  # it converges quadratically: this was the last that matters
            break
    return phase


@lru_cache(maxsize=16)
def _quarter(half_m: float, width_m: float) -> _Quarter:
    middle, end = 0.25 * pi, 0.5 * pi
    # beside these phases |dr/dp| has a root in the complex plane, so near that it says how small a panel is
    near_side, near_end = half_m / (4.0 * width_m), width_m / (2.0 * half_m)
    phases = sorted(
        {0.0, middle, end}
        | {middle - d for d in _halved(middle, near_side)}
        | {middle + d for d in _halved(0.5 * middle, near_side)}
        | {end - d for d in _halved(0.5 * middle, near_end)}
    )
    arcs_m = [0.0]
    for low, high in pairwise(phases):
        arcs_m.append(arcs_m[-1] + _arc_m(low, high, half_m, width_m))
    return _Quarter(tuple(phases), tuple(arcs_m))


def _halved(widest: float, least: float) -> list[float]:
    widths = [widest]
    while widths[-1] > min(least, 0.5 * widest):
        widths.append(0.5 * widths[-1])
    return widths


def _arc_m(low: float, high: float, half_m: float, width_m: float) -> float:
    centre, reach = 0.5 * (low + high), 0.5 * (high - low)
    total = 0.0
    for node, weight in _GAUSS:
        total += weight * (
            stretch_m(centre - reach * node, half_m, width_m)
            + stretch_m(centre + reach * node, half_m, width_m)
        )
    return reach * total
