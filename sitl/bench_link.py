"""How well it flies over links that lose and delay, and from where on it does not: on virtual time.

A datagram is lost with the given probability, each way, and takes a random time between two bounds, each way,
so that it overtakes others. The flights are the demo's, with its gains: section 4's helix with bounded
controls, and one of radius 20 m at 4 m/s. They begin on that link, and are judged by the plant's truth from
five time constants after convergence on.

The same figures on every machine: nothing here depends on how fast it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from typing import Any, Final, NamedTuple, TypeVar

from guidance.config import load
from guidance.demo import CONFIG_FILE
from guidance.figures import tracking_figures
from guidance.records import Link, Record, State
from guidance.se3 import Vec3, add, norm, subtract
from guidance.supervisor import State as Supervised
from guidance.trajectory import sample
from sitl.lockstep import PERFECT, SECOND, Channel, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions
from sitl.workers import workers

#: Largest error after convergence, m, by trajectory.
GOALS_M: Final = {"bounded helix": 0.03, "helix of 20 m at 4 m/s": 0.3}
TRAJECTORIES: Final = {
    "bounded helix": (),
    "helix of 20 m at 4 m/s": ("trajectory.radius_m=20", "trajectory.speed_m_s=4"),
}
#: 100 ms of jitter, from none on and about a mean of 100 ms; each way.
LINKS: Final = {
    "0 to 100 ms": Channel(delay_s=0.0, jitter_s=0.1, loss=0.3),
    "50 to 150 ms": Channel(delay_s=0.05, jitter_s=0.1, loss=0.3),
}
LOSSES: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
GAPS_S: Final = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0)
#: The loss at which the state must be at rate, for this part of the time, and the flight go on.
BORNE_LOSS: Final = 0.3
AT_RATE_PART: Final = 0.99
#: From this loss on, and from this gap on, control must be given up.
ACTED_LOSS: Final = 0.6
ACTED_GAP_S: Final = 1.0

#: Rows of flights: on these links, with these losses and gaps.
ROWS: Final = len(LINKS) * len(TRAJECTORIES) + len(LOSSES) + len(GAPS_S)

_Flown = TypeVar("_Flown")
_SETTLE_S: Final = 12.0
#: The default of 5 s ends one attempt in a hundred: what is said once a second may be lost five times.
_PATIENT: Final = "supervisor.step_timeout_s=20"
_LOOK_S: Final = 0.0137  # no multiple of any period, so that nothing hides between two setpoints


class Tracked(NamedTuple):
    """One flight: when it converged, its largest error after that, and that of the predicted position."""

    converged_s: float | None
    error_m: float | None
    predicted_m: float
    flying: bool


class Watched(NamedTuple):
    """One flight on a link that became bad: the state's verdicts since, and when control was given up."""

    at_rate: float
    not_at_rate_s: float
    gave_up_s: float | None


def begin(overrides: Iterable[str], channel: Channel, seed: int) -> Lockstep:
    """The demo's flight over `channel` each way; its newest State is all that is kept of its records."""
    config = load(CONFIG_FILE, (_PATIENT, *overrides))
    vehicle = Vehicle(VehicleOptions(firmware=Firmware(config.vehicle.profile)), boot_ns=SECOND)
    return Lockstep(config, vehicle, to_guide=channel, to_vehicle=channel, seed=seed, on_record=_drop)


