"""NED and FRD to ENU and FLU, and messages that are Foxglove's own, field by field."""

from __future__ import annotations

from math import pi, radians, sqrt
from typing import Any

import foxglove.messages as sdk
import msgspec
import numpy as np
import pytest
from hypothesis import given
from numpy.testing import assert_allclose

from guidance import se3
from guidance.records import Event, Level, Reference, State, TrackingError
from guidance.se3 import IDENTITY, ZERO, Pose, Quaternion, Vec3
from guidance.telemetry import foxglove
from guidance.telemetry.foxglove import FrameTransform, frames_of
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.schema import schema_of, well_known_name
from tests.strategies import poses, properties, vectors
from tests.test_recorder_schemas import fields_of
from tests.test_se3 import Matrix, motion_matrix, rotation_matrix

NOW = foxglove.timestamp(1_700_000_000_000_000_007)
#: Rows are the axes of ENU in NED, and of FLU in FRD.
ENU_OF_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
FLU_OF_FRD = np.diag([1.0, -1.0, -1.0])
#: What rounding may cost, m and without unit.
ROUNDING = 1e-4
#: Of the schemas' fields, those that are optional and of no use here.
LEFT_OUT = {"message_id", "lineage"}


def state(pose: Pose, velocity: Vec3 = ZERO, t_ns: int = 0) -> State:
    return State(
        t_ns=t_ns,
        position_ned_m=pose.position,
        velocity_ned_m_s=velocity,
        attitude_wxyz=pose.attitude,
        body_rates_frd_rad_s=ZERO,
        attitude_age_s=0.0,
        position_age_s=0.0,
        predicted_s=0.0,
        attitude_source="ATTITUDE_QUATERNION",
        position_source="LOCAL_POSITION_NED",
        vehicle_time_ms=0,
    )


def reference(position: Vec3, velocity: Vec3, t_ns: int = 0, trajectory_s: float = 0.0) -> Reference:
    return Reference(
        t_ns=t_ns,
        trajectory_s=trajectory_s,
        position_ned_m=position,
        velocity_ned_m_s=velocity,
        acceleration_ned_m_s2=ZERO,
    )


def tracking_error(field: Vec3, t_ns: int = 0) -> TrackingError:
    return TrackingError(t_ns=t_ns, error_ned_m=ZERO, norm_m=0.0, v1=0.0, v2=0.0, field_body=field)


def rotation(q: foxglove.Quaternion) -> Matrix:
    return rotation_matrix(Quaternion(q.w, q.x, q.y, q.z))


def vector(v: foxglove.Vector3) -> Matrix:
    return np.array([v.x, v.y, v.z])


def matrix(transform: FrameTransform) -> Matrix:
    """4 x 4: coordinates in the child to coordinates in the parent."""
    made = np.eye(4)
    made[:3, :3] = rotation(transform.rotation)
    made[:3, 3] = vector(transform.translation)
    return made


@properties
@given(vectors())
def test_ned_becomes_enu(v: Vec3) -> None:
    assert_allclose(vector(foxglove.enu_from_ned(v)), ENU_OF_NED @ np.asarray(v), atol=ROUNDING)


@properties
@given(poses())
def test_an_attitude_becomes_that_of_flu_in_enu_and_stays_a_rotation(pose: Pose) -> None:
    turned = rotation(foxglove.flu_in_enu(pose.attitude))
    assert_allclose(turned, ENU_OF_NED @ rotation_matrix(pose.attitude) @ FLU_OF_FRD.T, atol=ROUNDING)
    assert np.linalg.det(turned) == pytest.approx(1.0)


def test_a_vehicle_that_heads_north_nose_up_does_so_in_enu() -> None:
    level = rotation(foxglove.flu_in_enu(IDENTITY))
    assert_allclose(
        level, np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), atol=ROUNDING
    )  # x north, y west, z up
    pitched = rotation(foxglove.flu_in_enu(se3.from_euler(0.0, radians(30.0), 0.0)))
    assert_allclose(pitched[:, 0], [0.0, sqrt(0.75), 0.5], atol=ROUNDING)  # the nose: north and up
    east = rotation(foxglove.flu_in_enu(se3.from_yaw(0.5 * pi)))
    assert_allclose(east[:, 0], [1.0, 0.0, 0.0], atol=ROUNDING)
    rolled = rotation(foxglove.flu_in_enu(se3.from_euler(radians(30.0), 0.0, 0.0)))
    assert_allclose(rolled[:, 1], [-sqrt(0.75), 0.0, 0.5], atol=ROUNDING)  # right wing down: the left one up


@properties
@given(poses())
def test_by_way_of_the_twins_the_transforms_give_the_record_back(pose: Pose) -> None:
    """NED <- map <- base_link <- FRD is the motion that the record holds."""
    frames = frames_of("rover1")
    static = foxglove.static_transforms(NOW, frames).transforms
    in_frame = {t.child_frame_id: (t.parent_frame_id, matrix(t)) for t in static}
    assert in_frame.keys() == {"rover1/map_ned", "rover1/base_link_frd", "rover1/map"}
    assert in_frame["rover1/map"][0] == "map"
    assert_allclose(in_frame["rover1/map"][1], np.eye(4))
    parent, ned = in_frame["rover1/map_ned"]
    assert parent == "rover1/map"
    parent, frd = in_frame["rover1/base_link_frd"]
    assert parent == "rover1/base_link"
    body = foxglove.transform(NOW, frames.map, frames.base_link, foxglove.vehicle_pose(state(pose)))
    assert_allclose(np.linalg.inv(ned) @ matrix(body) @ frd, motion_matrix(pose), atol=ROUNDING)


