"""The schemas in the log are what viewers read, and true."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest

from guidance.records import Link, Status
from guidance.telemetry.schema import RECORDS, json_schema


def fields_of(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Every schema that a viewer looks at, from the top down."""
    yield schema
    for field in schema.get("properties", {}).values():
        yield from fields_of(field)
    if "items" in schema:
        yield from fields_of(schema["items"])


@pytest.mark.parametrize("topic", RECORDS)
def test_schemas_stay_within_what_viewers_read(topic: str) -> None:
    schema = msgspec.json.decode(json_schema(topic))
    assert schema["type"] == "object"
    for field in fields_of(schema):
        assert field["type"] in {"object", "array", "string", "number", "integer", "boolean"}
        assert not {"$ref", "anyOf", "oneOf", "prefixItems", "$defs"} & set(field)
        assert field["type"] != "array" or isinstance(field["items"], dict)
        assert field["type"] != "object" or isinstance(field["properties"], dict)
    for field in schema.get("patternProperties", {}).values():
        assert "$ref" not in str(field)


def test_a_field_that_may_be_null_is_still_described() -> None:
    status = msgspec.json.decode(json_schema("status"))
    assert status["patternProperties"]["^armed$"] == {"anyOf": [{"type": "boolean"}, {"type": "null"}]}
    assert "armed" in status["required"]
    triple = {"type": "array", "minItems": 3, "maxItems": 3, "items": {"type": "number"}}
    assert status["patternProperties"]["^origin_ned_m$"] == {"anyOf": [triple, {"type": "null"}]}
    described = set(status["properties"]) | {name[1:-1] for name in status["patternProperties"]}
    assert described == set(Status.__struct_fields__)
    link = msgspec.json.decode(json_schema("link"))
    assert link["properties"]["streams"]["items"]["patternProperties"].keys() == {"^age_s$"}
    assert set(link["required"]) == {field.name for field in msgspec.structs.fields(Link) if field.required}
