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
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final, TypedDict

import numpy as np

from sitl.campaign.flight import OUTCOMES, Rows
from sitl.campaign.plan import Plan
from sitl.campaign.run import cores, fly_range, run
from sitl.campaign.vehicle_plan import VehiclePlan
from sitl.campaign.vehicle_presets import airplane, rover
from sitl.compiled import cache_folder

SOURCE: Final = Path(__file__).with_name("bench_campaign.c")
FLAGS: Final = ("-O3", "-march=native", "-shared", "-fPIC", "-pthread")
#: The law to the letter, with reverse, from everywhere; rates are clamped one by one, as the C loop does.
#: Each flight has its own place on the helix, so that ours cannot save references by sharing them.
PLAN: Final = Plan(flights=4000, keep_direction=False, start_s=(0.0, 60.0))
#: The same from one place, as a campaign flies unless it is told otherwise.
TOGETHER: Final = replace(PLAN, start_s=(0.0, 0.0))
#: Vehicles with their handling, flights of one and two minutes.
ROVER: Final = rover(200)[0]
AIRPLANE: Final = airplane(50)[0]
ROUNDS: Final = 30
GOAL_C: Final = 0.7
GOAL_CRAZYFLOW: Final = 5.0
GOAL_COMPILE_S: Final = 15.0

NOT_MEASURED: Final = "not measured"
_VERDICT: Final = {True: "met", False: "MISSED"}

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
_CRAZYFLOW: Final = (sys.executable, "-m", "sitl.bench_crazyflow")
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

    `met` says whether every goal is; one that was not measured is not.
    `together_steps_per_s` and `ratio_to_c_together` are of flights that are at the same place of the
    trajectory and look it up once for all, which the C loop does not; the goals are held without that.
    `compile_s` and `cached_s`: from starting to import to the end of the first flight, with an empty cache
    and with a full one. `rover_flights_per_s` and `airplane_flights_per_s` are of the vehicles' presets and
    have no goal. `difference_to_c`: the largest between outcomes, relative.
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
    rover_flights_per_s: float
    airplane_flights_per_s: float
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
    try:
        library = cache_folder() / f"bench-{key}.so"
    except OSError as error:
        raise UnavailableError(f"no place to build the C loop in: {error}") from None
    if not library.exists():
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