def track(overrides: Iterable[str], channel: Channel, seed: int, seconds: float) -> Tracked:
    """Fly for `seconds` from the start of the trajectory on; looked at where the setpoints act."""
    flight = begin(overrides, channel, seed)
    newest: list[State] = []
    flight.on_record = lambda record: newest.append(record) if isinstance(record, State) else None
    tracker = flight.guide.tracker
    flight.run(60.0, until=lambda: tracker.start_ns is not None)
    errors: list[tuple[float, float]] = []
    predicted: list[tuple[float, float]] = []
    while flight.guide.engagement.state is Supervised.TRACKING and (not errors or errors[-1][0] < seconds):
        flight.run(_LOOK_S)
        if newest and newest[-1].t_ns >= flight.now_ns:
            state = newest[-1]
            flight.run((state.t_ns - flight.now_ns) / SECOND)
            newest.clear()
        else:
            state = None
        if tracker.start_ns is None or tracker.origin_ned_m is None:
            break
        time_s = (flight.now_ns - tracker.start_ns) / SECOND
        position = Vec3(*flight.truth().position_ned_m)
        reference = add(tracker.origin_ned_m, sample(flight.guide.config.trajectory, time_s).position)
        errors.append((time_s, norm(subtract(position, reference))))
        if state is not None:
            predicted.append((time_s, norm(subtract(position, Vec3(*state.position_ned_m)))))
    law = flight.guide.config.law
    figures = tracking_figures(errors, law.beta / law.k)
    since_s = seconds if figures.converged_s is None else figures.converged_s
    worst_m = max((miss for time_s, miss in predicted if time_s >= since_s), default=0.0)
    flying = bool(errors) and errors[-1][0] >= seconds
    return Tracked(figures.converged_s, figures.max_error_m, worst_m, flying)


def watch(loss: float, seed: int, seconds: float) -> Watched:
    """A flight that has converged meets `loss` each way, with 100 ms of jitter, for `seconds`."""
    flight = begin((), PERFECT, seed)
    flight.run(_SETTLE_S)
    flight.to_guide = flight.to_vehicle = Channel(jitter_s=0.1, loss=loss)
    verdicts: list[tuple[int, bool]] = []
    began_ns = flight.now_ns

    def note(record: Record) -> None:
        if isinstance(record, Link) and record.t_ns >= began_ns + SECOND:  # when the last second is all bad
            verdicts.append((record.t_ns, record.streams[0].at_rate))

    flight.on_record = note
    gave_up = flight.run(seconds, until=lambda: not _tracking(flight))
    gave_up_s = (flight.now_ns - began_ns) / SECOND if gave_up else None
    flight.run(seconds - (flight.now_ns - began_ns) / SECOND)
    longest_ns, since_ns = 0, None
    for t_ns, at_rate in verdicts:
        since_ns = None if at_rate else since_ns or t_ns
        longest_ns = max(longest_ns, t_ns - since_ns if since_ns is not None else 0)
    part = sum(at_rate for _, at_rate in verdicts) / len(verdicts)
    return Watched(part, longest_ns / SECOND, gave_up_s)


def gives_up(gap_s: float, seed: int) -> bool:
    """Whether control is given up by 1 s after a gap in both directions of a link that is else perfect."""
    flight = begin((), PERFECT, seed)
    flight.run(_SETTLE_S + 0.0031 * seed)
    flight.to_guide = flight.to_vehicle = Channel(loss=1.0)
    gave_up = flight.run(gap_s, until=lambda: not _tracking(flight))
    flight.to_guide = flight.to_vehicle = PERFECT
    return gave_up or flight.run(1.0, until=lambda: not _tracking(flight))


def measure(flights: int, seconds: float, step: Callable[[], object] = lambda: None) -> dict[str, Any]:
    """All of it, `flights` of each kind on all cores; what each row says stands in `rows`.

    `step` is called after each of `ROWS`.
    """
    seeds = range(flights)

    def done(jobs: list[Future[_Flown]]) -> list[_Flown]:
        found = [job.result() for job in jobs]
        step()
        return found

    with workers() as pool:
        tracked = {
            (way, name): [pool.submit(track, TRAJECTORIES[name], LINKS[way], s, seconds) for s in seeds]
            for way in LINKS
            for name in TRAJECTORIES
        }
        watched = {loss: [pool.submit(watch, loss, seed, seconds) for seed in seeds] for loss in LOSSES}
        gaps = {gap_s: [pool.submit(gives_up, gap_s, seed) for seed in seeds] for gap_s in GAPS_S}
        tracking = [_tracking_row(way, name, done(jobs)) for (way, name), jobs in tracked.items()]
        losses = [_loss_row(loss, done(jobs)) for loss, jobs in watched.items()]
        silences = [_gap_row(gap_s, done(jobs)) for gap_s, jobs in gaps.items()]
    met = all(row["met"] for row in (*tracking, *losses, *silences))
    conditions = {"flights": flights, "seconds": seconds, "loss_each_way": BORNE_LOSS}
    return {**conditions, "tracking": tracking, "losses": losses, "gaps": silences, "met": met}


