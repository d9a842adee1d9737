"""Whatever fails, and in whatever order: no setpoint outside the limits, no crash, no control taken back."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from guidance.supervisor import State
from sitl.faults.fault import AUTO, Action
from sitl.faults.flight import DEAD, SOUND, Flight, configured
from sitl.faults.link_faults import line
from sitl.faults.tampering import (
    ATTITUDE,
    POSITION,
    STATE,
    Stage,
    frozen,
    later,
    moved,
    not_a_number,
    quaternions,
    thinned,
)
from sitl.lockstep import Channel
from sitl.plant import PlantParameters
from sitl.vehicle import Effect, Firmware

DIRTY: Final = Channel(delay_s=0.02, jitter_s=0.05, loss=0.3, duplication=0.2, corruption=0.2)


def staged(stage: Stage | None) -> Action:
    return lambda flight: flight.stage(stage)


def jumped(metres: float) -> Action:
    return lambda flight: flight.line.vehicle.reset_estimator(flight.line.now_ns, (metres, 0.0, 0.0), 0.3)


def chosen(mode: str) -> Action:
    return lambda flight: flight.switch(mode)


#: Made anew for each flight: a stage may remember what it saw.
FAULTS: Final[dict[str, Callable[[], Action]]] = {
    "silence": lambda: line(DEAD, DEAD),
    "deaf": lambda: line(DEAD),
    "mute": lambda: line(SOUND, DEAD),
    "dirty": lambda: line(DIRTY, DIRTY),
    "late": lambda: line(Channel(delay_s=0.3), Channel(delay_s=0.1)),
    "sound": lambda: line(),
    "frozen attitude": lambda: staged(frozen(ATTITUDE, stamped=True)),
    "frozen position": lambda: staged(frozen(POSITION, stamped=False)),
    "clock": lambda: staged(later(5.0)),
    "slow": lambda: staged(thinned(STATE, 4.0)),
    "flip": lambda: staged(quaternions(lambda count: 1.5 if count % 3 else -1.0)),
    "no number": lambda: staged(not_a_number(STATE)),
    "elsewhere": lambda: staged(moved(300.0, -4.0)),
    "as it is": lambda: staged(None),
    "glitch": lambda: jumped(8.0),
    "reboot": lambda: Flight.reboot,
    "kill": lambda: Flight.kill_and_restart,
    "stop": lambda: Flight.shut_down,
    "engage": lambda: Flight.engage,
    "pause": lambda: Flight.hold,
    "resume": lambda: Flight.resume,
    "abort": lambda: Flight.abort,
    "manual": lambda: chosen("manual"),
    "hold": lambda: chosen("hold"),
    "control": lambda: chosen("control"),
    "disarm": lambda: lambda flight: flight.arm(False),
    "weak": lambda: lambda flight: flight.line.vehicle.refit(
        flight.line.now_ns, plant=PlantParameters(0.2, 0.4), effect=Effect(yaw=-0.5)
    ),
    "current": lambda: lambda flight: flight.line.vehicle.current(flight.line.now_ns, (3.0, -1.0, 0.5)),
    "refusal": lambda: lambda flight: flight.line.vehicle.refuse(modes=True, arming=True),
}  # fmt: skip
STEPS: Final = st.lists(
    st.tuples(st.sampled_from(sorted(FAULTS)), st.sampled_from([0.03, 0.2, 0.7, 1.6])), min_size=2, max_size=8
)


@pytest.mark.parametrize("firmware", [Firmware.PX4_UUV, Firmware.ARDUPILOT_ROVER])
def test_no_sequence_of_faults_breaks_what_must_hold(firmware: Firmware) -> None:
    config = configured(firmware, *AUTO)
    ends: set[State] = set()

    @settings(max_examples=25)
    @given(STEPS, st.integers(0, 9))
    @example([("kill", 1.6), ("sound", 1.6), ("engage", 1.6)], 0)
    @example([("pause", 1.6), ("dirty", 0.7), ("resume", 1.6), ("disarm", 1.6)], 0)
    @example([("pause", 0.03), ("silence", 1.6), ("sound", 0.7), ("resume", 1.6)], 0)
    @example([("refusal", 0.03), ("abort", 0.2), ("kill", 1.6), ("stop", 1.6)], 0)
    def explore(steps: list[tuple[str, float]], seed: int) -> None:
        flight = Flight(config, {}, seed)
        assert flight.run(5.0, until=State.TRACKING)
        flight.begin()
        for name, seconds in steps:
            FAULTS[name]()(flight)
            flight.run(seconds)
        flight.witness.finish()
        ends.update(flight.states)
        assert flight.witness.broken == [], (steps, flight.states)

    explore()
    assert ends >= {State.TRACKING, State.HANDED_OVER, State.DISCONNECTED, State.FINISHED, State.WITHHELD}
    assert ends >= {State.HOLDING, State.ABORTED}
