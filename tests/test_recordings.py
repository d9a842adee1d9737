"""Real autopilots' traffic through link, clock filter, estimator and guide; `data/recordings/README.md`.

Invariant: a state that the estimator gives is finite, has a unit quaternion, and what it predicts for the
instant of the next measurement is that measurement, to within what the vehicle can do in between.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import pytest

from guidance.core import Guide
from guidance.estimate import Estimate, Estimator, Reset
from guidance.geodesy import azimuthal_equidistant, equirectangular
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.messages import (
    DECODERS,
    MESSAGE_IDS,
    AttitudeQuaternion,
    LocalPositionNed,
    StateBody,
    Timesync,
)
from guidance.mavlink.report import link_record
from guidance.mavlink.streams import Stream
from guidance.records import Event
from guidance.se3 import is_finite_pose
from tests.helpers import make_config
from tests.mavlink_peer import recorded

ARDUPILOT = ("ardurover", "arduplane", "arducopter")
PX4 = ("px4_airplane", "px4_quadrotor")
FLIGHTS = (*ARDUPILOT, *PX4)
SECOND = 1_000_000_000
#: As they came over the telemetry link when ArduRover started.
BANNER = b"\n\nInit ArduRover V4.7.0-dev (2598e9d4)\n\nFree RAM: 131072\n0 0 0 "

#: Why samples are refused while an autopilot starts: GLOBAL_POSITION_INT of ArduPilot is zeros at first.
NOT_READY = {"before_time_sync", "no_position", "no_origin"}


def asked(packet: bytes) -> int | None:
    """The `ts1` of a TIMESYNC answer: what the companion had asked with."""
    if int.from_bytes(packet[7:10], "little") != MESSAGE_IDS["TIMESYNC"]:
        return None
    body = DECODERS[MESSAGE_IDS["TIMESYNC"]](packet[10:-2])
    assert isinstance(body, Timesync)
    return body.ts1 if body.tc1 != 0 else None


@dataclass
class Seen:
    """What became of one excerpt."""

    link: AutopilotLink
    counts: Counter[str] = field(default_factory=Counter)
    refused: Counter[str] = field(default_factory=Counter)
    estimates: list[Estimate] = field(default_factory=list)
    attitude_misses_rad: list[float] = field(default_factory=list)
    position_misses_m: list[float] = field(default_factory=list)
    ages_s: list[float] = field(default_factory=list)
    reboots_at_s: list[float] = field(default_factory=list)
    attitude_gap_s: float = 0.0
    seconds: float = 0.0
    resets: list[Reset] = field(default_factory=list)
    sources: Counter[str] = field(default_factory=Counter)


def play(name: str, *, noise: bytes = b"") -> Seen:
    """An excerpt through link and estimator, as `core.Guide` joins them; `noise` comes before each packet."""
    link = AutopilotLink(1, 1, 3.0, [Stream(m, 50.0) for m in ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED")])
    estimator = Estimator(azimuthal_equidistant if name.startswith(PX4) else equirectangular)
    seen = Seen(link)
    start_ns, last_ns = 0, 0
    for now_ns, packet in recorded(name):
        start_ns = start_ns or now_ns
        question = asked(packet)
        if question is not None:
            link._questions.append(question)
        if noise:
            link.receive(noise, now_ns)
        reboots = link.reboots
        for received in link.receive(packet, now_ns):
            seen.counts[received.name] += 1
            body = received.body
            if link.reboots != reboots:
                reboots = link.reboots
                estimator.reset()
                seen.reboots_at_s.append((now_ns - start_ns) * 1e-9)
            if isinstance(body, StateBody):
                if not link.clock.synced(now_ns):
                    seen.refused["before_time_sync"] += 1
                    continue
                _sample(seen, estimator, body, now_ns)
            if isinstance(body, AttitudeQuaternion):
                seen.attitude_gap_s = max(seen.attitude_gap_s, (now_ns - (last_ns or now_ns)) * 1e-9)
                last_ns = now_ns
        seen.seconds = (now_ns - start_ns) * 1e-9
    return seen


def _sample(seen: Seen, estimator: Estimator, body: StateBody, now_ns: int) -> None:
    instant_ns = seen.link.clock.to_local_ns(body.since_boot_ns)
    predicted = estimator.at(instant_ns)
    refused = estimator.take(body, instant_ns, now_ns, seen.link.origin)
    seen.resets += [happened for happened in estimator.news if isinstance(happened, Reset)]
    estimator.news.clear()
    if refused is not None:
        if refused != "not_needed":
            seen.refused[refused] += 1
    elif isinstance(body, AttitudeQuaternion):
        if predicted is not None:
            dot = abs(sum(a * b for a, b in zip(predicted.pose.attitude, body[1:5], strict=True)))
            seen.attitude_misses_rad.append(2.0 * math.acos(min(dot, 1.0)))
            seen.ages_s.append((now_ns - instant_ns) * 1e-9)
    elif isinstance(body, LocalPositionNed) and predicted is not None:
        seen.position_misses_m.append(math.dist(predicted.pose.position, (body.x, body.y, body.z)))
    estimate = estimator.at(now_ns)
    if estimate is not None:
        assert is_finite_pose(estimate.pose)
        assert math.hypot(*estimate.pose.attitude) == pytest.approx(1.0, abs=1e-9)
        seen.estimates.append(estimate)
        seen.sources[f"{estimate.attitude.source} {estimate.position.source}"] += 1


# One piece each ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flight", FLIGHTS)
def test_in_steady_flight_nothing_is_lost_and_both_rates_are_fifty(flight: str) -> None:
    seen = play(f"{flight}_steady")
    record = link_record(seen.link, next(reversed(list(recorded(f"{flight}_steady")))).t_ns)
    assert (record.lost, record.reboots, record.connected) == (0, 0, True)
    for stream in ("ATTITUDE_QUATERNION", "LOCAL_POSITION_NED"):
        assert seen.counts[stream] / seen.seconds == pytest.approx(50.0, rel=0.02)
    assert seen.attitude_gap_s < 0.06
    unused = {name for name, count in record.counters.items() if count}
    assert unused == ({"other_system", "unknown_message"} if flight in PX4 else {"other_system"})
    assert record.counters["other_system"] == 4, "the ground station's heartbeat, forwarded at 1 Hz"
    assert set(seen.refused) == {"before_time_sync"}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_in_steady_flight_each_sample_is_where_the_one_before_predicted_it(flight: str) -> None:
    seen = play(f"{flight}_steady")
    assert len(seen.position_misses_m) > 170
    assert len(seen.attitude_misses_rad) > 170
    # A slip of PX4's clock between two answers moves a sample by 4 ms: 5 cm at 12 m/s.
    assert max(seen.position_misses_m) < 0.08
    assert np.median(seen.position_misses_m) < 0.02
    assert max(seen.attitude_misses_rad) < 0.015
    steps = zip(seen.estimates, seen.estimates[1:], strict=False)
    # 20 m/s and 41 ms between two packets.
    assert max(math.dist(a.pose.position, b.pose.position) for a, b in steps) < 1.0


@pytest.mark.parametrize("flight", FLIGHTS)
def test_in_steady_flight_no_reset_is_found_and_no_source_is_left(flight: str) -> None:
    seen = play(f"{flight}_steady")
    assert seen.resets == []
    assert set(seen.sources) == {"ATTITUDE_QUATERNION LOCAL_POSITION_NED"}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_state_arrives_young(flight: str) -> None:
    ages_s = np.array(play(f"{flight}_steady").ages_s)
    # A simulated clock leaps to the end of its step and then waits (PX4: 4 ms), and a question that falls
    # into the wait is stamped with the leap: so state looks up to 3 ms younger than it can be.
    assert -0.005 < np.median(ages_s) < 0.005
    assert ages_s.min() > -0.01
    assert ages_s.max() < 0.02


@pytest.mark.parametrize("flight", FLIGHTS)
def test_the_beginning_is_followed_before_the_estimator_is_ready(flight: str) -> None:
    seen = play(f"{flight}_begin")
    link = seen.link
    assert (link_record(link, 0).lost, link.reboots) == (0, 0)
    assert link.version is not None
    assert link.heartbeat is not None
    assert link.heartbeat.autopilot == (12 if flight in PX4 else 3)
    assert seen.counts["COMMAND_ACK"] >= 15
    assert link.counters["ack_for_another"] == 0
    assert set(seen.refused) <= NOT_READY
    assert (len(seen.estimates) > 0) == (flight in PX4), "ArduPilot has no position in its first seconds"


@pytest.mark.parametrize(
    ("flight", "counted", "largest_m"), [("px4_airplane", 4, 1.35), ("px4_quadrotor", 5, 0.15)]
)
def test_the_resets_of_an_estimator_that_starts_are_those_that_it_counts(
    flight: str, counted: int, largest_m: float
) -> None:
    seen = play(f"{flight}_begin")
    assert [reset.cause for reset in seen.resets] == ["counter"] * counted
    moves_m = [math.hypot(*reset.moved_ned_m) for reset in seen.resets]
    assert max(moves_m) == pytest.approx(largest_m, abs=0.01)


def test_the_yaw_that_jumps_to_the_compass_is_a_reset() -> None:
    """From one sample to the next, without a counter: ArduPilot has no ODOMETRY."""
    (reset,) = play("arduplane_begin").resets
    assert (reset.cause, reset.source) == ("jump", "ATTITUDE_QUATERNION")
    assert math.degrees(math.hypot(*reset.turned_ned_rad)) == pytest.approx(19.8, abs=0.1)


@pytest.mark.parametrize("flight", FLIGHTS)
def test_the_reboot_is_found_once_and_the_state_comes_back(flight: str) -> None:
    seen = play(f"{flight}_reboot")
    link = seen.link
    assert link.reboots == len(seen.reboots_at_s) == 1
    assert link.vehicle_time_ms is not None
    assert link.vehicle_time_ms < 6000, "time since the new boot"
    assert link.heartbeat is not None, "the new autopilot's"
    after = [e for e in seen.estimates if e.attitude.boot_ms < 20_000]
    before = [e for e in seen.estimates if e.attitude.boot_ms > 20_000]
    assert len(before) > 20
    # No state mixes the two boots.
    assert all(e.position.boot_ms > 20_000 for e in before)
    assert all(e.position.boot_ms < 20_000 for e in after)
    if flight in PX4:
        assert len(after) > 50
    else:
        assert seen.counts["ATTITUDE_QUATERNION"] > 150, "no position within these seconds"
    assert set(seen.refused) <= NOT_READY
    assert link_record(link, 0).lost == 0


def test_text_between_the_packets_is_garbage_and_nothing_more() -> None:
    clean, noisy = play("ardurover_steady"), play("ardurover_steady", noise=BANNER)
    assert noisy.counts == clean.counts
    assert noisy.estimates == clean.estimates
    packets = len(list(recorded("ardurover_steady")))
    assert noisy.link.reader.counters == {"garbage_bytes": packets * len(BANNER)}


@pytest.mark.parametrize("flight", FLIGHTS)
def test_every_packet_is_read_and_only_px4_has_unknown_ones(flight: str) -> None:
    for piece in ("begin", "steady", "reboot"):
        link = AutopilotLink(1, 1, 3.0, [])
        for now_ns, packet in recorded(f"{flight}_{piece}"):
            link.receive(packet, now_ns)
        counters = Counter(link.reader.counters)
        if flight in PX4:
            assert counters.pop("unknown_message") > 5
        assert not counters


# The guide -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("flight", FLIGHTS)
@pytest.mark.parametrize("piece", ["begin", "steady", "reboot"])
def test_a_guide_for_another_vehicle_stays_silent_and_says_why(flight: str, piece: str) -> None:
    guide = Guide(make_config("supervisor.engage=auto", "supervisor.arm=true"))
    sent: list[bytes] = []
    events: list[Event] = []
    for now_ns, packet in recorded(f"{flight}_{piece}"):
        question = asked(packet)
        if question is not None:
            guide.link._questions.append(question)
        guide.receive(packet, now_ns)
        while guide.deadline() <= now_ns:
            guide.tick(now_ns)
        sent += guide.packets()
        events += [record for record in guide.records() if isinstance(record, Event)]
    assert guide.setpoints_sent == 0
    ids = {int.from_bytes(packet[7:10], "little") for packet in sent}
    assert 82 not in ids, "SET_ATTITUDE_TARGET"
    commands = {int.from_bytes(packet[38:40], "little") for packet in sent if packet[7] == 76}
    assert not commands & {176, 400}, "neither a mode nor arming"
    # In `steady` they fly already, armed: then silence comes before any other reason.
    assert ("silent" if piece == "steady" else "profile px4-uuv") in guide.engagement.reason
    assert [event.code for event in events].count("reboot") == (piece == "reboot")
