"""Steps that show how a vehicle answers, one channel at a time, and the room that they take.

A run steps one channel up and down around a value and asks for constants of the others; a channel that it
does not name stays with the guidance, as the height of an airplane while it banks. Every run starts with a
lead at rest on its channel, and runs are flown from one place: the guidance returns in between. Steps come in
opposite pairs, so that the vehicle stays about on its line, and small and large, so that lags and limits can
be told apart. All are well inside the limits: what saturates shows the limit only.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate
from math import cos, radians, sin, tan
from typing import Final, NamedTuple

#: Channels of vehicles that drive; copters have the first, too.
YAW_RATE: Final = "yaw_rate_rad_s"
SPEED: Final = "speed_m_s"
#: Of airplanes.
ROLL: Final = "roll_rad"
PITCH: Final = "pitch_rad"
THROTTLE: Final = "throttle"
#: Of copters.
VELOCITY: Final = ("north_m_s", "east_m_s", "down_m_s")
CHANNELS: Final = frozenset({YAW_RATE, SPEED, ROLL, PITCH, THROTTLE, *VELOCITY})

GRAVITY_M_S2: Final = 9.80665
#: Of what a limit allows, a step takes at most this part.
PART: Final = 0.5
LEAD_S: Final = 2.0
#: What small steps are of large ones.
SMALL: Final = 0.3
YAW_RATE_RAD_S: Final = 1.0
BANK_RAD: Final = radians(40.0)
PITCH_RAD: Final = radians(5.0)
THROTTLE_STEP: Final = 0.15
THROTTLE_S: Final = 4.0
#: A throttle stays between these, and a step smaller than the last says nothing.
THROTTLE_ENDS: Final = (0.05, 0.95)
THROTTLE_LEAST: Final = 0.05
VELOCITY_M_S: Final = 2.0
CLIMB_M_S: Final = 1.0

#: Room is counted for vehicles that turn by these parts of what is asked, and for one that is faster by this.
TURNS: Final = (0.7, 1.0, 1.2)
FASTER: Final = 1.15
#: After the last hold the vehicle goes on for so long, s. What is added on every side: m, and of an airplane
#: s of its flight, for what the guidance does not hold exactly.
COASTS_S: Final = 2.0
MARGIN_M: Final = 2.0
MARGIN_S: Final = 0.5
STEP_S: Final = 0.05


class Hold(NamedTuple):
    """The channel's value, and for how long."""

    lasts_s: float
    value: float


class Run(NamedTuple):
    """`channel` steps through `holds`; `others` are constant. Channels are named as in `Demand` of the
    handling class, with their unit."""

    name: str
    channel: str
    holds: tuple[Hold, ...]
    others: tuple[tuple[str, float], ...] = ()

    @property
    def lasts_s(self) -> float:
        """The whole run."""
        return sum(hold.lasts_s for hold in self.holds)


class Ground(NamedTuple):
    """What a rover or boat may do: all > 0. `turning_radius_m` of 0: it turns at rest."""

    cruise_m_s: float
    crawl_m_s: float
    speed_max_m_s: float
    yaw_rate_max_rad_s: float
    acceleration_m_s2: float
    turning_radius_m: float = 0.0


class Airplane(NamedTuple):
    """Level flight at `airspeed_m_s` takes `pitch_trim_rad` and `throttle_trim` (0 to 1); a throttle so much
    off that, at most, keeps the airspeed within its envelope."""

    airspeed_m_s: float
    bank_max_rad: float
    pitch_trim_rad: float
    throttle_trim: float
    throttle_off_max: float = THROTTLE_STEP


class Copter(NamedTuple):
    """Its limits."""

    speed_max_m_s: float
    climb_max_m_s: float
    yaw_rate_max_rad_s: float


class Box(NamedTuple):
    """Room around the start, m, each >= 0: along its heading (of a copter: along north), and up and down."""

    ahead_m: float
    behind_m: float
    right_m: float
    left_m: float
    up_m: float
    down_m: float


