"""What both firmwares share: commands, parameters and options."""

from __future__ import annotations

import math
import struct
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.vehicle import Firmware, Origin, Vehicle, VehicleOptions
from sitl.vehicle import telemetry as common
from tests.vehicle_peer import Peer

BOTH = pytest.mark.parametrize("firmware", list(Firmware))


# --- commands ------------------------------------------------------------------------------------------


@BOTH
def test_commands_for_others_are_not_answered(firmware: Firmware) -> None:
    peer = Peer(firmware)
    assert peer.command(400, 1, target_system=2) == []
    assert peer.command(400, 1, target_component=7) == []
    assert peer.command(400, 1, target_system=0, target_component=0) == [0]


@BOTH
def test_unknown_commands_are_unsupported(firmware: Firmware) -> None:
    assert Peer(firmware).command(31999) == [3]


@BOTH
def test_command_int_works_like_command_long(firmware: Firmware) -> None:
    peer = Peer(firmware)
    heard = peer.send(mavlink.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, 1.0, 0.0, 0.0, 0.0, 0, 0, 0.0))
    assert [(m.command, m.result) for m in heard if m.get_type() == "COMMAND_ACK"] == [(400, 0)]
    assert peer.vehicle.armed


@BOTH
def test_an_ack_goes_to_who_asked(firmware: Firmware) -> None:
    peer = Peer(firmware)
    message = mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, *[0.0] * 6)
    ack = next(m for m in peer.send(message, 255, 190) if m.get_type() == "COMMAND_ACK")
    assert (ack.target_system, ack.target_component) == (255, 190)


@BOTH
@pytest.mark.parametrize("name", ["AUTOPILOT_VERSION", "HOME_POSITION", "GPS_GLOBAL_ORIGIN", "ATTITUDE"])
def test_request_message_sends_it_once(firmware: Firmware, name: str) -> None:
    peer = Peer(firmware)
    peer.run(0.001)
    heard = peer.send(mavlink.MAVLink_command_long_message(1, 1, 512, 0, common.ID[name], *[0.0] * 6))
    order = ["COMMAND_ACK", name] if firmware.startswith("ardupilot") else [name, "COMMAND_ACK"]
    assert [m.get_type() for m in heard] == order


@pytest.mark.parametrize(("firmware", "result"), [(Firmware.PX4_UUV, 2), (Firmware.ARDUPILOT_ROVER, 4)])
@pytest.mark.parametrize("message_id", [9999.0, -1.0, math.nan])
def test_request_message_of_something_unknown(firmware: Firmware, result: int, message_id: float) -> None:
    assert Peer(firmware).command(512, message_id) == [result]


@BOTH
def test_an_early_request_for_the_home_is_accepted_and_nothing_comes(firmware: Firmware) -> None:
    peer = Peer(firmware, estimator_ready_s=60.0)
    peer.run(2.0)
    assert peer.command(512, 242) == [0]
    assert "HOME_POSITION" not in {m.get_type() for m in peer.heard}


@BOTH
def test_the_interval_that_was_set_is_the_interval_that_is_told(firmware: Firmware) -> None:
    peer = Peer(firmware)
    assert peer.command(511, 30, 100_000) == [0]
    assert peer.command(510, 30) == [0]
    assert peer.last("MESSAGE_INTERVAL").interval_us == 100_000
    peer.command(511, 30, -1)
    peer.command(510, 30)
    assert peer.last("MESSAGE_INTERVAL").interval_us == -1


@BOTH
def test_interval_zero_is_the_default_again(firmware: Firmware) -> None:
    streams = {"MAV1_EXTRA1": 1.0} if firmware.startswith("ardupilot") else {}
    peer = Peer(firmware, parameters=streams)
    peer.command(511, 30, -1)
    assert not [m for m in peer.run(2.0) if m.get_type() == "ATTITUDE"][1:]
    peer.command(511, 30, 0)
    assert len([m for m in peer.run(2.0) if m.get_type() == "ATTITUDE"]) >= 2


