"""An underwater vehicle on PX4 is asked by rates alone only where its version is sure to turn by them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.commands import Engage
from guidance.mavlink.messages import AutopilotVersion
from guidance.mavlink.profiles import PROFILES, Asked
from guidance.mavlink.setpoints import Demand, outgoing, setpoint_message
from guidance.preflight.findings import Verdict
from guidance.records import Setpoint
from guidance.replay import replay
from guidance.se3 import Quaternion, Vec3
from guidance.supervisor import State
from sitl.lockstep import Channel, Lockstep
from tests.helpers import events_of, fly_until, fly_until_tracking, make_flight, records_of, state_of
from tests.pilot import Pilot
from tests.preflight_rig import Bench
from tests.sent_setpoints import sent_setpoints
from tests.test_blended_flights import HELIX, UNGUARDED, from_trajectory_m, steps
from tests.test_flights import error_m, fly
from tests.test_replay import write
from tests.vehicle_peer import px4_in_offboard

UUV = PROFILES["px4-uuv"]
ALONE, WITH_ATTITUDE = 0x80, 0x00
OLD, NEW = (1, 16, 0), (1, 17, 0)
DEV, ALPHA, BETA, RC, OFFICIAL = 0, 64, 128, 192, 255
ID = mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION


def packed(major: int, minor: int, patch: int, kind: int = OFFICIAL) -> int:
    return major << 24 | minor << 16 | patch << 8 | kind


@pytest.mark.parametrize(
    ("version", "mask"),
    [
        (None, WITH_ATTITUDE),
        (0, WITH_ATTITUDE),
        (packed(1, 14, 4), WITH_ATTITUDE),
        (packed(1, 16, 255), WITH_ATTITUDE),
        (packed(1, 17, 0, DEV), WITH_ATTITUDE),
        (packed(1, 17, 0, ALPHA), WITH_ATTITUDE),
        (packed(1, 17, 0, BETA), WITH_ATTITUDE),
        (packed(1, 17, 0, RC), ALONE),
        (packed(1, 17, 0), ALONE),
        (packed(1, 17, 1, DEV), ALONE),
        (packed(2, 0, 0, DEV), ALONE),
    ],
)
def test_the_row_says_which_versions_take_rates_alone(version: int | None, mask: int) -> None:
    row = UUV.for_version(None if version is None else AutopilotVersion(version, 0))
    assert row.type_mask == mask
    assert row.asked is (Asked.RATES_SPEED if mask else Asked.ATTITUDE_RATES_SPEED)
    assert row.for_version(AutopilotVersion(packed(9, 0, 0), 0)) is row or mask, "what moves all is kept"


def test_no_other_row_depends_on_the_version() -> None:
    assert [row.name for row in PROFILES.values() if row.for_version(None) is not row] == ["px4-uuv"]


def test_the_bytes_carry_the_attitude_only_where_it_counts() -> None:
    demand = Demand(Vec3(0.5, -0.25, 0.125), 1.5, Quaternion(0.0, 2.0, 0.0, 0.0))
    sent = {}
    for row in (UUV, UUV.for_version(None)):
        payload = setpoint_message(row, outgoing(row, demand, 3.0), 1, 1, 0).payload
        message: Any = mavlink.MAVLink_set_attitude_target_message
        sent[row.type_mask] = message.unpacker.unpack(payload.ljust(message.unpacker.size, b"\0"))
    assert sent[ALONE][1:9] == (1.0, 0.0, 0.0, 0.0, 0.5, -0.25, 0.125, 0.5)
    assert sent[WITH_ATTITUDE][1:9] == (0.0, 1.0, 0.0, 0.0, 0.5, -0.25, 0.125, 0.5), "of length 1"


def masks(flight: Lockstep, since_ns: int = 0) -> set[int]:
    """Of the bytes that left, which are those of the records."""
    records = [record for record in flight.records if record.t_ns >= since_ns]
    sent = {message.type_mask for _, message in sent_setpoints(records)}
    assert {one.type_mask for one in records_of(flight, Setpoint, since_ns)} <= sent
    return sent


@pytest.mark.parametrize(
    ("options", "mask"),
    [
        ({"px4_version": NEW}, ALONE),
        ({"px4_version": OLD}, WITH_ATTITUDE),
        ({"px4_version": (1, 14, 3)}, WITH_ATTITUDE),
        ({"without_messages": ("AUTOPILOT_VERSION",)}, WITH_ATTITUDE),
    ],
)
def test_in_flight_rates_alone_go_to_a_version_that_takes_them(options: dict[str, Any], mask: int) -> None:
    flight = make_flight(**options)
    fly_until_tracking(flight, 10.0)
    flight.run(1.0)
    assert masks(flight) == {mask}
    told = ["setpoints ask for attitude, body rates and thrust for a speed (type_mask 0x00)"]
    assert events_of(flight, "setpoint_row") == ([] if mask else told)


class LateVersion:
    """AUTOPILOT_VERSION is lost on the way until it is let through."""

    def __init__(self) -> None:
        self.through = False

    def __call__(self, data: bytes, now_ns: int) -> list[bytes]:
        frame = int.from_bytes(data[7:10], "little") if len(data) > 10 else 0
        return [] if frame == ID and not self.through else [data]


def test_a_version_that_is_heard_in_flight_changes_nothing_before_the_next() -> None:
    flight = make_flight("supervisor.engage_max_error_m=100", px4_version=NEW)
    flight.on_the_way = late = LateVersion()
    fly_until_tracking(flight, 10.0)
    flight.run(0.5)
    late.through = True
    flight.run(3.0)
    assert flight.guide.link.version is not None
    assert masks(flight) == {WITH_ATTITUDE}
    Pilot(flight).switch("hold")
    fly_until(flight, State.HANDED_OVER)
    ended_ns = flight.now_ns
    flight.guide.command(Engage(), flight.now_ns)
    fly_until_tracking(flight, 10.0)
    flight.run(1.0)
    assert masks(flight, ended_ns) == {ALONE}


def test_a_version_that_is_lost_at_first_is_waited_for_and_not_for_long() -> None:
    flight = make_flight(px4_version=NEW)
    flight.on_the_way = late = LateVersion()
    flight.run(3.5)
    assert state_of(flight) is State.CONNECTED
    assert flight.guide.engagement.reason == "the autopilot's parameters are being read"
    late.through = True
    fly_until_tracking(flight)
    flight.run(0.5)
    assert masks(flight) == {ALONE}
    never = make_flight(without_messages=("AUTOPILOT_VERSION",))
    fly_until_tracking(never, 7.0)


def said(flight: Lockstep, version: int) -> None:
    """The autopilot says that it is of this version."""
    sender = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    zero = [0] * 8
    message = mavlink.MAVLink_autopilot_version_message(0, version, 0, 0, 0, zero, zero, zero, 0, 0, 0)
    sender.seq = ((flight.guide.link.sequence.newest or 0) + 1) % 256
    flight.inject(message.pack(sender))


def test_within_a_flight_it_changes_to_what_is_safe_and_not_back() -> None:
    flight = make_flight(px4_version=NEW)
    fly_until_tracking(flight)
    flight.run(1.0)
    assert masks(flight) == {ALONE}
    said(flight, packed(*OLD))
    at_ns = flight.now_ns
    flight.run(0.5)
    assert masks(flight, at_ns + 1) == {WITH_ATTITUDE}
    said(flight, packed(*NEW))
    assert flight.guide.link.version == AutopilotVersion(packed(*NEW), 0)
    flight.run(0.5)
    assert masks(flight, at_ns + 1) == {WITH_ATTITUDE}


def test_a_replay_chooses_the_same(tmp_path: Path) -> None:
    flight = make_flight(px4_version=OLD)
    fly_until_tracking(flight)
    flight.run(0.5)
    assert replay(write(tmp_path, flight.records)).identical


@pytest.mark.parametrize(
    ("options", "found"),
    [
        ({"px4_version": NEW}, "body rates and thrust for a speed (type_mask 0x80)"),
        (
            {"px4_version": OLD},
            "attitude, body rates and thrust for a speed (type_mask 0x00): "
            "a PX4 of this version may not move by less",
        ),
        (
            {"without_messages": ("AUTOPILOT_VERSION",)},
            "attitude, body rates and thrust for a speed (type_mask 0x00): "
            "a PX4 that does not tell its version may not move by less",
        ),
    ],
)
def test_the_check_says_what_it_will_be_asked_for(options: dict[str, Any], found: str) -> None:
    finding = Bench(vehicle=options).findings()["setpoints"]
    assert (finding.verdict, finding.found) == (Verdict.OK, found)


# The older manners ---------------------------------------------------------------------------------------


def test_the_older_one_does_nothing_by_rates_alone() -> None:
    peer = px4_in_offboard(px4_version=OLD)
    peer.setpoint(ALONE, rates=(0.1, 0.2, 0.3), thrust=0.2)
    truth = peer.vehicle.truth()
    assert truth.body_rates_frd_rad_s == (0.0, 0.0, 0.0)
    assert truth.speed_m_s == 0.0


@pytest.mark.parametrize("version", [OLD, NEW])
def test_an_attitude_turns_it_beside_the_rates(version: tuple[int, int, int]) -> None:
    """P of the angle over D of the rate: 4/1.5, 4/2, 4/2 by PX4's own defaults."""
    peer = px4_in_offboard(px4_version=version)
    half = 0.5 * 0.05
    peer.setpoint(0x00, q=(math.cos(half), 0.0, 0.0, math.sin(half)), rates=(0.0, 0.1, 0.2), thrust=0.2)
    truth = peer.vehicle.truth()
    assert truth.body_rates_frd_rad_s == pytest.approx((0.0, 0.1, 0.2 + 2.0 * 0.05), abs=1e-3)
    assert truth.speed_m_s == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("name", ["helix", "circle", "lemniscate"])
