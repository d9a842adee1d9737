"""A least speed for vehicles that cannot turn at rest.

The forward-only law stops a vehicle that points away from its field; one with wheels or a rudder then never
turns, and stands there for ever. So it is never asked for less than a crawl where it points at a right angle
to its field or farther off, and for less of it the better it points: near alignment it is the law's speed
that damps the last of a turn. Nor for more than the field itself: what is to stand may stand. As the field
fades at its goal so does the crawl, and a field of `REST_PART` of the crawl is but the noise of a position.
"""

from __future__ import annotations

from math import inf
from typing import Final

#: Below this part of the crawl the field asks for rest; from twice that on the crawl is whole.
REST_PART: Final = 0.15


def crawl_floor(
    crawl_m_s: float,
    field_m_s: float,
    along_m_s: float,
    previous_m_s: float,
    acceleration_m_s2: float,
    dt: float,
) -> float:
    """The least speed (m/s) that may be asked for where the desired field is `field_m_s` long, and
    `along_m_s` along b1.

    `previous_m_s` is the speed that was asked for `dt` s ago; the floor rises no faster than the vehicle can.
    A crawl of 0 is none.
    """
    rest = REST_PART * crawl_m_s
    if field_m_s <= rest:
        return 0.0
    floor = crawl_m_s if crawl_m_s < field_m_s else field_m_s
    if along_m_s > 0.0:
        floor *= 1.0 - along_m_s / field_m_s
    if field_m_s < 2.0 * rest:
        floor *= field_m_s / rest - 1.0
    if acceleration_m_s2 < inf:
        reached = max(previous_m_s, 0.0) + acceleration_m_s2 * dt
        if floor > reached:
            return reached
    return floor
