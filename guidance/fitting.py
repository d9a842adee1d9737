"""The autopilot's own parameters: read at the start, judged, and handed to what flies.

They are asked for a few at a time and never in flight, anew after a reboot; what somebody else changes is
heard of. Nobody may engage before those that the flight needs are known and fit.

In flight a change is told and otherwise waits for the flight's end, lest limits jump under a manoeuvre: all
but the speed of full thrust, which the autopilot follows at once, and the speeds asked for with it.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, isfinite, isnan
from typing import Final

from guidance.config import Config
from guidance.mavlink.air import AirBody, VfrHud
from guidance.mavlink.link import AutopilotLink, Received
from guidance.mavlink.messages import ParamValue
from guidance.mavlink.parameters import ParameterReader, name_of, request_read
from guidance.mavlink.profiles import Profile
from guidance.mavlink.requirements import Grade, Judged, judged, names_of, partners_of, values_of
from guidance.records import Event, Level, Parameters, Record
from guidance.tracker import Tracker

#: Between two rounds of questions: 40 a second at most are 1500 bytes/s each way.
ROUND_NS: Final = 100_000_000
#: Engaging waits no longer than this for what a flight does not need and is slow to come, or absent.
PATIENCE_NS: Final = 2_000_000_000
#: And no longer for the version, which is asked for once a second, where setpoints go by it.
VERSION_PATIENCE_NS: Final = 5_000_000_000

#: Between two looks in flight: who changes one over and over fills nobody's log.
CALM_NS: Final = 500_000_000

_LOOP_RATE: Final = "SCHED_LOOP_RATE"
_READING: Final = "the autopilot's parameters are being read"


class Fitting:
    """`unmet` is why the vehicle must not be flown with the parameters as they are, None if it may be."""

    def __init__(self, config: Config, profile: Profile, link: AutopilotLink, tracker: Tracker) -> None:
        self._config = config
        self._profile = profile
        self._link = link
        self._tracker = tracker
        self.rebooted()

    def rebooted(self) -> None:
        """Nothing is known any more."""
        table = self._profile.requirements
        self.unmet: str | None = _READING
        self._reader = ParameterReader(
            names_of(table), bytewise=self._profile.parameters_bytewise, partners=partners_of(table)
        )
        self._first_ns: int | None = None
        self._round_ns = 0
        self._calm_ns = 0
        self._judge = True
        self._fitted = False
        self._changed: dict[str, None] = {}
        self._told: set[Judged] = set()

    def reconfigure(self, config: Config) -> None:
        """Limits and trajectory are these: whether they fit is looked at anew."""
        self._judge = self._judge or config is not self._config
        self._config = config

    @property
    def answers(self) -> Mapping[str, float]:
        """What the autopilot has answered, by its own names."""
        return self._reader.values

    def heard(self, received: Received, now_ns: int) -> None:
        """A parameter, asked for by us or set by somebody else; or the air, for what flies. Others are not
        looked at."""
        body = received.body
        if isinstance(body, ParamValue):
            if self._reader.take(body):
                self._judge = True
                self._changed[name_of(body)] = None
        elif isinstance(body, AirBody):
            if isinstance(body, VfrHud) and isnan(body.airspeed):
                body = body._replace(airspeed=0.0)  # none is measured (PX4's `VFR_HUD.hpp`); the height holds
            if all(map(isfinite, body)):
                self._tracker.handler.heard(body, now_ns)
            else:
                self._link.counters[f"{received.name}:not_finite"] += 1

    def look(self, now_ns: int, *, flying: bool) -> list[Record]:
        """Ask for what is missing; what there is to tell. To be called before `unmet` is believed."""
        if self._link.heartbeat is None or not self._profile.fits(self._link.heartbeat):
            return []
        if not flying and now_ns >= self._round_ns:
            self._ask(now_ns)
        if not self._judge or not self._known(now_ns):
            return []
        if not flying:
            return self._fit(now_ns)
        if not self._changed or now_ns < self._calm_ns:
            return []
        self._calm_ns = now_ns + CALM_NS
        return self._in_flight(now_ns)

    def _ask(self, now_ns: int) -> None:
        self._first_ns = now_ns if self._first_ns is None else self._first_ns
        self._round_ns = now_ns + ROUND_NS
        for name in self._reader.due(now_ns):
            self._link.outbox.send(request_read(name, self._link.system, self._link.component))

    def _known(self, now_ns: int) -> bool:
        """Whether all are, and the version where it counts; or what a flight needs, after some patience."""
        waited_ns = 0 if self._first_ns is None else now_ns - self._first_ns
        by_version = self._profile.older is not None
        if by_version and self._link.version is None and waited_ns < VERSION_PATIENCE_NS:
            return False
        if self._reader.complete:
            return True
        if waited_ns < PATIENCE_NS:
            return False
        needed = (row for row in self._profile.requirements if row.required)
        return all(row.value(self._reader.values) is not None for row in needed)

    def _fit(self, now_ns: int) -> list[Record]:
        """What was read holds from here on, or `unmet` says why not."""
        answers = self._reader.values
        rows = [judged(row, answers, self._config) for row in self._profile.requirements]
        values = values_of(self._profile.requirements, answers)
        bad = next((one for one in rows if one.grade is Grade.BAD), None)
        before, self.unmet = self.unmet, self._tracker.fit(values) if bad is None else str(bad)
        if bad is None and _LOOP_RATE in values:
            self._link.streams.cap(granted_hz(values[_LOOP_RATE]))
        changed = f"{', '.join(self._changed)} changed: " if self._fitted and self._changed else ""
        news: list[Record] = [
            _event(now_ns, Level.WARNING, "parameter", f"{one}")
            for one in rows
            if one.grade is Grade.DOUBTFUL and one not in self._told
        ]
        if self.unmet is not None and self.unmet != before:
            news.append(_event(now_ns, Level.ERROR, "parameters_unfit", f"{changed}{self.unmet}"))
        elif self.unmet is None and changed:
            news.append(_event(now_ns, Level.NOTICE, "parameter_changed", f"{changed}it holds from here on"))
        if news or not self._fitted or self._changed:
            news.append(self._record(now_ns))
        self._told = set(rows)
        self._fitted, self._changed = True, {}
        self._insist()
        return news

    def _insist(self) -> None:
        """What a flight needs and did not come may have been lost: ask on."""
        rows = self._profile.requirements
        missing = [row for row in rows if row.required and row.value(self._reader.values) is None]
        self._reader.again(name for row in missing for name in row.names)
        self._judge = bool(missing)

    def _in_flight(self, now_ns: int) -> list[Record]:
        """Others change parameters while we fly."""
        answers, changed = self._reader.values, self._changed
        self._changed = {}
        news: list[Record] = []
        for row in self._profile.requirements:
            if not changed.keys() & set(row.names):
                continue
            one = judged(row, answers, self._config)
            holds = "it holds from the next flight on"
            if row.parameter == self._profile.full_thrust_parameter and one.grade is not Grade.BAD:
                self._tracker.full_thrust(values_of((row,), answers))
                holds = "speeds are asked for with it at once, limits follow after the flight"
            level = Level.ERROR if one.grade is Grade.BAD else Level.WARNING
            news.append(_event(now_ns, level, "parameter_changed", f"changed in flight: {one} ({holds})"))
        return [*news, self._record(now_ns)] if news else []

    def _record(self, now_ns: int) -> Parameters:
        answers = self._reader.values
        rows = [(row, row.value(answers)) for row in self._profile.requirements]
        return Parameters(
            t_ns=now_ns,
            values={found[0]: answers[found[0]] for _, found in rows if found is not None},
            used=tuple(found[0] for row, found in rows if row.used and found is not None),
            absent=tuple(row.parameter for row, found in rows if found is None),
            unmet=self.unmet or "",
        )


def granted_hz(loop_hz: float) -> float:
    """The highest rate that ArduPilot grants: 0.8 times its loop's, in whole ms (`cap_message_interval` of
    `GCS_Common.cpp`)."""
    return 1000.0 / ceil(1250.0 / loop_hz)


def _event(now_ns: int, level: Level, code: str, text: str) -> Event:
    return Event(t_ns=now_ns, level=level, code=code, text=text)
