"""All sinks of a run as one: what the service offers its records to, and asks how they are."""

from __future__ import annotations

import re
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final, Protocol, runtime_checkable

import msgspec

from guidance.config import Config, ConfigError
from guidance.records import TOPICS, Record, Session
from guidance.telemetry.console import Console
from guidance.telemetry.log_keeper import Keeper
from guidance.telemetry.queue import Sample
from guidance.telemetry.recorder import Recorder, Rotation
from guidance.telemetry.worker import Sink
from guidance.telemetry.zenoh_orders import HandOver
from guidance.telemetry.zenoh_sink import ZenohSink

_NUMBERS: Final = re.compile(r"\d+(\.\d+)?")


@runtime_checkable
class TakesOrders(Protocol):
    """A sink by which orders come."""

    def orders_to(self, hand_over: HandOver) -> None:
        """Whom they are handed to."""


class Sinks:
    """Sinks by name. Every call is of the control thread and returns at once, `close` excepted."""

    def __init__(self, sinks: Mapping[str, Sink]) -> None:
        self._sinks = dict(sinks)
        self._kinds = dict.fromkeys(sinks, "")
        self._encode = msgspec.json.Encoder().encode

    def start(self) -> None:
        """Start their threads."""
        for sink in self._sinks.values():
            sink.start()

    def publish(self, records: Iterable[Record]) -> None:
        """Encode each record once and offer it to all."""
        for record in records:
            sample = Sample(TOPICS[type(record)], record.t_ns, self._encode(record))
            for sink in self._sinks.values():
                sink.offer(sample)

    def orders_to(self, hand_over: HandOver) -> None:
        """Whom orders are handed to that come by a sink; before the start."""
        for sink in self._sinks.values():
            if isinstance(sink, TakesOrders):
                sink.orders_to(hand_over)

    @property
    def dropped(self) -> int:
        """Records that one of them will never write, since the start."""
        return sum(sink.dropped for sink in self._sinks.values())

    def news(self) -> list[str]:
        """What has come to be wrong since the last call, and what is well again; each is said once."""
        said = []
        for name, sink in self._sinks.items():
            problem = sink.problem
            kind = _NUMBERS.sub("", problem)  # the same problem, only older or larger, is no news
            if kind != self._kinds[name]:
                self._kinds[name] = kind
                said.append(f"{name}: {problem or 'well again'}")
        return said

    def close(self, timeout_s: float) -> dict[str, str]:
        """Close all within `timeout_s`; those that hang or did not write everything, with their problem."""
        end = time.monotonic() + timeout_s
        for sink in self._sinks.values():
            sink.close(0.0)  # all begin; the log is waited for first, it is what must not be lost
        left = {}
        for name in sorted(self._sinks, key=lambda name: name != "log"):
            if not self._sinks[name].close(max(end - time.monotonic(), 0.02)):
                left[name] = self._sinks[name].problem
        return left


def _recorder(config: Config, session: Session) -> Recorder:
    log, directory = config.log, Path(config.log.directory)
    return Recorder(
        directory,
        vehicle=config.vehicle.name,
        session_id=session.session_id,
        unix_offset_ns=session.unix_offset_ns,
        min_free_bytes=round(log.min_free_mb * 1e6),
        foxglove=log.foxglove,
        rotation=Rotation(size_bytes=log.rotate_mb * 1e6, age_ns=log.rotate_min * 60e9),
        keeper=Keeper(
            directory,
            vehicle=config.vehicle.name,
            session_id=session.session_id,
            keep_files=log.keep_files,
            keep_bytes=round(log.keep_mb * 1e6),
        ),
    )


def configured_sinks(config: Config, session: Session) -> dict[str, Sink]:
    """Every sink that the configuration wants, and the console; raises ConfigError for bad zenoh settings."""
    sinks: dict[str, Sink] = {"console": Console(session.unix_offset_ns)}
    if config.log.enabled:
        sinks["log"] = _recorder(config, session)
    if config.zenoh.enabled:
        zenoh = config.zenoh
        try:
            sinks["zenoh"] = ZenohSink(
                config.vehicle.name,
                mode=zenoh.mode,
                connect=zenoh.connect,
                listen=zenoh.listen,
                multicast_scouting=zenoh.multicast_scouting,
                config_file=Path(zenoh.config_file) if zenoh.config_file else None,
                commands=zenoh.commands,
            )
        except ValueError as error:
            raise ConfigError(str(error)) from None
    return sinks
