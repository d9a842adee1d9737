"""The MCAP library's writer as the recorder uses it: its types, its file in memory, a log's channels."""

from __future__ import annotations

import io
from typing import Protocol

from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.log import DERIVED
from guidance.telemetry.schema import RECORDS, json_schema, schema_name, schema_of, well_known_name


class McapWriter(Protocol):
    """`mcap.writer.Writer`, which comes with only some of its types."""

    def add_message(
        self, channel_id: int, log_time: int, data: bytes, publish_time: int, sequence: int
    ) -> None: ...

    def add_metadata(self, name: str, data: dict[str, str]) -> None: ...

    def register_schema(self, name: str, encoding: str, data: bytes) -> int: ...

    def register_channel(
        self, topic: str, message_encoding: str, schema_id: int, metadata: dict[str, str] = ...
    ) -> int: ...

    def flush(self) -> None: ...

    def finish(self) -> None: ...


class Outbox(io.BytesIO):
    """What the MCAP writer takes for its file: keeps the bytes until they are written out together."""

    def __init__(self) -> None:
        super().__init__()
        self._before = 0

    def tell(self) -> int:
        """Offset in the file of the next byte."""
        return self._before + super().tell()

    def empty(self) -> bool:
        return super().tell() == 0

    def take(self) -> bytes:
        data = self.getvalue()
        self.seek(0)
        self.truncate()
        self._before += len(data)
        return data


def register_channels(writer: McapWriter, *, foxglove: bool) -> dict[str, int]:
    """Topic (no slash) -> channel id: every record and, with `foxglove`, all that viewers draw."""
    channels = {}
    for topic in RECORDS:
        schema_id = writer.register_schema(schema_name(topic), "jsonschema", json_schema(topic))
        channels[topic] = writer.register_channel(f"/{topic}", "json", schema_id)
    if foxglove:
        schema_ids = {
            kind: writer.register_schema(well_known_name(kind), "jsonschema", schema_of(kind))
            for kind in dict.fromkeys(SHOWN.values())
        }
        for topic, kind in SHOWN.items():
            channels[topic] = writer.register_channel(f"/{topic}", "json", schema_ids[kind], DERIVED)
    return channels
