"""The last minutes over zenoh: what is kept of a flight, and how it is asked for and answered."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec
import pytest
import zenoh

from guidance.fleet import Fleet
from guidance.records import TOPICS, Event, Level, Link, Record, State, Status, TrackingError
from guidance.telemetry import Sample
from guidance.telemetry.arrivals import Answered, Arrival, History, Ignored
from guidance.telemetry.asking import ASK_NS, ORDERS_MAX, Orders
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_history import (
    EVENTS_MAX,
    KEPT_BYTES_MAX,
    KEPT_NS,
    REPLIES_PER_TURN,
    WAITING_MAX,
    HistoryQueries,
)
from guidance.telemetry.zenoh_history import History as Kept
from guidance.telemetry.zenoh_sink import ZenohSink, zenoh_config
from tests.fleet_rig import error, event, link, session, setpoint, state, status

S = 1_000_000_000
PATIENCE_S = 20.0
A = TypeVar("A", bound=Arrival)


@pytest.fixture(name="endpoint")
def a_free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def sample(record: Record) -> Sample:
    return Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record))


def flown(seconds: int, take: Callable[[Sample], object]) -> None:
    """What a service publishes, at its rates: 50 Hz of each stream, 5 Hz of the status, 2 Hz of the link."""
    for tick in range(seconds * 50):
        t_ns = 2 * S + tick * S // 50
        for record in (state(t_ns), error(t_ns, tick / 50), setpoint(t_ns, tick)):
            take(sample(record))
        if tick % 10 == 0:
            take(sample(status(t_ns)))
        if tick % 25 == 0:
            take(sample(link(t_ns)))


def topics_of(samples: list[Sample]) -> dict[str, int]:
    return {topic: sum(s.topic == topic for s in samples) for topic in {s.topic for s in samples}}


# What is kept ----------------------------------------------------------------------------------------


def test_streams_are_thinned_out_and_stay_together() -> None:
    history = Kept()
    flown(100, history.keep)
    kept = history.last(KEPT_NS * 1e-9)
    assert topics_of(kept) == {"state": 200, "error": 200, "setpoint": 200, "status": 100, "link": 50}
    instants = {topic: [s.t_ns for s in kept if s.topic == topic] for topic in ("state", "error", "setpoint")}
    assert instants["state"] == instants["error"] == instants["setpoint"]
    assert [s.t_ns for s in kept] == sorted(s.t_ns for s in kept)


def test_no_more_than_the_last_minutes_is_kept_but_of_events() -> None:
    history = Kept()
    for number in range(EVENTS_MAX + 5):
        history.keep(sample(event(number, f"event {number}")))
    flown(200, history.keep)
    history.keep(sample(session("abcd" * 8)))  # what does not change is asked for without a parameter
    kept = history.last(1e9)
    assert topics_of(kept)["event"] == EVENTS_MAX
    assert kept[0].t_ns == 5
    streams = kept[EVENTS_MAX:]
    assert len(streams) == len(history._streams)  # the older are gone
    assert streams[-1].t_ns - streams[0].t_ns == KEPT_NS
    assert sum(len(s.payload) for s in streams) < 0.6e6
    last = history.last(10.0)[EVENTS_MAX:]
    assert last[-1].t_ns - last[0].t_ns == 10 * S


def test_memory_has_a_limit_whatever_a_record_weighs() -> None:
    history = Kept()
    for number in range(300):
        history.keep(Sample("state", number * S, bytes(100_000)))
    kept = history.last(1e9)
    assert sum(len(s.payload) for s in kept) <= KEPT_BYTES_MAX
    assert kept[-1].t_ns == 299 * S
    history.keep(Sample("state", 300 * S, bytes(KEPT_BYTES_MAX + 1)))
    assert history.last(1e9) == []


# How it is answered ----------------------------------------------------------------------------------


def asked(station: zenoh.Session, selector: str) -> list[zenoh.Reply]:
    return list(station.get(selector, consolidation=zenoh.ConsolidationMode.NONE, timeout=PATIENCE_S))


def test_a_query_with_the_parameter_gets_the_history_and_any_other_the_newest(endpoint: str) -> None:
    sink = ZenohSink("uuv-1", listen=[endpoint], capacity=50_000, capacity_bytes=1 << 25)
    flown(60, sink.offer)
    sink.offer(sample(event(7, "engaged")))
    sink.start()
    with zenoh.open(zenoh_config(connect=[endpoint])) as station:
        while not any(reply.ok for reply in asked(station, "guidance/uuv-1/event")):
            continue

        def counted(selector: str) -> dict[str, int]:
            keys = [str(reply.ok.key_expr) for reply in asked(station, selector) if reply.ok]
            return {key: keys.count(f"guidance/uuv-1/{key}") for key in {k.split("/")[2] for k in keys}}

        newest = {"state": 1, "error": 1, "setpoint": 1, "status": 1, "link": 1, "event": 1}
        whole = {"state": 120, "error": 120, "setpoint": 120, "status": 60, "link": 30, "event": 1}
        assert counted("guidance/uuv-1/*") == newest
        assert counted("guidance/uuv-1/*?history=180") == whole
        assert counted("guidance/*/*?history=1e9") == whole
        assert counted("guidance/uuv-1/error?history=9.9") == {"error": 20}
        assert counted("guidance/uuv-1/*?else=1") == newest
        for bad in ("", "abc", "-1", "0", "nan", "\x1b[2J", "x" * 5000):
            (reply,) = asked(station, f"guidance/uuv-1/*?history={bad}")
            assert reply.err is not None
            said = reply.err.payload.to_string()
            assert "expected seconds, as in history=180" in said
            assert said.isprintable()
            assert len(said) < 100
    assert sink.problem == ""
    assert sink.close(PATIENCE_S)


class Query:
    """A query for everything with a parameter, and what it was answered with."""

    def __init__(self, history: str | None = "180") -> None:
        self.key_expr = zenoh.KeyExpr("guidance/uuv-1/*")
        self.parameters = {} if history is None else {"history": history}
        self.answers: list[Any] = []
        self.dropped = False

    def __enter__(self) -> Query:
        return self

    def __exit__(self, *_: object) -> None:
        self.dropped = True

    def reply(self, key: zenoh.KeyExpr, payload: bytes, encoding: zenoh.Encoding) -> None:
        assert not self.dropped
        self.answers.append((str(key), str(encoding)))

    def reply_err(self, payload: str) -> None:
        self.answers.append(payload)


def test_nothing_is_held_up_by_who_asks_for_histories() -> None:
    desk: Any = HistoryQueries("guidance/uuv-1/")
    flown(60, desk.history.keep)
    assert not desk.take(Query(None))
    queries = [Query() for _ in range(WAITING_MAX + 1)]
    assert all(desk.take(query) for query in queries)
    assert queries[-1].answers == ["8 wait for their history already: ask again"]
    assert queries[-1].dropped
    turns = 0
    while not queries[-2].dropped:
        before = sum(len(query.answers) for query in queries)
        desk.turn()
        turns += 1
        assert sum(len(query.answers) for query in queries) - before <= REPLIES_PER_TURN
    assert [len(query.answers) for query in queries[:-1]] == [450] * WAITING_MAX
    assert queries[0].answers[0] == ("guidance/uuv-1/state", "application/json;guidance.State/1")
    late = Query()
    desk.take(late)
    desk.turn()
    desk.forget()
    assert late.dropped
    desk.turn()


# What a subscriber asks ------------------------------------------------------------------------------


def arrived(subscriber: Subscriber, kind: type[A], left: list[Arrival] | None = None) -> A:
    """The next arrival of a kind; the others that came with it are `left` to be looked at."""
    end = time.monotonic() + PATIENCE_S
    left = [] if left is None else left
    while time.monotonic() < end:
        left += subscriber.take()
        for arrival in left:
            if isinstance(arrival, kind):
                left.remove(arrival)
                return arrival
        time.sleep(0.005)
    raise AssertionError(f"no {kind.__name__} came")


def test_who_comes_late_gets_the_last_minutes_at_once_and_in_order(endpoint: str) -> None:
    sink = ZenohSink("uuv-1", listen=[endpoint], capacity=50_000, capacity_bytes=1 << 25)
    flown(30, sink.offer)
    sink.offer(sample(event(7, "engaged")))
    sink.start()
    fleet = Fleet()
    with Subscriber(zenoh_config(connect=[endpoint])) as subscriber:
        with pytest.raises(ValueError, match="a name has 1 to 64"):
            subscriber.history("*")
        while fleet.newest("uuv-1", Event) is None:
            fleet.take(subscriber.take())
            time.sleep(0.005)
        noted = len(fleet.notes)
        for name in ("nobody", "uuv-1"):
            subscriber.history(name)
        left: list[Arrival] = []
        nobody = arrived(subscriber, History, left)
        assert (nobody.vehicle, nobody.records) == ("nobody", ())
        history = arrived(subscriber, History, left)
        assert history.vehicle == "uuv-1"
        kinds = (State, TrackingError, Status, Link, Event)
        counts = [sum(isinstance(r, kind) for r in history.records) for kind in kinds]
        assert counts == [60, 60, 30, 15, 1]
        assert [r.t_ns for r in history.records] == sorted(r.t_ns for r in history.records)
        assert history.records[0] == event(7, "engaged", Level.NOTICE)
        fleet.take([*left, history])
        assert len(fleet.notes) == noted  # it is no news
    assert sink.close(PATIENCE_S)


def test_garbage_in_a_history_is_named(endpoint: str) -> None:
    with (
        zenoh.open(zenoh_config(listen=[endpoint])) as stranger,
        Subscriber(zenoh_config(connect=[endpoint])) as subscriber,
    ):
        answering = stranger.declare_queryable("guidance/uuv-2/*", zenoh.handlers.FifoChannel(9))
        while not subscriber.neighbours:
            time.sleep(0.005)
        subscriber.history("uuv-2")
        with answering.recv() as query:
            assert str(query.parameters) == "history=180"
            query.reply("guidance/uuv-2/state", b"\xff", encoding="application/json;guidance.State/1")
            query.reply("guidance/uuv-2/state", b"{}", encoding="application/json;guidance.State/2")
        left: list[Arrival] = []
        assert arrived(subscriber, History, left).records == ()
        assert [arrival.what for arrival in left if isinstance(arrival, Ignored)] == [
            "garbage",
            "schema version 2",
        ]


def test_an_order_is_answered_and_one_to_nobody_is_told_so(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("guidance.telemetry.asking.ASK_NS", 300_000_000)
    sink = ZenohSink("uuv-1", listen=[endpoint])  # commands are off
    sink.start()
    with Subscriber(zenoh_config(connect=[endpoint])) as subscriber:
        with pytest.raises(ValueError, match="there is no order 'fly'"):
            subscriber.ask("uuv-1", "fly", {})
        while not subscriber.neighbours:
            time.sleep(0.005)
        given = subscriber.ask("uuv-1", "abort", {"id": "7"}, source="ada")
        answer = arrived(subscriber, Answered)
        assert (given, answer.id, answer.verb, answer.accepted) == ("7", "7", "abort", False)
        assert answer.reason.startswith("orders by zenoh are off")
        given = subscriber.ask("nobody", "abort", {})
        answer = arrived(subscriber, Answered)
        assert (answer.id, answer.vehicle, answer.accepted) == (given, "nobody", None)
        assert "no service of nobody answers" in answer.reason
    assert sink.close(PATIENCE_S)


class Air:
    """Stands in for a session: queries are kept, and answered by the test."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, bytes, Any]] = []

    def get(self, selector: str, handler: Any, *, payload: bytes, **_: object) -> None:
        self.asked.append((selector, payload, handler))


