"""The answer that fits best to what was measured, and how far repeated steps agree with it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from itertools import pairwise, product
from math import copysign, exp, inf, log
from statistics import fmean
from typing import Final, NamedTuple

from guidance.tune.answer import Answer, Command, Form, Sample, answered
from guidance.tune.least_squares import MOST_STEPS, fitted

#: The longest delay that is looked for, s, and the range of lags; faster than the fastest is none.
DELAY_MAX_S: Final = 1.0
TAU_S: Final = (0.005, 10.0)
LEAD_MAX_S: Final = 3.0
#: A second lag must take away this part of the squares; it bends every answer a little better.
SECOND_LAG_PART: Final = 0.4
#: What is known to be possible, a slew limit or a led command, must gain so much: twice the log likelihood.
WORTH: Final = 20.0
REACHED_PART: Final = 0.97
#: The part at the end of a hold in which the answer is looked at as settled.
SETTLED_PART: Final = 0.3
#: A step and its way back are a repeat if they differ by less than this part.
SAME_PART: Final = 0.05
#: Starts of the fit: delays and lags, s, and how long a step takes at the slew limit, s.
DELAYS_S: Final = (0.02, 0.08, 0.2, 0.4)
TAUS_S: Final = (0.03, 0.15, 0.6, 2.5)
SLEWING_S: Final = (0.02, 0.15, 0.5, 1.5)
#: Enough to see which start is the best.
ROUGH_STEPS: Final = 8
#: A start has at least this part of the gain that the size of the motion would be.
GAIN_PART: Final = 0.05


class Errors(NamedTuple):
    """Of an answer's numbers, one standard error each; inf where the data does not tell."""

    delay_s: float
    gain: float
    slew: float
    tau_s: float


class Spread(NamedTuple):
    """Least and most of repeated steps, each fitted alone for its delay and gain."""

    delay_s: tuple[float, float]
    gain: tuple[float, float]
    repeats: int


class Hold(NamedTuple):
    """A command, the one before it, until when it held, and y at its end with its own error; None if it had
    not settled."""

    value: float
    before: float
    from_s: float
    until_s: float
    settled: float | None
    error: float


