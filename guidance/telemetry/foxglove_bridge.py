"""The live view: what vehicles publish over zenoh, on a WebSocket for Foxglove and Lichtblick.

Needs the extra `foxglove`, which a vehicle does not. Messages are made in the caller's thread; a viewer that
joins is given the last one of each topic in the next turn, and one that is too slow loses messages in the
SDK, by its bounded backlog.
"""

from __future__ import annotations

import re
from collections import deque
from typing import Final, NamedTuple

import foxglove as sdk
import msgspec
from foxglove.websocket import ChannelView, Client, ServerListener

from guidance.records import LOG_ONLY, TOPICS, Record, Session
from guidance.telemetry.arrivals import VEHICLES_MAX
from guidance.telemetry.foxglove_view import SHOWN, View
from guidance.telemetry.queue import Sample
from guidance.telemetry.schema import RECORDS, json_schema, schema_name, schema_of, well_known_name

_WAITING_VIEWERS: Final = 4096
_LAST_NS: Final = (1 << 63) - 1  # what a viewer can hold of a time, whatever a stranger's record says

#: What is advertised of each vehicle: topic without a slash -> name and JSON Schema.
CHANNELS: Final[dict[str, tuple[str, bytes]]] = {
    topic: (schema_name(topic), json_schema(topic)) for topic in RECORDS if topic not in LOG_ONLY
} | {topic: (well_known_name(kind), schema_of(kind)) for topic, kind in SHOWN.items()}


class BridgeError(Exception):
    """The bridge cannot run; the text says why and what to do."""


class _Listener(ServerListener):
    """Notes who subscribes to what; called in the SDK's threads."""

    def __init__(self) -> None:
        self.joined: deque[tuple[int, int]] = deque(maxlen=_WAITING_VIEWERS)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        self.joined.append((client.id, channel.id))


class _Shown(NamedTuple):
    """One run of one vehicle."""

    session: Session
    view: View
    channels: dict[str, sdk.Channel]


class Bridge:
    """The server; `take` gives it the records in order.

    Args:
        host: address to listen on.
        port: to listen on; 0 for any that is free.
        only: the one vehicle that is shown; its topics and frames then have no prefix, as in a log.

    Raises:
        BridgeError: it cannot listen there.
    """

    def __init__(self, host: str, port: int, only: str = "") -> None:
        self._only = only
        self._context = sdk.Context()
        self._listener = _Listener()
        self._vehicles: dict[str, _Shown] = {}  # the one unheard for longest first
        self._last: dict[int, tuple[sdk.Channel, bytes, int]] = {}
        self._encode = msgspec.json.Encoder().encode
        try:
            self._server = sdk.start_server(
                name=only or "guidance",
                host=host,
                port=port,
                server_listener=self._listener,
                context=self._context,
            )
        except RuntimeError as error:
            why = re.sub(r"^FoxgloveError: (Failed to bind port: )?| \(os error \d+\)$", "", str(error))
            raise BridgeError(
                f"cannot listen on {host}, port {port}: {why}; choose others with --host and --port"
            ) from error

    @property
    def port(self) -> int:
        """Where it listens."""
        return self._server.port

    def close(self) -> None:
        """Part with all viewers."""
        self._server.stop()

    def take(self, vehicle: str, record: Record) -> None:
        """Show `record`; what comes before its session record has no time that a viewer knows, and is not."""
        if self._only not in ("", vehicle):
            return
        shown = self._vehicles.get(vehicle)
        if isinstance(record, Session) and (shown is None or shown.session != record):
            shown = self._begin(vehicle, record, shown)
        if shown is None:
            return
        self._vehicles[vehicle] = self._vehicles.pop(vehicle)
        sample = Sample(TOPICS[type(record)], record.t_ns, self._encode(record))
        prefix = "" if self._only else f"{vehicle}/"
        self._log(shown, sample.topic, sample)
        for made in shown.view.of(sample):
            self._log(shown, made.topic.removeprefix(prefix), made)

    def welcome(self) -> None:
        """Give those who have subscribed since the last call the last message of what they subscribed to."""
        while self._listener.joined:
            client, channel_id = self._listener.joined.popleft()
            last = self._last.get(channel_id)
            if last is not None:
                channel, payload, time_ns = last
                channel.log(payload, log_time=time_ns, sink_id=client)

    def _begin(self, vehicle: str, session: Session, before: _Shown | None) -> _Shown:
        if before is None and len(self._vehicles) >= VEHICLES_MAX:
            self._forget(next(iter(self._vehicles)))
        prefix = "" if self._only else f"/{vehicle}"
        channels = (
            {
                topic: sdk.Channel(
                    f"{prefix}/{topic}",
                    message_encoding="json",
                    schema=sdk.Schema(name=name, encoding="jsonschema", data=schema),
                    context=self._context,
                )
                for topic, (name, schema) in CHANNELS.items()
            }
            if before is None
            else before.channels
        )
        for channel in channels.values():
            self._last.pop(channel.id(), None)
        view = View(session.unix_offset_ns, "" if self._only else vehicle)
        shown = self._vehicles[vehicle] = _Shown(session, view, channels)
        return shown

    def _forget(self, vehicle: str) -> None:
        for channel in self._vehicles.pop(vehicle).channels.values():
            self._last.pop(channel.id(), None)
            channel.close()

    def _log(self, shown: _Shown, topic: str, sample: Sample) -> None:
        channel = shown.channels[topic]
        time_ns = min(max(0, sample.t_ns + shown.session.unix_offset_ns), _LAST_NS)
        self._last[channel.id()] = (channel, sample.payload, time_ns)
        channel.log(sample.payload, log_time=time_ns)
