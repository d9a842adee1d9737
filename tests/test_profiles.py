"""Golden bytes of what each profile sends, written from the firmware's facts and packed here by hand."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance.checking import one_of
from guidance.config import ConfigError, profile_of
from guidance.mavlink.codec import PacketWriter
from guidance.mavlink.messages import Heartbeat
from guidance.mavlink.profiles import PROFILES, Asked, Profile, command_long, fitting, set_mode_command
from guidance.mavlink.setpoints import BODY_RATE_MAX_RAD_S, Demand, Outgoing, outgoing, setpoint_message
from guidance.se3 import Quaternion, Vec3
from tests.helpers import ROVER, make_config
from tests.mavlink_peer import checksum
from tests.strategies import properties

UUV, BOAT = PROFILES["px4-uuv"], PROFILES["ardupilot-rover"]
#: Attitude masked, all three rates live: PX4 drops a message without roll and pitch rate.
UUV_MASK = 0x80
#: Attitude, roll and pitch rate masked: ArduRover takes yaw rate and speed.
ROVER_MASK = 0x83
CRC_EXTRA_SET_ATTITUDE_TARGET, CRC_EXTRA_COMMAND_LONG = 49, 152


def frame(message_id: int, payload: bytes, extra: int) -> str:
    """MAVLink 2 of 1/191, sequence 0, trailing zeros cut, as hex."""
    body = payload.rstrip(b"\0") or b"\0"
    head = struct.pack("<BBBBBB", len(body), 0, 0, 0, 1, 191) + message_id.to_bytes(3, "little")
    return (b"\xfd" + head + body + struct.pack("<H", checksum(head + body + bytes([extra])))).hex()


def attitude_target(boot_ms: int, mask: int, rates: tuple[float, float, float], thrust: float) -> str:
    """SET_ATTITUDE_TARGET (82) in wire order: time, q, rates, thrust, system, component, mask."""
    payload = struct.pack("<I8fBBB", boot_ms, 1.0, 0.0, 0.0, 0.0, *rates, thrust, 1, 1, mask)
    # The extension, thrust_body[3], is zero and cut.
    return frame(82, payload, CRC_EXTRA_SET_ATTITUDE_TARGET)


def command(number: int, *params: float) -> str:
    """COMMAND_LONG (76) in wire order: seven params, command, system, component, confirmation."""
    filled = [*params, *[0.0] * (7 - len(params))]
    return frame(76, struct.pack("<7fHBBB", *filled, number, 1, 1, 0), CRC_EXTRA_COMMAND_LONG)


def packed(message: Any) -> str:
    return PacketWriter(1, 191).pack(message).hex()


def test_golden_bytes_of_a_px4_uuv_setpoint() -> None:
    out = outgoing(UUV, Demand(Vec3(0.5, -0.25, 0.125), 1.5), 3.0)
    sent = packed(setpoint_message(UUV, out, 1, 1, 0x01020304))
    assert sent == attitude_target(0x01020304, UUV_MASK, (0.5, -0.25, 0.125), 0.5)
    # Once as bytes, so that the helpers above cannot be wrong together with the code.
    assert (
        sent
        == (
            "fd2700000001bf520000"
            "04030201"  # time
            "0000803f000000000000000000000000"  # q
            "0000003f000080be0000003e"  # rates
            "0000003f"  # thrust
            "010180"  # target, mask
        )
        + sent[-4:]
    )
    assert dialect.MAVLink(None).parse_buffer(bytes.fromhex(sent))[0].type_mask == UUV_MASK


def test_golden_bytes_of_an_ardupilot_rover_setpoint() -> None:
    out = outgoing(BOAT, Demand(Vec3(0.5, -0.25, 0.125), -1.5), 3.0)
    sent = packed(setpoint_message(BOAT, out, 1, 1, 1000))
    assert sent == attitude_target(1000, ROVER_MASK, (0.0, 0.0, 0.125), -0.5)
    assert (
        sent
        == (
            "fd2700000001bf520000"
            "e8030000"  # time
            "0000803f000000000000000000000000"  # q
            "00000000000000000000003e"  # rates
            "000000bf"  # thrust
            "010183"  # target, mask
        )
        + sent[-4:]
    )


@pytest.mark.parametrize(("name", "mask"), [("px4-plane", "07"), ("ardupilot-plane", "84")])
def test_golden_bytes_of_an_airplane_s_setpoint(name: str, mask: str) -> None:
    out = outgoing(PROFILES[name], Demand(attitude=Quaternion(1.6, 1.2, 0.0, 0.0), throttle=0.5), 1.0)
    sent = packed(setpoint_message(PROFILES[name], out, 1, 1, 1000))
    assert (
        sent
        == (
            "fd2700000001bf520000"
            "e8030000"  # time
            "cdcc4c3f9a99193f0000000000000000"  # q, of length 1
            "000000000000000000000000"  # rates
            "0000003f"  # throttle
            f"0101{mask}"  # target, mask
        )
        + sent[-4:]
    )


def test_golden_bytes_of_rates_and_throttle() -> None:
    profile = PROFILES["px4-plane"].by_rates()
    out = outgoing(profile, Demand(Vec3(0.5, -0.25, 0.125), throttle=1.5), 1.0)
    sent = packed(setpoint_message(profile, out, 1, 1, 1000))
    assert sent == attitude_target(1000, 0x80, (0.5, -0.25, 0.125), 1.0)
    takers = [row.name for row in PROFILES.values() if row.takes_rates]
    assert takers == ["px4-plane", "px4-copter", "ardupilot-copter"]


@pytest.mark.parametrize(
    ("name", "mask"), [("px4-copter", "c705"), ("ardupilot-copter", "c705"), ("px4-rover", "c70d")]
)
def test_golden_bytes_of_a_velocity(name: str, mask: str) -> None:
    demand = Demand(velocity_ned_m_s=Vec3(1.0, -2.0, 0.5), yaw_rate_rad_s=-0.25)
    out = outgoing(PROFILES[name], demand, 1.0)
    assert out.speed_m_s == pytest.approx(math.sqrt(5.25))
    sent = packed(setpoint_message(PROFILES[name], out, 1, 1, 1000))
    assert (
        sent
        == (
            "fd3500000001bf540000"
            "e8030000"  # time
            "000000000000000000000000"  # position
            "0000803f000000c00000003f"  # velocity
            "000000000000000000000000"  # acceleration
            "00000000"  # yaw
            "000080be"  # yaw rate
            f"{mask}0101"  # mask, target
            "01"  # local NED
        )
        + sent[-4:]
    )


def test_an_attitude_of_no_length_is_never_packed() -> None:
    out = outgoing(PROFILES["px4-plane"], Demand(attitude=Quaternion(0.0, 0.0, 0.0, 0.0)), 1.0)
    with pytest.raises(ValueError, match="not finite"):
        setpoint_message(PROFILES["px4-plane"], out, 1, 1, 0)


@pytest.mark.parametrize(("profile", "mask"), [(UUV, UUV_MASK), (BOAT, ROVER_MASK)])
def test_golden_bytes_of_the_neutral_setpoint(profile: Profile, mask: int) -> None:
    sent = packed(setpoint_message(profile, outgoing(profile, Demand(), 5.0), 1, 1, 7))
    assert sent == attitude_target(7, mask, (0.0, 0.0, 0.0), 0.0)


@pytest.mark.parametrize(
    ("profile", "name", "param2", "param3", "custom_mode"),
    [
        (UUV, "offboard", 6.0, 0.0, 393216),
        (UUV, "position", 3.0, 0.0, 196608),
        (UUV, "loiter", 4.0, 3.0, 50593792),
        (PROFILES["px4-rover"], "hold", 4.0, 3.0, 50593792),
        (UUV, "takeoff", 4.0, 2.0, 33816576),
        (UUV, "return", 4.0, 5.0, 84148224),
        (UUV, "land", 4.0, 6.0, 100925440),
        (UUV, "manual", 1.0, 0.0, 65536),
        (BOAT, "guided", 15.0, 0.0, 15),
        (BOAT, "hold", 4.0, 0.0, 4),
        (PROFILES["ardupilot-plane"], "loiter", 12.0, 0.0, 12),
        (PROFILES["ardupilot-copter"], "brake", 17.0, 0.0, 17),
        (BOAT, "manual", 0.0, 0.0, 0),
        (BOAT, "rtl", 11.0, 0.0, 11),
        (BOAT, "loiter", 5.0, 0.0, 5),
    ],
)
def test_golden_bytes_of_mode_commands(
    profile: Profile, name: str, param2: float, param3: float, custom_mode: int
) -> None:
    mode = profile.mode(name)
    assert mode is not None
    assert packed(set_mode_command(mode, 1, 1)) == command(176, 1.0, param2, param3)
    assert mode.custom_mode == custom_mode
    assert profile.mode_name(custom_mode) == name


@pytest.mark.parametrize(
    ("name", "holds"),
    [
        ("px4-uuv", "manual"),
        ("px4-copter", "hold"),
        ("ardupilot-rover", "hold"),
        ("ardupilot-plane", "loiter"),
        ("ardupilot-copter", "brake"),
    ],
)
def test_hold_is_the_mode_that_stays_without_a_pilot(name: str, holds: str) -> None:
    mode = PROFILES[name].mode("hold")
    assert mode is not None
    assert mode.name == holds
    assert "hold" in PROFILES[name].exits


def test_golden_bytes_of_arming() -> None:
    sent = packed(command_long(1, 1, dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0))
    assert sent == command(400, 1.0)
    assert sent[:-4] == "fd2000000001bf4c0000" + "0000803f" + "00000000" * 6 + "9001" + "0101"


def test_the_rows_say_what_the_firmwares_do() -> None:
    assert (UUV.autopilot, UUV.vehicle_types, UUV.planar, UUV.needs_stream) == (
        12,
        frozenset({12}),
        False,
        True,
    )
    assert (BOAT.autopilot, BOAT.vehicle_types, BOAT.planar, BOAT.needs_stream) == (
        3,
        frozenset({10, 11}),
        True,
        False,
    )
    assert (UUV.stream_timeout_s, BOAT.stream_timeout_s) == (1.0, 3.0)
    assert (UUV.control_mode.name, BOAT.control_mode.name) == ("offboard", "guided")
    assert UUV.mode_hz > 0, "only CURRENT_MODE shows what PX4 intends"
    for profile in PROFILES.values():
        assert profile.control_mode in profile.modes
        assert len({mode.custom_mode for mode in profile.modes}) == len(profile.modes)
        assert len({mode.name for mode in profile.modes}) == len(profile.modes)
        assert profile.mode("no such mode") is None
        assert profile.mode_name(99) == "mode 99"


def test_a_copter_of_any_number_of_rotors_is_one() -> None:
    """ArduCopter tells dodeca-hexas and decas as such (`AP_MotorsMatrix.cpp`); they were refused."""
    for kind in ("QUADROTOR", "HEXAROTOR", "OCTOROTOR", "DODECAROTOR", "DECAROTOR", "COAXIAL", "HELICOPTER"):
        beat = Heartbeat(getattr(dialect, f"MAV_TYPE_{kind}"), dialect.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 3)
        assert fitting(beat) == ["ardupilot-copter"]


numbers = st.floats(allow_nan=False)


@properties
@given(st.sampled_from(sorted(PROFILES)), numbers, numbers, numbers, numbers, st.floats(0.1, 50.0))
def test_every_field_is_clamped(
    name: str, roll: float, pitch: float, yaw: float, speed_m_s: float, full_m_s: float
) -> None:
    profile = PROFILES[name]
    velocity = Vec3(roll, pitch, speed_m_s)
    demand = Demand(
        Vec3(roll, pitch, yaw), speed_m_s, throttle=yaw, velocity_ned_m_s=velocity, yaw_rate_rad_s=yaw
    )
    out = outgoing(profile, demand, full_m_s)
    sent = bytes.fromhex(packed(setpoint_message(profile, out, 1, 1, 2**40)))
    (message,) = dialect.MAVLink(None).parse_buffer(sent)
    assert message.type_mask == profile.type_mask
    assert message.time_boot_ms == 0
    if profile.asked is Asked.VELOCITY_YAW_RATE:
        assert max(map(abs, (message.vx, message.vy, message.vz))) <= 1000.0
        assert abs(message.yaw_rate) <= BODY_RATE_MAX_RAD_S + 1e-6
        return
    for rate in (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate):
        assert abs(rate) <= BODY_RATE_MAX_RAD_S + 1e-6  # of 32 bits, too
    assert profile.thrust_min <= message.thrust <= profile.thrust_max
    if profile.asked is not Asked.ATTITUDE_THROTTLE:
        assert out.speed_m_s == pytest.approx(min(max(speed_m_s, -full_m_s), full_m_s))


@pytest.mark.parametrize("value", [1e300, -1e300, math.inf, -math.inf])
def test_clamps_hold_at_both_ends(value: float) -> None:
    sign = math.copysign(1.0, value)
    out = outgoing(UUV, Demand(Vec3(value, value, value), value), 5.0)
    assert out == Outgoing((sign * BODY_RATE_MAX_RAD_S,) * 3, sign, sign * 5.0)
    planar = outgoing(BOAT, Demand(Vec3(value, value, value), value), 5.0)
    assert planar == Outgoing((0.0, 0.0, sign * BODY_RATE_MAX_RAD_S), sign, sign * 5.0)


@pytest.mark.parametrize("field", range(4))
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_not_finite_is_never_packed(field: int, bad: float) -> None:
    fields = [0.0] * 4
    fields[field] = bad
    rates = (fields[0], fields[1], fields[2])
    with pytest.raises(ValueError, match="not finite"):
        setpoint_message(UUV, Outgoing(rates, fields[3], 0.0), 1, 1, 0)


@pytest.mark.parametrize("field", range(4))
def test_a_nan_is_not_clamped_into_a_number(field: int) -> None:
    fields = [0.0] * 4
    fields[field] = math.nan
    roll, pitch, yaw, speed_m_s = fields
    out = outgoing(UUV, Demand(Vec3(roll, pitch, yaw), speed_m_s), 5.0)
    assert math.isnan((*out.body_rates_frd_rad_s, out.thrust)[field])


def test_the_configuration_names_a_profile_and_a_mode_to_leave_to() -> None:
    assert profile_of(make_config()) is UUV
    assert profile_of(make_config(*ROVER)) is BOAT
    for override, text in (
        ("vehicle.profile=zeppelin", f"must be {one_of(sorted(PROFILES))}"),
        ("supervisor.exit_mode=offboard", "not a mode that px4-uuv can be left in"),
        ("supervisor.exit_mode=smart_rtl", 'must be "hold", "manual", "altitude"'),
    ):
        with pytest.raises(ConfigError, match=text):
            make_config(override)
