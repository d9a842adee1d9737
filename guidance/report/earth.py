"""Where the local frame of a log is on earth, as the autopilot said it when tracking began."""

from __future__ import annotations

import msgspec

from guidance.config import Config
from guidance.connection import parse_connection
from guidance.geodesy import Geodetic
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.signing import Signing
from guidance.records import Input, InputKind


class Origin:
    """Reads GPS_GLOBAL_ORIGIN out of a log's traffic, as the service's own link did."""

    def __init__(self, config: Config) -> None:
        self._link = AutopilotLink(
            config.vehicle.system_id,
            config.vehicle.component_id,
            config.link.heartbeat_timeout_s,
            (),
            byte_stream=parse_connection(config.link.connection).byte_stream,
            signing=Signing(None, config.link.signing_link_id) if config.link.signing_key_file else None,
        )
        self._decode = msgspec.json.Decoder(Input).decode

    def take(self, payload: bytes) -> None:
        """An input, as it is in the log; raises what a record does that is none."""
        event = self._decode(payload)
        if event.kind is InputKind.DATAGRAM:
            self._link.receive(event.data, event.t_ns, event.text)
            self._link.outbox.drain()
        elif event.kind is InputKind.LINK_UP:
            self._link.reader.forget()

    @property
    def place(self) -> Geodetic | None:
        """deg, deg and m AMSL, None before it was said."""
        said = self._link.origin
        if said is None:
            return None
        return said.latitude * 1e-7, said.longitude * 1e-7, said.altitude * 1e-3
