"""Orders over zenoh: a real session against the real sink and shell, and the waiting desk by itself."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import msgspec
import pytest
import zenoh
from msgspec.structs import replace
from typer.testing import CliRunner

from guidance import ordering
from guidance.cli import app
from guidance.commands import PAYLOAD_BYTES_MAX, Engage, Order
from guidance.ordering import NoAnswerError, ask
from guidance.records import Answer
from guidance.shell import Shell
from guidance.telemetry import zenoh_orders
from guidance.telemetry.arrivals import Answered
from guidance.telemetry.asking import Orders
from guidance.telemetry.zenoh_orders import (
    ANSWER_NS,
    HELD_UP_NS,
    OBEY_NS,
    SETTLED_NS,
    WAITING_MAX,
    OrderQueries,
    Reply,
)
from guidance.telemetry.zenoh_sink import ZenohSink, zenoh_config
from tests.service_rig import PATIENCE_S, running

S = 1_000_000_000


@pytest.fixture(name="endpoint")
def a_free_endpoint() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


# End to end ------------------------------------------------------------------------------------------


def get(session: zenoh.Session, key: str, payload: bytes = b"") -> list[dict[str, Any]]:
    """The answers to one query."""
    return [
        json.loads(reply.ok.payload.to_bytes())
        for reply in session.get(key, payload=payload, timeout=PATIENCE_S)
        if reply.ok is not None
    ]


def test_orders_by_a_real_session_are_answered_by_the_control_loop(endpoint: str) -> None:
    def station() -> None:
        """Blocking calls, in a thread of its own."""

        def order(verb: str, **fields: Any) -> Reply:
            return ask("demo", verb, fields, connect=[endpoint], seconds=PATIENCE_S)

        refused = order("engage")
        assert not refused.accepted
        assert refused.reason.startswith("disconnected: ")
        tuned = order("set", id="7", source="ada", key="law.k", value=0.5)
        assert tuned == Reply(accepted=True, reason="law.k: 1.0 -> 0.5", id="7")
        again = order("set", id="7", source="ada", key="law.k", value=0.5)
        assert again == Reply(accepted=True, reason="law.k: 1.0 -> 0.5", id="7", repeated=True)
        with zenoh.open(zenoh_config(connect=[endpoint])) as session:
            while not (answers := get(session, "guidance/demo/command/engage", b"now")):
                continue
            (malformed,) = answers
            assert not malformed["accepted"]
            assert malformed["reason"].startswith("the payload must be a JSON object")
            assert "there is no order 'fly'" in get(session, "guidance/demo/command/fly")[0]["reason"]
            # Nobody is ordered by a pattern.
            assert get(session, "guidance/*/command/engage") == []
            assert "name one order" in get(session, "guidance/demo/command/*")[0]["reason"]
            assert get(session, "guidance/demo/answers")[0]["id"] == "7"

    async def serve() -> None:
        sink = ZenohSink("demo", listen=[endpoint], commands=True)
        async with running(others={"zenoh": sink}) as rig:
            sink.orders_to(rig.shell.hand_over)
            sink.start()
            await asyncio.get_running_loop().run_in_executor(None, station)
            answers = [r for r in rig.memory.records if isinstance(r, Answer)]
            assert [(a.order, a.accepted, a.repeated) for a in answers] == [
                ("engage", False, False),
                ("set", True, False),
                ("set", True, True),
            ]
            assert {a.source.split()[0] for a in answers} == {"zenoh"}
            sink.close(PATIENCE_S)

    asyncio.run(serve())


@pytest.mark.parametrize(
    ("ends", "why"), [(False, "the control loop did not answer within 0.1 s"), (True, "the service ends")]
)
def test_a_loop_that_does_not_answer_leaves_nobody_waiting(
    endpoint: str, ends: bool, why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not ends:
        monkeypatch.setattr(zenoh_orders, "ANSWER_NS", 100_000_000)
    handed = threading.Event()
    sink = ZenohSink("demo", listen=[endpoint], commands=True)
    sink.orders_to(lambda order, until_ns: handed.set())
    sink.start()
    with ThreadPoolExecutor() as pool:
        reply = pool.submit(ask, "demo", "hold", {}, connect=[endpoint], seconds=PATIENCE_S)
        assert handed.wait(PATIENCE_S)
        if ends:
            assert sink.close(PATIENCE_S)
        assert reply.result(PATIENCE_S).reason.startswith(why)
    assert sink.close(PATIENCE_S)


def test_the_command_line_orders_and_says_what_became_of_it(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Against a service that takes no orders: an answer too, status 1. Where nobody is: status 2."""
    handed: list[Order] = []
    sink = ZenohSink("uuv-1", listen=[endpoint])
    sink.orders_to(lambda order, until_ns: handed.append(order))
    sink.start()
    try:
        where = ["--connect", endpoint, "--seconds", "20"]
        outcome = CliRunner().invoke(app, ["command", "uuv-1", "engage", "--json", *where])
        assert outcome.exit_code == 1, outcome.output
        reply = json.loads(outcome.stdout)
        assert reply["accepted"] is False
        assert reply["reason"].startswith("orders by zenoh are off (zenoh.commands = false")
        assert handed == []
        nobody = CliRunner().invoke(
            app, ["command", "uuv-2", "hold", "--connect", endpoint, "--seconds", "0.1"]
        )
        assert nobody.exit_code == 1
        assert f"no service of uuv-2 answers at {endpoint}" in nobody.stderr
    finally:
        assert sink.close(PATIENCE_S)

    monkeypatch.setattr(ordering, "ask", lambda *args, **kwargs: Reply(accepted=True, reason="so already"))
    accepted = CliRunner().invoke(app, ["command", "uuv-1", "resume"])
    assert (accepted.exit_code, accepted.stdout) == (0, "resume accepted: so already\n")


