"""The other simulator of `sitl bench campaign`, in a process of its own: `python -m sitl.bench_crazyflow`.

crazyflow (PyPI) wants to be imported before scipy, and its array library keeps threads of its own. For each
line on stdin it measures once and answers with steps per second on stdout; the first answer comes unasked,
when it has compiled and is warm.
"""

from __future__ import annotations

import sys
import time
from typing import Final

import crazyflow  # noqa: F401  # first: it sets what scipy reads when that is imported
import numpy as np
from crazyflow.control import Control
from crazyflow.sim import Sim

WORLDS: Final = 1000
#: So many that a measurement lasts about as long as one of the other sides.
STEPS: Final = 600
ANSWER: Final = "steps_per_s "
#: Collective thrust that about holds the drone up, N.
THRUST_N: Final = 0.4


def main() -> None:
    """Until stdin ends."""
    sim = Sim(n_worlds=WORLDS, n_drones=1, control=Control.attitude)
    sim.reset()
    level = np.zeros((WORLDS, 1, 4), dtype=np.float32)
    level[..., 3] = THRUST_N

    def measure() -> float:
        sim.attitude_control(level)
        start = time.perf_counter()
        sim.step(STEPS)
        np.asarray(sim.data.states.pos)  # waits until it is there
        return WORLDS * STEPS / (time.perf_counter() - start)

    for _ in range(2):
        found = measure()
    _answer(found)
    for _ in sys.stdin:
        _answer(measure())


def _answer(steps_per_s: float) -> None:
    # Its libraries have things to say on stdout too.
    sys.stdout.write(f"{ANSWER}{steps_per_s}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