def _tracking_row(way: str, name: str, flown: Sequence[Tracked]) -> dict[str, Any]:
    errors = [one.error_m for one in flown if one.error_m is not None]
    good = len(errors) == len(flown) and all(one.flying for one in flown)
    worst_m = max(errors, default=None)
    return {
        "delay_each_way": way,
        "trajectory": name,
        "converged_s": max((one.converged_s for one in flown if one.converged_s is not None), default=None),
        "max_error_m": worst_m,
        "max_prediction_error_m": max(one.predicted_m for one in flown),
        "tracked": len(errors),
        "goal_m": GOALS_M[name],
        "met": good and worst_m is not None and worst_m <= GOALS_M[name],
    }


def _loss_row(loss: float, seen: Sequence[Watched]) -> dict[str, Any]:
    part = sum(one.at_rate for one in seen) / len(seen)
    ended = [one.gave_up_s for one in seen if one.gave_up_s is not None]
    borne = part >= AT_RATE_PART and not ended
    met = borne if loss <= BORNE_LOSS else len(ended) == len(seen) if loss >= ACTED_LOSS else True
    return {
        "loss": loss,
        "at_rate": part,
        "longest_not_at_rate_s": max(one.not_at_rate_s for one in seen),
        "gave_up": len(ended),
        "gave_up_after_s": max(ended, default=None),
        "met": met,
    }


def _gap_row(gap_s: float, gave_up: Sequence[bool]) -> dict[str, Any]:
    met = all(gave_up) if gap_s >= ACTED_GAP_S else True
    return {"gap_s": gap_s, "gave_up": sum(gave_up), "met": met}


def rows(report: dict[str, Any]) -> list[tuple[str, str]]:
    """The report as lines of what and figures."""
    lines = []
    for row in report["tracking"]:
        off, goal, predicted = map(_mm, (row["max_error_m"], row["goal_m"], row["max_prediction_error_m"]))
        figures = f"at most {off} off (goal {goal}); state predicted to {predicted}"
        lines.append((f"{row['trajectory']}, {row['delay_each_way']}", figures, row))
    for row in report["losses"]:
        figures = (
            f"at rate {row['at_rate']:.1%} of the time (longest not: {row['longest_not_at_rate_s']:.1f} s); "
            + _given_up(row, report["flights"])
        )
        lines.append((f"loss {row['loss']:.0%} each way", figures, row))
    for row in report["gaps"]:
        lines.append((f"gap of {row['gap_s']:.1f} s", _given_up(row, report["flights"]), row))
    return [(f"{what:<38}", f"{figures}  {_verdict(row)}") for what, figures, row in lines]


def _given_up(row: dict[str, Any], flights: int) -> str:
    after_s = row.get("gave_up_after_s")
    within = "" if after_s is None else f", within {after_s:.0f} s"
    return f"control given up in {row['gave_up']} of {flights}{within}"


def _tracking(flight: Lockstep) -> bool:
    return flight.guide.engagement.state is Supervised.TRACKING


def _mm(value_m: float | None) -> str:
    return "none" if value_m is None else f"{value_m * 1e3:.1f} mm"


def _verdict(row: dict[str, Any]) -> str:
    return "met" if row["met"] else "MISSED"


def _drop(record: Record) -> None:
    """A sink that costs nothing."""
