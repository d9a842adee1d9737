"""The functions that fly, compiled: numba is given the very text of guidance and plant, from outside.

Nothing in `guidance` knows of it: the vehicle has no compiler, and there the same functions are interpreted.
Both compute the same but for the last bits, which a flight may magnify: most agree to 1e-12 to the end, also
where rates slew; with lag, delay and wind as well, 85 pairs on a circle differed by up to 3e-7 after 15 s.
One rule of arithmetic is relaxed, as C compilers relax it unasked: a product may go into a sum unrounded
(`contract`), where the processor has one instruction for both. Nothing else that `fastmath` could allow is:
sums keep their order, quotients stay quotients, NaN and infinity keep their meaning. Division by zero gives
inf or NaN, as in numpy, and raises nothing.

numba keeps machine code in files and looks only at the file of the function that was asked for, not at what
that calls, so that after a change of the law it would serve the old one. Here the folder is named by a hash
of every source in it and of the processor; a changed source has a folder of its own, and those not used for a
month are removed.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import platform
import shutil
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.extending import register_jitable

from guidance import alignment, allocation, error_function, law, limits, se3, trajectory
from guidance.handling import (
    airplane,
    airplane_bank,
    airplane_clock,
    airplane_course,
    airplane_envelope,
    airplane_pitch,
    airplane_prediction,
    airplane_throttle,
    airplane_wind,
    copter_rates,
    crawl,
    ground,
    response,
    saturation,
    slip,
    smoothing,
    speed_loop,
    stuck,
    velocity,
    waiting,
)
from sitl import airplane_flight, copter_flight, plant, rover_flight
from sitl.campaign import draw, flight
from sitl.models import airplane as airplane_model
from sitl.models import attitude, copter_axis, gusts, rover
from sitl.models import copter as copter_model

#: Every module that has text in the machine code.
MATHS: Final[tuple[ModuleType, ...]] = (
    se3,
    error_function,
    limits,
    alignment,
    allocation,
    law,
    trajectory,
    waiting,
    copter_rates,
    crawl,
    saturation,
    slip,
    smoothing,
    speed_loop,
    stuck,
    ground,
    response,
    velocity,
    airplane,
    airplane_bank,
    airplane_clock,
    airplane_course,
    airplane_envelope,
    airplane_pitch,
    airplane_prediction,
    airplane_throttle,
    airplane_wind,
    plant,
    rover,
    flight,
    draw,
    airplane_model,
    gusts,
    attitude,
    copter_axis,
    copter_model,
    airplane_flight,
    copter_flight,
    rover_flight,
)

#: Too seldom and too long to be worth a copy at each place that calls them.
SELDOM: Final = frozenset({"_bounded", "_roll", "_step_with_lags"})

#: What every function is compiled with.
OPTIONS: Final[dict[str, Any]] = {"error_model": "numpy", "fastmath": {"contract"}}

#: Folders of sources that nobody has any more go after this.
STALE_AFTER_S: Final = 30 * 24 * 3600


def functions(module: ModuleType) -> list[Callable[..., Any]]:
    """The functions that a module defines, its private ones too."""
    return [
        value
        for value in vars(module).values()
        if inspect.isfunction(value) and value.__module__ == module.__name__
    ]


@cache
def register() -> None:
    """Let numba compile a call of any of these functions; the functions themselves stay as they are.

    They are inlined by LLVM rather than called: a step makes some forty calls that pass tuples.
    """
    for module in MATHS:
        for function in functions(module):
            register_jitable(**OPTIONS, forceinline=function.__name__ not in SELDOM)(function)


def processor() -> str:
    """Name and features of the processor that machine code is made for; a home directory may see several."""
    return f"{platform.machine()} {llvm.get_host_cpu_name()} {llvm.get_host_cpu_features().flatten()}"


def key() -> str:
    """What the machine code depends on: the text of the maths, numba, numpy, python and the processor.

    How it is compiled (`OPTIONS`, `SELDOM`) is the text of this module.
    """
    digest = hashlib.sha256()
    for part in (numba.__version__, np.__version__, platform.python_version(), processor()):
        digest.update(part.encode() + b"\0")
    digest.update(Path(__file__).read_bytes() + b"\0")
    for module in MATHS:
        digest.update(module.__name__.encode() + b"\0")
        digest.update(Path(str(module.__file__)).read_bytes() + b"\0")
    return digest.hexdigest()[:16]


def cache_root() -> Path:
    """The user's cache of this project: under XDG_CACHE_HOME, or ~/.cache."""
    chosen = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(chosen) if os.path.isabs(chosen) else Path.home() / ".cache"
    return base / "se3-guidance" / "compiled"


def cache_folder() -> Path:
    """Where this text's machine code lies; created here, the stale ones removed.

    Raises:
        OSError: there is no place that can be written to.
    """
    root = cache_root()
    folder = root / key()
    folder.mkdir(parents=True, exist_ok=True)
    os.utime(folder)
    for other in root.iterdir():
        with suppress(FileNotFoundError):  # another process removes the same
            if other != folder and other.stat().st_mtime < time.time() - STALE_AFTER_S:
                shutil.rmtree(other, ignore_errors=True)
    return folder


@cache
def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of `MATHS` as machine code that holds no interpreter lock; `.py_func` is the plain one.

    It is compiled at its first call, some seconds, and then found in the cache. Without a place to write to
    it is compiled each time.
    """
    register()
    settings: dict[str, Any] = vars(numba.config)
    before = settings["CACHE_DIR"]
    try:
        settings["CACHE_DIR"] = str(cache_folder())
        keep = True
    except OSError:
        keep = False
    try:
        jit: Callable[..., Any] = numba.njit(**OPTIONS, nogil=True, cache=keep)(function)
    finally:
        settings["CACHE_DIR"] = before
    return jit
