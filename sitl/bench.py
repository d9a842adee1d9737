"""Speed and memory, measured: lockstep, replay, the law, the time to the first setpoint, growth in flight.

Times depend on the machine; they are printed with what they are held against, and no test asserts them.
"""

from __future__ import annotations

import gc
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from guidance.config import Config, load
from guidance.demo import CONFIG_FILE
from guidance.law import evaluate
from guidance.records import Record
from guidance.replay import replay
from guidance.se3 import IDENTITY_POSE
from guidance.supervisor import State
from guidance.trajectory import sample
from sitl.lockstep import SECOND, Lockstep
from sitl.logbook import LogBook
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

FLIGHT_S = 100.0


class Figure(NamedTuple):
    """One measured figure, and the goal that it is held against."""

    name: str
    value: float
    unit: str
    goal: str
    met: bool


def flight(config: Config, on_record: Callable[[Record], object]) -> Lockstep:
    """The demo's flight in lockstep, its vehicle booting now."""
    vehicle = Vehicle(VehicleOptions(firmware=Firmware(config.vehicle.profile)), boot_ns=SECOND)
    return Lockstep(config, vehicle, start_ns=SECOND, on_record=on_record)


def run(step: Callable[[], object] = lambda: None) -> list[Figure]:
    """All figures; takes some ten seconds. `step` is called after each of the `MEASUREMENTS`."""
    config = load(CONFIG_FILE)
    figures = []
    for measure in MEASUREMENTS:
        figures.append(measure(config))
        step()
    return figures


def _lockstep(config: Config) -> Figure:
    best = min(_timed(lambda: flight(config, _drop).run(FLIGHT_S)) for _ in range(3))
    return Figure("lockstep, 100 s of the helix", best, "s", "at most 2", best <= 2.0)


def _replay(config: Config) -> Figure:
    with tempfile.TemporaryDirectory() as directory:
        with LogBook(config, Path(directory)) as book:
            flight(config, book.add).run(FLIGHT_S)
        best = min(_timed(lambda: replay(book.path)) for _ in range(3))
        found = replay(book.path)
    factor = found.flight_s / best
    return Figure("replay, times real time", factor, "x", "at least 50", factor >= 50.0 and found.identical)


def _law(config: Config) -> Figure:
    gains, limits = config.law.gains(), config.limits.limits()
    reference = sample(config.trajectory, 1.0)
    count = 20_000

    def many() -> None:
        for _ in range(count):
            evaluate(gains, limits, IDENTITY_POSE, reference)

    best_us = min(_timed(many) for _ in range(3)) / count * 1e6
    return Figure("one evaluation of the law", best_us, "us", "at most 25", best_us <= 25.0)


def _first_setpoint(config: Config) -> Figure:
    lockstep = flight(config, _drop)
    lockstep.run(10.0, lambda: lockstep.guide.link.heartbeat is not None)
    heartbeat_ns = lockstep.now_ns
    lockstep.run(10.0, lambda: lockstep.guide.setpoints_sent > 0)
    delay_s = (lockstep.now_ns - heartbeat_ns) * 1e-9
    return Figure("heartbeat to first setpoint", delay_s, "s (virtual)", "at most 1.5", delay_s <= 1.5)


def _memory(config: Config) -> Figure:
    """Growth of the core's and the vehicle's memory over 50 s of tracking, after the same time to settle."""
    lockstep = flight(config, _drop)
    lockstep.run(50.0)
    assert lockstep.guide.engagement.state is State.TRACKING
    lockstep.setpoint_times_ns.clear()
    gc.collect()
    tracemalloc.start()
    lockstep.run(10.0)
    lockstep.setpoint_times_ns.clear()
    gc.collect()
    before = tracemalloc.get_traced_memory()[0]
    lockstep.run(50.0)
    lockstep.setpoint_times_ns.clear()
    gc.collect()
    grown_kib = (tracemalloc.get_traced_memory()[0] - before) / 1024
    tracemalloc.stop()
    return Figure("memory grown in 50 s of flight", grown_kib, "KiB", "flat: under 16", grown_kib < 16.0)


MEASUREMENTS: Final = (_lockstep, _replay, _law, _first_setpoint, _memory)


def _drop(record: Record) -> None:
    """A sink that costs nothing."""


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start
