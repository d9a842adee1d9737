"""The built-in vehicle against recorded autopilots: message sets, fields, rates, answers, modes.

What differs on purpose stands in the tables below, with the reason; anything else that differs fails.
"""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from sitl.vehicle import Firmware
from sitl.vehicle.telemetry import ID
from tests.vehicle_peer import RATES, YAW_RATE, Peer

FLIGHTS = json.loads((Path(__file__).parent / "data" / "vehicle_messages.json").read_text())["flights"]
KEY = {Firmware.PX4_UUV: "px4", Firmware.ARDUPILOT_ROVER: "ardurover"}
MASK = {Firmware.PX4_UUV: RATES, Firmware.ARDUPILOT_ROVER: YAW_RATE}
BOTH = pytest.mark.parametrize("firmware", list(KEY))

#: Recorded, and not sent by the built-in vehicle.
LEFT_OUT = {
    Firmware.PX4_UUV: {
        "DISTANCE_SENSOR": "a UUV has no range finder by default",
        "OPEN_DRONE_ID_LOCATION": "remote identification of aircraft",
        "OPEN_DRONE_ID_SYSTEM": "remote identification of aircraft",
        "POSITION_TARGET_GLOBAL_INT": "no position controller",
        "POSITION_TARGET_LOCAL_NED": "no position controller",
    },
    Firmware.ARDUPILOT_ROVER: {
        "SCALED_IMU2": "one set of sensors",
        "SCALED_IMU3": "one set of sensors",
        "SCALED_PRESSURE2": "one set of sensors",
    },
}
#: Fields whose recorded values do not bind: another vehicle, or a quantity that the plant does not model.
FREE = {
    Firmware.PX4_UUV: {
        "AUTOPILOT_VERSION": {"flight_sw_version", "middleware_sw_version", "os_sw_version", "uid"},
        "BATTERY_STATUS": {"current_battery", "current_consumed"},
        "ESTIMATOR_STATUS": set(),
        "GPS_RAW_INT": {"h_acc", "v_acc", "vel_acc"},
        "HEARTBEAT": {"type"},
        "HIGHRES_IMU": {"temperature"},
        "ODOMETRY": {"reset_counter"},
        "SERVO_OUTPUT_RAW": {f"servo{n}_raw" for n in range(1, 9)},
        "SYS_STATUS": {
            "current_battery",
            "onboard_control_sensors_present",
            "onboard_control_sensors_enabled",
            "onboard_control_sensors_health",
        },
    },
    Firmware.ARDUPILOT_ROVER: {
        "AUTOPILOT_VERSION": {"uid2"},
        "BATTERY_STATUS": {
            "battery_function",
            "type",
            "current_consumed",
            "current_battery",
            "energy_consumed",
        },
        "GPS_RAW_INT": {"alt", "alt_ellipsoid", "eph", "epv"},
        "RAW_IMU": {"xgyro", "ygyro", "zmag", "zacc"},
        "SERVO_OUTPUT_RAW": set(),
        "VFR_HUD": {"airspeed"},
        "VIBRATION": set(),
        "SIMSTATE": {"zacc", "xgyro", "ygyro"},
        "GLOBAL_POSITION_INT": {"vz"},
        "SYS_STATUS": {"current_battery"},
    },
}
PARAMETERS_OF_A_UUV = {f"UUV_{axis}_{gain}" for axis in ("ROLL", "PITCH", "YAW") for gain in "PD"} | {
    "UUV_THRUST_SAT",
    "UUV_TORQUE_SAT",
}
#: Of ArduRover, and not among those that were recorded (`Rover/Parameters.cpp`).
PARAMETERS_NOT_RECORDED = {"FS_EKF_ACTION", "FS_GCS_ENABLE", "LOIT_RADIUS"}


