"""Identification against truth: the models' parameters, flown open loop with noise; and when it refuses."""

from __future__ import annotations

from math import inf, nan, sin
from random import Random

import pytest
from numpy.testing import assert_allclose

from guidance.tune.answer import Answer, Command, Form, Sample, answered, character
from guidance.tune.excitation import Airplane, Ground, Hold, Run, airplane_runs, ground_runs
from guidance.tune.identify import Identified, Measurement, Refused, identified
from sitl.models.airplane import flying
from sitl.models.files import AIRPLANES, load_airplane, load_rover
from sitl.models.gusts import CALM
from tests.steps_flown import SILENT, banked, driven

GROUND = {
    "rover": Ground(2.0, 0.8, 5.0, 2.09, 1.0, 0.9),
    "boat": Ground(2.0, 0.8, 4.0, 1.5, 0.7, 2.0),
}
SPEEDS_M_S = {"airplane_12": 12.0, "airplane_20": 20.0}
#: The issue asks for a delay within 20 ms, and slew, gain and time constants within 10 to 15 %.
DELAY_S = 0.02
PART = 0.12


def found(measurement: Measurement) -> Identified:
    result = identified(measurement)
    assert isinstance(result, Identified), result
    return result


def refused(measurement: Measurement) -> str:
    result = identified(measurement)
    assert isinstance(result, Refused), result
    return result.reason


def made(answer: Answer, holds: tuple[Hold, ...], sigma: float, *, offset: bool = False) -> Measurement:
    """Measurements of this very answer at irregular times."""
    dice = Random(1)
    commands, t = [], 0.0
    for hold in holds:
        commands.append(Command(t, hold.value))
        t += hold.lasts_s
    times = [0.0]
    while times[-1] < t:
        times.append(times[-1] + dice.uniform(0.012, 0.028))
    y = answered(answer, commands, [Sample(at, 0.0) for at in times], answer.offset)
    samples = [Sample(at, value + dice.gauss(0.0, sigma)) for at, value in zip(times, y, strict=True)]
    return Measurement(commands, samples, offset)


#: Small and large, to both sides, as `excitation` has them.
STEPS = (
    Hold(2.0, 0.0),
    *(hold for size in (0.3, -0.3, 1.0, -1.0) for hold in (Hold(2.5, size), Hold(2.0, 0.0))),
)
PLAIN = Answer(Form.ONE_LAG, 0.1, 0.9, 0.0, 2.0, 0.1)


def airplane_run(name: str, channel: str) -> Run:
    parameters = load_airplane(name)
    trim = flying(parameters, 0.0, 0.0, 0.0, 0.0, SPEEDS_M_S[name], CALM).queue[-1]
    limits = Airplane(SPEEDS_M_S[name], parameters.roll_max_rad, trim.pitch_rad, trim.throttle)
    return next(run for run in airplane_runs(limits) if run.channel == channel)


def test_a_limit_that_a_step_hardly_touches_is_none_however_little_noise_there_is() -> None:
    begins = PLAIN.gain / PLAIN.tau_s
    a = found(made(PLAIN._replace(slew=0.985 * begins), STEPS, 1e-6)).answer
    assert a.slew == inf
    assert_allclose(a.tau_s, PLAIN.tau_s, rtol=0.03)


@pytest.mark.parametrize("name", ["rover", "boat"])
def test_yaw_rate_of_a_vehicle_that_drives_is_its_models(name: str) -> None:
    model = load_rover(name)
    result = found(driven(model, ground_runs(GROUND[name])[0]).measurement)
    a = result.answer
    assert a.form is Form.ONE_LAG
    assert abs(a.delay_s - model.delay_s) < 0.005
    assert_allclose(a.gain, model.yaw_gain, rtol=0.01)
    assert_allclose(a.slew, model.yaw_slew_rad_s2, rtol=0.02)
    assert_allclose(a.tau_s, model.yaw_lag_s, rtol=PART)
    assert_allclose(result.noise, 0.005, rtol=0.15)
    assert_allclose(result.rms, 0.005, rtol=0.1)
    low, high = result.spread.gain
    assert result.spread.repeats == 4
    assert low <= a.gain <= high
    assert high - low < 0.02


@pytest.mark.parametrize("name", ["rover", "boat"])
@pytest.mark.parametrize("seed", range(2))
def test_speed_of_a_vehicle_that_drives_is_its_autopilots_loop(name: str, seed: int) -> None:
    """PI on a led command against a drag: tau is (P + 1/drag)/I, tau tau2 is 1/I, the lead (F/drag + P)/I."""
    model = load_rover(name)
    a = found(driven(model, ground_runs(GROUND[name])[1], seed=seed).measurement).answer
    assert a.form is Form.LED
    assert abs(a.delay_s - model.delay_s) < 1.5 * DELAY_S
    assert_allclose(a.gain, 1.0, rtol=0.01)
    assert_allclose(a.slew, model.acceleration_m_s2, rtol=0.06)
    assert_allclose(a.tau_s, (model.speed_p + 1.0 / model.drag_s) / model.speed_i, rtol=PART)
    assert_allclose(a.tau_s * a.tau2_s, 1.0 / model.speed_i, rtol=PART)
    lead_s = (model.speed_feed / model.drag_s + model.speed_p) / model.speed_i
    assert_allclose(a.lead_s, lead_s, rtol=PART)


