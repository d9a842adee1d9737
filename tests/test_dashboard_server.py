"""The dashboard's server, by real clients: who is let in, and what a page gets whatever another one does."""

from __future__ import annotations

import asyncio
import http.client
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import pytest
from hatchling.builders.wheel import WheelBuilder
from msgspec.structs import replace
from typer.testing import CliRunner
from websockets.exceptions import InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from guidance.cli import app
from guidance.dashboard.command import url_of
from guidance.dashboard.rows import COLUMNS, ROW
from guidance.dashboard.server import (
    ANSWERED_NS,
    PAGES_MAX,
    Dashboard,
    DashboardError,
    _Open,
    files,
    from_here,
    names_us,
)
from guidance.records import TOPICS, Record
from guidance.telemetry.arrivals import Answered, Arrival, Heard, Presence, read
from tests.fleet_rig import error, event, session, state, status

PATIENCE_S: Final = 20.0
ROOT: Final = Path(__file__).parents[1]


class Sky:
    """A network that the test speaks for."""

    def __init__(self) -> None:
        self.trouble = ""
        self.neighbours = 1
        self.orders: list[tuple[str, str, Mapping[str, Any], str]] = []
        self.wanted: list[str] = []
        self.arrivals: list[Arrival] = []
        self.refusal = ""

    def take(self) -> list[Arrival]:
        taken, self.arrivals = self.arrivals, []
        return taken

    def history(self, vehicle: str) -> None:
        self.wanted.append(vehicle)

    def ask(self, vehicle: str, verb: str, fields: Mapping[str, Any], source: str = "") -> str:
        if self.refusal:
            raise ValueError(self.refusal)
        self.orders.append((vehicle, verb, fields, source))
        return f"id-{len(self.orders)}"

    def say(self, *records: Record, vehicle: str = "uuv-1") -> None:
        now_ns = time.monotonic_ns()
        self.arrivals = [*self.arrivals, *(Heard(now_ns, vehicle, TOPICS[type(one)], one) for one in records)]


@contextmanager
def serving(
    sky: Sky, *, commands: bool = False, host: str = "127.0.0.1", port: int = 0
) -> Iterator[SimpleNamespace]:
    dashboard = Dashboard(sky, commands=commands)
    found: list[int] = []
    up, stop = threading.Event(), threading.Event()

    def is_up(port: int) -> None:
        found.append(port)
        up.set()

    thread = threading.Thread(target=lambda: asyncio.run(dashboard.run(host, port, is_up, stop.is_set)))
    thread.start()
    try:
        assert up.wait(PATIENCE_S)
        yield SimpleNamespace(port=found[0], dashboard=dashboard)
    finally:
        stop.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def get(port: int, path: str, **headers: str) -> tuple[int, str, Mapping[str, str]]:
    asking = http.client.HTTPConnection("127.0.0.1", port, timeout=PATIENCE_S)
    asking.request("GET", path, headers=headers)
    answer = asking.getresponse()
    body = answer.read().decode()
    asking.close()
    return answer.status, body, dict(answer.getheaders())


def page(port: int, origin: str | None = "", **options: Any) -> ClientConnection:
    chosen = f"http://127.0.0.1:{port}" if origin == "" else origin
    from_page = None if chosen is None else Origin(chosen)
    client: ClientConnection = connect(
        f"ws://127.0.0.1:{port}/live", origin=from_page, max_size=None, **options
    )
    return client


def until(client: ClientConnection, wanted: Callable[[Any], bool]) -> Any:
    """The first message that is wanted: JSON as a dict, rows as bytes."""
    end_s = time.monotonic() + PATIENCE_S
    while True:
        came = client.recv(timeout=max(0.0, end_s - time.monotonic()))
        message = came if isinstance(came, bytes) else json.loads(came)
        if wanted(message):
            return message


def kind(name: str) -> Callable[[Any], bool]:
    return lambda message: isinstance(message, dict) and message["kind"] == name


def test_the_page_is_served_and_asks_nothing_of_the_world_outside() -> None:
    with serving(Sky()) as served:
        status_, body, headers = get(served.port, "/")
        assert status_ == 200
        assert headers["Content-Type"] == "text/html; charset=utf-8"
        assert "default-src 'none'" in headers["Content-Security-Policy"]
        for name in re.findall(r'(?:src|href)="([^"]+)"', body):
            assert get(served.port, f"/{name}")[0] == 200
        assert get(served.port, "/?theme=dark")[0] == 200
        assert get(served.port, "/main.js")[2]["Content-Type"].startswith("text/javascript")
        for path in ("/index.html.bak", "/../server.py", "/%2e%2e/server.py", "/server.py"):
            assert get(served.port, path)[0] == 404


