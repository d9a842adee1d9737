"""The log holds what was offered, in order, under names, times and schemas that others can read."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from guidance.records import SCHEMA_VERSION, TOPICS
from guidance.telemetry import Sample
from guidance.telemetry.foxglove_view import SHOWN
from guidance.telemetry.log import read_log, read_metadata
from guidance.telemetry.log_keeper import log_name
from guidance.telemetry.schema import RECORDS
from tests.recorder_rig import OFFSET_NS, as_messages, record_all, sample


def test_what_was_offered_is_read_back_in_order_and_byte_for_byte(tmp_path: Path) -> None:
    topics = itertools.cycle(RECORDS)
    # Instants go back and forth on purpose: the order of a log is that of the offers.
    samples = [sample(number ^ 5, topic) for number, topic in zip(range(3000), topics, strict=False)]
    path = record_all(tmp_path, samples, chunk_bytes=4096)
    assert list(read_log(path)) == as_messages(samples)


@settings(max_examples=25)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([*RECORDS, "stranger"]), st.integers(-(2**62), 2**62), st.binary(max_size=300)
        )
    ),
    st.integers(1, 2000),
)
def test_any_payload_at_any_instant_survives(
    tmp_path_factory: pytest.TempPathFactory, items: list[tuple[str, int, bytes]], chunk_bytes: int
) -> None:
    samples = list(itertools.starmap(Sample, items))
    path = record_all(tmp_path_factory.mktemp("log"), samples, chunk_bytes=chunk_bytes)
    assert list(read_log(path)) == as_messages(samples)


def test_the_library_reads_the_log_with_its_schemas_times_and_metadata(tmp_path: Path) -> None:
    samples = [sample(number, "setpoint") for number in range(100)]
    path = record_all(tmp_path, samples, chunk_bytes=1000)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        found = list(reader.iter_messages(log_time_order=False))
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 100
    assert {channel.topic for channel in summary.channels.values()} == {
        f"/{topic}" for topic in [*TOPICS.values(), *SHOWN]
    }
    assert {channel.message_encoding for channel in summary.channels.values()} == {"json"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"jsonschema"}
    names = {f"guidance.{r.__name__}" for r in TOPICS} | {f"foxglove.{k.__name__}" for k in SHOWN.values()}
    assert {schema.name for schema in summary.schemas.values()} == names
    for item, (schema, channel, message) in zip(samples, found, strict=True):
        assert schema is not None
        assert (schema.name, channel.topic, message.data) == ("guidance.Setpoint", "/setpoint", item.payload)
        assert message.log_time == message.publish_time == item.t_ns + OFFSET_NS
    assert read_metadata(path) == {
        "session_id": "0123456789abcdef",
        "schema_version": str(SCHEMA_VERSION),
        "vehicle": "rover1",
        "unix_offset_ns": str(OFFSET_NS),
        "part": "1",
    }


def test_the_file_name_sorts_by_run_and_never_leaves_the_directory() -> None:
    earlier = log_name(9, "b", "0123456789", 1_700_000_000_000_000_000)
    assert earlier == "00009_20231114T221320Z_b_01234567.mcap"
    assert earlier < log_name(9, "b", "0123456789", 1_700_000_000_000_000_000, 2)
    assert earlier < log_name(10, "a", "0", 0)
    assert "/" not in log_name(1, "../x", "/etc/passwd", 0)
