"""A least speed for vehicles that cannot turn at rest.

The forward-only law stops a vehicle that points away from its field; one with wheels or a rudder then never
turns, and stands there for ever. So it is never asked for less than a crawl where it points at a right angle
to its field or farther off, and for less of it the better it points: near alignment it is the law's speed
that damps the last of a turn. Nor for more than the field itself: what is to stand may stand. As the field
fades at its goal so does the crawl, and a field of `REST_PART` of the crawl is but the noise of a position.

What has come to rest at a goal that stands has overshot it by a little, or the position has drifted since. To
come back it would have to drive a whole loop, farther away than it is: it rests within its turning radius.
"""

from __future__ import annotations

from math import inf
from typing import Final

#: Below this part of the crawl the field asks for rest; from twice that on the crawl is whole.
REST_PART: Final = 0.15


def rest_m_s(
    crawl_m_s: float, per_s: float, radius_m: float, reference_m_s: float, previous_m_s: float
) -> float:
    """The field (m/s) below which nothing is asked for, of a field of `per_s` a metre.

    A vehicle that was asked to stand stands on within `radius_m` of a reference that does, and of one that
    is slow until it is as far off.
    """
    rest = REST_PART * crawl_m_s
    near = per_s * radius_m - reference_m_s
    return near if previous_m_s <= 0.0 and near > rest else rest


def crawl_floor(
    crawl_m_s: float,
    rest_m_s: float,
    field_m_s: float,
    along_m_s: float,
    previous_m_s: float,
    acceleration_m_s2: float,
    dt: float,
) -> float:
    """The least speed (m/s) that may be asked for where the desired field is `field_m_s` long, and
    `along_m_s` along b1.

    `previous_m_s` is the speed that was asked for `dt` s ago; the floor rises no faster than the vehicle can.
    Below `rest_m_s` of the field there is none, and a crawl of 0 is none.
    """
    if field_m_s <= rest_m_s:
        return 0.0
    floor = crawl_m_s if crawl_m_s < field_m_s else field_m_s
    if along_m_s > 0.0:
        floor *= 1.0 - along_m_s / field_m_s
    if field_m_s < 2.0 * rest_m_s:
        floor *= field_m_s / rest_m_s - 1.0
    if acceleration_m_s2 < inf:
        reached = max(previous_m_s, 0.0) + acceleration_m_s2 * dt
        if floor > reached:
            return reached
    return floor