def test_the_older_one_converges_as_the_paper_has_it(name: str) -> None:
    figures = fly(make_flight(f"trajectory.name={name}", px4_version=OLD), 40.0)
    assert figures.converged_s is not None
    assert figures.converged_s < 12.0
    assert figures.rms_error_m is not None
    assert figures.rms_error_m < 5e-4
    assert figures.max_error_m is not None
    assert figures.max_error_m < 1e-3


def turned_by_itself_rad_s(flight: Lockstep, seconds: float) -> float:
    """The largest difference between the rates that were asked for and those that it has, at odd instants."""
    most, end_ns = 0.0, flight.now_ns + round(1e9 * seconds)
    while flight.now_ns < end_ns:
        flight.run(0.0137)
        sent = records_of(flight, Setpoint, flight.now_ns - 100_000_000)[-1]
        has = flight.truth().body_rates_frd_rad_s
        most = max(most, math.dist(sent.body_rates_frd_rad_s, has))
    return most


@pytest.mark.parametrize("delay_s", [0.0, 0.04])
def test_the_attitude_asks_for_next_to_no_turn_of_its_own(delay_s: float) -> None:
    """Told one that it has left or not reached yet, it would turn by 2 1/s times the angle."""
    way = Channel(delay_s=delay_s)
    flight = make_flight("law.rho2_per_s=4", to_guide=way, to_vehicle=way, px4_version=OLD)
    fly_until_tracking(flight, 10.0)
    flight.run(15.0)
    assert turned_by_itself_rad_s(flight, 5.0) < 0.02