def test_an_order_is_asked_again_under_one_id_until_its_time_is_over() -> None:
    air: Any = Air()
    orders = Orders()
    given = orders.give("uuv-1", "engage", {}, "ada")
    answers: list[Answered] = []
    now_ns = 0
    while not answers:
        answers = orders.turn(air, now_ns, "")
        air.asked[-1][2].drop()  # nobody answers
        now_ns += 50_000_000
        assert now_ns < 2 * ASK_NS
    assert now_ns >= ASK_NS
    assert len(air.asked) > 10
    assert {payload for _, payload, _ in air.asked} == {air.asked[0][1]}
    assert msgspec.json.decode(air.asked[0][1]) == {"id": given, "source": "ada"}
    assert (answers[0].accepted, answers[0].id) == (None, given)


def test_no_order_waits_for_another_and_too_many_are_refused() -> None:
    air: Any = Air()
    orders = Orders()
    for number in range(ORDERS_MAX):
        orders.give(f"uuv-{number}", "abort", {})
    with pytest.raises(ValueError, match="32 orders wait"):
        orders.give("uuv-1", "abort", {})
    assert orders.turn(air, 0, "") == []
    assert len(air.asked) == ORDERS_MAX


def test_without_a_session_an_order_waits_for_one_and_then_says_why_not() -> None:
    air: Any = Air()
    orders = Orders()
    orders.give("uuv-1", "hold", {})
    assert orders.turn(None, 0, "no session: refused") == []
    orders.turn(air, S, "")
    orders.forget()  # it died, and with it the query
    orders.turn(air, 2 * S, "")
    assert len(air.asked) == 2
    orders.forget()
    (answer,) = orders.turn(None, 4 * S, "no session: refused")
    assert (answer.accepted, answer.reason) == (None, "no service of uuv-1 answers: no session: refused")


def test_both_at_once_come_to_one_subscriber_from_threads(endpoint: str) -> None:
    """Wishes are left by any thread while the subscriber's own empties them."""
    with Subscriber(zenoh_config(connect=[endpoint]), capacity=10) as subscriber:
        threads = [threading.Thread(target=subscriber.history, args=(f"uuv-{n}",)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        left: list[Arrival] = []
        seen = {arrived(subscriber, History, left).vehicle for _ in threads}
    assert seen == {f"uuv-{n}" for n in range(4)}
