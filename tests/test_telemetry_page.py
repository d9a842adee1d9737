"""docs/telemetry.md is what the types say now, and what it tells a stranger to run works."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import msgspec
import pytest
import zenoh

from guidance.records import LOG_ONLY, RATES, TOPICS, Level, Record, Setpoint
from guidance.reporting import PERIODS_NS
from guidance.supervisor import State
from guidance.telemetry.schema import RECORDS
from guidance.telemetry.zenoh_sink import ZenohSink
from tests.helpers import make_flight
from tests.service_rig import PATIENCE_S
from tests.telemetry_page import PAGE, SUBSCRIBER, field_table, frame, rewritten, unit
from tests.test_service_process import flight
from tests.test_zenoh import STATUS, a_free_endpoint, sample

__all__ = ["a_free_endpoint"]  # a fixture

TEXT = PAGE.read_text(encoding="utf-8")


def test_the_page_is_current() -> None:
    assert rewritten(TEXT) == TEXT, "write it anew: python -m tests.telemetry_page"


def test_a_page_without_a_part_is_refused() -> None:
    with pytest.raises(AssertionError, match="has no <!-- orders -->"):
        rewritten(TEXT.replace("<!-- orders -->", ""))


def test_every_record_and_field_is_told() -> None:
    for topic, record in RECORDS.items():
        section = TEXT.partition(f"\n### {topic}\n")[2].partition("\n### ")[0]
        assert section.lstrip().startswith(f"{record.__name__}: ")
        for name in record.__struct_fields__:
            assert name == "t_ns" or f"\n| `{name}` | " in section, f"{topic}.{name}"
        assert (f"`guidance/<vehicle>/{topic}`" in TEXT) is (topic not in LOG_ONLY)


def test_every_number_has_a_unit_and_every_state_is_named() -> None:
    kind = r"(?:\d )?(?:object: name to |list: )?(?:integer|number)s?(?: or null)?"
    numbers = re.findall(rf"(?m)^\| `(\w+)` \| {kind} \| ([^|]*)\|", TEXT)
    assert len(numbers) > 90
    assert {name for name, unit in numbers if not unit.strip()} == {"schema_version"}
    status = TEXT.partition("\n### status\n")[2].partition("\n### ")[0]
    said = status.partition("`state` is one of ")[2].partition("(")[0]
    assert re.findall(r"`([a-z-]+)`", said) == [str(state) for state in State]


class Sample(Record, frozen=True, kw_only=True, omit_defaults=True):
    """Of each kind a field."""

    speed_ned_m_s: tuple[float, float, float] = (0.0, 0.0, 1.0)
    level: Level | None
    counts: dict[str, int]
    raw: bytes = b""


def test_types_units_frames_and_what_is_left_out_are_read_from_the_type() -> None:
    assert field_table(Sample, skipped=("t_ns",))[2:] == [
        "| `speed_ned_m_s` | 3 numbers | m/s | world, north east down | [0.0, 0.0, 1.0] |",
        "| `level` | text: info, notice, warning, error, critical or null |  |  |  |",
        "| `counts` | object: name to integer |  |  |  |",
        '| `raw` | bytes, as base64 text |  |  | "" |',
    ]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("norm_m", "m"),
        ("speed_m_s", "m/s"),
        ("acceleration_ned_m_s2", "m/s^2"),
        ("age_s", "s"),
        ("since_ns", "ns"),
        ("body_rates_frd_rad_s", "rad/s"),
        ("slip_rad", "rad"),
        ("drag_per_s", "1/s"),
        ("sent_bytes_per_s", "bytes/s"),
        ("rate_hz", "Hz"),
        ("resets", "count"),
        ("v1", "m^2/s"),
        ("thrust", "1"),
        ("streams", ""),
    ],
)
def test_a_unit_is_the_end_of_a_name(name: str, words: str) -> None:
    assert unit(name) == words


def test_a_frame_is_a_part_of_a_name() -> None:
    assert frame("field_body").startswith("body")
    assert frame("body_rates_frd_rad_s").startswith("body")
    assert frame("attitude_wxyz").startswith("rotation")
    assert frame("everybody_m") == frame("reason") == ""


def test_rates_are_those_of_a_flight() -> None:
    """Whatever has a rate in Hz comes so often, and the handling's records only of their vehicles."""
    assert RATES.keys() == TOPICS.keys()
    lockstep = make_flight()
    told = {TOPICS[record]: re.findall(r"(\d+) Hz", words) for record, words in RATES.items()}
    asked_for = told.pop(TOPICS[Setpoint])
    assert [float(hz) for hz in asked_for] == [lockstep.guide.config.link.rate_hz]
    assert {topic: float(hz) for topic, rates in told.items() for hz in rates} == {
        name: 1e9 / period_ns for name, period_ns in PERIODS_NS.items()
    }
    seen: Counter[str] = Counter()
    lockstep.run(10.0, until=lambda: lockstep.guide.tracker.start_ns is not None)
    lockstep.on_record = lambda record: seen.update([TOPICS[type(record)]])
    lockstep.run(10.0)
    assert (seen["link"], seen["timing"]) == (20, 10)
    assert seen["status"] >= 50
    assert seen["setpoint"] == seen["state"] == seen["reference"] == seen["error"] > 450
    assert seen.keys().isdisjoint({"ground", "airplane", "copter", "stepping", "lost"})


