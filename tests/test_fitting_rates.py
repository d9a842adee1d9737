"""What is asked of the autopilot besides its state: the air for airplanes, and no rate that it denies."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.config import parse_connection
from guidance.flying.rates import Rates
from guidance.intake import streams_at
from guidance.mavlink.air import VfrHud, Wind, WindCov
from guidance.mavlink.budget import OVERHEAD_BYTES, needed_bytes_per_s
from guidance.mavlink.messages import Body
from guidance.mavlink.profiles import PROFILES, Profile
from guidance.records import StreamStatus
from tests.helpers import ROVER, events_of, fly_until_tracking, make_config, make_flight
from tests.mavlink_peer import Sender


class Listening(Rates):
    """Keeps what it hears."""

    def __init__(self) -> None:
        super().__init__(make_config(), planar=False)
        self.bodies: list[Body] = []

    def heard(self, body: Body, now_ns: int) -> None:
        self.bodies.append(body)


def test_airspeed_and_wind_reach_what_flies_and_nothing_else_does() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    handler = flight.guide.tracker.handler = Listening()
    sender = Sender()
    sender.sequence = (flight.guide.link.sequence.newest or 0) + 1
    for message in (
        mavlink.MAVLink_vfr_hud_message(12.5, 11.0, 90, 40, 100.0, 0.5),
        mavlink.MAVLink_wind_message(270.0, 5.0, -0.25),
        mavlink.MAVLink_wind_cov_message(0, 3.0, -4.0, 0.5, 0, 0, 0, 0, 0),
        mavlink.MAVLink_vfr_hud_message(float("nan"), 11.0, 90, 40, 101.0, 0.5),
        mavlink.MAVLink_vfr_hud_message(float("inf"), 11.0, 90, 40, 102.0, 0.5),
        mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 50, 0, 0, 0, 0, 0, 0),
    ):
        flight.inject(sender.pack(message))
    assert handler.bodies == [
        VfrHud(12.5, 100.0),
        Wind(270.0, 5.0, -0.25),
        WindCov(3.0, -4.0, 0.5),
        VfrHud(0.0, 101.0),
    ], "PX4 without an airspeed sensor says NaN, and its height all the same"
    assert flight.guide.link.counters["VFR_HUD:not_finite"] == 1


@pytest.mark.parametrize(
    ("loop_hz", "granted"), [(50, 40.0), (55, 1000.0 / 23.0), (200, 50.0)], ids=["50", "55", "200"]
)
def test_the_highest_rate_that_is_granted_is_asked_for_and_told(loop_hz: int, granted: float) -> None:
    flight = make_flight(
        *ROVER, "law.rho2_per_s=3", "law.rho3_per_s=3", parameters={"SCHED_LOOP_RATE": loop_hz}
    )
    fly_until_tracking(flight)
    flight.run(5.0)
    stream = flight.guide.link.streams["ATTITUDE_QUATERNION"]
    assert stream.asked_hz == granted
    status: StreamStatus = stream.status(flight.now_ns)
    assert status.rate_hz == pytest.approx(granted, rel=0.05)
    told = events_of(flight, "parameter")
    if granted == 50.0:
        assert not told
        assert not events_of(flight, "rate_denied")
    else:
        assert f"ATTITUDE_QUATERNION: 50 Hz is not granted, {granted:.3g} Hz is asked for" in events_of(
            flight, "rate_denied"
        )
        assert told[0].startswith(
            f"SCHED_LOOP_RATE = {loop_hz} Hz, needs at least 62.5 for link.rate_hz = 50: "
            f"set SCHED_LOOP_RATE to at least 62.5, or link.rate_hz = {0.8 * loop_hz:g}: "
        )


@pytest.mark.parametrize("profile", PROFILES.values(), ids=lambda profile: profile.name)
def test_only_airplanes_are_asked_for_the_air_and_a_line_of_115200_baud_carries_it(profile: Profile) -> None:
    line = parse_connection("serial:///dev/ttyAMA0?baud=115200")
    streams = streams_at(50.0, make_config(), profile, line)
    asked = {s.message: s.wanted_hz for s in streams if s.message in ("VFR_HUD", "WIND", "WIND_COV")}
    assert asked == {
        "px4-plane": {"VFR_HUD": 10.0, "WIND_COV": 2.0},
        "ardupilot-plane": {"VFR_HUD": 10.0, "WIND": 2.0},
    }.get(profile.name, {})
    assert line.capacity_bytes_per_s is not None
    assert needed_bytes_per_s(streams, 50.0) < line.capacity_bytes_per_s


def test_a_line_that_carries_an_airplanes_state_carries_its_air_too() -> None:
    line = parse_connection("serial:///dev/ttyAMA0?baud=115200")
    plane = streams_at(50.0, make_config(), PROFILES["ardupilot-plane"], line)
    rover = streams_at(50.0, make_config(), PROFILES["ardupilot-rover"], line)
    air = 10.0 * (20 + OVERHEAD_BYTES) + 2.0 * (12 + OVERHEAD_BYTES)
    landed = 5.0 * (2 + OVERHEAD_BYTES)
    assert needed_bytes_per_s(plane, 1.0) - needed_bytes_per_s(rover, 1.0) == pytest.approx(air + landed)