def test_nothing_in_the_page_names_an_address() -> None:
    for path, file in files().items():
        text = file.body.decode().replace("http://www.w3.org/2000/svg", "")
        assert not re.search(r"https?://|[\"'(]//", text), path
        for name in re.findall(r'from "\./([^"]+)"', text):
            assert f"/{name}" in files()


def test_every_element_that_the_scripts_seek_is_on_the_page() -> None:
    page_ = files()["/"].body.decode()
    has = set(re.findall(r'id="([^"]+)"', page_)) | {"load-name"}  # made with the form
    for path, file in files().items():
        if path.endswith(".js"):
            assert set(re.findall(r'\$\("([^"]+)"\)', file.body.decode())) <= has, path


def test_the_columns_that_the_charts_name_are_those_of_a_row() -> None:
    text = "".join(file.body.decode() for path, file in files().items() if path.endswith(".js"))
    named = set(re.findall(r'(?:column|words): "(\w+)"', text))
    named |= {name for pair in re.findall(r'against\(".*?", ".*?", "(\w+)", "(\w+)"', text) for name in pair}
    named |= set(re.findall(r'rows\.newest\("(\w+)"', text)) | set(re.findall(r"rows\.at\.(\w+)", text))
    assert len(named) > 30
    assert named <= set(COLUMNS)


@pytest.mark.parametrize(
    ("host", "us"),
    [
        ("127.0.0.1:8080", True),
        ("192.168.1.2", True),
        ("[::1]:8080", True),
        ("localhost:1", True),
        (f"{socket.gethostname()}:8080", True),
        ("boat.example:8080", True),
        ("BOAT.example", True),
        ("evil.example", False),
        ("127.0.0.1.evil.example", False),
        ("", False),
        ("[", False),
    ],
)
def test_only_names_of_this_machine_are_answered(host: str, us: bool) -> None:
    assert names_us(host, ["Boat.example"]) is us


@pytest.mark.parametrize(
    ("origin", "here"),
    [
        ("http://a:1", True),
        ("https://a:1", True),  # behind a proxy that speaks TLS
        ("http://a:2", False),
        ("http://evil.example", False),
        ("null", False),
        ("http://[", False),
        (None, False),
    ],
)
def test_only_a_page_of_this_server_opens_a_socket(origin: str | None, here: bool) -> None:
    assert from_here(origin, "a:1") is here
    assert not from_here("null", "")


def test_strangers_are_turned_away() -> None:
    with serving(Sky()) as served:
        for origin in ("http://evil.example", None, "null"):
            with pytest.raises(InvalidStatus) as refused:
                page(served.port, origin)
            assert refused.value.response.status_code == 403
        with pytest.raises(InvalidStatus) as refused:
            page(served.port, "http://evil.example", additional_headers={"Host": "evil.example"})
        assert get(served.port, "/", Host="evil.example")[0] == 421
        assert get(served.port, "/live")[0] == 403


def test_two_pages_see_two_vehicles_and_the_whole_fleet() -> None:
    sky = Sky()
    with serving(sky) as served, page(served.port) as one, page(served.port) as two:
        assert until(one, kind("welcome"))["commands"] is False
        for vehicle in ("uuv-1", "uuv-2"):
            sky.say(session("aa"), status(0), vehicle=vehicle)
        one.send('{"ask":"see","vehicle":"uuv-1"}')
        two.send('{"ask":"see","vehicle":"uuv-2"}')
        assert until(one, kind("begin"))["vehicle"] == "uuv-1"
        assert until(two, kind("begin"))["columns"] == list(COLUMNS)
        for vehicle, metres in (("uuv-1", 1.0), ("uuv-2", 2.0)):
            sky.say(state(0), error(0, metres), vehicle=vehicle)
        at = COLUMNS.index("error")

        def shows(metres: float) -> Callable[[Any], bool]:
            return lambda m: isinstance(m, bytes) and bool(m) and ROW.unpack(m[-ROW.size :])[at] == metres

        until(one, shows(1.0))
        until(two, shows(2.0))
        fleet = until(one, lambda m: kind("fleet")(m) and len(m["fleet"]) == 2)["fleet"]
        assert [seen["vehicle"] for seen in fleet] == ["uuv-1", "uuv-2"]
        assert until(two, kind("about"))["vehicle"] == "uuv-2"


