"""The conditions for flying, one by one, on a link that is in flight: each is named when it is not met."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.core import Guide
from guidance.estimate import AttitudeSample, Estimate, PositionSample
from guidance.mavlink.messages import Heartbeat
from guidance.readiness import first_unmet, young
from guidance.se3 import IDENTITY, ZERO, Pose, Twist, Vec3
from tests.helpers import make_config, make_flight

MS = 1_000_000
START = Vec3(0.0, 1.0, 0.0)


def estimate(attitude_age_s: float = 0.01, position_age_s: float = 0.01, position: Vec3 = START) -> Estimate:
    """A level vehicle, at the start of the helix unless told."""
    return Estimate(
        instant_ns=0,
        pose=Pose(position, IDENTITY),
        twist=Twist(ZERO, ZERO),
        attitude=AttitudeSample(0, 0, IDENTITY, ZERO, "ATTITUDE"),
        position=PositionSample(0, 0, position, ZERO, "LOCAL_POSITION_NED"),
        attitude_age_s=attitude_age_s,
        position_age_s=position_age_s,
        seen=Pose(position, IDENTITY),
    )


@pytest.fixture
def ready() -> tuple[Guide, int]:
    """A guide that waits for its pilot, every condition met, and the time."""
    flight = make_flight("supervisor.engage=pilot", "supervisor.engage_max_error_m=5")
    flight.run(3.0)
    return flight.guide, flight.now_ns


def measured(attitude_ms: int, position_ms: int) -> Estimate:
    """An estimate of samples that were measured at these instants."""
    one = estimate()
    return one._replace(
        attitude=one.attitude._replace(instant_ns=attitude_ms * MS),
        position=one.position._replace(instant_ns=position_ms * MS),
    )


def unmet(guide: Guide, now_ns: int, state: Estimate | str, *, engaging: bool = False) -> str | None:
    """What stands in the way."""
    g = guide
    return first_unmet(g.config, g.profile, g.link, g.tracker, g.condition, state, now_ns, engaging)


def test_a_state_may_be_used_while_attitude_and_position_are_young() -> None:
    link = make_config("link.attitude_timeout_s=0.2", "link.position_timeout_s=0.3").link
    assert young(None, link, 0) == "no attitude or no position yet"
    assert isinstance(young(measured(-199, -299), link, 0), Estimate)
    assert young(measured(-210, -100), link, 0) == "the attitude is 0.21 s old"
    assert young(measured(-100, -310), link, 0) == "the position is 0.31 s old"


def test_that_a_setpoint_acts_later_is_no_age() -> None:
    link = make_config().link
    later = measured(-190, -290)._replace(instant_ns=150 * MS, attitude_age_s=0.34, position_age_s=0.44)
    assert young(later, link, 0) is later
    assert young(later, link, 20 * MS) == "the attitude is 0.21 s old"


def test_all_is_well_at_the_start(ready: tuple[Guide, int]) -> None:
    assert unmet(*ready, estimate()) is None


@pytest.mark.parametrize(
    ("kind", "autopilot", "said", "needed"),
    [
        (mavlink.MAV_TYPE_GROUND_ROVER, 12, "PX4 MAV_TYPE_GROUND_ROVER", "this vehicle needs px4-rover"),
        (mavlink.MAV_TYPE_FIXED_WING, 12, "PX4 MAV_TYPE_FIXED_WING", "this vehicle needs px4-plane"),
        (
            mavlink.MAV_TYPE_SUBMARINE,
            3,
            "ARDUPILOTMEGA MAV_TYPE_SUBMARINE",
            "there is no profile for this vehicle",
        ),
        (250, 251, " 251 MAV_TYPE 250", "there is no profile for this vehicle"),
    ],
)
def test_another_vehicle_type_or_firmware_is_not_flown(
    ready: tuple[Guide, int], kind: int, autopilot: int, said: str, needed: str
) -> None:
    ready[0].link.heartbeat = Heartbeat(kind, autopilot, 0, 0, 0)
    firmware = f"MAV_AUTOPILOT{'' if said.startswith(' ') else '_'}{said}"
    wanted = f"{firmware} is not what vehicle.profile px4-uuv is for: {needed}"
    assert unmet(*ready, estimate()) == wanted
    assert unmet(*ready, estimate(), engaging=True) == wanted


def test_a_silent_autopilot_is_named_first(ready: tuple[Guide, int]) -> None:
    ready[0].link.heartbeat = None
    assert unmet(*ready, "no attitude or no position yet") == "no heartbeat of the autopilot yet"


def test_an_unknown_clock_is_named(ready: tuple[Guide, int]) -> None:
    ready[0].link.clock.reset()
    said = unmet(*ready, estimate())
    assert said == "the autopilot's clock is not known: waiting for its TIMESYNC answers"


def test_a_state_that_must_not_be_used_blocks_always(ready: tuple[Guide, int]) -> None:
    for engaging in (False, True):
        assert unmet(*ready, "the attitude is 0.30 s old", engaging=engaging) == "the attitude is 0.30 s old"


def test_streams_that_stopped_block_only_before_engaging(ready: tuple[Guide, int]) -> None:
    guide, now_ns = ready
    later_ns = now_ns + 1_000_000_000
    wanted = "no ODOMETRY, ATTITUDE_QUATERNION or ATTITUDE: is the estimator ready?"
    assert unmet(guide, later_ns, estimate()) == wanted
    assert unmet(guide, later_ns, estimate(), engaging=True) is None


def test_the_distance_counts_until_the_trajectory_has_begun(ready: tuple[Guide, int]) -> None:
    far = estimate(position=Vec3(3.0, 1.0, 4.1))
    assert unmet(*ready, far) == "5.1 m from the start, engage_max_error_m is 5: go closer"
    assert unmet(*ready, estimate(position=Vec3(3.0, 1.0, 3.9))) is None
    ready[0].tracker.start(ready[1], ZERO)
    assert unmet(*ready, far) is None


def test_an_unknown_origin_is_named() -> None:
    for origin, lacking in [("home", "home"), ("[47.4, 8.5, 489.0]", "origin")]:
        flight = make_flight(
            "supervisor.engage=pilot", f"flight.origin={origin}", "supervisor.engage_max_error_m=100000"
        )
        flight.run(3.0)
        assert unmet(flight.guide, flight.now_ns, estimate()) is None
        setattr(flight.guide.link, lacking, None)
        said = unmet(flight.guide, flight.now_ns, estimate())
        assert said is not None
        assert said.startswith("the autopilot has not said where ")
        assert ("HOME_POSITION" if lacking == "home" else "GPS_GLOBAL_ORIGIN") in said