def ground_runs(limits: Ground) -> tuple[Run, ...]:
    """Yaw rate at cruise; speed from rest to crawl and cruise."""
    speed = limits.cruise_m_s
    if not 0.0 < limits.crawl_m_s < speed <= limits.speed_max_m_s:
        raise ValueError(
            f"crawl {limits.crawl_m_s:g}, cruise {speed:g} and highest speed {limits.speed_max_m_s:g} m/s: "
            "must rise and be above 0"
        )
    turn = min(YAW_RATE_RAD_S, PART * limits.yaw_rate_max_rad_s)
    if limits.turning_radius_m > 0.0:
        turn = min(turn, PART * speed / limits.turning_radius_m)
    reached_s = LEAD_S + speed / limits.acceleration_m_s2
    yaw = (Hold(reached_s, 0.0), *_pairs((SMALL * turn, turn), 2.0, 1.5))
    crawl = limits.crawl_m_s
    change_s = LEAD_S + (speed - crawl) / limits.acceleration_m_s2
    up_down = (Hold(change_s, speed), Hold(change_s, crawl))
    start_s = LEAD_S + crawl / limits.acceleration_m_s2
    # not back to rest: there an autopilot lets go, which is another answer
    along = (Hold(LEAD_S, 0.0), Hold(start_s, crawl), *up_down, *up_down)
    return (
        Run("yaw rate", YAW_RATE, yaw, ((SPEED, speed),)),
        Run("speed", SPEED, along, ((YAW_RATE, 0.0),)),
    )


def airplane_runs(limits: Airplane) -> tuple[Run, ...]:
    """Bank, with height and speed held; pitch about its trim with the speed held; throttle about its trim
    with the wings level and the height held."""
    low, high = THROTTLE_ENDS
    trim, pitch = limits.throttle_trim, limits.pitch_trim_rad
    if min(trim - low, high - trim) < THROTTLE_LEAST:
        raise ValueError(
            f"throttle {trim:g} in level flight leaves no room for a step of {THROTTLE_LEAST:g} within "
            f"{low:g} to {high:g}: fly faster or slower"
        )
    throttle = min(THROTTLE_STEP, trim - low, high - trim, limits.throttle_off_max)
    if throttle < THROTTLE_LEAST:
        raise ValueError(
            f"at {limits.airspeed_m_s:g} m/s a throttle that is {throttle:.2g} off already uses up the room "
            f"to the least or the greatest airspeed, and a step of {THROTTLE_LEAST:g} is needed: fly faster "
            "or slower"
        )
    bank = min(BANK_RAD, 0.9 * limits.bank_max_rad)
    level = (ROLL, 0.0)
    return (
        Run("bank", ROLL, (Hold(LEAD_S, 0.0), *_pairs((PART * bank, bank), 2.0, 1.5))),
        Run(
            "pitch",
            PITCH,
            # down first: the speed that it gains is there when the nose goes up
            (Hold(LEAD_S, pitch), *_pairs((-PITCH_RAD,), 2.6, 2.0, pitch)),
            (level,),
        ),
        Run(
            "throttle",
            THROTTLE,
            (Hold(LEAD_S, trim), *_pairs((throttle,), THROTTLE_S, THROTTLE_S, trim)),
            (level,),
        ),
    )


def copter_runs(limits: Copter) -> tuple[Run, ...]:
    """Velocity along each axis, and yaw rate on the spot."""
    speed = min(VELOCITY_M_S, PART * limits.speed_max_m_s)
    climb = min(CLIMB_M_S, PART * limits.climb_max_m_s)
    turn = min(YAW_RATE_RAD_S, PART * limits.yaw_rate_max_rad_s)
    axes = (("north", speed), ("east", speed), ("down", climb))
    names = (*VELOCITY, YAW_RATE)

    def run(name: str, channel: str, sizes: Sequence[float], away_s: float, back_s: float) -> Run:
        holds = (Hold(LEAD_S, 0.0), *_pairs(sizes, away_s, back_s))
        return Run(name, channel, holds, tuple((other, 0.0) for other in names if other != channel))

    return (
        *(run(f"velocity {axis}", f"{axis}_m_s", (size,), 3.5, 2.5) for axis, size in axes),
        run("yaw rate", YAW_RATE, (SMALL * turn, turn), 2.0, 1.5),
    )


