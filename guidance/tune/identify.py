"""What a vehicle's answer to steps says of it: delay, slew, lag and gain, or why it says nothing.

The model is that of `answer`; it is fitted by least squares from the best of a grid of starts. What the data
does not need is left out: a second lag, unless it explains clearly more, and a slew limit that was never
reached. Noise is averaged over the flight. How sure it is shows in two ways: the standard error of the
fit, and the spread between repeated steps, which also sees what the model does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise
from math import hypot, inf, isfinite, sqrt
from statistics import fmean, median
from typing import Final, NamedTuple

from guidance.tune.answer import Answer, Command, Sample
from guidance.tune.fitting import DELAY_MAX_S, Errors, Fitting, Hold, Spread, end_of, spans

#: Fewer measurements, or before the first step, say nothing.
LEAST_SAMPLES: Final = 40
LEAST_BEFORE: Final = 5
#: The largest standard errors: of the delay (s), and of the gain as a part of it.
DELAY_ERROR_S: Final = 0.04
GAIN_ERROR: Final = 0.1
#: With more noise than this part of the answer a delay and a lag are told apart by chance.
NOISE_PART: Final = 0.25
#: The part of the measured variance that the answer must explain.
EXPLAINED: Final = 0.8
#: Gains of small and large steps that differ by more than this part are not one gain.
SATURATED_PART: Final = 0.25
#: Steps smaller than this part of the largest have no gain to speak of.
LARGE_PART: Final = 0.1


class Measurement(NamedTuple):
    """One channel: what was asked for and what was measured, on one clock (s), each in the order of time.

    `offset`: whether y may differ from K u at rest (a trim); `led`: whether the autopilot may lead its
    command there, as that of a ground speed. The vehicle is at rest at the start.
    """

    commands: Sequence[Command]
    samples: Sequence[Sample]
    offset: bool = False
    led: bool = False


class Identified(NamedTuple):
    """`rms` is of the residual, `noise` of what changes from one measurement to the next, both in the unit of
    y; `step` is the largest step of the command."""

    answer: Answer
    errors: Errors
    spread: Spread
    rms: float
    noise: float
    step: float


class Refused(NamedTuple):
    """Nothing can be said of this channel, and why."""

    reason: str


def identified(measurement: Measurement) -> Identified | Refused:
    """The answer that fits best, or the reason why none can be given; raises nothing."""
    commands, samples = _steps(measurement.commands), measurement.samples
    reason = _unusable(commands, samples)
    if reason:
        return Refused(reason)
    noise = _noise(samples)
    holds = list(_holds(commands, samples, noise))
    step = max(abs(h.value - h.before) for h in holds)
    reason = _unmoved(samples, holds, step, noise)
    if reason:
        return Refused(reason)
    start = fmean(s.value for s in samples if s.at_s < commands[1].at_s)
    fit = Fitting(commands, samples, start, measurement.offset)
    found, squares = fit.best(step, noise, led=measurement.led)
    errors = fit.errors
    rms = sqrt(squares / len(samples))
    reason = _doubtful(found, errors, samples, holds, start, rms, noise, step)
    if reason:
        return Refused(reason)
    return Identified(found, errors, fit.spread(found, holds), rms, noise, step)


def _steps(commands: Sequence[Command]) -> list[Command]:
    """Only the commands that differ from the one before."""
    return [c for n, c in enumerate(commands) if n == 0 or c.value != commands[n - 1].value]


def _unusable(commands: Sequence[Command], samples: Sequence[Sample]) -> str:
    """Why this is no step response at all; empty if it is one."""
    if len(samples) < LEAST_SAMPLES:
        return f"{len(samples)} measurements; at least {LEAST_SAMPLES} are needed"
    numbers = (*(number for c in commands for number in c), *(number for s in samples for number in s))
    if not all(map(isfinite, numbers)):
        return "a command or a measurement is not a finite number"
    instants = {"commands": [c.at_s for c in commands], "measurements": [s.at_s for s in samples]}
    for what, times in instants.items():
        if any(after <= before for before, after in pairwise(times)):
            return f"the times of the {what} do not rise"
    if len(commands) < 3:
        return "the command does not step there and back"
    if sum(s.at_s < commands[1].at_s for s in samples) < LEAST_BEFORE:
        return f"fewer than {LEAST_BEFORE} measurements before the first step"
    if samples[-1].at_s < commands[-1].at_s:
        return "the measurements end before the last step"
    return ""


def _unmoved(samples: Sequence[Sample], holds: Sequence[Hold], step: float, noise: float) -> str:
    """Why there is nothing to be fitted; empty if there is."""
    ordered = sorted(s.value for s in samples)
    tenth = len(ordered) // 20
    moved = ordered[-1 - tenth] - ordered[tenth]
    asked = max(h.value for h in holds) - min(h.value for h in holds)
    if moved <= 4.5 * noise or moved == 0.0:
        return (
            f"no motion: steps of up to {step:.3g} were asked for (from end to end {asked:.3g}), "
            f"and it moved by {moved:.3g} with a noise of {noise:.2g}"
        )
    return ""


def _doubtful(
    found: Answer,
    errors: Errors,
    samples: Sequence[Sample],
    holds: Sequence[Hold],
    start: float,
    rms: float,
    noise: float,
    step: float,
) -> str:
    """Why the fit is not to be believed; empty if it is."""
    saturated = _saturated(holds, start)
    if saturated:
        return saturated
    mean = fmean(s.value for s in samples)
    deviation = sqrt(fmean((s.value - mean) ** 2 for s in samples))
    unexplained = rms * rms - min(noise, rms) ** 2
    motion = max(deviation * deviation - noise * noise, 1e-300)
    if unexplained > (1.0 - EXPLAINED) * motion:
        return (
            f"it does not answer the command: of its motion ({deviation:.3g}) {rms:.3g} is left unexplained; "
            "a limit, wind, or somebody else moves it"
        )
    size = abs(found.gain) * step
    sure = errors.delay_s <= DELAY_ERROR_S and errors.gain <= GAIN_ERROR * abs(found.gain)
    if not sure or noise > NOISE_PART * size:
        return (
            f"too noisy: a noise of {noise:.2g} on an answer of {size:.2g} leaves the delay uncertain by "
            f"{errors.delay_s:.2g} s or more; take larger or more steps"
        )
    if found.gain < 0.0:
        return f"it answers the wrong way round: gain {found.gain:.3g}; check the axes and their signs"
    if found.delay_s >= DELAY_MAX_S - 1e-3:
        return f"the delay is {DELAY_MAX_S:g} s or longer: is it the same clock?"
    return ""


def _saturated(holds: Sequence[Hold], start: float) -> str:
    """Small and large steps away that settle at different gains: a limit cuts the large ones."""
    rest = holds[0].before
    least = LARGE_PART * max(abs(h.value - rest) for h in holds)
    gains = [
        (abs(h.value - rest), (h.settled - start) / (h.value - rest), h.error / abs(h.value - rest))
        for h in holds
        if abs(h.value - rest) > least and h.settled is not None
    ]
    if not gains:
        return ""
    small, large = min(gains), max(gains)
    sure = 4.0 * hypot(small[2], large[2])
    if large[0] > 1.2 * small[0] and small[1] - large[1] > max(SATURATED_PART * abs(small[1]), sure):
        return (
            f"saturated: a step of {small[0]:.3g} settles at {small[1]:.2f} of it, one of {large[0]:.3g} at "
            f"{large[1]:.2f}; a limit lies between: ask for less"
        )
    return ""


def _noise(samples: Sequence[Sample]) -> float:
    """Sigma of what is white, from second differences, which motion hardly enters."""
    y = [s.value for s in samples]
    second = [abs(a - 2.0 * b + c) for a, b, c in zip(y, y[1:], y[2:], strict=False)]
    return median(second) / (0.6745 * sqrt(6.0))


def _holds(commands: Sequence[Command], samples: Sequence[Sample], noise: float) -> Iterator[Hold]:
    """With the settled value of those whose end no longer moves."""
    for hold in spans(commands, samples):
        mean, values = end_of(hold, samples)
        error = noise / sqrt(len(values))
        half = len(values) // 2
        drift = abs(fmean(values[half:]) - fmean(values[:half])) if half else inf
        still = drift <= max(0.05 * abs(mean), 6.0 * error)
        yield hold._replace(settled=mean if still else None, error=error)