class Fitting:
    """One channel's data, and the fits of it."""

    def __init__(
        self, commands: Sequence[Command], samples: Sequence[Sample], start: float, offset: bool
    ) -> None:
        self._commands, self._samples = commands, samples
        self._start, self._offset = start, offset
        self._y = [s.value for s in samples]
        self.errors = Errors(inf, inf, inf, inf)

    def best(self, step: float, noise: float, *, led: bool) -> tuple[Answer, float]:
        """The simplest answer that explains what there is to explain, and its sum of squares."""
        gain, offset = self._regression(step)
        slews = [abs(gain) * step / seconds for seconds in SLEWING_S]
        # of each slew the best: from one that is far off, the fit ends without any
        starts = [
            min(
                (Answer(Form.ONE_LAG, d, gain, offset, slew, tau) for d, tau in product(DELAYS_S, TAUS_S)),
                key=self._squares,
            )
            for slew in slews
        ]
        rough = min((self._fit(a, most_steps=ROUGH_STEPS) for a in starts), key=lambda f: f[1])
        one, squares, errors = self._fit(rough[0])
        # a slow start is in the delay of one lag, in the second lag of two
        earlier = one._replace(form=Form.TWO_LAGS, delay_s=0.5 * one.delay_s)
        seed = earlier._replace(tau_s=max(one.tau_s, 0.1), tau2_s=0.2)
        slower = earlier._replace(slew=2.0 * one.slew, tau_s=0.5, tau2_s=0.5)
        most = (1.0 - SECOND_LAG_PART) * squares
        # no form explains noise
        if most > noise * noise * len(self._y):
            two = min((self._fit(a) for a in (seed, slower)), key=lambda f: f[1])
            if two[1] < most:
                one, squares, errors = two
        if led:
            tried = self._fit(slower._replace(form=Form.LED, slew=one.slew, lead_s=0.5))
            if self._worth(tried[1], squares) > WORTH:
                one, squares, errors = tried
        free, more, free_errors = self._fit(one._replace(slew=inf))
        # as steep as the lag alone begins the largest step is no limit, however little noise there is
        begins = abs(one.gain) * step / one.tau_s
        reached = one.form is Form.LED or one.slew < REACHED_PART * begins
        if not reached or self._worth(squares, more) < WORTH:
            one, squares, errors = free, more, free_errors
        self.errors = errors
        return one, squares

    def _worth(self, less: float, more: float) -> float:
        """Twice the gain in log likelihood of the smaller sum of squares."""
        return len(self._y) * log(max(more, 1e-300) / max(less, 1e-300))

    def spread(self, found: Answer, holds: Sequence[Hold]) -> Spread:
        """Delay and gain of each step away and back, fitted alone."""
        delays, gains = [], []
        times = [s.at_s for s in self._samples]
        for hold, back in pairwise(holds):
            if abs(back.value - hold.before) > SAME_PART * abs(hold.value - hold.before):
                continue
            first, end = bisect_left(times, hold.from_s), bisect_left(times, back.until_s)
            answer = self._fit(found, (first, end))[0]
            delays.append(answer.delay_s)
            gains.append(answer.gain)
        if not delays:
            return Spread((found.delay_s, found.delay_s), (found.gain, found.gain), 0)
        return Spread((min(delays), max(delays)), (min(gains), max(gains)), len(delays))

    def _regression(self, step: float) -> tuple[float, float]:
        """Gain and offset of the ends of the holds, settled or not; a gain that is not zero."""
        points = [(h.value, end_of(h, self._samples)[0]) for h in spans(self._commands, self._samples)]
        points.append((self._commands[0].value, self._start))
        least = GAIN_PART * (max(self._y) - min(self._y)) / step
        if not self._offset:
            gain = sum(u * y for u, y in points) / sum(u * u for u, _ in points)
            return copysign(max(abs(gain), least), gain), 0.0
        mean_u, mean_y = fmean(u for u, _ in points), fmean(y for _, y in points)
        gain = sum((u - mean_u) * (y - mean_y) for u, y in points) / sum((u - mean_u) ** 2 for u, _ in points)
        gain = copysign(max(abs(gain), least), gain)
        return gain, mean_y - gain * mean_u

    def _squares(self, answer: Answer) -> float:
        found = answered(answer, self._commands, self._samples, self._start)
        return sum((m - y) * (m - y) for m, y in zip(self._y, found, strict=True))

    def _fit(
        self, start: Answer, window: tuple[int, int] | None = None, most_steps: int = MOST_STEPS
    ) -> tuple[Answer, float, Errors]:
        """From there, in its form, with a slew limit if it has one; to a window of the samples only delay,
        gain and offset are fitted."""
        shape = window is None
        first, end = window or (0, len(self._samples))
        slew = shape and start.slew < inf
        second = shape and start.form is not Form.ONE_LAG
        led = shape and start.form is Form.LED
        scale = max(abs(start.gain), 1e-9)

        def unpacked(x: Sequence[float]) -> Answer:
            rest = iter(x)
            a = start._replace(delay_s=next(rest), gain=next(rest) * scale)
            if self._offset:
                a = a._replace(offset=next(rest) * scale)
            if shape:
                a = a._replace(tau_s=exp(next(rest)))
            if slew:
                a = a._replace(slew=exp(next(rest)))
            if second:
                a = a._replace(tau2_s=exp(next(rest)))
            if led:
                a = a._replace(lead_s=next(rest))
            return a

        taus = (log(TAU_S[0]), log(TAU_S[1]))
        x = [(start.delay_s, 0.0, DELAY_MAX_S), (start.gain / scale, -10.0, 10.0)]
        if self._offset:
            x.append((start.offset / scale, -1e6, 1e6))
        if shape:
            x.append((log(start.tau_s), *taus))
        if slew:
            x.append((log(start.slew), log(start.slew) - 4.0, log(start.slew) + 4.0))
        if second:
            x.append((log(start.tau2_s), *taus))
        if led:
            x.append((start.lead_s, 0.0, LEAD_MAX_S))
        samples, y = self._samples[:end], self._y[first:end]
        fit = fitted(
            lambda x: answered(unpacked(x), self._commands, samples, self._start)[first:],
            y,
            [value for value, _, _ in x],
            [(low, high) for _, low, high in x],
            most_steps,
        )
        answer = unpacked(fit.unknowns)
        errors = list(fit.errors)
        if self._offset:
            del errors[2]
        of_tau = errors[2] * answer.tau_s if shape else inf
        of_slew = errors[3] * answer.slew if slew else inf
        return answer, fit.squares, Errors(errors[0], errors[1] * scale, of_slew, of_tau)


def spans(commands: Sequence[Command], samples: Sequence[Sample]) -> Iterator[Hold]:
    """The holds after the first command, as they were asked for."""
    ends = [*(c.at_s for c in commands[2:]), samples[-1].at_s]
    for (before, command), end in zip(pairwise(commands), ends, strict=True):
        yield Hold(command.value, before.value, command.at_s, end, None, inf)


def end_of(hold: Hold, samples: Sequence[Sample]) -> tuple[float, list[float]]:
    """The mean of y in the last part of a hold, and its values; of a hold without any, of all samples."""
    since = hold.until_s - SETTLED_PART * (hold.until_s - hold.from_s)
    values = [s.value for s in samples if since <= s.at_s <= hold.until_s] or [s.value for s in samples]
    return fmean(values), values
