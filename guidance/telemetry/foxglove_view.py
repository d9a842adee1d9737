"""What a viewer is shown of one vehicle: which messages are made of which records, and how often.

Made in the thread of a sink, for a log and for the live bridge alike. Poses are shown `SHOWN_HZ` times a
second, paths once a second, so that a log grows by a tenth only. A path begins anew where the flight does:
with the trajectory, and where the estimator was reset.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import msgspec

from guidance.records import NOT_A_RECORD, TOPICS, Event, Record, Reference, State, TrackingError, Triple
from guidance.telemetry import foxglove
from guidance.telemetry.queue import Sample

#: Topic (without a slash) of each message; its schema is `foxglove.<Class>`.
SHOWN: Final[dict[str, type[msgspec.Struct]]] = {
    "tf": foxglove.FrameTransforms,
    "tf_static": foxglove.FrameTransforms,
    "vehicle/pose": foxglove.PoseInFrame,
    "vehicle/path": foxglove.PosesInFrame,
    "vehicle/field": foxglove.PoseInFrame,
    "reference/pose": foxglove.PoseInFrame,
    "reference/path": foxglove.PosesInFrame,
    "log": foxglove.Log,
}

SHOWN_HZ: Final = 10
_SHOW_NS: Final = 1_000_000_000 // SHOWN_HZ
_PATH_NS: Final = 1_000_000_000  # between two paths
#: Nothing is followed any more when the newest record of a reference is older.
_REFERENCE_NS: Final = 2 * _SHOW_NS + _SHOW_NS // 2

#: A path has at most so many poses.
PATH_POSES: Final = 200
#: They begin so far apart in time; each time the path is full, every second one is left out.
PATH_SPACING_NS: Final = 100_000_000
#: They are never farther apart: from then on the oldest one goes, and the path shows the last minutes.
PATH_SPACING_MAX_NS: Final = 800_000_000


class Path:
    """Where something has been: thinned out evenly as it grows, bounded."""

    def __init__(self) -> None:
        self._poses: list[msgspec.Raw] = []
        self._spacing_ns = PATH_SPACING_NS
        self._slot: int | None = None

    def __len__(self) -> int:
        return len(self._poses)

    def add(self, t_ns: int, position_ned_m: Triple) -> None:
        """The next place, unless it is too close in time to the one before."""
        slot = t_ns // self._spacing_ns
        if slot == self._slot:
            return
        self._slot = slot
        if len(self._poses) >= PATH_POSES:
            self._thin_out(t_ns)
        self._poses.append(foxglove.path_pose(position_ned_m))

    def _thin_out(self, t_ns: int) -> None:
        if self._spacing_ns < PATH_SPACING_MAX_NS:
            del self._poses[1::2]
            self._spacing_ns *= 2
            self._slot = t_ns // self._spacing_ns
        else:
            del self._poses[0]

    def poses(self, position_ned_m: Triple) -> list[msgspec.Raw]:
        """The path up to `position_ned_m`."""
        return [*self._poses, foxglove.path_pose(position_ned_m)]


class View:
    """Makes the messages of one run of one vehicle.

    Args:
        unix_offset_ns: added to the `t_ns` of the records gives Unix time, as in the session record.
        vehicle: prefix of topics and frames where several vehicles are shown; none if empty.
    """

    def __init__(self, unix_offset_ns: int, vehicle: str = "") -> None:
        self._unix_offset_ns = unix_offset_ns
        self._prefix = f"{vehicle}/" if vehicle else ""
        self._frames = foxglove.frames_of(vehicle)
        self._encode = msgspec.json.Encoder().encode
        self._makers: dict[str, tuple[int, Callable[[bytes], Any], Callable[[Any], list[Sample]]]] = {
            TOPICS[State]: (_SHOW_NS, _decoder(State), self._of_state),
            TOPICS[Reference]: (_SHOW_NS, _decoder(Reference), self._of_reference),
            TOPICS[TrackingError]: (_SHOW_NS, _decoder(TrackingError), self._of_error),
            TOPICS[Event]: (0, _decoder(Event), self._of_event),
        }
        self._slots: dict[str, int] = {}
        self._restart()
        self._state: State | None = None
        self._reference: Reference | None = None

    def of(self, sample: Sample) -> list[Sample]:
        """The messages that `sample` gives rise to, with its `t_ns`; none for a payload that is no record."""
        maker = self._makers.get(sample.topic)
        if maker is None:
            return []
        period_ns, decode, make = maker
        if period_ns and not self._due(sample.topic, sample.t_ns, period_ns):
            return []
        try:
            record = decode(sample.payload)
        except NOT_A_RECORD:
            return []
        made: list[Sample] = make(record)
        return made

    def repeat_static(self) -> None:
        """Begin a file that opens alone: the static transforms come again with the next state."""
        self._slots.pop("tf_static", None)

    def _due(self, what: str, t_ns: int, period_ns: int) -> bool:
        """Once in each period. All have the same ones, so that records of one instant are shown together."""
        slot = t_ns // period_ns
        if self._slots.get(what) == slot:
            return False
        self._slots[what] = slot
        return True

    def _of_state(self, state: State) -> list[Sample]:
        if self._state is not None and state.resets != self._state.resets:
            self._restart()
        self._state = state
        made = [] if self._follows(state) else self._transforms(state)
        pose = foxglove.PoseInFrame(self._stamp(state), self._frames.map, foxglove.vehicle_pose(state))
        made.append(self._sample(state, "vehicle/pose", pose))
        return made + self._path(state, "vehicle/path", self._flown, state.position_ned_m)

    def _of_reference(self, reference: Reference) -> list[Sample]:
        before = self._reference
        if before is None or reference.trajectory_s < before.trajectory_s:
            self._restart()
        self._reference = reference
        pose = foxglove.PoseInFrame(
            self._stamp(reference), self._frames.map, foxglove.reference_pose(reference)
        )
        made = self._transforms(self._state) if self._state is not None else []
        made.append(self._sample(reference, "reference/pose", pose))
        return made + self._path(reference, "reference/path", self._followed, reference.position_ned_m)

    def _of_error(self, error: TrackingError) -> list[Sample]:
        pose = foxglove.PoseInFrame(self._stamp(error), self._frames.base_link, foxglove.field_pose(error))
        return [self._sample(error, "vehicle/field", pose)]

    def _of_event(self, event: Event) -> list[Sample]:
        return [self._sample(event, "log", foxglove.log_line(self._stamp(event), event))]

    def _follows(self, state: State) -> bool:
        """Whether a reference of the same instant comes next, as with each state while tracking."""
        return self._reference is not None and state.t_ns - self._reference.t_ns < _REFERENCE_NS

    def _transforms(self, state: State) -> list[Sample]:
        """Body and reference in one message: a viewer that seeks is given the last one of the topic."""
        stamp, frames, reference = self._stamp(state), self._frames, self._reference
        moving = [foxglove.transform(stamp, frames.map, frames.base_link, foxglove.vehicle_pose(state))]
        if reference is not None and self._follows(state):
            moving.append(
                foxglove.transform(
                    self._stamp(reference), frames.map, frames.reference, foxglove.reference_pose(reference)
                )
            )
        made = [self._sample(state, "tf", foxglove.FrameTransforms(tuple(moving)))]
        if "tf_static" not in self._slots:
            self._slots["tf_static"] = 0
            made.insert(0, self._sample(state, "tf_static", foxglove.static_transforms(stamp, frames)))
        return made

    def _path(self, record: Record, topic: str, path: Path, position_ned_m: Triple) -> list[Sample]:
        path.add(record.t_ns, position_ned_m)
        if not self._due(topic, record.t_ns, _PATH_NS):
            return []
        line = foxglove.path(self._stamp(record), self._frames.map, path.poses(position_ned_m))
        return [self._sample(record, topic, line)]

    def _restart(self) -> None:
        self._flown, self._followed = Path(), Path()

    def _stamp(self, record: Record) -> foxglove.Timestamp:
        return foxglove.timestamp(record.t_ns + self._unix_offset_ns)

    def _sample(self, record: Record, topic: str, message: msgspec.Struct) -> Sample:
        return Sample(self._prefix + topic, record.t_ns, self._encode(message))


def _decoder(kind: type[Record]) -> Callable[[bytes], Any]:
    return msgspec.json.Decoder(kind).decode
