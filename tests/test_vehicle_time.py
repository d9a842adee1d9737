"""The vehicle's time, its streams and its packets, and that nothing sent to it breaks it.

Invariant of the fuzzing: whatever bytes arrive, `receive` and `advance` return, every datagram sent is a row
of good MAVLink 2 packets with gapless sequence numbers, and the vehicle's truth stays finite.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import attitude_from_euler
from sitl.vehicle import Firmware, Noise, Origin, Vehicle, VehicleOptions
from sitl.vehicle import telemetry as common
from sitl.vehicle.body import BodyState
from sitl.vehicle.clock import BootClock
from sitl.vehicle.projection import azimuthal_equidistant
from sitl.vehicle.px4_uuv import Px4Uuv
from sitl.vehicle.sample import Sample
from sitl.vehicle.schedule import Streams
from tests.vehicle_peer import MS, RATES, SECOND, YAW_RATE, Peer, px4_in_offboard

BOTH = pytest.mark.parametrize("firmware", list(Firmware))


def decoded(datagrams: list[bytes]) -> list[Any]:
    parser = mavlink.MAVLink(None)
    return [m for datagram in datagrams for m in parser.parse_buffer(datagram) or []]


# --- time ----------------------------------------------------------------------------------------------


@given(
    st.integers(-(10**17), 10**17), st.integers(0, 10**13), st.integers(-100_000_000, 100_000_000), st.data()
)
def test_when_is_the_first_instant_at_which_the_clock_shows_it(
    boot_ns: int, offset_ns: int, drift_ppb: int, data: st.DataObject
) -> None:
    clock = BootClock(boot_ns, offset_ns, drift_ppb)
    shown = data.draw(st.integers(offset_ns + 1, offset_ns + 10**14))
    now_ns = clock.when(shown)
    assert clock.at(now_ns) >= shown
    assert clock.at(now_ns - 1) < shown


@BOTH
@pytest.mark.parametrize("drift_ppm", [0.0, 200.0, -4700.0])
def test_timesync_is_answered_with_the_boot_clock(firmware: Firmware, drift_ppm: float) -> None:
    peer = Peer(firmware, clock_drift_ppm=drift_ppm, clock_offset_ns=5 * SECOND)
    peer.run(100.0)
    heard = peer.send(mavlink.MAVLink_timesync_message(0, 123))
    answer = next(m for m in heard if m.get_type() == "TIMESYNC" and m.tc1)
    assert answer.ts1 == 123
    assert answer.tc1 == pytest.approx(105 * SECOND + 100_000 * drift_ppm, abs=1000)
    assert not [m for m in peer.send(mavlink.MAVLink_timesync_message(5, 6)) if m.get_type() == "TIMESYNC"]


def test_telemetry_carries_the_state_of_its_own_time_stamp() -> None:
    """Position is exact at the stamped millisecond although the setpoint came between two of them."""
    peer = px4_in_offboard()
    peer.run(0.0123456)
    start_ns = peer.now_ns
    peer.setpoint(thrust=0.5)
    heard = [m for m in peer.run(0.5) if m.get_type() == "LOCAL_POSITION_NED"]
    assert len(heard) > 10
    for m in heard:
        assert m.x == pytest.approx(-10.0 + 2.5 * (m.time_boot_ms * MS - start_ns) * 1e-9, abs=2e-6)


def test_a_setpoint_acts_at_the_nanosecond_of_its_receipt() -> None:
    peer = px4_in_offboard()
    peer.run(0.001000001)
    peer.setpoint(thrust=1.0)
    peer.run(0.000000123)
    assert peer.vehicle.truth(peer.now_ns).position_ned_m[0] + 10.0 == pytest.approx(5.0 * 123e-9, rel=1e-6)


@BOTH
def test_how_often_advance_is_called_changes_nothing(firmware: Firmware) -> None:
    mask = YAW_RATE if firmware is Firmware.ARDUPILOT_ROVER else RATES

    def fly(steps_ns: int) -> tuple[list[bytes], Any]:
        peer = Peer(firmware, noise=Noise(position_m=0.1, attitude_rad=0.01), seed=7)
        out: list[bytes] = []
        for index in range(100):
            end_ns = peer.now_ns + 20 * MS + 12_345
            while peer.now_ns < end_ns:
                peer.now_ns = min(end_ns, peer.now_ns + steps_ns)
                out += peer.vehicle.advance(peer.now_ns)
            if index == 10:
                peer.vehicle.receive(peer.pack(mavlink.MAVLink_set_mode_message(1, 1, 393216)), peer.now_ns)
            message = mavlink.MAVLink_set_attitude_target_message(
                0, 1, 1, mask, [1.0, 0.0, 0.0, 0.0], 0.1, 0.2, 0.3 * index, 0.5
            )
            peer.vehicle.receive(peer.pack(message), peer.now_ns)
        return out, peer.vehicle.truth()

    assert fly(3 * MS + 7) == fly(10 * SECOND)


def test_two_vehicles_with_one_seed_say_the_same_to_the_bit() -> None:
    def noise(seed: int) -> bytes:
        vehicle = Vehicle(VehicleOptions(noise=Noise(position_m=0.1, attitude_rad=0.02), seed=seed))
        return b"".join(vehicle.advance(5 * SECOND))

    assert noise(1) == noise(1)
    assert noise(1) != noise(2)


def test_noise_has_the_sigma_of_the_options_and_spares_the_truth() -> None:
    vehicle = Vehicle(VehicleOptions(noise=Noise(position_m=0.1, attitude_rad=0.02)))
    heard = decoded(vehicle.advance(100 * SECOND))
    north = [m.x + 10.0 for m in heard if m.get_type() == "LOCAL_POSITION_NED"]
    yaw = [m.yaw for m in heard if m.get_type() == "ATTITUDE"]
    assert math.sqrt(sum(x * x for x in north) / len(north)) == pytest.approx(0.1, rel=0.1)
    assert math.sqrt(sum(x * x for x in yaw) / len(yaw)) == pytest.approx(0.02, rel=0.1)
    assert vehicle.truth().position_ned_m == (-10.0, -30.0, -5.0)


def test_an_earlier_instant_counts_as_the_latest_one_seen() -> None:
    peer = px4_in_offboard()
    peer.run(1.0)
    latest = peer.vehicle.truth().t_ns
    peer.vehicle.receive(b"", 5)
    assert peer.vehicle.advance(7) == []
    assert peer.vehicle.truth(3).t_ns == latest


@BOTH
def test_reboot_restarts_time_sequence_streams_and_mode_but_not_pose_and_parameters(
    firmware: Firmware,
) -> None:
    name, kind = ("COM_OF_LOSS_T", 9) if firmware.startswith("px4") else ("SCHED_LOOP_RATE", 4)
    streams = {"MAV1_EXTRA1": 1.0} if firmware.startswith("ardupilot") else {}
    peer = Peer(firmware, clock_offset_ns=100 * SECOND, parameters=streams)
    peer.send(mavlink.MAVLink_param_set_message(1, 1, name.encode(), 30.0, kind))
    peer.command(511, 30, -1)
    peer.command(400, 1)
    peer.run(10.0)
    before = peer.vehicle.truth(peer.now_ns)
    peer.vehicle.reboot(peer.now_ns)
    after = peer.vehicle.truth()
    assert (before.boot_ms, after.boot_ms) == (110_000.0, 0.0)
    assert (after.armed, after.position_ned_m) == (False, before.position_ned_m)
    heard = peer.run(2.0)
    assert heard[0].get_seq() == 0
    assert "ATTITUDE" in {m.get_type() for m in heard}
    assert peer.vehicle.parameter(name) == 30.0


# --- streams -------------------------------------------------------------------------------------------


def test_streams_keep_their_mean_rate_on_the_grid_of_the_loop() -> None:
    streams = Streams({30: 10_000, 32: 33_333}, grid_ms=4, start_ms=0)
    sent: dict[int, list[int]] = {30: [], 32: []}
    while (tick := streams.next_ms()) is not None and tick < 10_000:
        for message_id in streams.due(tick):
            sent[message_id].append(tick)
    assert len(sent[30]) == pytest.approx(1000, abs=1)
    assert len(sent[32]) == pytest.approx(300, abs=1)
    assert all(tick % 4 == 0 for ticks in sent.values() for tick in ticks)
    assert {b - a for a, b in pairwise(sent[30])} == {8, 12}


def test_a_stream_faster_than_the_loop_comes_every_loop_and_never_piles_up() -> None:
    streams = Streams({30: 1_000}, grid_ms=4, start_ms=0)
    assert [streams.due(tick) for tick in (0, 4, 8)] == [[30]] * 3
    assert streams.due(1000) == [30]
    assert streams.due(1000) == []
    assert streams.next_ms() == 1004


def test_a_stopped_stream_is_silent_and_the_schedule_can_be_empty() -> None:
    streams = Streams({30: 10_000}, grid_ms=4, start_ms=0)
    streams.set(30, -1, 0)
    assert (streams.next_ms(), streams.due(100), streams.interval_us(30)) == (None, [], 0)


# --- packing and parsing -------------------------------------------------------------------------------


@pytest.mark.parametrize("key", [None, bytes(range(32))], ids=["unsigned", "signed"])
def test_quick_packing_gives_the_bytes_of_pymavlink(key: bytes | None) -> None:
    attitude = attitude_from_euler(0.1, -0.2, 3.0)
    state = BodyState((1.5, -2.5, 3.0), attitude, (0.1, -0.2, 0.0), (-1.9, 0.3, 0.4), 2.0)
    sample = Sample(1_234_567_000_000, state, Origin(), azimuthal_equidistant)
    pilot = Px4Uuv(VehicleOptions())
    quick = [pilot.builders()[common.ID[name]](sample) for name in QUICK]
    for sequence, (name, message) in enumerate(zip(QUICK, quick, strict=True)):
        ours = mavlink.MAVLink(None, 7, 1)
        ours.seq = sequence * 50
        ours.signing.secret_key, ours.signing.sign_outgoing = key, key is not None
        ours.signing.timestamp = 2**40 + sequence
        packet = message.pack(ours)
        heard = mavlink.MAVLink(None).parse_char(packet)
        assert heard.get_type() == name
        assert (heard.get_srcSystem(), heard.get_seq()) == (7, sequence * 50)
        ours.signing.timestamp = 2**40 + sequence
        assert heard.pack(ours) == packet


QUICK = (
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "GLOBAL_POSITION_INT",
    "ODOMETRY",
    "HIGHRES_IMU",
)


@BOTH
def test_sequence_numbers_have_no_gap(firmware: Firmware) -> None:
    streams = {"MAV1_EXTRA1": 20.0} if firmware.startswith("ardupilot") else {}
    vehicle = Vehicle(VehicleOptions(firmware=firmware, parameters=streams))
    numbers = [m.get_seq() for m in decoded(vehicle.advance(60 * SECOND))]
    assert len(numbers) > 1000
    assert numbers == [index % 256 for index in range(len(numbers))]


def test_half_a_packet_of_one_peer_does_not_meet_half_a_packet_of_another() -> None:
    peer = Peer()
    arm = peer.pack(mavlink.MAVLink_command_long_message(1, 1, 400, 0, 1, *[0.0] * 6))
    peer.vehicle.receive(arm[:20], 0, "one")
    peer.vehicle.receive(b"\x00" * 50, 0, "other")
    peer.vehicle.receive(arm[20:], 0, "one")
    assert peer.vehicle.armed
    assert peer.vehicle.bad_packets > 0


MESSAGES = [
    lambda floats: mavlink.MAVLink_command_long_message(
        1, 1, int(abs(floats[0])) % 600 if math.isfinite(floats[0]) else 600, 0, *floats[:7]
    ),
    lambda floats: mavlink.MAVLink_command_long_message(1, 1, 511, 0, *floats[:7]),
    lambda floats: mavlink.MAVLink_command_long_message(1, 1, 512, 0, *floats[:7]),
    lambda floats: mavlink.MAVLink_command_long_message(1, 1, 176, 0, 1.0, *floats[:6]),
    lambda floats: mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0x00, floats[:4], *floats[4:8]),
    lambda floats: mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0x83, floats[:4], *floats[4:8]),
    lambda floats: mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0x07, floats[:4], *floats[4:8]),
    lambda floats: mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0x1C7, *floats[:11]),
    lambda floats: mavlink.MAVLink_param_set_message(1, 1, b"WP_SPEED", floats[0], 9),
    lambda floats: mavlink.MAVLink_param_set_message(1, 1, b"COM_OF_LOSS_T", floats[0], 9),
    lambda floats: mavlink.MAVLink_param_set_message(1, 1, b"SCHED_LOOP_RATE", floats[0], 4),
]
FLOAT32 = st.floats(width=32)


@BOTH
@settings(deadline=None, max_examples=60)
@given(
    events=st.lists(
        st.one_of(
            st.binary(max_size=300),
            st.tuples(st.sampled_from(range(len(MESSAGES))), st.lists(FLOAT32, min_size=11, max_size=11)),
        ),
        min_size=1,
        max_size=30,
    ),
    damage=st.integers(0, 60),
)
def test_nothing_that_arrives_breaks_it(firmware: Firmware, events: list[Any], damage: int) -> None:
    peer = Peer(firmware, initially_armed=True)
    peer.send(mavlink.MAVLink_set_mode_message(1, 1, 15 if firmware is Firmware.ARDUPILOT_ROVER else 393216))
    out: list[bytes] = []
    for number, event in enumerate(events):
        packet = event if isinstance(event, bytes) else peer.pack(MESSAGES[event[0]](event[1]))
        data = bytearray(packet)
        if number == damage and data:
            data[number % len(data)] ^= 0xFF
        peer.now_ns += 37 * MS
        peer.vehicle.receive(bytes(data), peer.now_ns)
        out += peer.vehicle.advance(peer.now_ns)
    out += peer.vehicle.advance(peer.now_ns + 2 * SECOND)
    heard = decoded(out)
    assert heard
    truth = peer.vehicle.truth()
    assert all(map(math.isfinite, (*truth.position_ned_m, *truth.attitude_wxyz, truth.speed_m_s)))
    # A reboot, if the dice order one, starts the numbers again.
    steps = {(b.get_seq() - a.get_seq()) % 256 for a, b in pairwise(heard) if b.get_seq() != 0}
    assert steps <= {1}


def test_a_clock_of_signatures_that_was_moved_to_its_end_stays_there() -> None:
    """By another holder of the key; 48 bits hold no more."""
    still = (0.0, 0.0, 0.0)
    state = BodyState(still, attitude_from_euler(0.0, 0.0, 0.0), still, still, 0.0)
    sample = Sample(1_000_000, state, Origin(), azimuthal_equidistant)
    message = Px4Uuv(VehicleOptions()).builders()[common.ID[QUICK[0]]](sample)
    ours = mavlink.MAVLink(None, 1, 1)
    ours.signing.secret_key, ours.signing.sign_outgoing = bytes(32), True
    ours.signing.timestamp = 2**48 + 5
    for _ in range(2):
        assert message.pack(ours)[-12:-6] == b"\xff" * 6
