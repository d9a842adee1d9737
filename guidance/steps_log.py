"""From the records of a tuning flight to the vehicle's answers; nothing of it is on the control path."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import msgspec

from guidance.config import Config, ConfigError, from_json, profile_of
from guidance.flying.around import Phase
from guidance.flying.channels import sent
from guidance.mavlink.profiles import Asked
from guidance.records import NOT_A_RECORD, TOPICS, Record, Session, Setpoint, Stepping
from guidance.telemetry.log import LogDamaged
from guidance.telemetry.log_parts import PartMissing, read_run
from guidance.telemetry.schema import RECORDS
from guidance.tune.answer import Command, Sample
from guidance.tune.excitation import PITCH, ROLL, SPEED, THROTTLE, Run
from guidance.tune.identify import Identified, Measurement, Refused, identified
from guidance.tune.propose import Results

#: Records that are needed, by topic.
NEEDED: Final = (TOPICS[Setpoint], TOPICS[Stepping])
#: Of a run so much may be missing at its end: the periods of the slowest setpoints.
MISSING_S: Final = 0.25
#: At rest they are not what is asked for: an airplane has trims.
_TRIMMED: Final = frozenset({ROLL, PITCH, THROTTLE})


class NoStepsError(Exception):
    """The log is of no tuning flight; the text says so."""


class _Flown:
    """One attempt at a run, which began at `zero_ns`."""

    def __init__(self, zero_ns: int) -> None:
        self.zero_ns = zero_ns
        self.until_s = 0.0
        self.commands: list[Command] = []
        self.samples: list[Sample] = []

    def take(self, record: Stepping, setpoint: Setpoint, delay_ns: int) -> None:
        """What was sent and what had been measured then."""
        self.until_s = record.into_s
        arrived_s = (record.t_ns - delay_ns - self.zero_ns) * 1e-9
        self.commands.append(Command(arrived_s, sent(record.channel, setpoint)))
        seen_s = (record.measured_ns - self.zero_ns) * 1e-9
        if not self.samples or seen_s > self.samples[-1].at_s:  # else nothing new was measured
            self.samples.append(Sample(seen_s, record.measured, record.push))


def results_of(config: Config, records: Iterable[Record]) -> Results:
    """The answer of each run's channel; a run that was not flown to its end is refused.

    Times are s from the run's first setpoint; a command is at the instant of its arrival, from where
    `link.actuation_delay_s` counts.
    """
    runs = {run.name: run for run in config.excitation.runs}
    flown: dict[str, _Flown] = {}
    newest: Setpoint | None = None
    delay_ns = round(config.link.actuation_delay_s * 1e9)
    for record in records:
        if isinstance(record, Setpoint):
            newest = record
        elif isinstance(record, Stepping) and record.phase == Phase.STEPPING and record.run in runs:
            if newest is None or newest.t_ns != record.t_ns:
                continue  # the recorder dropped it
            attempt = flown.get(record.run)
            if attempt is None or record.into_s < attempt.until_s:  # the first, or anew after a hold
                attempt = flown[record.run] = _Flown(record.t_ns)
            attempt.take(record, newest, delay_ns)
    # PX4's rovers hold their speed by an integral that remembers minutes
    trimmed = _TRIMMED | ({SPEED} if profile_of(config).asked is Asked.VELOCITY_YAW_RATE else set())
    return {
        run.channel: _answer(run, flown.get(run.name), offset=run.channel in trimmed) for run in runs.values()
    }


def read_log(path: Path) -> tuple[Config, list[Record]]:
    """Configuration and records of a tuning flight's log.

    Raises:
        NotALog: it is none of ours.
        NoStepsError: nothing was stepped in it, or it cannot be read.
    """
    records: list[Record] = []
    config: Config | None = None
    try:
        for topic, payload in read_run(path):
            if topic == TOPICS[Session] and config is None:
                config = from_json(msgspec.json.decode(payload, type=Session).config_json)
            elif topic in NEEDED:
                records.append(msgspec.json.decode(payload, type=RECORDS[topic]))
    except (LogDamaged, PartMissing) as damage:
        if config is None:
            raise NoStepsError(str(damage)) from None
        # what was read stands: a run counts only if it is there to its end
    except (*NOT_A_RECORD, ConfigError) as error:
        raise NoStepsError(f"{path}: {error}") from None
    if config is None or not config.excitation.runs:
        raise NoStepsError(f"{path}: no tuning flight: its configuration has no steps")
    return config, records


def _answer(run: Run, flown: _Flown | None, *, offset: bool) -> Identified | Refused:
    if flown is None:
        return Refused("its run was not flown")
    if flown.until_s < run.lasts_s - MISSING_S:
        return Refused(f"its run ended after {flown.until_s:.1f} of {run.lasts_s:.1f} s")
    # an autopilot may lead its command of the speed
    return identified(Measurement(flown.commands, flown.samples, offset, led=run.channel == SPEED))
