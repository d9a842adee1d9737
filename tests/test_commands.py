"""Orders as JSON: what is one, what is not and why; no bytes whatever raise anything else."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.commands import (
    PAYLOAD_BYTES_MAX,
    VERBS,
    Abort,
    Allocate,
    Engage,
    Hold,
    LoadTrajectory,
    Order,
    OrderError,
    Resume,
    Set,
    Shutdown,
    read,
    read_payload,
    text_of,
    verb_of,
)

EACH: tuple[Order, ...] = (
    Engage(id="1", source="zenoh ada"),
    Hold(),
    Resume(),
    Abort(source="mavlink 255/190"),
    Shutdown(),
    Allocate(allocation="roll-yaw"),
    LoadTrajectory(trajectory={"name": "circle", "radius_m": 5, "clockwise": False}),
    Set(key="law.k", value=0.5),
    Set(key="limits.acceleration_max_m_s2", value=None),
)


@pytest.mark.parametrize("order", EACH, ids=verb_of)
def test_an_order_survives_its_text(order: Order) -> None:
    assert read(text_of(order)) == order
    fields = json.loads(text_of(order))
    assert read_payload(fields.pop("order"), json.dumps(fields).encode()) == order


def test_every_verb_is_there() -> None:
    assert {verb_of(order) for order in EACH} == set(VERBS)


def test_an_empty_payload_has_no_fields() -> None:
    assert read_payload("engage", b"") == Engage()


@pytest.mark.parametrize(
    ("verb", "payload", "why"),
    [
        ("take-off", b"", "there is no order 'take-off'; there are engage, hold, resume"),
        ("engage", b"now", "the payload must be a JSON object"),
        ("engage", b"[]", "the payload must be a JSON object"),
        ("engage", b'{"order": "abort"}', "the payload must not name the order; the key does"),
        ("engage", b'{"height_m": 3}', "height_m"),
        ("engage", b'{"id": 7}', "id"),
        ("engage", b'{"id": "' + b"x" * 101 + b'"}', "<= 100"),
        ("engage", b" " * (PAYLOAD_BYTES_MAX + 1), "4097 bytes: an order has at most 4096"),
        ("set", b'{"key": "law.k"}', "value"),
        ("set", b'{"key": "law.k", "value": [1]}', "value"),
        ("set", b'{"key": "law.k", "value": 1e999}', ""),
        ("load", b"{}", "trajectory"),
        ("load", b'{"trajectory": {"name": {}}}', "trajectory"),
        ("allocate", b'{"allocation": "yaw"}', "yaw"),
    ],
)
def test_what_is_no_order_is_refused_with_the_reason(verb: str, payload: bytes, why: str) -> None:
    with pytest.raises(OrderError) as refused:
        read_payload(verb, payload)
    assert why in str(refused.value)


@given(st.sampled_from([*VERBS, "", "x", "../engage"]), st.binary(max_size=200))
def test_no_bytes_raise_anything_else(verb: str, payload: bytes) -> None:
    try:
        order = read_payload(verb, payload)
    except OrderError:
        return
    assert read(text_of(order)) == order


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=8,
)
FIELDS = st.dictionaries(
    st.sampled_from(["id", "source", "key", "value", "trajectory", "allocation", "order", "x"]), JSON
)


@given(st.sampled_from(list(VERBS)), FIELDS)
def test_no_json_raises_anything_else(verb: str, fields: dict[str, Any]) -> None:
    try:
        order = read_payload(verb, json.dumps(fields).encode())
    except OrderError:
        return
    assert verb_of(order) == verb


@given(st.text(max_size=100))
def test_no_text_raises_anything_else(text: str) -> None:
    with pytest.raises(OrderError):
        read(text)