def test_without_noise_the_numbers_are_the_models_own() -> None:
    model = load_rover("boat")
    yaw, speed = (driven(model, run, SILENT).measurement for run in ground_runs(GROUND["boat"]))
    a = found(yaw).answer
    assert_allclose((a.delay_s, a.gain, a.slew, a.tau_s), (0.1, 0.9, 1.0, 0.15), rtol=1e-3)
    a = found(speed).answer
    assert_allclose((a.delay_s, a.gain, a.slew), (0.1, 1.0, 0.7), rtol=1e-3)


@pytest.mark.parametrize("name", AIRPLANES)
def test_bank_of_an_airplane_is_its_models(name: str) -> None:
    model = load_airplane(name)
    a = found(banked(model, SPEEDS_M_S[name], airplane_run(name, "roll_rad")).measurement).answer
    assert a.form is (Form.TWO_LAGS if model.roll_lag2_s else Form.ONE_LAG)
    assert abs(a.delay_s - model.roll_delay_s) < 0.005
    assert_allclose(a.gain, model.roll_gain, rtol=0.01)
    assert_allclose(a.slew, model.roll_slew_rad_s, rtol=0.03)
    assert_allclose(a.tau_s, model.roll_lag_s, rtol=0.05)
    assert_allclose(a.tau2_s, model.roll_lag2_s, rtol=0.05)
    assert abs(a.offset - model.roll_offset_rad) < 0.001


@pytest.mark.parametrize("name", AIRPLANES)
def test_pitch_of_an_airplane_is_its_models_and_no_slew_is_made_up(name: str) -> None:
    model = load_airplane(name)
    a = found(banked(model, SPEEDS_M_S[name], airplane_run(name, "pitch_rad")).measurement).answer
    assert a.form is (Form.TWO_LAGS if model.pitch_lag2_s else Form.ONE_LAG)
    assert abs(a.delay_s - model.pitch_delay_s) < DELAY_S
    assert_allclose(a.gain, model.pitch_gain, rtol=0.02)
    assert_allclose(a.tau_s, model.pitch_lag_s, rtol=PART)
    assert_allclose(a.tau2_s, model.pitch_lag2_s, rtol=PART)
    assert a.slew == inf


@pytest.mark.parametrize("name", AIRPLANES)
def test_speed_by_throttle_gives_an_airplanes_thrust(name: str) -> None:
    """Linear about its speed: 1/tau is the slope of drag over speed, and gain over tau the thrust."""
    model, speed = load_airplane(name), SPEEDS_M_S[name]
    a = found(banked(model, speed, airplane_run(name, "throttle")).measurement).answer
    slope = 2.0 * model.drag_per_m * speed - 2.0 * model.induced_m3_s4 / speed**3
    assert abs(a.delay_s - model.throttle_delay_s - 0.5 * model.throttle_lag_s) < DELAY_S
    assert_allclose(a.tau_s, 1.0 / slope, rtol=PART)
    assert_allclose(a.gain, model.thrust_m_s2 / slope, rtol=PART)
    assert_allclose(a.gain / a.tau_s, model.thrust_m_s2, rtol=0.05)


def test_one_standard_error_is_one() -> None:
    """Over many draws of noise the numbers scatter by as much as is said, and are right on average."""
    model = Answer(Form.ONE_LAG, 0.1, 0.9, 0.0, inf, 0.2)
    off = []
    for seed in range(8):
        dice = Random(seed)
        silent = made(model, STEPS[:5], 0.0)
        samples = [s._replace(value=s.value + dice.gauss(0.0, 0.02)) for s in silent.samples]
        result = found(silent._replace(samples=samples))
        off.append((result.answer.delay_s - 0.1) / result.errors.delay_s)
    assert 0.5 < (sum(x * x for x in off) / len(off)) ** 0.5 < 1.7


def test_integration_is_that_of_the_equations() -> None:
    """Against steps of 0.1 ms, for each form, with a push."""
    commands = [Command(0.0, 0.0), Command(0.5, 1.0), Command(2.0, -0.5)]
    samples = [Sample(0.02 * n, 0.0, 0.3) for n in range(200)]
    forms = (PLAIN, PLAIN._replace(form=Form.TWO_LAGS, tau2_s=0.2))
    for a in (*forms, Answer(Form.LED, 0.1, 0.9, 0.1, 1.0, 0.7, 0.6, 0.8)):
        y, w, z, expected = 0.2, 0.0, 0.2, [0.2]
        dt, led, two = 1e-4, a.form is Form.LED, a.form is not Form.ONE_LAG
        for n in range(round(samples[-1].at_s / dt)):
            at = n * dt + 0.5 * dt - a.delay_s
            c = a.gain * max((x for x in commands if x.at_s <= max(at, 0.0)), key=lambda x: x.at_s).value
            z += max(-a.slew * dt, min(a.slew * dt, c + a.offset - z))
            rate = ((z if led else c + a.offset) - y) / a.tau_s
            wanted = rate if led else max(-a.slew, min(a.slew, rate))
            w = w + dt * (wanted - w) / a.tau2_s if two else wanted
            y += dt * (w + 0.3)
            if (n + 1) % 200 == 0:
                expected.append(y + a.lead_s * w)
        assert_allclose(answered(a, commands, samples, 0.2), expected, atol=0.004)


