"""How the vehicle moves until a setpoint acts: what was measured, and the setpoints that act in between.

A vehicle that is seen late and obeys late is turning by then as the setpoints say that are on their way to
it. The rates that were measured, held for so long, make a loop unstable whose gain times delay is more than
about a half; the rates that were sent take the delay out of the loop (Smith's predictor). So a measured rate
holds until the next setpoint acts, and from there each setpoint until the one after it. That a single one is
lost or overtaken hardly matters: those around it ask for nearly the same.

Only the rates are taken from the setpoints. They must be known well, for the law turns fast, and autopilots
close a loop on them; the velocity follows from a map of thrust, and from current or wind, that nobody knows
as well as it is measured. In body axes it stays as it was.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from guidance.se3 import Pose, Twist, Vec3, compose, exp

#: So many setpoints are remembered: 1.3 s at 50 Hz. Before the oldest, what was measured holds.
REMEMBERED: Final = 64


class Acting(NamedTuple):
    """A setpoint's body rates (FRD, rad/s), and the instant from which the vehicle is taken to obey it."""

    instant_ns: int
    body_rates_frd_rad_s: Vec3


#: The last setpoints, in the order in which they were sent; at most `REMEMBERED`.
History = tuple[Acting, ...]
NOTHING_SENT: Final[History] = ()


def sent(history: History, instant_ns: int, body_rates_frd_rad_s: Vec3) -> History:
    """The history with one more setpoint, which acts at `instant_ns`."""
    return (*history[1 - REMEMBERED :], Acting(instant_ns, body_rates_frd_rad_s))


def predict(history: History, pose: Pose, twist: Twist, from_ns: int, to_ns: int) -> tuple[Pose, Twist]:
    """Pose and twist at `to_ns` of a vehicle that had these at `from_ns`; before it, by the twist alone.

    Exact for a vehicle that obeys at once and keeps its velocity in body axes.
    """
    following = len(history)
    while following and history[following - 1].instant_ns > from_ns:
        following -= 1
    at_ns = from_ns
    for instant_ns, rates in history[following:]:
        if instant_ns >= to_ns:
            break
        pose = compose(pose, exp(twist, (instant_ns - at_ns) * 1e-9))
        twist = Twist(rates, twist.linear)
        at_ns = instant_ns
    return compose(pose, exp(twist, (to_ns - at_ns) * 1e-9)), twist