# The desk, with a clock of its own -------------------------------------------------------------------


class _Query:
    """As much of a query as the desk asks for."""

    def __init__(self, verb: str, payload: bytes = b"") -> None:
        self.key_expr = f"guidance/uuv-1/command/{verb}"
        self.payload = self
        self._payload = payload
        self.replies: list[Reply] = []
        self.parameters: dict[str, str] = {}
        self.dropped = False

    def __len__(self) -> int:
        return len(self._payload)

    def to_bytes(self) -> bytes:
        assert len(self) <= PAYLOAD_BYTES_MAX
        return self._payload

    def reply(self, key: str, payload: bytes, *, encoding: object) -> None:
        assert key == self.key_expr
        self.replies.append(msgspec.json.decode(payload, type=Reply))

    def __enter__(self) -> _Query:
        return self

    def __exit__(self, *_: object) -> None:
        self.dropped = True


class _Desk:
    def __init__(self) -> None:
        self.now_ns = 5 * S
        self.handed: list[tuple[Order, int]] = []
        self.it = OrderQueries("guidance/uuv-1/command/", enabled=True, clock_ns=lambda: self.now_ns)
        self.it.hand_over = lambda order, until_ns: self.handed.append((order, until_ns))

    def ask(self, verb: str = "engage", payload: bytes = b"", **parameters: str) -> Any:
        query: Any = _Query(verb, payload)
        query.parameters = parameters
        assert self.it.take(query)
        return query

    def answer(self, number: int = -1, **changed: Any) -> None:
        order = self.handed[number][0]
        answer = Answer(t_ns=1, order="engage", id=order.id, source=order.source, accepted=True, reason="")
        self.it.answered(msgspec.json.encode(replace(answer, **changed)))


@pytest.fixture
def desk() -> _Desk:
    return _Desk()


def test_an_order_is_handed_over_and_answered_when_its_answer_comes(desk: _Desk) -> None:
    query = desk.ask(payload=b'{"source": "ada\\u0007", "id": "1"}')
    ((order, until_ns),) = desk.handed
    assert (order.id, until_ns) == ("1", desk.now_ns + OBEY_NS)
    assert order.source.startswith("zenoh ada")
    assert "\a" not in order.source
    assert query.replies == []
    desk.answer(source="mavlink 255/190")  # of somebody else, with the same id
    assert query.replies == []
    desk.answer(reason="already tracking")
    assert query.replies == [Reply(accepted=True, reason="already tracking", id="1")]
    assert query.dropped
    desk.answer()  # a second answer has nobody to go to
    assert len(query.replies) == 1


def test_orders_without_an_id_get_one_each(desk: _Desk) -> None:
    first, second = desk.ask(), desk.ask()
    assert desk.handed[0][0].id != desk.handed[1][0].id
    desk.answer(1)
    assert (first.replies, len(second.replies)) == ([], 1)


def test_what_is_not_answered_in_time_is_answered_with_that(desk: _Desk) -> None:
    query = desk.ask()
    desk.now_ns += ANSWER_NS - 1
    desk.it.expire()
    assert query.replies == []
    desk.now_ns += 1
    desk.it.expire()
    (reply,) = query.replies
    assert reply.reason == "the control loop did not answer within 2 s; look at its events"
    assert OBEY_NS < ANSWER_NS


def test_no_more_wait_than_may(desk: _Desk) -> None:
    for _ in range(WAITING_MAX):
        desk.ask()
    assert desk.ask().replies[0].reason == "32 orders wait already"
    assert len(desk.handed) == WAITING_MAX


def test_a_payload_that_is_no_line_is_not_even_copied(desk: _Desk) -> None:
    query = desk.ask(payload=bytes(PAYLOAD_BYTES_MAX + 1))
    assert query.replies[0].reason == "4097 bytes: an order has at most 4096"


