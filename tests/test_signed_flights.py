"""Flights over a signed link: they track, replay without the key, and believe nobody who does not hold it."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any, Final

import msgspec
import pytest
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.mavlink.signing import Refusal, Signing, wall_timestamp
from guidance.preflight.findings import Verdict
from guidance.records import Input, InputKind, Packet, Record
from guidance.replay import replay
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from sitl.logbook import LogBook
from tests.helpers import events_of, fly_until_tracking, make_config, make_flight, records_of, state_of
from tests.preflight_rig import Bench, only
from tests.service_rig import a_socket, running, vehicle_for
from tests.test_signing import KEY, OTHER_KEY, Oracle

SIGNED: Final = ('link.signing_key_file="a.key"',)


def signed_flight(*overrides: str, **options: Any) -> Lockstep:
    return make_flight(*SIGNED, *overrides, signing_key=KEY, **options)


def write(directory: Path, records: list[Record]) -> Path:
    with LogBook(make_config(*SIGNED), directory) as book:
        for record in records:
            book.add(record)
    return book.path


@pytest.mark.parametrize("overrides", [(), ("vehicle.profile=ardupilot-rover", "flight.origin=engage")])
def test_a_signed_flight_tracks_and_replays_without_the_key(
    overrides: tuple[str, ...], tmp_path: Path
) -> None:
    flight = signed_flight(*overrides)
    fly_until_tracking(flight)
    flight.run(3.0)
    assert state_of(flight) is State.TRACKING
    assert flight.guide.link.signing is not None
    assert not flight.guide.link.signing.refused
    assert flight.vehicle.bad_packets == 0
    with LogBook(flight.guide.config, tmp_path) as book:
        for record in flight.records:
            book.add(record)
    found = replay(book.path)
    assert found.difference is None
    assert found.identical
    content = book.path.read_bytes()
    assert KEY not in content
    assert KEY.hex().encode() not in content


def test_forged_and_replayed_packets_replay_as_they_were_judged(tmp_path: Path) -> None:
    flight = signed_flight()
    fly_until_tracking(flight)
    capture = [r.data for r in records_of(flight, Input) if r.data]
    mode = dialect.MAVLink_heartbeat_message(12, 12, 0, 0, 4, 3)  # disarmed: would hand over
    for key in (OTHER_KEY, None):
        flight.inject(Oracle(key, at=10**14).pack(mode))
        flight.inject(capture[-1])
        flight.run(0.5)
    counters = flight.guide.link.counters
    assert [counters[why] > 0 for why in Refusal] == [True] * 3
    assert state_of(flight) is State.TRACKING
    assert replay(write(tmp_path, flight.records)).identical


def test_a_packet_that_differs_beside_the_signature_is_found(tmp_path: Path) -> None:
    flight = signed_flight()
    fly_until_tracking(flight)
    flight.run(0.2)
    place = max(i for i, record in enumerate(flight.records) if isinstance(record, Packet))
    packet = flight.records[place]
    assert isinstance(packet, Packet)
    data = bytearray(packet.data)
    data[-8] ^= 1  # of the timestamp
    flight.records[place] = msgspec.structs.replace(packet, data=bytes(data))
    found = replay(write(tmp_path, flight.records))
    assert found.difference is not None
    assert found.difference.topic == "packet"


def test_the_core_takes_no_key_file_without_a_key_nor_the_other_way() -> None:
    with pytest.raises(ValueError, match="go together"):
        Guide(make_config(*SIGNED))
    with pytest.raises(ValueError, match="go together"):
        Guide(make_config(), Signing(KEY, 0))


@pytest.mark.parametrize(
    ("vehicle_key", "words"),
    [
        (b"", "heard 1/1, but the autopilot does not sign: give it the key of link.signing_key_file"),
        (OTHER_KEY, "heard 1/1, but the autopilot signs with another key: give it that of link.signing"),
    ],
)
def test_an_autopilot_without_our_key_is_never_flown_and_named(vehicle_key: bytes, words: str) -> None:
    flight = signed_flight(vehicle_key=vehicle_key)
    flight.run(3.0)
    assert state_of(flight) is State.DISCONNECTED
    assert flight.guide.engagement.reason.startswith(words)
    assert not flight.setpoint_times_ns


def test_an_autopilot_that_stops_signing_in_flight_is_lost_and_named() -> None:
    flight = signed_flight()
    fly_until_tracking(flight)
    signing = flight.vehicle._pilot.link._mav.signing
    signing.sign_outgoing = False
    flight.run(4.0)
    assert state_of(flight) is State.DISCONNECTED
    assert "does not sign" in flight.guide.engagement.reason
    last_ns = flight.setpoint_times_ns[-1]
    assert flight.now_ns - last_ns > 2_000_000_000


def test_a_replayed_capture_after_a_restart_takes_nobody_in() -> None:
    flown = signed_flight()
    fly_until_tracking(flown)
    flown.run(1.0)
    assert flown.guide.link.signing is not None
    kept = flown.guide.link.signing.clock
    again = signed_flight(signing_clock=kept, to_guide=Channel(loss=1.0))
    for record in records_of(flown, Input):
        if record.kind is InputKind.DATAGRAM:
            again.inject(record.data)
            again.run(0.001)
    assert state_of(again) is State.DISCONNECTED
    assert again.guide.link.received == 0
    assert "its signatures are of the past" in again.guide.engagement.reason


def test_a_link_that_loses_repeats_and_delays_is_still_flown() -> None:
    channel = Channel(delay_s=0.02, jitter_s=0.01, loss=0.2, duplication=0.1)
    flight = signed_flight(to_guide=channel, to_vehicle=channel)
    fly_until_tracking(flight, 20.0)
    flight.run(5.0)
    assert state_of(flight) is State.TRACKING
    assert flight.guide.link.counters[Refusal.REPLAYED]
    assert not flight.guide.link.counters[Refusal.BAD_SIGNATURE]


# Others who order the autopilot about -----------------------------------------------------------------


def command(number: int, *, component: int = 1, system: int = 1) -> Any:
    return dialect.MAVLink_command_long_message(system, component, number, 0, 1, 6, 0, 0, 0, 0, 0)


def attitude(system: int = 1) -> Any:
    return dialect.MAVLink_set_attitude_target_message(0, system, 1, 7, [1.0, 0, 0, 0], 1.0, 1.0, 1.0, 1.0)


ORDERS: Final = {
    "SET_ATTITUDE_TARGET": attitude(),
    "SET_POSITION_TARGET_LOCAL_NED": dialect.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, 1, 0, 1, 2, 3, 0, 0, 0, 0, 0, 0, 0, 0
    ),
    "SET_POSITION_TARGET_GLOBAL_INT": dialect.MAVLink_set_position_target_global_int_message(
        0, 1, 1, 5, 0, 1, 2, 3, 0, 0, 0, 0, 0, 0, 0, 0
    ),
    "SET_ACTUATOR_CONTROL_TARGET": dialect.MAVLink_set_actuator_control_target_message(0, 0, 1, 1, [0.0] * 8),
    "MANUAL_CONTROL": dialect.MAVLink_manual_control_message(1, 0, 0, 500, 0, 0),
    "RC_CHANNELS_OVERRIDE": dialect.MAVLink_rc_channels_override_message(1, 1, *[1500] * 8),
    "SET_MODE": dialect.MAVLink_set_mode_message(1, 1, 0),
    "MISSION_COUNT": dialect.MAVLink_mission_count_message(1, 1, 3),
    "MISSION_ITEM_INT": dialect.MAVLink_mission_item_int_message(1, 1, 0, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0),
    "MISSION_CLEAR_ALL": dialect.MAVLink_mission_clear_all_message(1, 1),
    "MISSION_SET_CURRENT": dialect.MAVLink_mission_set_current_message(0, 0, 1),
    "MAV_CMD_DO_SET_MODE": command(dialect.MAV_CMD_DO_SET_MODE),
    "MAV_CMD_COMPONENT_ARM_DISARM": command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, component=0),
    "MAV_CMD_NAV_RETURN_TO_LAUNCH": dialect.MAVLink_command_int_message(1, 1, 0, 20, 0, 0, *[0] * 7),
}


@pytest.mark.parametrize("name", ORDERS)
def test_an_order_of_another_is_counted_told_once_and_changes_nothing(name: str) -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    stranger = Oracle(None, system=255, component=190)
    stranger.mav.signing.secret_key = None
    flight.inject(stranger.pack(dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)))
    for _ in range(20):
        flight.inject(stranger.pack(ORDERS[name]))
        flight.run(0.1)
    assert flight.guide.link.counters["orders_of_others"] == 20
    (told,) = events_of(flight, "orders_of_others")
    assert told == f"a ground station (255/190) sent {name}: not obeyed here, but the autopilot may"
    assert state_of(flight) is State.TRACKING


def test_it_is_told_on_a_signed_link_too_though_nobody_believes_it() -> None:
    flight = signed_flight()
    flight.run(1.0)
    flight.inject(Oracle(None, system=66, component=1).pack(attitude()))
    flight.run(1.0)
    assert events_of(flight, "orders_of_others")[0].startswith("somebody (66/1) sent SET_ATTITUDE_TARGET")
    assert flight.guide.link.counters["unsigned"] == 1


@pytest.mark.parametrize(
    "message",
    [
        attitude(system=2),
        command(dialect.MAV_CMD_DO_SET_MODE, system=2),
        command(dialect.MAV_CMD_DO_SET_MODE, component=191),
        command(dialect.MAV_CMD_REQUEST_MESSAGE),
        dialect.MAVLink_mission_request_list_message(1, 1),
    ],
    ids=["another vehicle's", "a mode of another", "to us", "a question", "a mission read"],
)
def test_what_is_no_order_to_our_autopilot_is_not_counted(message: Any) -> None:
    guide = Guide(make_config())
    guide.receive(Oracle(None, system=255, component=190).pack(message), 1)
    assert guide.link.counters == {"other_system": 1}


def test_a_crowd_that_orders_costs_no_memory() -> None:
    guide = Guide(make_config())
    for system in range(2, 250):
        guide.receive(Oracle(None, system=system).pack(attitude(1)), system)
    assert guide.link.counters["orders_of_others"] == 248
    assert len(guide.link.company.newly_ordering()) == 16
    assert not guide.link.company.newly_ordering()


# guidance check, and the service over a socket --------------------------------------------------------


def bench(vehicle_key: bytes, key: bytes | None) -> Bench:
    return Bench(*(SIGNED if key else ()), vehicle={"signing_key": vehicle_key}, signing_key=key)


def test_a_check_of_a_signed_link_is_well() -> None:
    looked = bench(KEY, KEY)
    assert not looked.bad()
    assert looked.findings()["signing"].found == "both ends sign, by one key (a.key)"


@pytest.mark.parametrize(
    ("vehicle_key", "text"), [(b"", "does not sign"), (OTHER_KEY, "signs with another key")]
)
def test_a_check_names_an_autopilot_without_our_key(vehicle_key: bytes, text: str) -> None:
    bad = bench(vehicle_key, KEY).bad()
    assert bad["autopilot"].verdict is Verdict.FAIL
    assert text in bad["autopilot"].found
    assert "link.signing_key_file" in bad["autopilot"].todo


def test_a_check_without_a_key_names_an_autopilot_that_signs() -> None:
    found = only(bench_that_answers_anybody(), "signing", Verdict.WARN)
    assert "this service has no key" in found.found


def bench_that_answers_anybody() -> Bench:
    """PX4's and ArduPilot's telemetry is signed to whomever; what we ask for unsigned may not be heard."""
    return Bench(vehicle={"signing_key": KEY}, lenient=True)


def key_file(directory: Path) -> Path:
    path = directory / "signing.key"
    path.write_bytes(KEY)
    path.chmod(0o600)
    return path


@pytest.mark.parametrize("unix_ns", [time.time_ns(), 1_700_000_000_000_000_000], ids=["now", "2023"])
def test_over_a_socket_it_flies_and_a_capture_is_refused_after_a_restart(
    unix_ns: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A vehicle whose clock is years behind is refused until it has heard ours, and goes by it."""
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    key = f'link.signing_key_file="{key_file(tmp_path)}"'

    async def fly() -> list[bytes]:
        async with running(key) as rig, vehicle_for(rig, signing_key=KEY, unix_at_zero_ns=unix_ns) as vehicle:
            await rig.bell.until(lambda: len(rig.memory.setpoints()) > 50, "setpoints")
            assert vehicle.vehicle.bad_packets == 0
            return [r.data for r in rig.memory.records if isinstance(r, Input) and r.data]

    async def attack(capture: list[bytes]) -> None:
        async with running(key) as rig:
            sock, address, link = a_socket(), await rig.address(), rig.shell._guide.link
            with sock:
                for datagram in capture:
                    sock.sendto(datagram, address)
                    await asyncio.sleep(0)
                await rig.bell.until(lambda: link.counters[Refusal.REPLAYED] > 100, "refusals")
            assert link.received == 0

    capture = asyncio.run(fly())
    assert capture
    asyncio.run(attack(capture))


