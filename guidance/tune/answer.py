"""How a vehicle answers a command: a delay, a gain, a slew limit, and lags. Three forms, u the command:

    y' = limit((c - y)/tau, +-slew)                              ONE_LAG     c = K u(t - delay) + b
    w' = (limit((c - y)/tau, +-slew) - w)/tau2     y' = w        TWO_LAGS    may overshoot
    w' = ((z - x)/tau - w)/tau2     x' = w     y = x + lead w    LED         z' towards c, by at most the slew

The third is a loop with proportional and integral part on a command that is led to what is asked for, such as
the speed of ArduPilot's rovers. Whatever else is known to move y (gravity along the path of an airplane that
climbs) is added to its derivative as `push`.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from itertools import pairwise
from math import exp, inf
from typing import Final, NamedTuple

#: Longest step (s) in which two lags are integrated.
SUBSTEP_S: Final = 0.01
#: How a step's answer is looked at: every so often (s), for so long.
LOOK_S: Final = 0.01
LOOK_FOR_S: Final = 20.0


class Form(StrEnum):
    """Of the module's equations."""

    ONE_LAG = "one lag"
    TWO_LAGS = "two lags"
    LED = "led, PI"


class Answer(NamedTuple):
    """Of one channel; y is in the unit of what is measured, u in that of the command.

    `gain` is K, `offset` b, `slew` the most change in a second (inf: never reached), `tau_s` > 0. `tau2_s`
    > 0 and `lead_s` >= 0 are for the forms that have them.
    """

    form: Form
    delay_s: float
    gain: float
    offset: float
    slew: float
    tau_s: float
    tau2_s: float = 0.0
    lead_s: float = 0.0


class Command(NamedTuple):
    """What is asked for from `at_s` on."""

    at_s: float
    value: float


class Sample(NamedTuple):
    """What is measured at `at_s`, and what else moves it from then on, in units a second."""

    at_s: float
    value: float
    push: float = 0.0


class Character(NamedTuple):
    """The answer to one step. `lag_s` is how much later than the command it comes on average, the delay
    apart: the integral of what is still missing, as a part of the step; of a slow motion the lag, and more
    where the slew limits. `overshoot` is a part of the step."""

    lag_s: float
    overshoot: float


def answered(
    answer: Answer, commands: Sequence[Command], samples: Sequence[Sample], start: float
) -> list[float]:
    """y at each sample's instant, from rest at `start` at the first of them.

    Commands and samples are each in the order of time; the first command holds from ever.
    """
    acting = _Acting(answer, commands, samples[0].at_s)
    form, lead = answer.form, answer.lead_s
    y, w, z = start, 0.0, start
    found = [y]
    for before, after in pairwise(samples):
        at, end = before.at_s, after.at_s
        while at < end:
            until = min(acting.until_s, end)
            if until > at:
                if form is Form.ONE_LAG:
                    y = _one(answer, acting.target, y, until - at) + before.push * (until - at)
                elif form is Form.TWO_LAGS:
                    y, w = _two(answer, acting.target, y, w, before.push, until - at)
                else:
                    y, w, z = _led(answer, acting.target, y, w, z, before.push, until - at)
                at = until
            if at >= acting.until_s:
                acting.next()
        found.append(y + lead * w)
    return found


def character(answer: Answer, step: float) -> Character:
    """Of a step of the command (> 0), from rest."""
    looks = [Sample(n * LOOK_S, 0.0) for n in range(round(LOOK_FOR_S / LOOK_S))]
    at_once = answer._replace(delay_s=0.0, offset=0.0)
    end = answer.gain * step
    part = [y / end for y in answered(at_once, [Command(0.0, step)], looks, 0.0)]
    missing = sum(1.0 - p for p in part) - 0.5
    return Character(missing * LOOK_S, max(max(part) - 1.0, 0.0))


class _Acting:
    """The command that acts, as the y that it leads to, and until when."""

    def __init__(self, answer: Answer, commands: Sequence[Command], from_s: float) -> None:
        self._answer = answer
        self._commands = commands
        self._n = -1
        self.target = 0.0
        self.until_s = -inf
        while self.until_s <= from_s:
            self.next()

    def next(self) -> None:
        a, commands = self._answer, self._commands
        self._n += 1
        self.target = a.gain * commands[self._n].value + a.offset
        last = self._n + 1 == len(commands)
        self.until_s = inf if last else commands[self._n + 1].at_s + a.delay_s


def _one(a: Answer, target: float, y: float, h: float) -> float:
    """Exactly: straight while the slew limits, then exponential."""
    gap = target - y
    knee = a.slew * a.tau_s
    if abs(gap) > knee:
        slewing = (abs(gap) - knee) / a.slew
        step = a.slew if gap > 0.0 else -a.slew
        if slewing >= h:
            return y + step * h
        gap = step * a.tau_s
        h -= slewing
    return target - gap * exp(-h / a.tau_s)


def _two(a: Answer, target: float, y: float, w: float, push: float, h: float) -> tuple[float, float]:
    """Of second order in the substep: the rate with y at its middle, exact in the second lag."""
    steps = int(h / SUBSTEP_S) + 1
    dt = h / steps
    kept = exp(-dt / a.tau2_s)
    for _ in range(steps):
        wanted = (target - y - 0.5 * dt * (w + push)) / a.tau_s
        if wanted > a.slew:
            wanted = a.slew
        elif wanted < -a.slew:
            wanted = -a.slew
        off = w - wanted
        w = wanted + off * kept
        y += (wanted + push) * dt + off * a.tau2_s * (1.0 - kept)
    return y, w


def _led(
    a: Answer, target: float, x: float, w: float, z: float, push: float, h: float
) -> tuple[float, float, float]:
    """Likewise, with the led command at its middle, too."""
    steps = int(h / SUBSTEP_S) + 1
    dt = h / steps
    kept = exp(-dt / a.tau2_s)
    most = a.slew * dt
    for _ in range(steps):
        gap = target - z
        moved = most if gap > most else -most if gap < -most else gap
        wanted = (z + 0.5 * moved - x - 0.5 * dt * (w + push)) / a.tau_s
        z += moved
        off = w - wanted
        w = wanted + off * kept
        x += (wanted + push) * dt + off * a.tau2_s * (1.0 - kept)
    return x, w, z
