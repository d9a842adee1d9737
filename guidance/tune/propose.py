"""From identified answers to lines of the configuration, each with its reason in words.

The rules are those that the flights on real autopilots left (see `handling.rover`):

- rho times (delay + lag) is at most a half, the lag being that of a small change: where the slew limits, it
  is longer than the time constant;
- lambda k is at most a half over delay and lag of the speed, and never above 1/s; for airplanes it is a third
  of rho, since what is turned is the course;
- limits are what was measured, or a little less where a loop must follow what is asked for.

What was not identified gives no line. Channels are named as in `excitation`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import floor, inf, log10
from typing import Final, NamedTuple

from guidance.limits import SLEW_PART
from guidance.tune.answer import Form, character
from guidance.tune.excitation import GRAVITY_M_S2, SMALL
from guidance.tune.identify import Identified, Refused

#: rho and lambda k times (delay + lag): from about twice that on there are limit cycles.
MARGIN: Final = 0.5
K_MOST_PER_S: Final = 1.0
#: Near the path speed changes by no more than this.
CHANGE_M_S: Final = 1.0
#: The same for the turn around a bank: ArduPlane's swings pitch and load as well, a cycle at 0.65.
MARGIN_AIRPLANE: Final = 0.35
#: No airplane was flown with more.
RHO_AIRPLANE_MOST_PER_S: Final = 1.8
COURSE_PART: Final = 1.0 / 3.0
#: Of a measured acceleration so much is asked for, and of a mean slope; the rest is for the loops.
ACCELERATION_PART: Final = 0.95
SLOPE_PART: Final = 0.9
ROLL_RATE_PART: Final = 0.7
#: Of the highest speed, the fastest approach.
APPROACH_PART: Final = 0.8
#: A map from thrust to speed that is wrong by less is the speed loop's.
SPEED_WRONG: Final = 0.05

Results = Mapping[str, Identified | Refused]


class Line(NamedTuple):
    """`key` = `value` in `table` of the configuration, and why."""

    table: str
    key: str
    value: float | str
    why: str


class Known(NamedTuple):
    """What is not measured here: limits of the configuration, and the autopilot's or measured radius of the
    tightest turn (0: it turns at rest)."""

    speed_max_m_s: float
    yaw_rate_max_rad_s: float = inf
    turning_radius_m: float = 0.0
    speed_at_full_thrust_m_s: float = 0.0


def ground_lines(results: Results, known: Known) -> tuple[Line, ...]:
    """Of the channels `yaw_rate_rad_s` and `speed_m_s`."""
    return tuple(_ground(_found(results, "yaw_rate_rad_s"), _found(results, "speed_m_s"), known))


def airplane_lines(results: Results, airspeed_m_s: float = 0.0) -> tuple[Line, ...]:
    """Of `roll_rad` and, at this airspeed, `throttle`; pitch is answered as it is, and its trim learned."""
    throttle = _found(results, "throttle") if airspeed_m_s else None
    return (
        *_airplane(_found(results, "roll_rad")),
        *(() if throttle is None else _throttle(throttle, airspeed_m_s)),
    )


def copter_lines(results: Results, known: Known) -> tuple[Line, ...]:
    """Of `north_m_s`, `east_m_s`, `down_m_s`, `yaw_rate_rad_s`; of north and east the slower counts."""
    level = [found for axis in ("north_m_s", "east_m_s") if (found := _found(results, axis))]
    return tuple(_copter(level, _found(results, "down_m_s"), _found(results, "yaw_rate_rad_s"), known))


def toml(lines: Sequence[Line]) -> str:
    """As the configuration has them, each below its reason."""
    text = []
    for table in dict.fromkeys(line.table for line in lines):
        text.append(f"[{table}]")
        for line in lines:
            if line.table == table:
                value = f'"{line.value}"' if isinstance(line.value, str) else f"{line.value!r}"
                text += [f"# {line.why}", f"{line.key} = {value}"]
        text.append("")
    return "\n".join(text)


def _ground(yaw: Identified | None, speed: Identified | None, known: Known) -> Iterator[Line]:
    if speed and known.speed_at_full_thrust_m_s:
        gain, sure = speed.answer.gain, max(SPEED_WRONG, 3.0 * speed.errors.gain)
        if abs(gain - 1.0) > sure:
            full = known.speed_at_full_thrust_m_s
            yield Line(
                "vehicle",
                "speed_at_full_thrust_m_s",
                round(gain * full, 2),
                f"with {full:g} it drives {gain:.2f} of what is asked for; WP_SPEED must be the same",
            )
    if yaw:
        yield _delay(yaw, "the yaw rate", yaw.answer.tau_s)
    if speed:
        yield _k("law", "k", speed, "the speed")
    if yaw:
        rho, why = _rho(yaw, "the yaw rate")
        yield Line("law", "rho2_per_s", rho, "as rho3; a vehicle that drives does not pitch")
        yield Line("law", "rho3_per_s", rho, why)
    approach = _down(APPROACH_PART * known.speed_max_m_s)
    yield Line("law.error_function", "name", "bounded", "from far off it is no faster than it can turn")
    yield Line(
        "law.error_function",
        "approach_m_s",
        approach,
        f"{APPROACH_PART:g} of the highest speed, {known.speed_max_m_s:g} m/s: the rest is to catch up with",
    )
    if speed and speed.answer.slew < inf:
        yield _acceleration(speed, "acceleration_max_m_s2", "the speed")
    if yaw and yaw.answer.slew < inf:
        yield _slew(yaw)
    if yaw:
        gain = yaw.answer.gain
        low, high = yaw.spread.gain
        yield Line(
            "ground",
            "yaw_gain",
            round(gain, 3),
            f"yaw rate got for one asked; {low:.2f} to {high:.2f} in {yaw.spread.repeats} steps",
        )
        radius, rate = known.turning_radius_m, known.yaw_rate_max_rad_s
        if radius > 0.0 and rate < inf:
            crawl = min(radius * rate, known.speed_max_m_s)
            yield Line(
                "ground",
                "crawl_m_s",
                _down(crawl),
                f"so its tightest turn, {radius:.2g} m, takes its highest yaw rate, {rate:.3g} rad/s",
            )
    if speed:
        change = min(speed.step, CHANGE_M_S)
        lag = character(speed.answer, change).lag_s
        yield Line(
            "ground",
            "speed_lag_s",
            round(lag, 2),
            f"mean lag of a change by {change:.2g} m/s, so that the loop does not integrate it",
        )


def _airplane(bank: Identified | None) -> Iterator[Line]:
    if bank:
        yield _delay(bank, "the bank")
        # of two lags the one overshoots for the other: the mean is early, the loop around it is late by both
        a = bank.answer
        late = a.delay_s + max(character(a, SMALL * bank.step).lag_s, a.tau_s + a.tau2_s)
        yield Line("airplane", "bank_lag_s", round(late, 2), "delay and lags of the bank, together")
        rho, why = _rho(bank, "the bank")
        if rho > MARGIN_AIRPLANE / late:
            rho = _down(MARGIN_AIRPLANE / late)
            why = f"{MARGIN_AIRPLANE:g} over bank_lag_s: the turn is a loop around both lags"
        if rho > RHO_AIRPLANE_MOST_PER_S:
            rho = RHO_AIRPLANE_MOST_PER_S
            why += f"; no airplane was flown with more than {rho:g}"
        yield Line("law", "rho2_per_s", rho, "as rho3; climbs are no rates of an airplane")
        yield Line("law", "rho3_per_s", rho, why)
        yield Line(
            "law",
            "k",
            _down(COURSE_PART * rho),
            f"a third of rho, {rho:g}: the field turns no faster than the course can follow",
        )
        if bank.answer.slew < inf:
            yield Line(
                "limits",
                "roll_rate_max_rad_s",
                _down(ROLL_RATE_PART * bank.answer.slew),
                f"{ROLL_RATE_PART:g} of the measured roll rate, {bank.answer.slew:.3g} rad/s, "
                "so that a turn can be ended in time",
            )


def _throttle(found: Identified, airspeed_m_s: float) -> Iterator[Line]:
    """V' = thrust u - ..., so that the gain over the lag is the thrust; and V = K u + b in level flight."""
    a, V = found.answer, airspeed_m_s
    thrust, cruise = a.gain / a.tau_s, (V - a.offset) / a.gain
    if not 0.01 <= cruise <= 0.95:
        return
    yield Line(
        "airplane",
        "throttle_cruise",
        round(cruise, 2),
        f"it holds {V:.3g} m/s; airspeed_cruise_m_s must be the same",
    )
    yield Line(
        "airplane",
        "climb_full_m_s",
        _down(V * thrust * (1.0 - cruise) / GRAVITY_M_S2),
        f"at {V:.3g} m/s: {thrust:.3g} m/s^2 at full throttle, {cruise:.2g} of it to fly level",
    )
    yield Line(
        "airplane",
        "throttle_lag_s",
        round(max(a.delay_s, 0.02), 3),
        "from a throttle that is asked for until it pulls",
    )


