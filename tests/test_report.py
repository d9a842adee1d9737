"""The report's figures: of flights made by hand they are known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from guidance.records import Record
from guidance.report.flight import read_flight, stretches_of
from guidance.report.judged import Figures, along_cross_up, judged
from guidance.report.panels import bank_pitch, nose
from guidance.report.settings import settings_of
from guidance.report.thin import thin, thin_path
from guidance.se3 import Quaternion, multiply
from tests.hand_made_flight import PERIOD_NS, ZERO_NS, flown, log_of, status
from tests.helpers import make_config

#: 1 m off for two seconds, then 3 cm ahead, 4 cm right and 12 cm above: 13 cm.
OFF_S = 2.0
SECONDS = 14.0


def track(t_s: float) -> tuple[float, float, float]:
    return (-1.0, 0.0, 0.0) if t_s < OFF_S - 1e-9 else (0.03, 0.04, 0.12)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    records = flown(SECONDS, track, saturated=lambda t_s: 4.0 <= t_s < 7.5)
    return log_of(tmp_path_factory.mktemp("logs"), make_config(), records)


def figures_of(path: Path, converged_m: float = 0.2) -> list[Figures]:
    flight = read_flight(path)
    return [judged(flight, stretch, converged_m) for stretch in flight.stretches]


# Figures -------------------------------------------------------------------------------------------------


def test_a_flight_made_by_hand_has_the_figures_that_it_was_made_with(log: Path) -> None:
    (one,) = figures_of(log)
    assert one.tracked_s == pytest.approx(SECONDS)
    assert one.flown_m == pytest.approx(2.0 * SECONDS)
    assert one.converged_s == pytest.approx(OFF_S)
    # k = 1 per second and beta = 1: settled from 5 s after
    settled = 7.0
    assert one.settled_rms_m == pytest.approx(0.13)
    assert one.settled_max_m == pytest.approx(0.13)
    assert one.settled_p95_m == pytest.approx(0.13)
    assert one.settled_along_rms_m == pytest.approx(0.03)
    assert one.settled_cross_max_m == pytest.approx(0.04)
    assert one.settled_vertical_p95_m == pytest.approx(0.12)
    count = round(SECONDS * 50) + 1
    early = round(OFF_S * 50)
    assert one.all_rms_m == pytest.approx(((early * 1.0 + (count - early) * 0.13**2) / count) ** 0.5)
    assert one.all_max_m == pytest.approx(1.0)
    assert one.setpoints == count
    assert one.setpoint_rate_hz == pytest.approx(50.0)
    assert one.saturated_part == pytest.approx(3.5 * 50 / count)
    assert one.settled_saturated_part == pytest.approx(25 / (count - round(settled * 50)))
    assert (one.attitude_age_median_s, one.position_age_p95_s) == (0.04, 0.06)
    assert (one.round_trip_median_s, one.round_trip_p95_s) == (0.03, 0.03)
    assert one.packets_lost_part == pytest.approx(0.01)
    assert one.loop_late_max_s == 0.004
    assert one.waited_s is None


def test_percentile_is_that_of_the_settled_samples(tmp_path: Path) -> None:
    """Of a hundred settled samples 95 are 1 cm off and the rest 5 cm."""

    def off(t_s: float) -> tuple[float, float, float]:
        return 0.0, (0.05 if round(t_s * 50) % 20 == 7 else 0.01), 0.0

    (one,) = figures_of(log_of(tmp_path, make_config(), flown(8.0, off)))
    assert one.converged_s == 0.0
    assert one.settled_p95_m == pytest.approx(0.01, abs=1e-12)
    assert one.settled_max_m == pytest.approx(0.05)


def test_never_converged_leaves_the_settled_figures_open(log: Path) -> None:
    (one,) = figures_of(log, converged_m=0.1)
    assert one.converged_s is None
    assert one.settled_rms_m is None
    assert one.settled_cross_p95_m is None
    assert one.settled_saturated_part is None
    assert one.all_max_m == pytest.approx(1.0)


def test_a_silence_is_a_gap_and_a_hold_is_none(tmp_path: Path) -> None:
    quiet = flown(6.0, track, silent=lambda t_s: 3.0 < t_s < 3.5)
    (one,) = figures_of(log_of(tmp_path / "a", make_config(), quiet))
    assert one.setpoint_gap_max_s == pytest.approx(0.5)
    held_ns = ZERO_NS + 3_100_000_000
    held = status("holding", held_ns, held_ns)
    (one,) = figures_of(log_of(tmp_path / "b", make_config(), [*quiet[:-1], held, quiet[-1]]))
    assert one.setpoint_gap_max_s == pytest.approx(0.02)


def test_a_trajectory_that_begins_anew_is_another_flight(tmp_path: Path) -> None:
    later: list[Record] = []
    first = flown(6.0, track)
    for record in flown(4.0, track):
        later.append(replace(record, t_ns=record.t_ns + 10_000_000_000))
    flight = read_flight(log_of(tmp_path, make_config(), [*first, *later]))
    assert [stop - start for start, stop in flight.stretches] == [301, 201]
    both = [judged(flight, stretch, 0.2) for stretch in flight.stretches]
    assert [one.tracked_s for one in both] == [pytest.approx(6.0), pytest.approx(4.0)]


def test_stretches_part_where_the_trajectory_goes_back_and_not_where_tracking_pauses() -> None:
    tracked = np.array([False, True, True, False, True, True, True, False])
    on_s = np.array([np.nan, 0.0, 1.0, np.nan, 5.0, 0.0, 0.1, np.nan])
    assert stretches_of(on_s, tracked) == ((1, 5), (5, 7))
    assert stretches_of(on_s, np.zeros(8, dtype=bool)) == ()


def test_along_cross_and_up_are_level_by_the_course_and_keep_it_where_there_is_none() -> None:
    error = np.array([[3.0, 4.0, -5.0]] * 4)
    course = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 0.0], [0.0, 2.0, 9.0], [0.0, 0.0, -1.0]])
    expected = [[3.0, 4.0, 5.0], [3.0, 4.0, 5.0], [4.0, -3.0, 5.0], [4.0, -3.0, 5.0]]
    assert along_cross_up(error, course) == pytest.approx(np.array(expected))
    straight_up = along_cross_up(error[:1], np.array([[0.0, 0.0, -1.0]]))
    assert straight_up == pytest.approx(np.array([[3.0, 4.0, 5.0]]))


def test_a_setpoint_has_the_record_of_its_own_instant_or_none(tmp_path: Path) -> None:
    """A lost state must not be replaced by the one before."""
    records = flown(1.0, track)
    at = [i for i, record in enumerate(records) if type(record).__name__ == "State"][10]
    columns = read_flight(log_of(tmp_path, make_config(), records[:at] + records[at + 1 :])).columns
    assert np.flatnonzero(np.isnan(columns.position_ned_m[:, 0])).tolist() == [10]
    assert not np.isnan(columns.norm_m).any()
    assert (np.diff(columns.sent_ns) == PERIOD_NS).all()
    assert columns.sent_ns[0] == ZERO_NS


def test_bank_pitch_and_nose_are_those_of_the_quaternion() -> None:
    half = np.radians([40.0, 25.0]) / 2.0
    bank = np.array([np.cos(half[0]), np.sin(half[0]), 0.0, 0.0])
    pitch = np.array([np.cos(half[1]), 0.0, np.sin(half[1]), 0.0])
    both = np.array([bank, pitch])
    assert np.degrees(bank_pitch(both)) == pytest.approx(np.array([[40.0, 0.0], [0.0, 25.0]]))
    turned = multiply(Quaternion(0.6, 0.0, 0.0, 0.8), Quaternion(*pitch.tolist()))
    all_three = multiply(turned, Quaternion(*bank.tolist()))
    assert np.degrees(bank_pitch(np.array([all_three]))) == pytest.approx(np.array([[40.0, 25.0]]))
    assert nose(both)[1] == pytest.approx([np.cos(2 * half[1]), 0.0, -np.sin(2 * half[1])])


def test_peaks_survive_the_thinning_and_gaps_break_the_line() -> None:
    x = np.linspace(0.0, 1999.98, 100_000)
    y = np.sin(x)
    y[54_321], y[77_777] = 40.0, -30.0
    few_x, few_y = thin(x, y, 500)
    assert len(few_x) < 2500
    assert (few_y.max(), few_y.min()) == (40.0, -30.0)
    assert few_x[few_y.argmax()] == x[54_321]
    assert (np.diff(few_x) >= 0.0).all()
    gone = (x < 800.0) | (x > 900.0)
    _, broken = thin(x[gone], y[gone], 500)
    assert np.isnan(broken).sum() == 1
    path = np.column_stack((np.cos(x), y, -x))
    assert thin_path(path, 300)[:, 1].max() == 40.0
    slow = np.linspace(0.0, 29.0, 30)
    assert not np.isnan(thin(slow, slow)[1]).any()


def test_settings_are_held_against_their_defaults_and_one_another() -> None:
    found = {one.key: one for one in settings_of([make_config(), make_config("law.k=0.5")])}
    assert found["law.k"].values == ("1.0", "0.5")
    assert found["law.k"].differs
    assert not found["law.k"].changed
    assert found["ground.enabled"].changed
    assert not found["link.rate_hz"].differs
    assert found["trajectory.name"].values == ('"helix"', '"helix"')