def a_flight(firmware: Firmware) -> Peer:
    """The recorded flight in short: early requests, arming, setpoints, refusals, loss of the stream."""
    peer = Peer(firmware, estimator_ready_s=3.0)
    peer.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
    peer.run(0.5)
    peer.command(400, 1)
    peer.command(512, ID["AUTOPILOT_VERSION"])
    peer.run(5.0)
    interval_us = 20_000 if firmware is Firmware.PX4_UUV else 25_000
    for name in ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"):
        assert peer.command(511, ID[name], interval_us) == [0]
    peer.command(512, ID["GPS_GLOBAL_ORIGIN"])
    peer.command(512, ID["HOME_POSITION"])
    peer.send(mavlink.MAVLink_param_request_list_message(1, 1))
    peer.setpoint(MASK[firmware])
    peer.command(176, 1, 6 if firmware is Firmware.PX4_UUV else 15)
    peer.command(400, 1)
    peer.stream(3.0, MASK[firmware], rates=(0.0, 0.0, 0.2), thrust=0.4)
    peer.run(5.0)
    return peer


@pytest.fixture(scope="module", params=list(KEY))
def flown(request: pytest.FixtureRequest) -> tuple[Firmware, Peer]:
    """One flight of each firmware, for all that only looks at what was said."""
    return request.param, a_flight(request.param)


def test_it_says_what_the_recorded_one_says_and_what_it_leaves_out_is_listed(
    flown: tuple[Firmware, Peer],
) -> None:
    firmware, peer = flown
    said = {m.get_type() for m in peer.heard}
    recorded = set(FLIGHTS[KEY[firmware]]["messages"])
    assert said - recorded == set()
    assert recorded - said == set(LEFT_OUT[firmware])


def test_every_message_has_the_recorded_fields(flown: tuple[Firmware, Peer]) -> None:
    firmware, peer = flown
    recorded = FLIGHTS[KEY[firmware]]["messages"]
    seen = {m.get_type(): m for m in peer.heard}
    assert len(seen) > 20
    for name, message in seen.items():
        assert list(message.fieldnames) == recorded[name]["fields"]


def test_fields_that_hardly_change_have_recorded_values(flown: tuple[Firmware, Peer]) -> None:
    firmware, peer = flown
    recorded = FLIGHTS[KEY[firmware]]["messages"]
    free = FREE[firmware]
    compared = 0
    wrong = []
    for message in peer.heard:
        name = message.get_type()
        for field, values in recorded[name].get("constant", {}).items():
            if field in free.get(name, set()) or (name == "HEARTBEAT" and field != "autopilot"):
                continue
            compared += 1
            if plain(getattr(message, field)) not in values:
                wrong.append((name, field, getattr(message, field), values))
    assert wrong == []
    assert compared > 1000


def plain(value: Any) -> Any:
    """A field as the excerpt writes it."""
    if isinstance(value, float) and math.isnan(value):
        return None
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value


@BOTH
def test_default_rates_are_the_recorded_ones(firmware: Firmware) -> None:
    peer = Peer(firmware)
    heard = peer.run(40.0)
    recorded = FLIGHTS[KEY[firmware]]["messages"]
    said = {m.get_type() for m in heard}
    compared = 0
    for name, entry in recorded.items():
        interval_ms = entry.get("default_interval_ms")
        # TIMESYNC counts the answers to the companion's questions, HEARTBEAT those at mode changes.
        if interval_ms is None or name in {"TIMESYNC", "HEARTBEAT"} or name not in said:
            continue
        count = sum(1 for m in heard if m.get_type() == name)
        assert 40_000 / count == pytest.approx(interval_ms, rel=0.06), name
        compared += 1
    assert compared >= (18 if firmware is Firmware.PX4_UUV else 12)


@BOTH
def test_requested_rates_come_as_they_came_in_the_recording(firmware: Firmware) -> None:
    loop = {"SCHED_LOOP_RATE": 200.0} if firmware is Firmware.ARDUPILOT_ROVER else {}
    peer = Peer(firmware, parameters=loop)
    recorded = FLIGHTS[KEY[firmware]]["messages"]
    asked = {
        name: entry
        for name, entry in recorded.items()
        if "requested_us" in entry and name not in LEFT_OUT[firmware]
    }
    assert len(asked) > 8
    for name, entry in asked.items():
        assert peer.command(511, ID[name], entry["requested_us"]) == [0], name
    heard = peer.run(40.0)
    for name, entry in asked.items():
        count = sum(1 for m in heard if m.get_type() == name)
        if entry["requested_us"] < 0:
            assert count == 0, name
        else:
            assert 40_000 / count == pytest.approx(entry["requested_interval_ms"], rel=0.06), name