@BOTH
def test_home_is_the_origin_until_it_is_set_to_where_the_vehicle_is(firmware: Firmware) -> None:
    peer = Peer(firmware, origin=Origin(47.0, 8.0, 400.0), initial_position_ned_m=(10.0, 20.0, 0.0))
    assert peer.command(410) == [0]
    home = peer.last("HOME_POSITION")
    assert (home.x, home.y, home.z, home.latitude, home.altitude) == (0.0, 0.0, 0.0, 470000000, 400000)
    assert peer.command(179, 1) == [0]
    home = peer.last("HOME_POSITION")
    assert (home.x, home.y) == (10.0, 20.0)
    assert home.latitude > 470000000


# --- parameters ----------------------------------------------------------------------------------------


@BOTH
def test_the_parameter_list_is_complete(firmware: Firmware) -> None:
    peer = Peer(firmware)
    heard = peer.send(mavlink.MAVLink_param_request_list_message(1, 1))
    values = [m for m in heard if m.get_type() == "PARAM_VALUE"]
    numbered = [m for m in values if m.param_id != "_HASH_CHECK"]
    assert [m.param_index for m in numbered] == list(range(numbered[0].param_count))
    assert len(values) - len(numbered) == firmware.startswith("px4")


def bytewise(value: int) -> float:
    number: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return number


@pytest.mark.parametrize(
    ("firmware", "name", "value", "kind", "stored"),
    [
        (Firmware.PX4_UUV, "COM_OBL_RC_ACT", bytewise(5), 6, 5.0),
        (Firmware.PX4_UUV, "COM_OF_LOSS_T", 2.5, 9, 2.5),
        (Firmware.PX4_UUV, "COM_OF_LOSS_T", 2.5, 6, 1.0),
        (Firmware.PX4_UUV, "COM_OF_LOSS_T", math.nan, 9, 1.0),
        (Firmware.ARDUPILOT_ROVER, "SCHED_LOOP_RATE", 200.0, 4, 200.0),
        (Firmware.ARDUPILOT_ROVER, "SCHED_LOOP_RATE", 200.0, 9, 200.0),
        (Firmware.ARDUPILOT_ROVER, "SCHED_LOOP_RATE", 1e9, 4, 50.0),
        (Firmware.ARDUPILOT_ROVER, "WP_SPEED", math.inf, 9, 5.0),
    ],
)
def test_param_set(firmware: Firmware, name: str, value: float, kind: int, stored: float) -> None:
    peer = Peer(firmware)
    peer.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), value, kind))
    assert peer.vehicle.parameter(name) == stored
    heard = peer.send(mavlink.MAVLink_param_request_read_message(1, 1, name.encode(), -1))
    answer = next(m for m in heard if m.get_type() == "PARAM_VALUE")
    integer = firmware is Firmware.PX4_UUV and answer.param_type != 9
    assert answer.param_value == (bytewise(round(stored)) if integer else stored)


@BOTH
@pytest.mark.parametrize(("name", "index"), [(b"NO_SUCH", -1), (b"", 9999), (b"\xff\xfe", -1)])
def test_unknown_parameters_are_not_answered(firmware: Firmware, name: bytes, index: int) -> None:
    peer = Peer(firmware)
    heard = peer.send(mavlink.MAVLink_param_request_read_message(1, 1, name, index))
    assert "PARAM_VALUE" not in {m.get_type() for m in heard}


def test_unknown_overrides_and_modes_are_refused_when_the_vehicle_is_built() -> None:
    for options in (
        VehicleOptions(parameters={"NO_SUCH": 1.0}),
        VehicleOptions(parameters={"COM_OF_LOSS_T": math.nan}),
        VehicleOptions(initial_mode="NO_SUCH"),
    ):
        with pytest.raises(ValueError, match=r"NO_SUCH|cannot be"):
            Vehicle(options)


@pytest.mark.parametrize(
    "wrong",
    [
        {"system_id": 0},
        {"speed_at_full_thrust_m_s": 0.0},
        {"initial_position_ned_m": (math.nan, 0.0, 0.0)},
        {"origin": Origin(91.0, 0.0, 0.0)},
        {"clock_drift_ppm": math.nan},
        {"estimator_ready_s": -1.0},
    ],
)
def test_options_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="must be"):
        VehicleOptions(**wrong)
