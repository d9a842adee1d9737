"""From the link to the estimator: which streams are asked for, and how a sample of state is taken."""

from __future__ import annotations

from guidance.condition import Condition
from guidance.config import Config
from guidance.connection import Connection
from guidance.estimate import Estimator
from guidance.mavlink.budget import affords_odometry
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.messages import GlobalPositionInt, StateBody
from guidance.mavlink.profiles import Profile
from guidance.mavlink.streams import Stream, wanted_streams


def streams_at(rate_hz: float, config: Config, profile: Profile, connection: Connection) -> list[Stream]:
    """The streams that setpoints at `rate_hz` need on this line."""
    affordable = affords_odometry(connection.capacity_bytes_per_s, rate_hz)
    return wanted_streams(
        rate_hz,
        config.link.attitude_timeout_s,
        config.link.position_timeout_s,
        profile.mode_hz,
        odometry=profile.odometry and affordable,
        air=profile.air + profile.condition,
    )


def take_state(
    link: AutopilotLink,
    estimator: Estimator,
    name: str,
    body: StateBody,
    now_ns: int,
    *,
    condition: Condition | None = None,
) -> str | None:
    """Hand a sample to the estimator at the instant of its measurement; why it was refused, None if taken.

    By the autopilot's `condition` a GLOBAL_POSITION_INT may be of no use. Its stream learns of it; a refusal
    is counted, but for one that another source makes needless.
    """
    refused: str | None = "before_time_sync"
    local = link.streams.get("LOCAL_POSITION_NED")
    local_ns = None if local is None else local.last_ns
    if isinstance(body, GlobalPositionInt) and condition is not None and condition.doubted(local_ns):
        refused = "not_needed" if condition.no_position is None else "dead_reckoned"
    elif link.clock.synced(now_ns):
        instant_ns = link.clock.to_local_ns(body.since_boot_ns)
        refused = estimator.take(body, instant_ns, now_ns, link.origin)
    stream = link.streams.get(name)
    if stream is not None:
        stream.arrived(now_ns, valid=refused is None or refused == "not_needed")
    if refused is not None and refused != "not_needed":
        link.counters[f"{name}:{refused}"] += 1
    return refused
