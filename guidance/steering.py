"""From what is known now to one setpoint that is sent, or a reason to be silent."""

from __future__ import annotations

from typing import NamedTuple

from guidance.config import Config
from guidance.connection import Connection
from guidance.estimate import Estimate, Estimator
from guidance.guarding import Guards
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.profiles import Profile
from guidance.mavlink.setpoints import Outgoing, setpoint_message
from guidance.readiness import stalled, young
from guidance.timing import Pace
from guidance.tracker import Solution, Tracker


class Sent(NamedTuple):
    """One setpoint that was sent, what it was made of (`solution`: None for neutral) and by which row, and
    when it was due."""

    estimate: Estimate
    solution: Solution | None
    outgoing: Outgoing
    row: Profile
    due_ns: int


class Steering:
    """Computes each setpoint for its own instant and hands it to the link; never the same one twice."""

    def __init__(
        self,
        config: Config,
        connection: Connection,
        link: AutopilotLink,
        tracker: Tracker,
        estimator: Estimator,
        guards: Guards,
    ) -> None:
        self.setpoints_sent = 0
        self.sent_ns: int | None = None
        self.pace = Pace(config.link.rate_hz)
        self._config = config
        self._connection = connection
        self._link = link
        self._tracker = tracker
        self._estimator = estimator
        self._guards = guards
        self._delay_ns = round(config.link.actuation_delay_s * 1e9)

    def acts_ns(self, now_ns: int) -> int:
        """The instant at which a setpoint sent now acts."""
        return now_ns + round(self._link.clock.uplink_s * 1e9) + self._delay_ns

    def basis(self, now_ns: int) -> Estimate | str:
        """The state that a setpoint may be made of now, or why none may be sent."""
        held_up = stalled(self._connection, self._link.uplink_age_s(now_ns))
        return held_up or self._estimator.origin.moved or self.estimate(now_ns)

    def estimate(self, now_ns: int) -> Estimate | str:
        """The state at the instant that a setpoint sent now acts, or why there is none to be used."""
        estimate = self._estimator.at(self.acts_ns(now_ns), self._tracker.history)
        return young(estimate, self._config.link, now_ns)

    def send(self, now_ns: int, boot_ms: int, *, law: bool) -> Sent | str:
        """Compute and send one setpoint, of the law or neutral, or say why not."""
        due_ns = self.pace.taken(now_ns)
        self._guards.late_s = (now_ns - due_ns) * 1e-9
        estimate = self.basis(now_ns)
        if isinstance(estimate, str):
            return estimate
        row = self._tracker.row_for(self._link.version)
        solution = self._solve(estimate, now_ns) if law else None
        if isinstance(solution, str):
            return solution
        out = self._tracker.neutral(estimate) if solution is None else solution.outgoing
        self._link.outbox.send(setpoint_message(row, out, self._link.system, self._link.component, boot_ms))
        self.setpoints_sent += 1
        self.sent_ns = now_ns
        return Sent(estimate, solution, out, row, due_ns)

    def _solve(self, estimate: Estimate, now_ns: int) -> Solution | str:
        if self._tracker.start_ns is None:
            origin = self._tracker.find_origin(estimate.pose.position, self._link.origin, self._link.home)
            if isinstance(origin, str):
                return origin
            self._tracker.start(self.acts_ns(now_ns), origin)
        solution = self._tracker.solve(estimate)
        return self._guards.before_sending(solution, now_ns) or solution