@pytest.mark.parametrize("turn_rad", [0.2, 1.0])
def test_a_heading_reset_turns_the_older_one_as_it_does_the_newer(turn_rad: float) -> None:
    """The attitude is the autopilot's own after the reset: it asks for no turn."""
    ends = []
    for version in (OLD, NEW):
        flight = make_flight(*HELIX, *UNGUARDED, px4_version=version)
        fly_until_tracking(flight)
        flight.run(20.0)
        reset_ns = flight.now_ns
        flight.vehicle.reset_estimator(reset_ns, (0.0, 0.0, 0.0), turn_rad)
        flight.run(0.1)
        assert turned_by_itself_rad_s(flight, 2.0) < 0.1
        flight.run(20.0)
        assert steps(flight, reset_ns).rates < 0.07
        ends.append(from_trajectory_m(flight))
    assert ends[0] == pytest.approx(ends[1], rel=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_older_one_is_flown_over_a_bad_link(seed: int) -> None:
    """30 % lost and up to 0.1 s late each way: an old attitude is held longer, and pulls."""
    bad = Channel(delay_s=0.01, jitter_s=0.1, loss=0.3, duplication=0.1)
    flight = make_flight(to_guide=bad, to_vehicle=bad, seed=seed, px4_version=OLD)
    fly_until_tracking(flight, 20.0)
    flight.run(25.0)
    errors = []
    for _ in range(200):
        flight.run(0.0737)
        errors.append(error_m(flight))
    assert max(errors) < 0.05
