"""Any sequence of faults, with every profile as it ships: what must hold, holds."""

from __future__ import annotations

import random
from typing import Final

import pytest

from guidance.supervisor import State
from sitl.faults.crafts import CRAFTS
from sitl.faults.flight import Flight, as_it_ships
from sitl.vehicle import Firmware
from tests.test_faults_random import FAULTS

#: All but what only the ideal vehicle can be given, and a mode that a copter has not.
NAMES: Final = sorted(FAULTS.keys() - {"weak", "manual"})
FLIGHTS: Final = 9


@pytest.mark.parametrize("firmware", Firmware)
@pytest.mark.parametrize("seed", range(FLIGHTS))
def test_no_sequence_of_faults_breaks_what_must_hold(firmware: Firmware, seed: int) -> None:
    dice = random.Random(f"{firmware} {seed}")
    flight = Flight(as_it_ships(firmware), dict(CRAFTS[firmware].vehicle), seed)
    assert flight.run(20.0, until=State.READY)
    flight.engage()
    assert flight.run(20.0, until=State.TRACKING)
    flight.begin()
    done = []
    for _ in range(5):
        name, seconds = dice.choice(NAMES), dice.choice([0.03, 0.2, 0.7, 1.6])
        done.append((name, seconds))
        FAULTS[name]()(flight)
        flight.run(seconds)
    flight.witness.finish()
    assert flight.witness.broken == [], (done, flight.states)