def test_a_vehicle_that_appears_is_asked_for_its_history() -> None:
    sky = Sky()
    with serving(sky) as served, page(served.port) as one:
        sky.arrivals = [Presence(time.monotonic_ns(), "uuv-1", here=True)]
        until(one, lambda m: kind("fleet")(m) and m["fleet"] != [])
    assert sky.wanted == ["uuv-1"]


def test_silence_is_told_with_the_first_turn_after_it() -> None:
    """Words are told every fourth turn; whenever it begins, this is not left for the next of them."""
    for phase in range(4):
        sky, now_ns = Sky(), 10**12
        dashboard = Dashboard(sky, commands=False, clock_ns=lambda: now_ns)  # noqa: B023 - called within
        opened = _Open()
        dashboard._open.add(opened)
        for _ in range(phase):
            dashboard.turn(now_ns)
        sky.arrivals = [Heard(now_ns, "uuv-1", "status", status(0))]
        dashboard.turn(now_ns)
        while dashboard.hub.seen[0].contact == "live":
            opened.page.take(dashboard.hub.ring)
            now_ns += 50_000_000
            dashboard.turn(now_ns)
        told = [json.loads(message) for message in opened.page.take(dashboard.hub.ring)]
        assert [seen["contact"] for seen in told[0]["fleet"]] == ["silent"]


def test_garbage_from_zenoh_and_from_pages_is_named_or_passed_over() -> None:
    sky = Sky()
    with serving(sky) as served, page(served.port) as one:
        now_ns = time.monotonic_ns()
        sky.arrivals = [
            read(now_ns, "guidance/uuv-1/state", "application/json;guidance.State/1", b"[" * 9000),
            read(now_ns, "guidance/\x00/state", "text/plain", b"\xff"),
            read(now_ns, "guidance/uuv-1/state", "application/json;guidance.State/9", b"{}"),
        ]
        for text in ("", "[", "null", '{"ask":"see","vehicle":"../.."}', "[" * 8000, b"\xff\x00"):
            one.send(text)
        sky.say(replace(state(0), position_ned_m=(1e300, -1e300, 0.0)), event(-(1 << 63), "\x00"))
        said = until(one, lambda m: kind("fleet")(m) and m["ignored"] != [] and m["fleet"] != [])
        assert {ignored["what"] for ignored in said["ignored"]} >= {"garbage", "schema version 9"}
        one.send('{"ask":"see","vehicle":"uuv-1"}')
        until(one, kind("begin"))


def with_orders(sky: Sky) -> None:
    sky.say(replace(session("aa"), config_json='{"zenoh":{"commands":true}}'), status(0))


def order(verb: str, vehicle: str = "uuv-1", **fields: Any) -> str:
    return json.dumps(
        {
            "ask": "order",
            "vehicle": vehicle,
            "verb": verb,
            "number": 7,
            "as_of_s": time.monotonic(),
            "fields": fields,
        }
    )


def test_an_order_is_given_once_and_its_answer_goes_to_who_asked() -> None:
    sky = Sky()
    with serving(sky, commands=True) as served, page(served.port) as one, page(served.port) as two:
        welcome = until(one, kind("welcome"))
        assert welcome["commands"] is True
        assert "circle" in [shape["name"] for shape in welcome["trajectories"]]
        with_orders(sky)
        until(one, lambda m: kind("fleet")(m) and m["fleet"] != [])
        one.send(order("abort"))
        while not sky.orders:
            time.sleep(0.01)
        sky.arrivals = [Answered(0, "uuv-1", "abort", "id-1", True, "it is")]
        assert until(one, kind("answer")) == {
            "kind": "answer",
            "number": 7,
            "vehicle": "uuv-1",
            "verb": "abort",
            "accepted": True,
            "reason": "it is",
        }
        for _ in range(8):
            assert not kind("answer")(until(two, lambda _: True))
    assert sky.orders == [("uuv-1", "abort", {}, "dashboard")]


