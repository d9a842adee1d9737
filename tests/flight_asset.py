"""Makes `tests/data/flight.mcap`: `python -m tests.flight_asset`, and after a change that is meant to be one.

A drive of the built-in ArduRover with an estimator's noise over a link that delays, jitters and loses, at
10 Hz, in lockstep on virtual time: what enters the core is the same on every machine.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Final

from guidance.commands import Engage
from guidance.config import Config, load
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.logbook import LogBook
from sitl.vehicle.estimator import USUAL
from tests.helpers import fly_until, make_flight

ASSET: Final = Path(__file__).parent / "data" / "flight.mcap"
DRIVE_S: Final = 14.0


def configuration() -> Config:
    """The rover's as it ships, slowed down to what a small file holds."""
    shipped = Path(__file__).parents[1] / "deploy" / "ardupilot-rover.toml"
    fence = "guards.fence_ned_m=[[-25.0,-25.0],[25.0,-25.0],[25.0,25.0],[-25.0,25.0]]"
    slow = ("link.rate_hz=10", "log.foxglove=false", "trajectory.radius_m=8")
    return load(shipped, (*slow, fence))


def flight(book: LogBook) -> Lockstep:
    """The drive, its records in the book."""
    late = Channel(delay_s=0.01, jitter_s=0.01, loss=0.01)
    flight = make_flight(
        config=configuration(),
        to_guide=late,
        to_vehicle=late,
        seed=3,
        initial_position_ned_m=(6.0, 1.0, 0.0),
        noise=USUAL,
        initially_armed=True,
    )
    flight.on_record = book.add
    fly_until(flight, State.READY, 20.0)
    flight.guide.command(Engage(), flight.now_ns)
    flight.run(DRIVE_S)
    return flight


def make(directory: Path) -> Path:
    """The log, written into a directory."""
    with LogBook(configuration(), directory) as book:
        flight(book)
    return book.path


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as directory:
        ASSET.write_bytes(make(Path(directory)).read_bytes())
