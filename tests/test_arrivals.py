"""What comes over zenoh is named for what it is, by its key, its encoding and its payload."""

from __future__ import annotations

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.records import LOG_ONLY, SCHEMA_VERSION, TOPICS, Record
from guidance.telemetry.arrivals import LARGEST_BYTES, Heard, Ignored, read, vehicle_of
from guidance.telemetry.schema import encoding_schema
from tests.fleet_rig import event, link, session, state, status

STATUS = msgspec.json.encode(status(1))
OURS = "application/json;guidance.Status/1"


@pytest.mark.parametrize("record", [status(1), event(1, "x"), link(1), session("aa"), state(1)])
def test_what_the_sink_publishes_is_read_back(record: Record) -> None:
    topic = TOPICS[type(record)]
    encoding = f"application/json;{encoding_schema(topic)}"
    heard = read(5, f"guidance/uuv-1/{topic}", encoding, msgspec.json.encode(record), answered=True)
    assert heard == Heard(5, "uuv-1", topic, record, True)


def test_a_new_field_of_this_version_is_passed_over() -> None:
    payload = STATUS[:-1] + b',"new":1}'
    assert read(0, "guidance/v/status", OURS, payload) == Heard(0, "v", "status", status(1))


@pytest.mark.parametrize(
    ("key", "encoding", "payload", "what", "detail", "version"),
    [
        (
            "v/status",
            "application/json;guidance.Status/2",
            STATUS,
            "schema version 2",
            "status: guidance.Status",
            2,
        ),
        ("v/new", "application/json;guidance.New/7", b"", "schema version 7", "new: guidance.New", 7),
        ("v/status", "zenoh/bytes", STATUS, "no schema of ours", "status: zenoh/bytes", None),
        ("v/status", "application/json", STATUS, "no schema of ours", "status: application/json", None),
        ("v/status", "application/cbor;guidance.Status/1", STATUS, "no schema of ours", "cbor", None),
        ("v/status", "application/json;std_msgs.String/1", STATUS, "no schema of ours", "std_msgs", None),
        ("v/error", OURS, STATUS, "foreign key", "guidance.Status under error", None),
        ("v/new", "application/json;guidance.New/1", b"", "foreign key", "guidance.New under new", None),
        ("v/input", "application/json;guidance.Input/1", b"", "foreign key", "guidance.Input", None),
        ("v/status", OURS, b"", "garbage", "status: ", None),
        ("v/status", OURS, b"{}", "garbage", "missing required field", None),
        ("v/status", OURS, b'{"t_ns":"\xff"}', "garbage", "status: ", None),
        ("v/status", OURS, b'{"new":' + b"[" * 5000, "garbage", "recursion", None),
        ("v/status", OURS, b" " * (LARGEST_BYTES + 1), "garbage", "bytes", None),
        ("\x1b[2J/status", OURS, STATUS, "no name of a vehicle", "", None),
        ("x" * 65 + "/status", OURS, STATUS, "no name of a vehicle", "", None),
    ],
)
def test_what_is_no_record_is_named(
    key: str, encoding: str, payload: bytes, what: str, detail: str, version: int | None
) -> None:
    found = read(0, f"guidance/{key}", encoding, payload)
    assert isinstance(found, Ignored)
    assert (found.vehicle, found.what, found.version) == (key.partition("/")[0], what, version)
    assert detail in found.detail


def test_this_test_knows_the_version_and_the_raw_topics() -> None:
    assert SCHEMA_VERSION == 1
    assert "input" in LOG_ONLY
    assert vehicle_of("guidance/uuv-1/alive") == "uuv-1"


@given(st.text(min_size=1).filter(lambda t: "/" not in t), st.text(), st.binary())
def test_nothing_raises(topic: str, encoding: str, payload: bytes) -> None:
    for claim in (encoding, OURS, f"application/json;guidance.{encoding}/1"):
        read(0, f"guidance/v/{topic}", claim, payload)
        read(0, "guidance/v/status", claim, payload)