@pytest.mark.parametrize("verb", ["engage", "resume", "load", "hold", "abort"])
def test_an_order_that_lay_on_the_way_moves_nothing_but_stops_still(verb: str) -> None:
    sky = Sky()
    with serving(sky, commands=True) as served, page(served.port) as one:
        with_orders(sky)
        heard = until(one, lambda m: kind("fleet")(m) and m["fleet"] != [])
        late = json.loads(order(verb)) | {"as_of_s": heard["at_s"] - 5.0}
        one.send(json.dumps(late))
        if verb in ("hold", "abort"):
            while not sky.orders:
                time.sleep(0.01)
        else:
            assert "s on its way and is not given" in until(one, kind("answer"))["reason"]
            assert sky.orders == []
            one.send(json.dumps(late | {"as_of_s": heard["at_s"]}))
            while not sky.orders:
                time.sleep(0.01)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (lambda: order("shutdown"), "there is no order 'shutdown' here"),
        (lambda: order("set", key="law.k", value=1.0), "there is no order 'set' here"),
        (lambda: order("abort", vehicle="uuv-2"), "uuv-2 takes no orders"),
        (lambda: order("engage"), "too many"),
    ],
)
def test_what_may_not_be_ordered_is_refused_with_why(text: Callable[[], str], why: str) -> None:
    sky = Sky()
    sky.refusal = "too many"
    with serving(sky, commands=True) as served, page(served.port) as one:
        with_orders(sky)
        sky.say(status(0), vehicle="uuv-2")
        until(one, lambda m: kind("fleet")(m) and len(m["fleet"]) == 2)
        one.send(text())
        answer = until(one, kind("answer"))
        assert answer["accepted"] is False
        assert why in answer["reason"]
    assert sky.orders == []


def test_an_order_whose_answer_is_lost_is_given_up() -> None:
    """The thread that asks may have died; the page must not wait, nor the memory grow, for ever."""
    sky, now_ns = Sky(), 10**12
    dashboard = Dashboard(sky, commands=True, clock_ns=lambda: now_ns)
    opened = _Open()
    with_orders(sky)
    dashboard.turn(now_ns)
    for verb in ("hold", "abort"):
        dashboard._asked(opened, order(verb))
        now_ns += ANSWERED_NS // 2
    opened.page.take(dashboard.hub.ring)
    sky.trouble = "stopped by an internal error"
    dashboard.turn(now_ns)
    dashboard.turn(now_ns)
    (told,) = map(json.loads, opened.page.take(dashboard.hub.ring))
    assert (told["kind"], told["verb"], told["accepted"]) == ("answer", "hold", None)
    assert told["reason"] == "stopped by an internal error: look at the vehicle's state"
    sky.arrivals = [Answered(0, "uuv-1", "hold", "id-1", True, "late"), Answered(0, "", "", "id-2", True, "")]
    dashboard.turn(now_ns)
    assert [json.loads(one)["verb"] for one in opened.page.take(dashboard.hub.ring)] == ["abort"]
    assert dashboard._given == {}


def test_no_more_pages_are_let_in_than_there_may_be() -> None:
    """Those count that have shaken hands; several may be at it at once."""
    dashboard = Dashboard(Sky(), commands=False)
    dashboard._open.update(_Open() for _ in range(PAGES_MAX))
    closed: list[int] = []

    async def close(code: int, reason: str) -> None:
        closed.append(code)
        assert reason == f"{PAGES_MAX} pages are open"

    late: Any = SimpleNamespace(close=close)
    asyncio.run(dashboard._live(late))
    assert closed == [1013]
    assert len(dashboard._open) == PAGES_MAX


def test_without_commands_nothing_is_ordered_whatever_a_page_sends() -> None:
    sky = Sky()
    with serving(sky) as served, page(served.port) as one:
        with_orders(sky)
        until(one, lambda m: kind("fleet")(m) and m["fleet"] != [])
        one.send(order("engage"))
        assert "--commands" in until(one, kind("answer"))["reason"]
    assert sky.orders == []


def test_a_page_that_reads_nothing_holds_nobody_up() -> None:
    sky = Sky()
    with serving(sky) as served, page(served.port) as one, socket.socket() as stuck:
        here = f"127.0.0.1:{served.port}"
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.connect(("127.0.0.1", served.port))
        asked = f"GET /live HTTP/1.1\r\nHost: {here}\r\nOrigin: http://{here}\r\nUpgrade: websocket\r\n"
        asked += "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
        asked += "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
        see = b'{"ask":"see","vehicle":"uuv-1"}'
        stuck.sendall(f"{asked}\r\n".encode() + bytes((0x81, 0x80 | len(see), 0, 0, 0, 0)) + see)
        one.send('{"ask":"see","vehicle":"uuv-1"}')
        sky.say(*(event(number, f"{number} " + "x" * 400) for number in range(100)), status(0))
        for _ in range(10):
            sky.say(status(0), state(0))
            assert isinstance(until(one, lambda m: isinstance(m, bytes) and bool(m)), bytes)
            until(one, kind("fleet"))