def test_one_vehicle_alone_has_frames_without_a_prefix() -> None:
    frames = frames_of("")
    assert frames == ("map", "map_ned", "base_link", "base_link_frd", "reference")
    static = foxglove.static_transforms(NOW, frames).transforms
    assert [t.child_frame_id for t in static] == ["map_ned", "base_link_frd"]


@properties
@given(vectors(), vectors(5.0))
def test_the_reference_points_where_it_goes_without_roll(position: Vec3, velocity: Vec3) -> None:
    pose = foxglove.reference_pose(reference(position, velocity))
    assert_allclose(vector(pose.position), ENU_OF_NED @ np.asarray(position), atol=ROUNDING)
    turned = rotation(pose.orientation)
    if se3.norm(velocity) > 1e-3:
        ahead = ENU_OF_NED @ np.asarray(velocity) / se3.norm(velocity)
        assert_allclose(turned[:, 0], ahead, atol=ROUNDING)
    assert turned[2, 1] == pytest.approx(0.0, abs=ROUNDING)  # left is horizontal
    assert turned[2, 2] >= -ROUNDING  # and the top is up


@properties
@given(vectors(5.0))
def test_the_field_points_as_it_does_in_the_body(field: Vec3) -> None:
    pose = foxglove.field_pose(tracking_error(field))
    assert pose.position == foxglove.ORIGIN
    if se3.norm(field) > 1e-3:
        ahead = FLU_OF_FRD @ np.asarray(field) / se3.norm(field)
        assert_allclose(rotation(pose.orientation)[:, 0], ahead, atol=ROUNDING)


def test_time_is_unix_time_and_never_negative() -> None:
    assert (NOW.sec, NOW.nsec) == (1_700_000_000, 7)
    assert foxglove.timestamp(-1) == foxglove.Timestamp(0, 0)


@pytest.mark.parametrize("level", Level)
def test_an_event_keeps_its_rank_in_the_log_panel(level: Level) -> None:
    line = foxglove.log_line(NOW, Event(t_ns=0, level=level, code="link_up", text="listening"))
    assert (line.message, line.name) == ("listening", "link_up")
    rank = {"info": "Info", "notice": "Info", "warning": "Warning", "error": "Error", "critical": "Fatal"}
    assert line.level == getattr(sdk.LogLevel, rank[level]).value


MESSAGES: dict[str, msgspec.Struct] = {
    "tf": foxglove.static_transforms(NOW, frames_of("")),
    "pose": foxglove.PoseInFrame(NOW, "map", foxglove.field_pose(tracking_error(Vec3(1.0, 2.0, 3.0)))),
    "path": foxglove.PosesInFrame(NOW, "map", [foxglove.Pose(foxglove.ORIGIN, foxglove.NO_TURN)]),
    "log": foxglove.log_line(NOW, Event(t_ns=0, level=Level.ERROR, code="x", text="y")),
}


def as_theirs(ours: Any) -> Any:
    """The same message made with the SDK's classes, which know no field that the schema does not have."""
    if isinstance(ours, msgspec.Struct):
        theirs = getattr(sdk, type(ours).__name__)
        fields = {name: as_theirs(getattr(ours, name)) for name in ours.__struct_fields__}
        if isinstance(ours, foxglove.Log):
            fields["level"] = {4: sdk.LogLevel.Error}[ours.level]
        return theirs(**fields)
    return [as_theirs(item) for item in ours] if isinstance(ours, list | tuple) else ours


def kinds_in(ours: Any) -> set[type[msgspec.Struct]]:
    """The classes of a message and all of its parts."""
    if isinstance(ours, msgspec.Struct):
        parts = [kinds_in(getattr(ours, name)) for name in ours.__struct_fields__]
        return {type(ours)}.union(*parts)
    return set().union(*map(kinds_in, ours)) if isinstance(ours, list | tuple) else set()


@pytest.mark.parametrize("message", MESSAGES.values(), ids=MESSAGES)
def test_every_message_is_one_of_the_sdk_with_all_its_fields(message: msgspec.Struct) -> None:
    assert type(as_theirs(message)).__name__ == type(message).__name__
    for kind in kinds_in(message):
        signature = getattr(sdk, kind.__name__).__text_signature__
        theirs = {part.partition("=")[0].strip("(*) ") for part in signature.split(",")} - {""}
        assert theirs - LEFT_OUT == set(kind.__struct_fields__)


def test_the_names_are_the_well_known_ones() -> None:
    assert {type(message) for message in MESSAGES.values()} == set(SHOWN.values())
    for kind in SHOWN.values():
        assert well_known_name(kind) == getattr(sdk, kind.__name__).get_schema().name


@pytest.mark.parametrize("message", MESSAGES.values(), ids=MESSAGES)
def test_schemas_stay_within_what_viewers_read_and_describe_the_message(message: msgspec.Struct) -> None:
    schema = msgspec.json.decode(schema_of(type(message)))
    for field in fields_of(schema):
        assert field["type"] in {"object", "array", "string", "number", "integer"}
        assert not {"$ref", "anyOf", "prefixItems", "patternProperties"} & set(field)
    told = msgspec.json.decode(msgspec.json.encode(message))
    assert told.keys() == schema["properties"].keys() == set(schema["required"])
