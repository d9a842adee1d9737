"""What the guide knows, as records."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import msgspec

from guidance.engagement import Engagement
from guidance.estimate import Estimate, Reset, Switch
from guidance.flying import Caution
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.setpoints import Outgoing
from guidance.records import Event, Level, Record, Reference, Setpoint, State, Status, TrackingError
from guidance.se3 import norm
from guidance.tracker import Solution, Tracker

#: Records that are due by time alone, and how often, ns; `state` only where no setpoint says it.
PERIODS_NS: Final = {
    "state": 100_000_000,
    "status": 200_000_000,
    "link": 500_000_000,
    "timing": 1_000_000_000,
}

#: Resets that follow one another faster than this are one run.
RESET_RUN_NS: Final = 500_000_000


class Cadence:
    """When each of them is due."""

    def __init__(self) -> None:
        self._next_ns = dict.fromkeys(PERIODS_NS, 0)

    def due(self, now_ns: int) -> list[str]:
        """The names of those due now, which are then told."""
        due = [name for name, next_ns in self._next_ns.items() if now_ns >= next_ns]
        for name in due:
            self.told(name, now_ns)
        return due

    def told(self, name: str, now_ns: int) -> None:
        """It was told now: the next one is due a period later."""
        self._next_ns[name] = now_ns + PERIODS_NS[name]

    def now(self, name: str) -> None:
        """It has changed: tell it at once."""
        self._next_ns[name] = 0


def status_record(
    engagement: Engagement,
    link: AutopilotLink,
    tracker: Tracker,
    cautions: Iterable[Caution],
    setpoints_sent: int,
    now_ns: int,
) -> Status:
    """The supervisor and what it knows of the vehicle's mode."""
    profile = engagement.profile
    return Status(
        t_ns=now_ns,
        state=engagement.state,
        reason=engagement.reason,
        since_ns=engagement.since_ns,
        armed=link.armed,
        mode="" if link.custom_mode is None else profile.mode_name(link.custom_mode),
        intended_mode="" if link.intended_mode is None else profile.mode_name(link.intended_mode),
        trajectory_start_ns=tracker.start_ns,
        origin_ned_m=tracker.origin_ned_m,
        setpoints_sent=setpoints_sent,
        allocation=tracker.allocation,
        cautions=tuple(caution.text for caution in cautions),
        trajectory_json="" if tracker.loaded is None else msgspec.json.encode(tracker.loaded).decode(),
    )


def state_record(estimate: Estimate) -> State:
    """The vehicle as the service sees it."""
    return State(
        t_ns=estimate.instant_ns,
        position_ned_m=estimate.pose.position,
        velocity_ned_m_s=estimate.velocity_ned_m_s,
        attitude_wxyz=estimate.pose.attitude,
        body_rates_frd_rad_s=estimate.twist.angular,
        attitude_age_s=estimate.attitude_age_s,
        position_age_s=estimate.position_age_s,
        predicted_s=estimate.attitude_age_s,
        attitude_source=estimate.attitude.source,
        position_source=estimate.position.source,
        vehicle_time_ms=estimate.attitude.boot_ms,
        resets=estimate.resets,
        source_offset_m=estimate.offset_m,
        measured_body_rates_frd_rad_s=estimate.attitude.body_rates_frd_rad_s,
    )


class News:
    """What the estimator says beside its state, as events: resets and changes of source."""

    def __init__(self) -> None:
        self._reset_ns = 0
        self._reset_m = 0.0

    def events(self, news: Iterable[Reset | Switch], now_ns: int) -> list[Event]:
        """All that happened within a read: of each quantity's changes of source, what stands at its end.

        What comes late and all at once goes through every change that it missed.
        """
        switches: dict[str, Switch] = {}
        told = []
        for one in news:
            if isinstance(one, Switch):
                first = switches.get(one.quantity, one)
                switches[one.quantity] = one._replace(before=first.before)
            elif (event := self.told(one, now_ns)) is not None:
                told.append(event)
        standing = [str(switch) for switch in switches.values() if switch.before != switch.after]
        return [Event(t_ns=now_ns, level=Level.NOTICE, code="source", text=text) for text in standing] + told

    def told(self, happened: Reset, now_ns: int) -> Event | None:
        """The event; None within a run of resets.

        An estimator that finds its way back moves with every sample (recorded: 44 m, then 29 steps from 3.5 m
        down). `State.resets` counts them all; of a run only the first and what is larger is told.
        """
        moved_m = norm(happened.moved_ned_m)
        in_a_run = now_ns - self._reset_ns < RESET_RUN_NS and moved_m <= self._reset_m
        self._reset_ns = now_ns
        if in_a_run and happened.cause != "counter":
            return None
        self._reset_m = moved_m
        return Event(t_ns=now_ns, level=Level.WARNING, code="estimator_reset", text=str(happened))


def setpoint_records(
    estimate: Estimate, solution: Solution | None, out: Outgoing, type_mask: int, seq: int
) -> list[Record]:
    """The state, and what was made of it; a neutral setpoint has no reference and no error."""
    t_ns = estimate.instant_ns
    made: list[Record] = [state_record(estimate)]
    if solution is None:
        demanded_rates, demanded_speed = out.body_rates_frd_rad_s, out.speed_m_s
        saturated = singular = False
    else:
        reference, e = solution.reference, solution.evaluation
        u = e.demanded
        demanded_rates, demanded_speed = (u.u1, u.u2, u.u3), u.u4
        saturated, singular = e.saturated, e.singular
        made.append(
            Reference(
                t_ns=t_ns,
                trajectory_s=solution.trajectory_s,
                position_ned_m=reference.position,
                velocity_ned_m_s=reference.velocity,
                acceleration_ned_m_s2=reference.acceleration,
                offset_ned_m=solution.offset_ned_m,
            )
        )
        made.append(
            TrackingError(
                t_ns=t_ns,
                error_ned_m=e.e,
                norm_m=norm(e.e),
                v1=e.V1,
                v2=e.V2,
                field_body=(e.y4, e.y5, e.y6),
            )
        )
    made.append(
        Setpoint(
            t_ns=t_ns,
            seq=seq,
            neutral=solution is None,
            body_rates_frd_rad_s=out.body_rates_frd_rad_s,
            speed_m_s=out.speed_m_s,
            demanded_body_rates_frd_rad_s=demanded_rates,
            demanded_speed_m_s=demanded_speed,
            thrust=out.thrust,
            saturated=saturated,
            singular=singular,
            attitude_wxyz=out.attitude_wxyz,
            velocity_ned_m_s=out.velocity_ned_m_s,
            type_mask=type_mask,
        )
    )
    if solution is not None and solution.flown.around is not None:
        made.append(solution.flown.around)
    return made
