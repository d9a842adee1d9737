"""Identification against real autopilots: what was fitted to the whole recordings by other means."""

from __future__ import annotations

from math import inf

import pytest
from numpy.testing import assert_allclose

from guidance.tune.answer import Form
from guidance.tune.identify import Identified, identified
from tests.steps_flown import recorded

#: Delay, slew, tau, tau2 (s; unit/s; s; s) and gain, fitted to the recordings with Nelder and Mead.
FITTED = {
    "ardurover yaw rate": (0.075, 1.95, 0.027, 0.0, 0.926),
    "arduplane bank": (0.086, 1.94, 0.154, 0.186, 0.983),
    "px4_airplane bank": (0.016, 2.94, 0.142, 0.0, 0.977),
    "arducopter velocity north": (0.308, 2.26, 0.405, 0.0, 1.003),
    "px4_quadrotor yaw rate": (0.115, 2.04, 0.268, 0.0, 0.909),
}


@pytest.mark.parametrize("channel", FITTED)
def test_identified_is_what_was_fitted_elsewhere(channel: str) -> None:
    result = identified(recorded(channel, offset="bank" in channel))
    assert isinstance(result, Identified), result
    a = result.answer
    delay_s, slew, tau_s, tau2_s, gain = FITTED[channel]
    assert a.form is (Form.TWO_LAGS if tau2_s else Form.ONE_LAG)
    assert abs(a.delay_s - delay_s) < 0.01
    assert_allclose(a.slew, slew, rtol=0.05)
    assert abs(a.tau_s - tau_s) < 0.1 * tau_s + 0.004
    assert_allclose(a.tau2_s, tau2_s, rtol=0.05)
    assert_allclose(a.gain, gain, rtol=0.01)


def test_a_rovers_speed_is_the_loop_that_its_parameters_describe() -> None:
    """ATC_ACCEL_MAX 1, ATC_SPEED_P 0.1 and I 0.2 over a drive of 10 m/s^2 with a drag of 2 s: tau 0.75 s,
    tau tau2 0.5 s^2, lead 0.8 s. One lag or two leave ten times as much unexplained."""
    result = identified(recorded("ardurover speed", led=True))
    assert isinstance(result, Identified), result
    a = result.answer
    assert a.form is Form.LED
    assert_allclose((a.gain, a.slew), (1.0, 1.0), rtol=0.02)
    assert_allclose((a.tau_s, a.tau_s * a.tau2_s, a.lead_s), (0.75, 0.5, 0.8), rtol=0.06)
    assert 0.0 <= a.delay_s < 0.08
    assert result.rms < 0.01
    assert a.slew < inf
