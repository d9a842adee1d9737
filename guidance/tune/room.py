"""Whether the room that steps need is inside the fence, and what is said if it is not."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, hypot
from typing import Final

from guidance.geofence import Corner, Fence
from guidance.se3 import Vec3
from guidance.tune.excitation import Box, corners_ned_m
from guidance.tune.way_back import Place

#: The edge of the room is looked at in pieces of this length, m.
LOOK_M: Final = 1.0
#: An estimate wanders by less, and so do corners 50 m off with its heading.
SPARE_M: Final = 2.0


def outside_m(fence: Fence, box: Box, place: Place, down_m: float) -> float:
    """How far the room from this start is outside, 0 if it is inside."""
    corners = corners_ned_m(box, *place)
    levels = (down_m - box.up_m, down_m + box.down_m)
    return max(fence.outside_m(Vec3(*at, level)) for at in _edge(corners) for level in levels)


def in_words(box: Box) -> str:
    """The room, from the start and along its heading."""
    level = f"{box.ahead_m:.0f} m ahead, {box.behind_m:.0f} m behind, {box.right_m:.0f} m to the right and "
    height = f", {box.up_m:.0f} m up and {box.down_m:.0f} m down" if box.up_m or box.down_m else ""
    return f"{level}{box.left_m:.0f} m to the left{height}"


def fence_in_words(box: Box, place: Place) -> str:
    """A line of [guards] that holds it, and a start that is seen a little elsewhere."""
    wide = Box(*(side + SPARE_M for side in box))
    corners = ", ".join(f"[{n:.1f}, {e:.1f}]" for n, e in corners_ned_m(wide, *place))
    return f"fence_ned_m = [{corners}]"


def _edge(corners: tuple[Corner, ...]) -> Iterator[Corner]:
    for (n0, e0), (n1, e1) in zip(corners, (*corners[1:], corners[0]), strict=True):
        pieces = max(1, ceil(hypot(n1 - n0, e1 - e0) / LOOK_M))
        yield from ((n0 + (n1 - n0) * k / pieces, e0 + (e1 - e0) * k / pieces) for k in range(pieces))