def test_a_port_that_is_taken_is_an_error_that_says_so() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(DashboardError, match=f"port {port}: .*--port"):
            asyncio.run(Dashboard(Sky(), commands=False).run("127.0.0.1", port, print, lambda: True))


def test_the_command_serves_until_ctrl_c_and_says_where() -> None:
    command = [sys.executable, "-m", "guidance", "dashboard", "--no-multicast", "--port", "0"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        said = process.stderr.readline()
        found = re.search(r"http://127\.0\.0\.1:(\d+)/", said)
        assert found is not None, said
        assert get(int(found[1]), "/")[0] == 200
        process.send_signal(signal.SIGINT)
        rest = process.stderr.read()
        assert process.wait(PATIENCE_S) == 130
    assert rest == ""


def test_the_browser_that_it_opens_is_served_while_it_waits(tmp_path: Path) -> None:
    """A text browser, or what BROWSER names, comes back when it is closed; who opened it serves the page."""
    fetched = tmp_path / "fetched"
    script = tmp_path / "browser.py"
    script.write_text(
        "import pathlib, sys, time, urllib.request\n"
        "page = urllib.request.urlopen(sys.argv[1], timeout=20).read()\n"
        f"pathlib.Path({str(fetched)!r}).write_bytes(page)\n"
    )
    command = [sys.executable, "-m", "guidance", "dashboard", "--no-multicast", "--port", "0", "--open"]
    environment = {**os.environ, "DISPLAY": ":0", "BROWSER": f"{sys.executable} {script} %s"}
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment) as process:
        end_s = time.monotonic() + PATIENCE_S
        while not (fetched.exists() and fetched.stat().st_size) and time.monotonic() < end_s:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE_S) == 130
        assert process.stderr is not None
        assert "--open" not in process.stderr.read()
    assert b"<html" in fetched.read_bytes()


def test_under_systemd_its_lines_have_their_priorities(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "guidance", "dashboard", "--no-multicast", "--port", "0"]
    journal = tmp_path / "journal"
    with journal.open("w") as stream:
        found = os.fstat(stream.fileno())
        environment = {**os.environ, "JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        with subprocess.Popen(
            [*command, "--host", "0.0.0.0", "--commands"], stderr=stream, env=environment
        ) as process:
            end_s = time.monotonic() + PATIENCE_S
            while journal.read_text().count("\n") < 2 and time.monotonic() < end_s:
                time.sleep(0.02)
            process.terminate()
            assert process.wait(PATIENCE_S) == 143
    listens, orders_on = journal.read_text().splitlines()
    assert listens.startswith("<6>guidance dashboard: http://127.0.0.1:")
    assert orders_on.startswith("<4>guidance dashboard: orders are on: whoever reaches")


def test_wrong_settings_and_a_missing_extra_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = CliRunner().invoke(app, ["dashboard", "--connect", "tcp/10.0.0.1"])
    assert wrong.exit_code == 2
    assert "names no port" in wrong.stderr
    for name in [name for name in sys.modules if name.startswith("guidance.dashboard.")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "websockets.asyncio.server", None)
    missing = CliRunner().invoke(app, ["dashboard"])
    assert missing.exit_code == 2
    assert "pip install 'se3-guidance[dashboard]'" in missing.stderr


@pytest.mark.parametrize(
    ("host", "url"),
    [
        ("0.0.0.0", "http://127.0.0.1:80/"),
        ("", "http://127.0.0.1:80/"),
        ("::", "http://[::1]:80/"),
        ("::0", "http://[::1]:80/"),
        ("::1", "http://[::1]:80/"),
        ("boat", "http://boat:80/"),
    ],
)
def test_the_url_is_one_that_a_browser_here_can_open(host: str, url: str) -> None:
    assert url_of(host, 80) == url


def test_the_wheel_has_the_page(tmp_path: Path) -> None:
    builder = WheelBuilder(str(ROOT))
    shipped = {str(file.distribution_path) for file in builder.recurse_included_files()}
    assert {f"guidance/dashboard/static{'/index.html' if p == '/' else p}" for p in files()} <= shipped