def test_character_is_mean_lag_and_overshoot() -> None:
    free = Answer(Form.ONE_LAG, 0.3, 2.0, 0.1, inf, 0.2)
    assert_allclose(character(free, 0.5), (0.2, 0.0), atol=0.002)
    # with a slew limit alone, half the time that the step takes
    assert_allclose(character(free._replace(slew=1.0, tau_s=0.001), 0.5).lag_s, 0.5, atol=0.01)
    # damping 1/2: exp(-pi/sqrt(3)) of overshoot
    assert_allclose(character(free._replace(form=Form.TWO_LAGS, tau2_s=0.2), 0.5), (0.2, 0.163), atol=0.003)


def test_nothing_that_moves_is_refused() -> None:
    still = made(PLAIN._replace(gain=0.0), STEPS, 0.005)
    assert "no motion" in refused(still)
    assert "no motion" in refused(still._replace(samples=[s._replace(value=0.3) for s in still.samples]))


def test_what_moves_by_itself_is_refused() -> None:
    flown = made(PLAIN, STEPS, 0.005)
    wander = [s._replace(value=sin(0.7 * s.at_s)) for s in flown.samples]
    assert "does not answer the command" in refused(flown._replace(samples=wander))


def test_saturation_is_refused_with_the_size_that_is_too_much() -> None:
    flown = made(PLAIN, STEPS, 0.005)
    cut = [s._replace(value=max(-0.5, min(0.5, s.value))) for s in flown.samples]
    reason = refused(flown._replace(samples=cut))
    assert reason.startswith("saturated: a step of 0.3 settles at 0.90 of it, one of 1 at 0.50")


def test_too_much_noise_is_refused_and_more_steps_help() -> None:
    slow = Answer(Form.ONE_LAG, 0.1, 1.0, 0.0, inf, 0.3)
    step = (Hold(2.0, 1.0), Hold(2.0, 0.0))
    assert "too noisy: a noise of 0.3" in refused(made(slow, (Hold(1.0, 0.0), *step, *step), 0.35))
    short = (Hold(1.0, 0.0), Hold(0.4, 1.0), Hold(0.4, 0.0))
    assert "too noisy: a noise of 0.1" in refused(made(slow, short, 0.15))
    assert abs(found(made(slow, (Hold(1.0, 0.0), *step * 8), 0.22)).answer.delay_s - 0.1) < 0.03


def test_the_wrong_way_round_is_refused() -> None:
    assert "wrong way round" in refused(made(PLAIN._replace(gain=-0.9), STEPS, 0.005))


def test_another_clock_is_refused() -> None:
    flown = made(PLAIN, STEPS, 0.005)
    late = [s._replace(at_s=s.at_s + 1.2) for s in flown.samples]
    assert "same clock" in refused(flown._replace(samples=late))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: m._replace(samples=m.samples[:30]), "30 measurements"),
        (lambda m: m._replace(samples=[*m.samples[:50], Sample(nan, 0.0)]), "not a finite number"),
        (lambda m: m._replace(samples=[*m.samples, m.samples[-1]]), "measurements do not rise"),
        (lambda m: m._replace(commands=[*m.commands, Command(0.0, 3.0)]), "commands do not rise"),
        (lambda m: m._replace(commands=m.commands[:2]), "there and back"),
        (lambda m: m._replace(commands=[]), "there and back"),
        (lambda m: m._replace(samples=[s for s in m.samples if s.at_s > 2.0]), "before the first step"),
        (lambda m: m._replace(samples=[s for s in m.samples if s.at_s < 9.0]), "end before the last step"),
    ],
)
def test_what_is_no_step_response_is_refused(change: object, reason: str) -> None:
    assert callable(change)
    assert reason in refused(change(made(PLAIN, STEPS, 0.005)))


@pytest.mark.parametrize("seed", range(4))
def test_garbage_raises_nothing(seed: int) -> None:
    dice = Random(seed)
    commands = [Command(0.5 * n, dice.choice((0.0, 1.0, -1e3, 1e-9))) for n in range(12)]
    scale = 10.0 ** dice.uniform(-9.0, 9.0)
    samples = [Sample(0.04 * n, dice.gauss(0.0, scale) * dice.choice((0, 1, 50))) for n in range(-10, 160)]
    for led in (False, True):
        result = identified(Measurement(commands, samples, offset=seed % 2 == 0, led=led))
        assert isinstance(result, Identified | Refused)
