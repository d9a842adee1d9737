"""JSON Schema of the records, in the form that log viewers understand.

Foxglove and its descendants read a subset of JSON Schema: no `$ref`, no `anyOf`, arrays with one `items`
schema, and `properties` on every object. The schemas here stay inside that subset and are still true for a
validator:

- references are replaced by what they refer to;
- a tuple of n equal items is an array with `items` and a fixed length, not `prefixItems`;
- an enumeration is a string;
- a field that may be null stands under `patternProperties`: a validator applies it, a viewer passes over it
  and shows the value as it finds it.
"""

from __future__ import annotations

import re
from typing import Any, Final

import msgspec

from guidance.records import SCHEMA_VERSION, TOPICS, Record

Schema = dict[str, Any]

#: The record of each topic, the inverse of `TOPICS`.
RECORDS: Final[dict[str, type[Record]]] = {topic: record for record, topic in TOPICS.items()}


def schema_name(topic: str) -> str:
    """Name of the schema of `topic`, `guidance.<RecordName>`; KeyError for a topic that does not exist."""
    return f"guidance.{RECORDS[topic].__name__}"


def encoding_schema(topic: str) -> str:
    """What follows `application/json;` in a zenoh encoding: `guidance.<RecordName>/<SCHEMA_VERSION>`."""
    return f"{schema_name(topic)}/{SCHEMA_VERSION}"


def json_schema(topic: str) -> bytes:
    """Self-contained JSON Schema of the record of `topic`; KeyError for a topic that does not exist."""
    return schema_of(RECORDS[topic])


def well_known_name(kind: type[msgspec.Struct]) -> str:
    """Name of the schema of a class of `telemetry.foxglove`: `foxglove.<Class>`, exactly."""
    return f"foxglove.{kind.__name__}"


def schema_of(kind: type[msgspec.Struct]) -> bytes:
    """Self-contained JSON Schema of a Struct."""
    generated = msgspec.json.schema(kind)
    return msgspec.json.encode(_inline(generated, generated.get("$defs", {})))


def _inline(schema: Schema, definitions: dict[str, Schema]) -> Schema:
    if "$ref" in schema:
        return _inline(definitions[schema["$ref"].rpartition("/")[2]], definitions)
    plain = {key: value for key, value in schema.items() if key not in ("$defs", "default")}
    if "enum" in plain:
        plain["type"] = "string"
    if "anyOf" in plain:
        plain["anyOf"] = [_inline(choice, definitions) for choice in plain["anyOf"]]
    if "prefixItems" in plain:
        # Every tuple of the records is one of equal items; anything else has no form a viewer reads.
        first, *others = plain.pop("prefixItems")
        if any(other != first for other in others):
            raise TypeError(f"a tuple of unequal items has no schema that viewers understand: {schema}")
        plain["items"] = first
    if isinstance(plain.get("items"), dict):
        plain["items"] = _inline(plain["items"], definitions)
    if plain.get("type") == "object":
        fields = {name: _inline(field, definitions) for name, field in plain.get("properties", {}).items()}
        plain["properties"] = {name: field for name, field in fields.items() if "anyOf" not in field}
        nullable = {f"^{re.escape(name)}$": field for name, field in fields.items() if "anyOf" in field}
        if nullable:
            plain["patternProperties"] = nullable
    return plain