def demand_at(run: Run, t_s: float) -> dict[str, float]:
    """What to ask for `t_s` into the run, by channel; before and after it, as at its ends."""
    ends = accumulate(hold.lasts_s for hold in run.holds)
    # times are sums of steps: a nanosecond is no hold
    left = (hold.value for hold, end in zip(run.holds, ends, strict=True) if t_s < end - 1e-9)
    return {run.channel: next(left, run.holds[-1].value), **dict(run.others)}


def space_needed(runs: Iterable[Run], speed_m_s: float) -> Box:
    """The room for all of them from one start: for vehicles that turn less and more than they are asked, and
    run on after the end. `speed_m_s` is an airplane's airspeed, or 0 where the runs say how fast; wind is
    not in it."""
    box = Box(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for run in runs:
        for turns in TURNS:
            for ahead, right, down, _ in path(run, speed_m_s, turns):
                box = with_place(box, ahead, right, down)
    margin_m = MARGIN_M + MARGIN_S * speed_m_s
    return Box(*(side + margin_m for side in box))


def with_place(box: Box, ahead_m: float, right_m: float, down_m: float = 0.0) -> Box:
    """The box, enlarged to hold this place."""
    return Box(*map(max, box, (ahead_m, -ahead_m, right_m, -right_m, -down_m, down_m)))


def corners_ned_m(
    box: Box, north_m: float, east_m: float, heading_rad: float
) -> tuple[tuple[float, float], ...]:
    """Of the level rectangle, with the start there: what a fence must hold."""
    c, s = cos(heading_rad), sin(heading_rad)
    level = (
        (box.ahead_m, box.right_m),
        (-box.behind_m, box.right_m),
        (-box.behind_m, -box.left_m),
        (box.ahead_m, -box.left_m),
    )
    return tuple((north_m + a * c - r * s, east_m + a * s + r * c) for a, r in level)


def _pairs(sizes: Sequence[float], away_s: float, back_s: float, about: float = 0.0) -> tuple[Hold, ...]:
    """To either side by each size, and back."""
    values = (about + sign * size for size in sizes for sign in (1.0, -1.0))
    return tuple(hold for value in values for hold in (Hold(away_s, value), Hold(back_s, about)))


def path(run: Run, airspeed_m_s: float, turns: float) -> Iterable[tuple[float, float, float, float]]:
    """Ahead, right and down of the start, m, and heading, rad, of a vehicle that does at once what it is
    asked, but turns by this part of it."""
    x = y = z = heading = 0.0
    rest = demand_at(run, 0.0)
    for n in range(round((run.lasts_s + COASTS_S) / STEP_S)):
        asked = demand_at(run, n * STEP_S)
        speed = FASTER * (airspeed_m_s or asked.get("speed_m_s", 0.0))
        rate = asked.get("yaw_rate_rad_s", 0.0)
        if airspeed_m_s:
            rate = GRAVITY_M_S2 * tan(asked.get("roll_rad", 0.0)) / airspeed_m_s
            # the path rises by what the nose is above its trim
            z -= speed * sin(asked.get("pitch_rad", 0.0) - rest.get("pitch_rad", 0.0)) * STEP_S
        heading += turns * rate * STEP_S
        x += (speed * cos(heading) + FASTER * asked.get("north_m_s", 0.0)) * STEP_S
        y += (speed * sin(heading) + FASTER * asked.get("east_m_s", 0.0)) * STEP_S
        z += FASTER * asked.get("down_m_s", 0.0) * STEP_S
        yield x, y, z, heading
