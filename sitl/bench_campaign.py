"""Throughput of campaigns: ours, a hand-written C loop of the same arithmetic, and crazyflow, in one run.

A step is one evaluation of the law and one step of the plant; of crazyflow, one step of its dynamics with its
attitude controller. All may use every core. The three take turns, many short ones, and each figure is of the
best: what else a machine does only ever slows them.
"""

from __future__ import annotations

import ctypes
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple, TypedDict

import numpy as np

from sitl.campaign.flight import OUTCOMES, Rows
from sitl.campaign.plan import Plan
from sitl.campaign.run import cores, fly_range, run
from sitl.compiled import cache_root

SOURCE: Final = Path(__file__).with_name("bench_campaign.c")
FLAGS: Final = ("-O3", "-march=native", "-shared", "-fPIC", "-pthread")
#: The law to the letter, with reverse, from everywhere; rates are clamped one by one, as the C loop does.
#: Each flight has its own place on the helix, so that ours cannot save references by sharing them.
PLAN: Final = Plan(flights=4000, keep_direction=False, start_s=(0.0, 60.0))
#: The same from one place, as a campaign flies unless it is told otherwise.
TOGETHER: Final = replace(PLAN, start_s=(0.0, 0.0))
ROUNDS: Final = 15
GOAL_C: Final = 0.7
GOAL_CRAZYFLOW: Final = 5.0
GOAL_COMPILE_S: Final = 15.0

#: The outcomes that the C loop gives, in its order.
_C_OUTCOMES: Final = (
    "entered_s",
    "settled_s",
    "final_error_m",
    "excursion_m",
    "rms_m",
    "y4_min",
    "singular_steps",
    "saturated_steps",
    "reverse_steps",
)
#: What an answer of `bench_crazyflow` begins with.
_ANSWER: Final = "steps_per_s "
_FIRST_FLIGHT: Final = """
import time
start = time.perf_counter()
from sitl.campaign.plan import Plan
from sitl.campaign.run import fly_range
fly_range(Plan(flights=1, duration_s=1.0), 0, 1)
print(time.perf_counter() - start)
"""


class UnavailableError(Exception):
    """What is to be measured is not on this machine; the text says how to get it."""


class Report(TypedDict):
    """Steps per second; a ratio is None where there is nothing to compare with, and `notes` says why.

    `together_steps_per_s` and `ratio_to_c_together` are of flights that are at the same place of the
    trajectory and look it up once for all, which the C loop does not; the goals are held without that.
    `compile_s` and `cached_s`: from starting to import to the end of the first flight, with an empty cache
    and with a full one. `difference_to_c`: the largest between outcomes, relative.
    """

    steps_per_s: float
    together_steps_per_s: float
    c_steps_per_s: float | None
    crazyflow_steps_per_s: float | None
    ratio_to_c: float | None
    ratio_to_c_together: float | None
    ratio_to_crazyflow: float | None
    difference_to_c: float | None
    compile_s: float
    cached_s: float
    cores: int
    notes: list[str]
    met: bool


class CPlan(ctypes.Structure):
    """`plan_t` of the C source."""

    _fields_ = [
        *((name, ctypes.c_double) for name in ("radius_m", "speed_m_s", "down_m_s")),
        *((name, ctypes.c_double) for name in ("k", "rho2", "rho3", "beta")),
        *((name, ctypes.c_double) for name in ("speed_min_m_s", "speed_max_m_s", "rate_max_rad_s")),
        *((name, ctypes.c_double) for name in ("dt_s", "within_m")),
        ("steps", ctypes.c_long),
    ]