def test_what_may_have_waited_while_all_stood_still_takes_no_control(desk: _Desk) -> None:
    """Who asked was told that nobody answers, and does not expect that it engages now."""
    desk.it.come_round()
    desk.now_ns += HELD_UP_NS - 1
    desk.it.come_round()
    assert desk.ask("engage").replies == []
    desk.now_ns += HELD_UP_NS
    desk.it.come_round()
    for verb in ("engage", "resume", "shutdown"):
        assert desk.ask(verb).replies[0].reason.startswith("the service was held up")
    assert [desk.ask(verb).replies for verb in ("hold", "abort")] == [[], []]
    desk.now_ns += SETTLED_NS
    desk.it.come_round()
    assert desk.ask("engage").replies == []
    desk.now_ns += 100 * S
    desk.it.opened()  # there was no session meanwhile
    desk.it.come_round()
    assert desk.ask("engage").replies == []


def test_what_was_ordered_before_the_service_began_takes_no_control(desk: _Desk) -> None:
    """A service that died before it answered may have obeyed, and its memory of ids is gone."""
    desk.now_ns += 2 * S
    for verb in ("engage", "resume", "shutdown"):
        query = desk.ask(verb, age="2.1")
        assert query.replies[0].reason.startswith("it was ordered before this service began")
    assert [desk.ask(verb, age="2.1").replies for verb in ("hold", "abort")] == [[], []]
    for age in ("1.9", "0", "", "soon", "nan", "-1e999"):
        assert desk.ask("engage", age=age).replies == []
    assert desk.ask("engage", age="1" * 5000).replies != []
    desk.now_ns += S
    assert desk.ask("engage", age="2.1").replies == []


def test_an_order_that_is_asked_again_says_for_how_long(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By `guidance command` and by the dashboard alike."""
    came: list[tuple[float, str]] = []
    with (
        zenoh.open(zenoh_config(listen=[endpoint])) as service,
        zenoh.open(zenoh_config(connect=[endpoint])) as session,
    ):
        key = "guidance/uuv-1/command/engage"

        def take(query: zenoh.Query) -> None:
            with query:
                assert query.payload is not None
                came.append((float(query.parameters.get("age") or "nan"), query.payload.to_bytes().decode()))

        service.declare_queryable(key, take)
        with pytest.raises(NoAnswerError):
            ask("uuv-1", "engage", {}, connect=[endpoint], seconds=0.5)
        by_command, came[:] = list(came), []
        orders, now_ns = Orders(), 7 * S
        orders.give("uuv-1", "engage", {}, "test")
        answers: list[Answered] = []
        while not answers:
            answers = orders.turn(session, now_ns, "")
            now_ns += 100_000_000
            time.sleep(0.01)
    for asked in (by_command, came):
        ages = [age for age, _ in asked]
        assert len(ages) > 2
        assert 0.0 <= ages[0] < 0.1
        assert ages == sorted(set(ages))
        assert len({payload for _, payload in asked}) == 1  # one id


def test_the_sink_notices_that_it_was_held_up(endpoint: str) -> None:
    now_ns = 0
    waits: list[Any] = []

    class Ring:
        def try_recv(self) -> Any:
            return waits.pop() if waits else None

    sink = ZenohSink("uuv-1", listen=[endpoint], commands=True, clock_ns=lambda: now_ns)
    handed: list[Order] = []
    sink.orders_to(lambda order, until_ns: handed.append(order))
    now_ns = 5 * S
    assert sink._ready()  # opened after 5 s, which held nobody up
    ring: Any = Ring()
    sink._queryable = ring
    waits.append(_Query("engage"))
    sink._turn()
    assert len(handed) == 1
    now_ns += 5 * S
    late: Any = _Query("engage")
    waits.append(late)
    sink._turn()
    assert late.replies[0].reason.startswith("the service was held up")
    assert len(handed) == 1
    assert sink._finish()


def test_a_session_that_dies_at_the_end_is_no_internal_error(endpoint: str) -> None:
    opened: list[Any] = []

    def opening(config: zenoh.Config) -> zenoh.Session:
        opened.append(zenoh.open(config))
        session: zenoh.Session = opened[-1]
        return session

    sink = ZenohSink("demo", listen=[endpoint], open_session=opening)
    assert sink._ready()
    opened[0].close()
    assert sink._finish()


def test_who_waits_at_the_end_is_told(desk: _Desk) -> None:
    query = desk.ask()
    desk.it.finish()
    assert query.replies[0].reason == "the service ends"


def test_what_is_no_order_is_left_to_others(desk: _Desk) -> None:
    query: Any = _Query("engage")
    query.key_expr = "guidance/uuv-1/**"
    assert not desk.it.take(query)


def test_an_order_that_the_loop_gets_too_late_is_not_obeyed() -> None:
    async def late() -> None:
        async with running() as rig:
            rig.shell.hand_over(Engage(id="1", source="zenoh ada"), 0)
            await rig.bell.until(lambda: rig.memory.events("note"), "a note")
            assert rig.memory.events("note") == ["engage of zenoh ada came too late and is not obeyed"]
            assert not any(isinstance(r, Answer) for r in rig.memory.records)
        shells.append(rig.shell)

    shells: list[Shell] = []

    asyncio.run(late())
    shells[0].hand_over(Engage(), 1 << 62)  # the loop is gone, and nobody is harmed
