"""The records as the messages that Foxglove and Lichtblick draw: NED and FRD end here.

Foxglove's world is ENU (x east, y north, z up) and its body FLU (x forward, y left, z up). The classes are
its well-known schemas `foxglove.<Class>`, field by field, but for the optional `message_id` and `lineage`.
A quaternion maps coordinates of the child (the body) to the parent (the world), as ours do.

Numbers are rounded to what can be seen: the records themselves are in the log and on zenoh as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, hypot, sqrt
from typing import Annotated, Final, NamedTuple, cast

import msgspec
from msgspec import Meta

from guidance import se3
from guidance.records import Event, Level, Reference, State, TrackingError, Triple, Wxyz

_M_DIGITS: Final = 4  # of a position, m
_Q_DIGITS: Final = 6  # of a quaternion
_PATH_DIGITS: Final = 2  # of a position in a path, m
_HALF: Final = sqrt(0.5)

_Count = Annotated[int, Meta(ge=0)]


class _Message(msgspec.Struct, frozen=True, gc=False):
    """A message, or a part of one."""


class Timestamp(_Message, frozen=True, gc=False):
    """Unix time."""

    sec: _Count
    nsec: _Count


class Vector3(_Message, frozen=True, gc=False):
    """A vector, m."""

    x: float
    y: float
    z: float


class Quaternion(_Message, frozen=True, gc=False):
    """A unit quaternion, scalar last, child to parent."""

    x: float
    y: float
    z: float
    w: float


class Pose(_Message, frozen=True, gc=False):
    """Where something is and how it is turned."""

    position: Vector3
    orientation: Quaternion


class FrameTransform(_Message, frozen=True, gc=False):
    """The pose of one frame in another."""

    timestamp: Timestamp
    parent_frame_id: str
    child_frame_id: str
    translation: Vector3
    rotation: Quaternion


class FrameTransforms(_Message, frozen=True, gc=False):
    """Several of them."""

    transforms: tuple[FrameTransform, ...]


class PoseInFrame(_Message, frozen=True, gc=False):
    """A pose at one instant."""

    timestamp: Timestamp
    frame_id: str
    pose: Pose


class PosesInFrame(_Message, frozen=True, gc=False):
    """A path."""

    timestamp: Timestamp
    frame_id: str
    poses: Sequence[Pose]


class Log(_Message, frozen=True, gc=False):
    """A line of the log panel; `level` is 1 (debug) to 5 (fatal)."""

    timestamp: Timestamp
    level: _Count
    message: str
    name: str
    file: str
    line: _Count


class Frames(NamedTuple):
    """Names of the frames of one vehicle.

    `map` is the vehicle's local frame as ENU, `map_ned` the same as NED; `base_link` the body as FLU,
    `base_link_frd` as FRD; `reference` is at r, with its x axis along r'.
    """

    map: str
    map_ned: str
    base_link: str
    base_link_frd: str
    reference: str


def frames_of(vehicle: str) -> Frames:
    """The frames `<vehicle>/map`, ..., or without a prefix if `vehicle` is empty."""
    return Frames(*(f"{vehicle}/{name}" if vehicle else name for name in Frames._fields))


NO_TURN: Final = Quaternion(0.0, 0.0, 0.0, 1.0)
ORIGIN: Final = Vector3(0.0, 0.0, 0.0)
#: The half turn about the line between north and east: NED in ENU, and ENU in NED.
NED_IN_ENU: Final = Quaternion(_HALF, _HALF, 0.0, 0.0)
#: The half turn about x: FRD in FLU, and FLU in FRD.
FRD_IN_FLU: Final = Quaternion(1.0, 0.0, 0.0, 0.0)


def enu_from_ned(ned: Triple, digits: int = _M_DIGITS) -> Vector3:
    """The same vector of the world in ENU."""
    north, east, down = ned
    return Vector3(round(east, digits), round(north, digits), round(-down, digits))


def flu_in_enu(attitude: Wxyz) -> Quaternion:
    """The attitude FLU to ENU of a body whose attitude FRD to NED is given: NED_IN_ENU q FRD_IN_FLU."""
    w, x, y, z = attitude
    return _quaternion(_HALF * (w + z), _HALF * (x + y), _HALF * (x - y), _HALF * (w - z))


def _flu_in_flu(turn: Wxyz) -> Quaternion:
    """A rotation between two bodies FRD as one between the same bodies FLU."""
    w, x, y, z = turn
    return _quaternion(w, x, -y, -z)


def _quaternion(w: float, x: float, y: float, z: float) -> Quaternion:
    return Quaternion(round(x, _Q_DIGITS), round(y, _Q_DIGITS), round(z, _Q_DIGITS), round(w, _Q_DIGITS))


def _pointing(v: Triple) -> se3.Quaternion:
    """The attitude without roll whose x axis is along v, z being down; level and not turned if v is zero."""
    x, y, z = v
    return se3.from_euler(0.0, atan2(-z, hypot(x, y)), atan2(y, x))


def timestamp(unix_ns: int) -> Timestamp:
    """Unix ns as Foxglove writes it; what was before 1970 is at 1970."""
    return Timestamp(*divmod(max(0, unix_ns), 1_000_000_000))


def vehicle_pose(state: State) -> Pose:
    """The body in `map`."""
    return Pose(enu_from_ned(state.position_ned_m), flu_in_enu(state.attitude_wxyz))


def reference_pose(reference: Reference) -> Pose:
    """The reference in `map`: at r, its x axis along r'."""
    return Pose(enu_from_ned(reference.position_ned_m), flu_in_enu(_pointing(reference.velocity_ned_m_s)))


def field_pose(error: TrackingError) -> Pose:
    """The desired field in `base_link`: where the law turns the body's x axis to."""
    return Pose(ORIGIN, _flu_in_flu(_pointing(error.field_body)))


def path_pose(position_ned_m: Triple) -> msgspec.Raw:
    """A place of a path in `map`, to the centimetre and encoded once; a line has no attitude."""
    return msgspec.Raw(msgspec.json.encode(Pose(enu_from_ned(position_ned_m, _PATH_DIGITS), NO_TURN)))


def path(stamp: Timestamp, frame: str, poses: list[msgspec.Raw]) -> PosesInFrame:
    """The line through `poses`. They are encoded already: a path is written again and again."""
    return PosesInFrame(stamp, frame, cast("list[Pose]", poses))


def transform(stamp: Timestamp, parent: str, child: str, pose: Pose) -> FrameTransform:
    """The frame `child` at `pose` in `parent`."""
    return FrameTransform(stamp, parent, child, pose.position, pose.orientation)


def static_transforms(stamp: Timestamp, frames: Frames) -> FrameTransforms:
    """The twins in NED and FRD; and `map` above the vehicle's own, if it has one.

    Vehicles are put at one place by that: their estimators' origins are not known to each other.
    """
    twins = [
        transform(stamp, frames.map, frames.map_ned, Pose(ORIGIN, NED_IN_ENU)),
        transform(stamp, frames.base_link, frames.base_link_frd, Pose(ORIGIN, FRD_IN_FLU)),
    ]
    shared = frames_of("").map
    if frames.map != shared:
        twins.append(transform(stamp, shared, frames.map, Pose(ORIGIN, NO_TURN)))
    return FrameTransforms(tuple(twins))


_LEVELS: Final = {Level.INFO: 2, Level.NOTICE: 2, Level.WARNING: 3, Level.ERROR: 4, Level.CRITICAL: 5}


def log_line(stamp: Timestamp, event: Event) -> Log:
    """The event under its code as the name."""
    return Log(stamp, _LEVELS[event.level], event.text, event.code, "", 0)