@BOTH
def test_parameters_have_the_recorded_types(firmware: Firmware) -> None:
    peer = Peer(firmware)
    peer.send(mavlink.MAVLink_param_request_list_message(1, 1))
    types = {m.param_id: m.param_type for m in peer.heard if m.get_type() == "PARAM_VALUE"}
    types.pop("_HASH_CHECK", None)
    own = PARAMETERS_OF_A_UUV if firmware is Firmware.PX4_UUV else PARAMETERS_NOT_RECORDED
    assert {name: kind for name, kind in types.items() if name not in own} == FLIGHTS[KEY[firmware]][
        "parameter_types"
    ]


def test_modes_show_in_heartbeat_and_current_mode_as_recorded(flown: tuple[Firmware, Peer]) -> None:
    """Every (base_mode, custom_mode, system_status) shown is a recorded one, and the main ones all come."""
    firmware, peer = flown
    recorded = FLIGHTS[KEY[firmware]]["modes"]
    shown: list[list[Any]] = []
    for m in peer.heard:
        if m.get_type() == "HEARTBEAT":
            assert m.autopilot == (12 if firmware is Firmware.PX4_UUV else 3)
            assert m.type == (12 if firmware is Firmware.PX4_UUV else 10)
            shown.append(["HEARTBEAT", m.base_mode, m.custom_mode, m.system_status])
        elif m.get_type() == "CURRENT_MODE":
            shown.append(["CURRENT_MODE", m.custom_mode, m.intended_custom_mode])
    assert [entry for entry in shown if entry not in recorded] == []
    must = (
        [["HEARTBEAT", 145, 393216, 4], ["HEARTBEAT", 209, 196608, 5], ["CURRENT_MODE", 196608, 393216]]
        if firmware is Firmware.PX4_UUV
        else [["HEARTBEAT", 65, 16, 2], ["HEARTBEAT", 65, 0, 4], ["HEARTBEAT", 137, 15, 4]]
    )
    assert [entry for entry in must if entry not in shown] == []


@BOTH
def test_commands_are_answered_as_recorded(firmware: Firmware) -> None:
    """The recorded commands in their order, each in the situation that it was recorded in.

    On purpose different: PX4 answers DO_SET_MODE twice since 2025-08, once in the recording; and its
    simulator refuses to reboot even disarmed, which a vehicle does not.
    """
    px4 = firmware is Firmware.PX4_UUV
    guided = (176, 6.0 if px4 else 15.0)
    peer = Peer(firmware, estimator_ready_s=3.0)
    peer.run(0.5)
    compared = 0
    for command, params, results in FLIGHTS[KEY[firmware]]["commands"]:
        if (command, params[0]) == (400, 1.0) and results == [0]:
            peer.run(5.0)
        if (command, params[1]) == guided:
            peer.run(2.0)
            if results == [0]:
                peer.setpoint(MASK[firmware])
        answers = peer.command(command, *params)
        if px4 and command == 176:
            assert answers.pop(0) == 0
        disarmed_reboot = px4 and command == 246 and compared == len(FLIGHTS["px4"]["commands"]) - 1
        assert answers == ([0] if disarmed_reboot else results), (command, params)
        compared += 1
    assert compared >= 15


@BOTH
def test_texts_are_recorded_texts(firmware: Firmware) -> None:
    peer = a_flight(firmware)
    recorded = {(severity, text) for severity, text in FLIGHTS[KEY[firmware]]["statustexts"]}
    # EKF lines of the recording are left out of the excerpt; the reason for not arming differs by the second.
    own = {(6, "EKF3 IMU0 is using GPS")}
    said = {(m.severity, m.text) for m in peer.heard if m.get_type() == "STATUSTEXT"}
    assert len(said) >= 3
    assert said - recorded - own == set()