@contextmanager
def crazyflow() -> Iterator[Callable[[], float]]:
    """A function that measures worlds times steps per second once, in a process that ends with the context.

    It has compiled and is warm when the context is entered.

    Raises:
        UnavailableError: crazyflow is not installed, or does not run; from the function: runs no longer.
    """
    if importlib.util.find_spec("crazyflow") is None:
        raise UnavailableError("crazyflow is not installed (pip install crazyflow)")
    process = subprocess.Popen(  # noqa: S603
        _CRAZYFLOW, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    assert process.stdin is not None
    assert process.stdout is not None
    asks, answers = process.stdin, process.stdout

    def answer() -> float:
        said = ""
        for line in answers:
            if line.startswith(_ANSWER):
                return float(line.removeprefix(_ANSWER))
            said = line.strip() or said
        raise UnavailableError(f"crazyflow failed: {said}")

    def steps_per_s() -> float:
        with suppress(BrokenPipeError):  # it has ended; its last words say more
            os.write(asks.fileno(), b"\n")
        return answer()

    with process:
        try:
            answer()
            yield steps_per_s
        finally:
            process.kill()


def measure(step: Callable[[], object] = lambda: None) -> Report:
    """All figures; takes a minute, most of it crazyflow's compilation. `step` is called after each round."""
    threads = cores()
    compile_s, cached_s = _first_flights()
    starts, ours = fly_range(PLAN, 0, PLAN.flights)
    starts = starts[:, :8]
    apart = None
    notes: dict[str, str] = {}
    sides: dict[str, Callable[[], float]] = {
        "ours": partial(_rate, lambda: run(PLAN, threads)),
        "together": partial(_rate, lambda: run(TOGETHER, threads)),
    }
    with ExitStack() as stack:
        try:
            loop = c_loop()
            apart = difference(ours, loop(PLAN, starts, threads))
            sides["C"] = partial(_rate, lambda: loop(PLAN, starts, threads))
        except UnavailableError as reason:
            notes["C"] = str(reason)
        try:
            sides["crazyflow"] = stack.enter_context(crazyflow())
        except UnavailableError as reason:
            notes["crazyflow"] = str(reason)
        best = dict.fromkeys(sides, 0.0)
        for _ in range(ROUNDS):
            for side in list(best):
                try:
                    best[side] = max(best[side], sides[side]())
                except UnavailableError as reason:
                    notes[side] = str(reason)
                    del best[side]
            step()

    def ratio(side: str, to: str) -> float | None:
        return best[side] / best[to] if to in best else None

    to_c, to_crazyflow = ratio("ours", "C"), ratio("ours", "crazyflow")
    return Report(
        steps_per_s=best["ours"],
        together_steps_per_s=best["together"],
        c_steps_per_s=best.get("C"),
        crazyflow_steps_per_s=best.get("crazyflow"),
        ratio_to_c=to_c,
        ratio_to_c_together=ratio("together", "C"),
        ratio_to_crazyflow=to_crazyflow,
        difference_to_c=apart,
        compile_s=compile_s,
        cached_s=cached_s,
        rover_flights_per_s=_flights_per_s(ROVER, threads),
        airplane_flights_per_s=_flights_per_s(AIRPLANE, threads),
        cores=threads,
        notes=[f"no ratio to {side}, and its goal not met: {reason}" for side, reason in notes.items()],
        met=_reached(to_c, GOAL_C) and _reached(to_crazyflow, GOAL_CRAZYFLOW) and compile_s <= GOAL_COMPILE_S,
    )


def _reached(ratio: float | None, goal: float) -> bool:
    return ratio is not None and ratio >= goal


def _rate(fly_all: Callable[[], object]) -> float:
    """Steps per second of a function that flies `PLAN`, or as many flights."""
    start = time.perf_counter()
    fly_all()
    return PLAN.flights * (PLAN.steps + 1) / (time.perf_counter() - start)


def _flights_per_s(plan: VehiclePlan, threads: int) -> float:
    """The best of a few turns, after the one that compiles."""
    best = 0.0
    for turn in range(4):
        start = time.perf_counter()
        run(plan, threads)
        if turn > 0:
            best = max(best, plan.flights / (time.perf_counter() - start))
    return best


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


def rows(report: Report) -> list[tuple[str, str, str]]:
    """The report as lines to print: what, how much, and the goal it is held against."""
    compile_s, apart = report["compile_s"], report["difference_to_c"]
    return [
        ("ours", _rate_text(report["steps_per_s"]), f"on {report['cores']} cores"),
        ("ours, references shared", _rate_text(report["together_steps_per_s"]), ""),
        ("hand-written C", _rate_text(report["c_steps_per_s"]), ""),
        ("ratio to C", *_ratio_texts(report["ratio_to_c"], GOAL_C)),
        ("ratio to C, references shared", _ratio_texts(report["ratio_to_c_together"], GOAL_C)[0], ""),
        ("largest difference to C", NOT_MEASURED if apart is None else f"{apart:.1e}", ""),
        ("crazyflow", _rate_text(report["crazyflow_steps_per_s"]), "1000 worlds, attitude control"),
        ("ratio to crazyflow", *_ratio_texts(report["ratio_to_crazyflow"], GOAL_CRAZYFLOW)),
        (
            "first flight, compiling",
            f"{compile_s:.1f} s",
            f"at most {GOAL_COMPILE_S} s {_VERDICT[compile_s <= GOAL_COMPILE_S]}",
        ),
        ("first flight, cached", f"{report['cached_s']:.1f} s", ""),
        ("rover with its handling", f"{report['rover_flights_per_s']:.0f} flights/s", "60 s at 40 Hz"),
        (
            "airplane with its handling",
            f"{report['airplane_flights_per_s']:.0f} flights/s",
            "120 s, 50 Hz",
        ),
    ]


def _rate_text(steps_per_s: float | None) -> str:
    return NOT_MEASURED if steps_per_s is None else f"{steps_per_s / 1e6:.2f} M steps/s"


def _ratio_texts(ratio: float | None, goal: float) -> tuple[str, str]:
    value = NOT_MEASURED if ratio is None else f"{ratio:.2f}"
    return value, f"at least {goal} {_VERDICT[_reached(ratio, goal)]}"