def test_the_subscriber_is_ten_lines_that_know_nothing_of_us() -> None:
    code = SUBSCRIBER.read_text(encoding="utf-8")
    assert len([line for line in code.splitlines() if line]) <= 10
    assert "import guidance" not in code
    assert f"```python\n{code}```" in TEXT


def test_the_subscriber_sees_a_flight(endpoint: str, tmp_path: Path) -> None:
    async def run() -> list[str]:
        async with flight(tmp_path, f'zenoh.listen=["{endpoint}"]') as (service, _):
            await service.says("tracking: ")
            stranger = await asyncio.create_subprocess_exec(
                sys.executable, str(SUBSCRIBER), endpoint, stdout=subprocess.PIPE, cwd=tmp_path
            )
            assert stranger.stdout is not None
            try:
                return [
                    (await asyncio.wait_for(stranger.stdout.readline(), PATIENCE_S)).decode() for _ in "123"
                ]
            finally:
                stranger.kill()
                await stranger.wait()

    for line in asyncio.run(run()):
        assert line.startswith("guidance/demo/status tracking"), line


def test_what_a_router_s_rest_asks_is_answered_as_the_page_says(endpoint: str) -> None:
    """A query as the plugin makes it, which shows as JSON what names no schema."""
    sink = ZenohSink("uuv-1", listen=[endpoint])
    sink.offer(sample(STATUS))
    sink.start()
    config = zenoh.Config()
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as plugin:
        try:

            def get(selector: str, payload: bytes | None = None) -> zenoh.Sample:
                while True:
                    for reply in plugin.get(
                        selector, payload=payload, consolidation=zenoh.ConsolidationMode.LATEST, timeout=1.0
                    ):
                        assert reply.ok is not None
                        return reply.ok

            newest = get("guidance/uuv-1/status?_raw=true")
            assert json.loads(newest.payload.to_bytes()) == msgspec.to_builtins(STATUS)
            assert newest.encoding != zenoh.Encoding.APPLICATION_JSON
            assert get("guidance/*/status").payload.to_bytes() == newest.payload.to_bytes()
            answer = get("guidance/uuv-1/command/hold", b'{"id": "1", "source": "me"}')
            assert answer.encoding == zenoh.Encoding.APPLICATION_JSON
            assert "zenoh.commands = false" in json.loads(answer.payload.to_bytes())["reason"]
        finally:
            assert sink.close(PATIENCE_S)