def test_while_it_runs_the_clock_is_kept_and_follows_the_wall_clock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    monkeypatch.setattr("guidance.shell.WATCH_S", 0.02)
    key = f'link.signing_key_file="{key_file(tmp_path)}"'
    kept = tmp_path / "signing-demo.json"

    def timestamp() -> int:
        return int(msgspec.json.decode(kept.read_bytes())["timestamp"]) if kept.exists() else 0

    async def live() -> None:
        async with running(key) as rig, vehicle_for(rig, signing_key=KEY):
            await rig.bell.until(timestamp, "a file")
            hour_on = time.time_ns() + 3_600_000_000_000
            monkeypatch.setattr("guidance.shell.time.time_ns", lambda: hour_on)
            await rig.bell.until(lambda: timestamp() >= wall_timestamp(hour_on), "the new time")
            kinds = [r.kind for r in rig.memory.records if isinstance(r, Input)]
            assert kinds.count(InputKind.SIGNING_CLOCK) == 2
            assert kinds[0] is InputKind.SIGNING_CLOCK

    asyncio.run(live())


def test_a_clock_that_cannot_be_kept_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path / "signing.key"))
    monkeypatch.setattr("guidance.shell.WATCH_S", 0.02)

    async def live() -> None:
        async with running(f'link.signing_key_file="{key_file(tmp_path)}"') as rig, vehicle_for(rig):
            await rig.bell.until(lambda: rig.memory.events("note"), "a note")
            assert "cannot be" in rig.memory.events("note")[0]

    asyncio.run(live())