def c_loop() -> Callable[[Plan, Rows, int], Rows]:
    """The C loop: (plan, starts (n, 8), threads) -> outcomes (n, 9), built here unless it was before.

    Raises:
        UnavailableError: there is no C compiler, or it fails.
    """
    compiler = shutil.which(os.environ.get("CC", "cc"))
    if compiler is None:
        raise UnavailableError("no C compiler (cc, or what CC names)")
    key = hashlib.sha256(SOURCE.read_bytes() + " ".join((compiler, *FLAGS)).encode()).hexdigest()[:16]
    library = cache_root() / f"bench-{key}.so"
    if not library.exists():
        library.parent.mkdir(parents=True, exist_ok=True)
        part = library.with_suffix(f".{os.getpid()}")
        done = subprocess.run(  # noqa: S603
            [compiler, *FLAGS, str(SOURCE), "-o", str(part), "-lm"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise UnavailableError(f"{compiler} failed: {done.stderr.strip()[:200]}")
        part.replace(library)
    fly_all = ctypes.CDLL(str(library)).fly_all
    double_p = ctypes.POINTER(ctypes.c_double)
    fly_all.argtypes = (ctypes.POINTER(CPlan), double_p, double_p, ctypes.c_long, ctypes.c_long)
    fly_all.restype = ctypes.c_int

    def fly(plan: Plan, starts: Rows, threads: int) -> Rows:
        radius_m, speed_m_s, down_m_s = plan.common().shape[:3]
        shared = CPlan(
            radius_m,
            speed_m_s,
            down_m_s,
            plan.k[0],
            plan.rho2_per_s[0],
            plan.rho3_per_s[0],
            plan.beta[0],
            plan.speed_min_m_s[0],
            plan.speed_max_m_s[0],
            plan.rate_max_rad_s[0],
            plan.step_s,
            plan.within_m,
            plan.steps,
        )
        starts = np.ascontiguousarray(starts)
        found = np.zeros((len(starts), len(_C_OUTCOMES)))
        if fly_all(
            shared, starts.ctypes.data_as(double_p), found.ctypes.data_as(double_p), len(starts), threads
        ):
            raise UnavailableError("the C loop got no threads")
        found[:, :2] = np.where(found[:, :2] < 0.0, np.nan, found[:, :2] * plan.step_s)
        return found

    return fly


def difference(ours: Rows, c: Rows) -> float:
    """The largest difference between outcomes of the same flights, relative, or in m below 1 m."""
    same = ours[:, [OUTCOMES.index(name) for name in _C_OUTCOMES]]
    if not np.array_equal(np.isnan(same), np.isnan(c)):
        return float("inf")
    return float(np.nanmax(np.abs(same - c) / np.maximum(1.0, np.abs(c))))


class Crazyflow:
    """A process that measures crazyflow whenever it is asked; compiled and warm from the start.

    Raises:
        UnavailableError: it is not installed, or does not run.
    """

    def __init__(self) -> None:
        if importlib.util.find_spec("crazyflow") is None:
            raise UnavailableError("crazyflow is not installed (pip install crazyflow)")
        self._process = subprocess.Popen(
            [sys.executable, "-m", "sitl.bench_crazyflow"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._answer()

    def steps_per_s(self) -> float:
        """Worlds times steps per second, once."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> float:
        assert self._process.stdout is not None
        said = ""
        for line in self._process.stdout:
            if line.startswith(_ANSWER):
                return float(line.removeprefix(_ANSWER))
            said = line.strip() or said
        raise UnavailableError(f"crazyflow failed: {said}")

    def close(self) -> None:
        """End the process."""
        self._process.communicate()


class _Turns(NamedTuple):
    ours: list[float]
    together: list[float]
    c: list[float]
    crazyflow: list[float]


def measure() -> Report:
    """All figures; takes a minute, most of it crazyflow's compilation."""
    notes = []
    threads = cores()
    compile_s, cached_s = _first_flights()
    starts, ours = fly_range(PLAN, 0, PLAN.flights)
    starts = starts[:, :8]
    steps = PLAN.flights * (PLAN.steps + 1)
    loop = other = None
    apart = None
    try:
        loop = c_loop()
        apart = difference(ours, loop(PLAN, starts, threads))
    except UnavailableError as reason:
        notes.append(f"no ratio to C: {reason}")
    try:
        other = Crazyflow()
    except UnavailableError as reason:
        notes.append(f"no ratio to crazyflow: {reason}")
    turns = _Turns([], [], [], [])
    for _ in range(ROUNDS):
        turns.ours.append(steps / _timed(lambda: run(PLAN, threads)))
        turns.together.append(steps / _timed(lambda: run(TOGETHER, threads)))
        if loop is not None:
            turns.c.append(steps / _timed(partial(loop, PLAN, starts, threads)))
        if other is not None:
            turns.crazyflow.append(other.steps_per_s())
    if other is not None:
        other.close()
    to_c, to_crazyflow = _ratio(turns.ours, turns.c), _ratio(turns.ours, turns.crazyflow)
    return Report(
        steps_per_s=max(turns.ours),
        together_steps_per_s=max(turns.together),
        c_steps_per_s=max(turns.c) if turns.c else None,
        crazyflow_steps_per_s=max(turns.crazyflow) if turns.crazyflow else None,
        ratio_to_c=to_c,
        ratio_to_c_together=_ratio(turns.together, turns.c),
        ratio_to_crazyflow=to_crazyflow,
        difference_to_c=apart,
        compile_s=compile_s,
        cached_s=cached_s,
        cores=threads,
        notes=notes,
        met=(to_c is None or to_c >= GOAL_C)
        and (to_crazyflow is None or to_crazyflow >= GOAL_CRAZYFLOW)
        and compile_s <= GOAL_COMPILE_S,
    )


def _ratio(ours: list[float], theirs: list[float]) -> float | None:
    return max(ours) / max(theirs) if theirs else None


def _first_flights() -> tuple[float, float]:
    """Seconds to a first flight in a new process, with an empty cache and then with that cache."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "XDG_CACHE_HOME": cache}
        found = [
            float(
                subprocess.run(  # noqa: S603
                    [sys.executable, "-c", _FIRST_FLIGHT],
                    env=environment,
                    capture_output=True,
                    text=True,
                    check=True,
                ).stdout
            )
            for _ in range(2)
        ]
    return found[0], found[1]


def _timed(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def rows(report: Report) -> list[tuple[str, str, str]]:
    """The report as lines to print: what, how much, and the goal it is held against."""
    met = {True: "met", False: "MISSED"}
    to_c, to_crazyflow = report["ratio_to_c"], report["ratio_to_crazyflow"]
    found = [
        ("ours", f"{report['steps_per_s'] / 1e6:.1f} M steps/s", f"on {report['cores']} cores"),
        ("ours, references shared", f"{report['together_steps_per_s'] / 1e6:.1f} M steps/s", ""),
    ]
    if report["c_steps_per_s"] is not None and to_c is not None:
        together = report["ratio_to_c_together"]
        found += [
            ("hand-written C", f"{report['c_steps_per_s'] / 1e6:.1f} M steps/s", ""),
            ("ratio to C", f"{to_c:.2f}", f"at least {GOAL_C} {met[to_c >= GOAL_C]}"),
            ("ratio to C, references shared", f"{together:.2f}", ""),
            ("largest difference to C", f"{report['difference_to_c']:.1e}", ""),
        ]
    if report["crazyflow_steps_per_s"] is not None and to_crazyflow is not None:
        found += [
            (
                "crazyflow",
                f"{report['crazyflow_steps_per_s'] / 1e6:.2f} M steps/s",
                "1000 worlds, attitude control",
            ),
            (
                "ratio to crazyflow",
                f"{to_crazyflow:.1f}",
                f"at least {GOAL_CRAZYFLOW} {met[to_crazyflow >= GOAL_CRAZYFLOW]}",
            ),
        ]
    compile_s = report["compile_s"]
    return [
        *found,
        (
            "first flight, compiling",
            f"{compile_s:.1f} s",
            f"at most {GOAL_COMPILE_S} s {met[compile_s <= GOAL_COMPILE_S]}",
        ),
        ("first flight, cached", f"{report['cached_s']:.1f} s", ""),
    ]