def _copter(
    level: Sequence[Identified], down: Identified | None, yaw: Identified | None, known: Known
) -> Iterator[Line]:
    slowest = max(level, key=_late_s, default=None)
    if slowest:
        # a velocity that the autopilot shapes is late by that, too, which the handling counts with already
        if slowest.answer.slew == inf:
            yield _delay(slowest, "the velocity")
        elif yaw:
            yield _delay(yaw, "the yaw rate")
        yield _k("law", "k", slowest, "the velocity")
    if yaw:
        rho, why = _rho(yaw, "the yaw rate")
        yield Line("law", "rho2_per_s", rho, "as rho3; velocity is asked for, not pitch")
        yield Line("law", "rho3_per_s", rho, why)
    yield Line("law.error_function", "name", "bounded-apart", "it climbs at other speeds than it flies level")
    if slowest:
        yield Line(
            "law.error_function",
            "horizontal_m_s",
            _down(APPROACH_PART * known.speed_max_m_s),
            f"{APPROACH_PART:g} of the highest speed, {known.speed_max_m_s:g} m/s",
        )
    if down:
        yield Line(
            "law.error_function",
            "vertical_m_s",
            _down(down.step),
            f"what was flown here; it is {_late_s(down):.2g} s late in a change by "
            f"{min(down.step, CHANGE_M_S):.2g} m/s",
        )
    slews = [found for found in level if found.answer.slew < inf]
    if slews:
        yield _acceleration(
            min(slews, key=lambda found: found.answer.slew), "acceleration_max_m_s2", "the velocity"
        )
    if yaw and yaw.answer.slew < inf:
        yield _slew(yaw)


