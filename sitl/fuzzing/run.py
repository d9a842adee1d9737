"""Episodes of fuzzing, on all cores: each is a function of its door, the seed and its number.

An episode begins anew (a flight, a fleet, a directory) and takes a bounded number of inputs, so that any of
them can be run alone, again and anywhere. Every so often one is run twice, and must be the same.
"""

from __future__ import annotations

import faulthandler
import gc
import hashlib
import multiprocessing
import os
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Final, NamedTuple, Protocol

from sitl.fuzzing.config_door import ConfigDoor
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.link_doors import BytesDoor, MessagesDoor
from sitl.fuzzing.logs_door import LogsDoor
from sitl.fuzzing.oracle import Broken
from sitl.fuzzing.zenoh_door import ZenohDoor
from sitl.workers import workers

#: An input that takes longer is a failure; an episode that does is ended, with the place where it hangs.
SLOW_S: Final = 10.0
HUNG_S: Final = 300.0
#: Every so many episodes of a door, one is run twice.
_TWICE_EVERY: Final = 25
#: A failure is shown by so much of its input.
_SHOWN: Final = 4000


class Door(Protocol):
    """Where inputs come in. `newest` shows the input that is being taken, `scene` what takes it."""

    newest: str

    @property
    def scene(self) -> str: ...

    def feed(self) -> None:
        """Draw one input, and hand it over."""

    def finish(self) -> bytes:
        """Look at what is left; a digest of all that came out."""


class Way(NamedTuple):
    """A door, the inputs of an episode, and how many of a million go through it."""

    make: Callable[[Dice], Door]
    inputs: int
    share: int


DOORS: Final[dict[str, Way]] = {
    "bytes": Way(BytesDoor, BytesDoor.inputs, 410_000),
    "messages": Way(MessagesDoor, MessagesDoor.inputs, 400_000),
    "config": Way(ConfigDoor, ConfigDoor.inputs, 10_000),
    "zenoh": Way(ZenohDoor, ZenohDoor.inputs, 165_000),
    "logs": Way(LogsDoor, LogsDoor.inputs, 15_000),
}


class Episode(NamedTuple):
    """One of a run: `inputs` of a door, drawn by the seed and the number."""

    door: str
    seed: int
    number: int
    inputs: int

    @property
    def command(self) -> str:
        """What runs it alone."""
        return f"sitl fuzz --door {self.door} --seed {self.seed} --episode {self.number}"


class Failure(NamedTuple):
    """What went wrong at which input of an episode (from 1 on), and how to see it again."""

    episode: Episode
    input: int
    scene: str
    shown: str
    error: str
    trace: str


class Outcome(NamedTuple):
    """What an episode came to."""

    episode: Episode
    inputs: int
    digest: bytes
    failure: Failure | None


class Report(NamedTuple):
    """What a run came to; two runs of one seed and as many inputs have the same digest."""

    inputs: dict[str, int]
    seconds: float
    digest: str
    failures: list[Failure]


def episodes(doors: list[str], inputs: int, seed: int) -> Iterator[Episode]:
    """So many inputs, shared out among the doors, in turns."""
    total = sum(DOORS[door].share for door in doors)
    left = {door: inputs * DOORS[door].share // total for door in doors}
    left[doors[0]] += inputs - sum(left.values())
    whole = {door: max(count, 1) for door, count in left.items()}
    number = dict.fromkeys(doors, 0)
    while any(left.values()):
        door = max(doors, key=lambda name: left[name] / whole[name])
        count = min(left[door], DOORS[door].inputs)
        yield Episode(door, seed, number[door], count)
        left[door] -= count
        number[door] += 1


def run_episode(episode: Episode) -> Outcome:
    """Run it; whatever is raised is its failure."""
    outcome = _run_once(episode)
    if outcome.failure is None and episode.number % _TWICE_EVERY == 0:
        again = _run_once(episode)
        if again.digest != outcome.digest:
            why = "run twice, it came to something else" if again.failure is None else again.failure.error
            failure = Failure(episode, episode.inputs, "twice the same", "all of it", why, "")
            return outcome._replace(failure=failure)
    return outcome


def _run_once(episode: Episode) -> Outcome:
    door: Door | None = None
    number = 0
    try:
        door = DOORS[episode.door].make(Dice(f"{episode.seed} {episode.door} {episode.number}"))
        while number < episode.inputs:
            number += 1
            begun_s = time.process_time()  # not what others do to the machine meanwhile
            door.feed()
            taken_s = time.process_time() - begun_s
            if taken_s > SLOW_S:
                raise Broken(f"the input took {taken_s:.1f} s of the processor")
        return Outcome(episode, episode.inputs, door.finish(), None)
    except Exception as error:
        failure = Failure(
            episode,
            number,
            "the first state is never reached" if door is None else door.scene,
            "" if door is None else door.newest[:_SHOWN],
            f"{type(error).__name__}: {error}",
            traceback.format_exc(),
        )
        return Outcome(episode, number, b"", failure)


def _run_watched(episode: Episode) -> Outcome:
    """In a process of its own: one that hangs says where and ends."""
    faulthandler.dump_traceback_later(HUNG_S, exit=True)
    try:
        return run_episode(episode)
    finally:
        faulthandler.cancel_dump_traceback_later()
        gc.collect()


def run(
    doors: list[str],
    inputs: int,
    seed: int,
    processes: int,
    on_progress: Callable[[str, int], object] = lambda door, inputs: None,
    failures_max: int = 10,
) -> Report:
    """All episodes; it ends early after so many failures. `on_progress` is told of each that has ended."""
    begun_s = time.monotonic()
    done = dict.fromkeys(doors, 0)
    digests: dict[tuple[str, int], bytes] = {}
    failures: list[Failure] = []
    waiting = episodes(doors, inputs, seed)
    with workers(processes, multiprocessing.get_context("spawn")) as pool:
        running: dict[Future[Outcome], Episode] = {}
        while len(failures) < failures_max:
            while len(running) < 2 * processes and (episode := next(waiting, None)) is not None:
                running[pool.submit(_run_watched, episode)] = episode
            if not running:
                break
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                episode = running.pop(future)
                outcome = _result(future, episode)
                if outcome.failure is not None:
                    failures.append(outcome.failure)
                    if outcome.failure.input == 0 and not outcome.digest and future.exception():
                        return Report(done, time.monotonic() - begun_s, "", failures)
                done[episode.door] += outcome.inputs
                digests[episode.door, episode.number] = outcome.digest
                on_progress(episode.door, outcome.inputs)
    whole = hashlib.sha256(b"".join(hashlib.sha256(digests[key]).digest() for key in sorted(digests)))
    return Report(done, time.monotonic() - begun_s, whole.hexdigest()[:16], failures)


def _result(future: Future[Outcome], episode: Episode) -> Outcome:
    try:
        return future.result()
    except BrokenProcessPool:
        why = f"its process ended: it hung for {HUNG_S:g} s, or was killed (or another that ran beside it)"
        return Outcome(episode, 0, b"", Failure(episode, 0, "", "", why, ""))


def cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
