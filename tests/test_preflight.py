"""`guidance check` on virtual time: all is well on both profiles, and each fault is named for what it is."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.mavlink.messages import MESSAGE_IDS
from guidance.preflight.findings import Verdict
from guidance.preflight.observation import LISTEN_NS
from sitl.vehicle import Firmware, Vehicle, VehicleOptions
from sitl.vehicle.px4_modes import LOITER, NAMES
from tests.helpers import ROVER
from tests.mavlink_peer import Sender
from tests.preflight_rig import SECOND, START_NS, Bench, Others, only

SERIAL = 'link.connection="serial:///dev/ttyUSB0?baud=115200"'
#: A rover as shipped: its loop grants 40 Hz.
SLOW_ROVER = (*ROVER, "link.rate_hz=40", "law.rho2_per_s=3", "law.rho3_per_s=3")
BOTH = pytest.mark.parametrize("profile", [(), SLOW_ROVER], ids=["px4-uuv", "ardupilot-rover"])


def once_a_second(sender: Sender, *messages: Any) -> Others:
    """What a component says beside the autopilot."""

    def others(now_ns: int) -> Iterator[bytes]:
        if (now_ns - START_NS) % SECOND == 0:
            yield from map(sender.pack, messages)

    return others


def once_and_again(sender: Sender, message: Any, *, from_ns: int) -> Others:
    """What another program insists on."""

    def orders(now_ns: int) -> Iterator[bytes]:
        since_ns = now_ns - START_NS - from_ns
        if since_ns >= 0 and since_ns % (SECOND // 2) == 0:
            yield sender.pack(message)

    return orders


def heartbeat(kind: int, autopilot: int = mavlink.MAV_AUTOPILOT_INVALID) -> Any:
    return mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, mavlink.MAV_STATE_ACTIVE, 3)


@BOTH
def test_a_healthy_vehicle_passes_and_takes_no_longer_than_the_listening(profile: tuple[str, ...]) -> None:
    bench = Bench(*profile)
    assert bench.bad() == {}
    assert bench.took_s == LISTEN_NS / SECOND
    skipped = {name for name, f in bench.findings().items() if f.verdict is Verdict.SKIP}
    assert skipped == {"zenoh", "log"}  # not looked at by the bench


@BOTH
def test_it_commands_nothing(profile: tuple[str, ...]) -> None:
    """Though the configuration says engage = "auto" and arm = true, and the vehicle is ready."""
    healths = [MESSAGE_IDS[name].to_bytes(3, "little") for name in ("SYS_STATUS", "ESTIMATOR_STATUS")]
    bench = Bench(
        *profile,
        seconds=20.0,
        deaf_to=lambda message: message.get_type() == "PARAM_REQUEST_READ",
        garbles=lambda data: b"" if data[7:10] in healths else data,  # so that they are asked for
    )
    kinds = Counter(message.get_type() for message in bench.sent)
    assert set(kinds) == {"HEARTBEAT", "TIMESYNC", "COMMAND_LONG", "PARAM_REQUEST_READ"}
    commands = {message.command for message in bench.sent if message.get_type() == "COMMAND_LONG"}
    assert commands == {mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, mavlink.MAV_CMD_REQUEST_MESSAGE}
    requested = {m.param1 for m in bench.sent if m.get_type() == "COMMAND_LONG" and m.command == 512}
    assert profile or requested >= {MESSAGE_IDS["SYS_STATUS"], MESSAGE_IDS["ESTIMATOR_STATUS"]}
    assert not bench.vehicle.armed
    assert bench.vehicle.mode == ("MANUAL" if profile else NAMES[LOITER])


def test_a_dead_line_ends_at_the_deadline_with_what_to_look_at() -> None:
    bench = Bench(SERIAL, dead=True)
    assert bench.took_s == 10.0
    found = only(bench, "bytes", Verdict.FAIL)
    assert found.found == "no bytes yet"
    assert "RX wired to TX" in found.todo
    assert bench.findings()["state"].found == "the autopilot is not heard"


def test_a_wrong_baud_rate_is_bytes_without_packets() -> None:
    dice = random.Random(1)
    bench = Bench(SERIAL, garbles=lambda data: dice.randbytes(len(data)))
    found = only(bench, "bytes", Verdict.FAIL)
    assert "bytes and no MAVLink frame" in found.found
    assert found.todo.startswith("wrong baud rate?")


def test_bytes_that_another_program_takes_away_are_seen_as_garbage() -> None:
    dice = random.Random(2)
    bench = Bench(garbles=lambda data: data if dice.random() < 0.9 else data[7:])
    assert "are no MAVLink" in bench.bad()["bytes"].found
    assert "another program" in bench.bad()["bytes"].todo


def test_an_autopilot_of_another_id_is_offered() -> None:
    found = only(Bench(vehicle={"system_id": 7}), "autopilot", Verdict.FAIL)
    assert found.found == "heard: an autopilot (7/1), no heartbeat of 1/1"
    assert found.todo == "is it vehicle.system_id = 7, vehicle.component_id = 1 that is meant?"


def test_a_ground_station_alone_is_no_autopilot() -> None:
    others = once_a_second(Sender(255, 190), heartbeat(mavlink.MAV_TYPE_GCS))
    found = only(Bench(dead=True, others=others), "autopilot", Verdict.FAIL)
    assert found.found == "heard: a ground station (255/190), no heartbeat of 1/1"
    assert "does the router forward" in found.todo


def test_a_telemetry_radio_with_nothing_behind_it_is_named() -> None:
    status = mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0)
    others = once_a_second(Sender(51, 68, mavlink1=True), heartbeat(mavlink.MAV_TYPE_GENERIC), status)
    found = only(Bench(SERIAL, dead=True, others=others), "autopilot", Verdict.FAIL)
    assert "a telemetry radio (51/68)" in found.found
    assert "nothing comes through the radio" in found.found
    assert "paired" in found.todo


def test_everybody_else_on_the_line_is_named() -> None:
    radio = once_a_second(Sender(51, 68), mavlink.MAVLink_radio_status_message(0, 0, 0, 0, 0, 0, 0))
    camera = once_a_second(Sender(1, 100), heartbeat(mavlink.MAV_TYPE_CAMERA))
    bench = Bench(others=lambda now_ns: [*radio(now_ns), *camera(now_ns)])
    assert bench.bad() == {}
    assert bench.findings()["others heard"].found == "camera (1/100), a telemetry radio (51/68)"


def test_a_service_that_runs_already_is_noticed_by_its_heartbeat() -> None:
    others = once_a_second(Sender(1, 191), heartbeat(mavlink.MAV_TYPE_ONBOARD_CONTROLLER))
    found = only(Bench(others=others), "others heard", Verdict.WARN)
    assert "as this service would (1/191)" in found.found


def test_two_autopilots_of_one_id_are_named() -> None:
    other = Vehicle(VehicleOptions(clock_offset_ns=3_000_000_000), boot_ns=START_NS)
    bench = Bench(others=other.advance)
    bad = bench.bad()
    assert bad["two autopilots"].verdict is Verdict.FAIL
    assert bad["two autopilots"].found == "two senders speak as 1/1"
    assert "MAV_SYS_ID" in bad["two autopilots"].todo


def test_orders_on_an_unsigned_line_are_worth_a_word() -> None:
    bad = Bench("link.commands_from=[255, 254]").bad()
    assert bad["orders by MAVLink"].verdict is Verdict.WARN
    assert "system 255 or 254" in bad["orders by MAVLink"].found
    assert "orders by MAVLink" not in Bench().bad()


def test_another_vehicle_type_is_not_what_the_profile_is_for() -> None:
    found = only(Bench(vehicle={"parameters": {"MAV_TYPE": 7}}), "profile", Verdict.FAIL)
    assert found.found == "px4-uuv is not for MAV_AUTOPILOT_PX4 MAV_TYPE_AIRSHIP"
    assert "known: ardupilot-copter, ardupilot-plane, ardupilot-rover, px4-copter" in found.todo


def test_the_profile_of_another_firmware_is_named() -> None:
    bench = Bench(vehicle={"firmware": Firmware.ARDUPILOT_ROVER})
    assert bench.bad()["profile"].todo.endswith("set vehicle.profile = ardupilot-rover")


def test_a_rate_that_is_denied_is_named_with_the_one_that_is_granted() -> None:
    bench = Bench(*ROVER, "link.rate_hz=70")
    found = bench.bad()["ATTITUDE_QUATERNION"]
    assert found.verdict is Verdict.WARN
    assert "70 Hz was denied" in found.found
    assert found.todo.startswith("set link.rate_hz = 36")
    loop = bench.bad()["SCHED_LOOP_RATE"]
    assert loop.found == "50 Hz, needs at least 87.5 for link.rate_hz = 70"
    assert "link.rate_hz = 40" in loop.todo


def test_a_rate_that_falls_back_is_noticed() -> None:
    station = Sender(255, 190)
    command, message = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, MESSAGE_IDS["ODOMETRY"]
    slow = mavlink.MAVLink_command_long_message(1, 1, command, 0, message, 100_000, 0, 0, 0, 0, 0)
    bad = Bench(orders=once_and_again(station, slow, from_ns=3 * SECOND // 2)).bad()
    assert bad["rate fell"].found.startswith("ODOMETRY fell back to ")
    assert "another program may have reset it" in bad["rate fell"].todo
    assert bad["ODOMETRY"].verdict is Verdict.FAIL


def test_a_stream_that_never_comes_is_named() -> None:
    def deaf(message: Any) -> bool:
        wanted = MESSAGE_IDS["ATTITUDE_QUATERNION"]
        return bool(message.get_type() == "COMMAND_LONG" and message.param1 == wanted)

    bench = Bench(*SLOW_ROVER, deaf_to=deaf)
    assert bench.findings()["ATTITUDE_QUATERNION"].found == "does not come, ATTITUDE stands in"
    assert bench.bad() == {}
    assert "ATTITUDE" in bench.findings()["state"].found


def test_without_timesync_the_clock_is_named() -> None:
    bench = Bench(deaf_to=lambda message: message.get_type() == "TIMESYNC")
    assert bench.bad()["clock"].found == "no answers to TIMESYNC"
    assert bench.bad()["state"].verdict is Verdict.FAIL


def test_an_estimator_that_is_not_ready_is_named_and_so_is_what_follows() -> None:
    bench = Bench(*SLOW_ROVER, vehicle={"estimator_ready_s": 60.0}, seconds=5.0)
    bad = bench.bad()
    assert (
        bad["estimator"].found
        == "without position, anything but a constant position (EKF_STATUS_REPORT 0xa7)"
    )
    assert bad["arming"].found == "its pre-arm checks do not pass, active"
    assert bad["state"].found == "no attitude or no position yet"
    assert bad["LOCAL_POSITION_NED"].found == "does not come"
    assert bad["GLOBAL_POSITION_INT"].found == "40 of 40 Hz, but not usable"
    assert bench.findings()["origin"].verdict is Verdict.SKIP
    assert bench.took_s == 5.0


def test_px4_that_stands_is_not_taken_for_one_without_position() -> None:
    """EKF2 sets ESTIMATOR_CONST_POS_MODE of a vehicle at rest, too: 0x3ff on the ground, PX4 1.17."""
    copter = ("vehicle.profile=px4-copter",)
    bench = Bench(*copter)
    assert bench.observation.estimator_flags == 0x3BF
    assert bench.findings()["estimator"].verdict is Verdict.OK
    bench = Bench(*copter, vehicle={"estimator_ready_s": 60.0}, seconds=5.0)
    assert bench.bad()["estimator"].found.endswith("anything but a constant position (ESTIMATOR_STATUS 0xe5)")


def test_px4_that_would_not_arm_is_named_though_it_does_not_enable_the_bit() -> None:
    bench = Bench(vehicle={"estimator_ready_s": 60.0}, seconds=5.0)
    assert bench.bad()["arming"].found == "its pre-arm checks do not pass, uninit"


def test_armed_in_the_control_mode_the_service_would_leave_it_alone() -> None:
    vehicle = {"initial_mode": "GUIDED", "initially_armed": True}
    found = only(Bench(*SLOW_ROVER, vehicle=vehicle), "mode", Verdict.WARN)
    assert "guided, armed" in found.found


def test_an_origin_that_is_not_known_is_named() -> None:
    place = "flight.origin=[47.397742, 8.545594, 489.0]"
    assert Bench(place).bad() == {}
    asked = MESSAGE_IDS["GPS_GLOBAL_ORIGIN"]
    bench = Bench(place, deaf_to=lambda m: m.get_type() == "COMMAND_LONG" and m.param1 == asked)
    found = only(bench, "origin", Verdict.FAIL)
    assert "GPS_GLOBAL_ORIGIN" in found.found
    assert bench.took_s < 5.0


def test_a_vehicle_far_from_the_start_is_sent_closer() -> None:
    found = only(Bench("supervisor.engage_max_error_m=5"), "start", Verdict.WARN)
    assert found.found.endswith("m away, engages within 5 m")


def test_a_lossy_line_is_named_and_everything_else_is_still_found() -> None:
    dice = random.Random(3)
    bench = Bench(garbles=lambda data: data if dice.random() < 0.92 else b"")
    found = only(bench, "loss", Verdict.WARN)
    assert "packets lost" in found.found


def test_a_serial_line_that_is_too_slow_is_named() -> None:
    bench = Bench('link.connection="serial:///dev/ttyUSB0?baud=57600"')
    bad = bench.bad()
    assert bad["slow line"].found == "the serial line is too slow"
    assert "baud rate of" in bad["slow line"].todo
    assert bad["throughput"].found.startswith("the line is full")