def _found(results: Results, channel: str) -> Identified | None:
    result = results.get(channel)
    return result if isinstance(result, Identified) else None


def _delay(found: Identified, what: str, lag_s: float = 0.0) -> Line:
    """`lag_s` where the state is predicted by rates that were asked for, as if they were had at once."""
    low, high = found.spread.delay_s
    return Line(
        "link",
        "actuation_delay_s",
        round(found.answer.delay_s + lag_s, 3),
        f"from a setpoint until {what} moves, {low * 1e3:.0f} to {high * 1e3:.0f} ms in "
        f"{found.spread.repeats} steps" + (f", and its lag, {lag_s * 1e3:.0f} ms" if lag_s else ""),
    )


def _late_s(found: Identified) -> float:
    """Delay and lag of a change of speed as there are near the path."""
    return found.answer.delay_s + character(found.answer, min(found.step, CHANGE_M_S)).lag_s


def _rho(found: Identified, what: str) -> tuple[float, str]:
    small = SMALL * found.step
    delay, lag = found.answer.delay_s, character(found.answer, small).lag_s
    rho = _down(MARGIN / (delay + lag))
    return rho, (
        f"{MARGIN:g} over delay {delay:.3f} s and lag {lag:.3f} s of {what} (a change by {small:.2g} rad"
        f"{'/s' if 'rate' in what else ''})"
    )


def _k(table: str, key: str, found: Identified, what: str) -> Line:
    late = _late_s(found)
    k = min(_down(MARGIN / late), K_MOST_PER_S)
    return Line(
        table,
        key,
        k,
        f"{MARGIN:g} over the {late:.2f} s that {what} is late in a change by "
        f"{min(found.step, CHANGE_M_S):.2g} m/s, "
        f"and at most {K_MOST_PER_S:g}/s; with beta = 1",
    )


def _acceleration(found: Identified, key: str, what: str) -> Line:
    led = found.answer.form is Form.LED
    part, slew = (ACCELERATION_PART if led else SLOPE_PART), found.answer.slew
    how = "leads its command by" if led else "changes by at most"
    why = f"{part:g} of the {slew:.3g} m/s^2 that {what} {how}, so that it can follow"
    return Line("limits", key, _down(part * slew), why)


def _slew(found: Identified) -> Line:
    return Line(
        "limits",
        "yaw_acceleration_max_rad_s2",
        _down(found.answer.slew),
        f"the yaw rate changes by {found.answer.slew:.3g} rad/s^2; the law counts on {SLEW_PART:g} of it to "
        "stop a turn",
    )


def _down(value: float) -> float:
    """To two digits, never up: every one of these is a limit."""
    scale = 10.0 ** (1 - floor(log10(value)))
    return round(floor(value * scale + 1e-9) / scale, 12)
