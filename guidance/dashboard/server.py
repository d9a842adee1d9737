"""The shell of the dashboard: files and one WebSocket, turned 20 times a second.

A page of another site in the same browser must neither read along nor give orders: a socket is opened only
for a page that came from here (Origin), and nothing is served under a name that somebody else may have
pointed at this machine (Host; DNS rebinding).
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import logging
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from http import HTTPStatus
from importlib import resources
from ipaddress import ip_address
from typing import Any, Final, NamedTuple, Protocol
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response

from guidance.dashboard.hub import Hub
from guidance.dashboard.orders import LATE_S, MOVING, OFF, VERBS, Order, See, answer, answered, read
from guidance.dashboard.pages import Page
from guidance.dashboard.rows import TICK_HZ
from guidance.dashboard.said import fleet_told, takes_orders, trajectories_told
from guidance.telemetry.arrivals import VEHICLE, Arrival

#: Words are told so seldom, in turns; a change of who is heard is told at once.
TELL_TURNS: Final = TICK_HZ // 5
PAGES_MAX: Final = 32
#: An order with a trajectory is a line.
_MESSAGE_BYTES_MAX: Final = 8192
#: The network answers each order within some 6 s, if only by saying that nobody does.
ANSWERED_NS: Final = 10_000_000_000
_KINDS: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".svg": "image/svg+xml",
}
_POLICY: Final = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class DashboardError(Exception):
    """The dashboard cannot run; the text says why and what to do."""


class Network(Protocol):
    """Where records come from and orders go to: `telemetry.subscriber.Subscriber`."""

    trouble: str
    neighbours: int

    def take(self) -> list[Arrival]: ...
    def history(self, vehicle: str) -> None: ...
    def ask(self, vehicle: str, verb: str, fields: Mapping[str, Any], source: str = "") -> str: ...


class File(NamedTuple):
    """A file of the page."""

    kind: str
    body: bytes


def files() -> dict[str, File]:
    """Path -> file, of all that the page consists of."""
    found: dict[str, File] = {}
    for entry in resources.files("guidance.dashboard").joinpath("static").iterdir():
        suffix = entry.name[entry.name.rfind(".") :]
        if suffix in _KINDS:
            found[f"/{entry.name}"] = File(_KINDS[suffix], entry.read_bytes())
    found["/"] = found.pop("/index.html")
    return found


def fingerprint(served: Mapping[str, File]) -> str:
    """Of all files together: a page that was open while another version was installed knows itself by it."""
    whole = hashlib.sha256()
    for path, file in sorted(served.items()):
        whole.update(f"{path} {len(file.body)} ".encode() + file.body)
    return whole.hexdigest()[:16]


def names_us(host: str, named: Sequence[str] = ()) -> bool:
    """Whether a Host header is an address, `localhost`, this machine's own name, or one that was `named`."""
    try:
        name = urlsplit(f"//{host}").hostname or ""
    except ValueError:
        return False
    with contextlib.suppress(ValueError):
        ip_address(name)
        return True
    own = socket.gethostname().lower()
    return name in {"localhost", own, f"{own}.local", own.partition(".")[0], *map(str.lower, named)}


def from_here(origin: str | None, host: str) -> bool:
    """Whether a page asks that was served under this Host; every browser says of which page it is."""
    try:
        return origin is not None and urlsplit(origin).netloc == host != ""
    except ValueError:
        return False


class _Open:
    """A page and its connection."""

    def __init__(self) -> None:
        self.page = Page()
        self.ready = asyncio.Event()


class _Given(NamedTuple):
    """An order on its way: by whose page, and when it was given."""

    by: _Open
    order: Order
    at_ns: int


class Dashboard:
    """Serves pages what the network brings.

    Args:
        network: its vehicles are shown, and get the orders.
        commands: whether pages may give orders.
        names: host names, beside its own, under which this machine is reached.
    """

    def __init__(
        self,
        network: Network,
        *,
        commands: bool,
        names: Sequence[str] = (),
        clock_ns: Callable[[], int] = time.monotonic_ns,
        unix_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self._network = network
        self._commands = commands
        self._names = names
        self._clock_ns = clock_ns
        self._unix_ns = unix_ns
        self._files = files()
        self._page = fingerprint(self._files)
        self._open: set[_Open] = set()
        self._given: dict[str, _Given] = {}
        self._turns = 0
        self._contacts: list[tuple[str, str]] = []
        self._encode = msgspec.json.Encoder().encode
        self.hub = Hub(network.history)

    async def run(
        self, host: str, port: int, up: Callable[[int], None], stopping: Callable[[], bool]
    ) -> None:
        """Serve until `stopping()`; `up` is told the port that is listened on.

        Raises:
            DashboardError: it cannot listen there.
        """
        quiet = logging.getLogger("guidance.dashboard.quiet")
        quiet.setLevel(logging.CRITICAL + 1)  # a browser's spare connection that asks nothing is no error
        try:
            server = await serve(
                self._live,
                host,
                port,
                process_request=self._answer,
                compression=None,
                max_size=_MESSAGE_BYTES_MAX,
                server_header=None,
                logger=quiet,
                close_timeout=1.0,
            )
        except OSError as error:
            why = error.strerror or str(error)
            raise DashboardError(
                f"cannot listen on {host}, port {port}: {why}; choose others with --host and --port"
            ) from error
        async with server:
            up(next(iter(server.sockets)).getsockname()[1])
            loop = asyncio.get_running_loop()
            due_s = loop.time()
            while not stopping():
                self.turn(self._clock_ns())
                due_s = max(due_s + 1.0 / TICK_HZ, loop.time())
                await asyncio.sleep(due_s - loop.time())

    def turn(self, now_ns: int) -> None:
        """Once: what has arrived becomes what pages are owed."""
        hub = self.hub
        for came in hub.turn(self._network.take(), now_ns):
            if (given := self._given.pop(came.id, None)) is not None:
                given.by.page.owe_answer(answered(given.order, came))
        self._give_up(now_ns)
        contacts = [(seen.vehicle, str(seen.contact)) for seen in hub.seen]
        telling = self._turns % TELL_TURNS == 0 or contacts != self._contacts
        self._contacts = contacts
        self._turns += 1
        fleet = self._fleet_told() if telling and self._open else None
        about: dict[str, bytes] = {}
        for opened in self._open:
            page = opened.page
            if page.vehicle in hub.renewed:
                page.begin()
            elif (row := hub.rows.get(page.vehicle)) is not None:
                page.owe_row(row)
            if fleet is not None:
                page.owe_fleet(fleet)
                if page.vehicle:
                    if page.vehicle not in about:
                        about[page.vehicle] = self._encode(hub.about(page.vehicle, now_ns))
                    page.owe_about(about[page.vehicle])
                    page.owe_plan(hub.plan(page.vehicle))
                    hub.recall(page.vehicle, now_ns)
            opened.ready.set()

    def _give_up(self, now_ns: int) -> None:
        """Nobody waits for ever, whatever became of the answers."""
        while self._given:
            oldest, given = next(iter(self._given.items()))
            if now_ns - given.at_ns < ANSWERED_NS:
                return
            del self._given[oldest]
            why = self._network.trouble or "no answer came"
            given.by.page.owe_answer(answer(given.order, None, f"{why}: look at the vehicle's state"))

    def _fleet_told(self) -> bytes:
        offset_ns = self._unix_ns() - self._clock_ns()
        network, hub = self._network, self.hub
        told = fleet_told(hub.fleet, hub.seen, network.trouble, network.neighbours, offset_ns)
        return self._encode({**told, "at_s": self._clock_ns() * 1e-9})

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """None lets a WebSocket through."""
        host = request.headers.get("Host", "")
        path = request.path.partition("?")[0]
        if not names_us(host, self._names):
            return _response(
                HTTPStatus.MISDIRECTED_REQUEST,
                "use this machine's address or name, or start the dashboard with --name NAME",
            )
        if path == "/live":
            if not from_here(request.headers.get("Origin"), host):
                return _response(HTTPStatus.FORBIDDEN, "only for pages of this dashboard")
            if len(self._open) >= PAGES_MAX:
                return _response(HTTPStatus.SERVICE_UNAVAILABLE, f"{PAGES_MAX} pages are open: close one")
            return None
        file = self._files.get(path)
        if file is None:
            return _response(HTTPStatus.NOT_FOUND, "nothing is here; the page is at /")
        return _response(HTTPStatus.OK, file.body, file.kind)

    async def _live(self, connection: ServerConnection) -> None:
        if len(self._open) >= PAGES_MAX:  # others came while this one shook hands
            await connection.close(CloseCode.TRY_AGAIN_LATER, f"{PAGES_MAX} pages are open")
            return
        opened = _Open()
        opened.page.owe_answer(self._encode(self._welcome()))
        opened.page.owe_fleet(self._fleet_told())
        opened.ready.set()
        self._open.add(opened)
        sending = asyncio.create_task(self._send(opened, connection))
        try:
            async for text in connection:
                self._asked(opened, text)
        except ConnectionClosed:
            pass
        finally:
            self._open.discard(opened)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError, ConnectionClosed):
                await sending

    async def _send(self, opened: _Open, connection: ServerConnection) -> None:
        """Whatever is owed, as fast as the page takes it."""
        while True:
            await opened.ready.wait()
            opened.ready.clear()
            for message in opened.page.take(self.hub.ring, self.hub.age_s):
                await connection.send(message)

    def _welcome(self) -> dict[str, object]:
        return {
            "kind": "welcome",
            "page": self._page,
            "commands": self._commands,
            "verbs": VERBS,
            "trajectories": trajectories_told() if self._commands else [],
        }

    def _asked(self, opened: _Open, text: str | bytes) -> None:
        asked = read(text)
        if isinstance(asked, See) and VEHICLE.fullmatch(asked.vehicle) is not None:
            opened.page.see(asked.vehicle)
            opened.page.owe_about(self._encode(self.hub.about(asked.vehicle, self._clock_ns())))
        elif isinstance(asked, Order):
            refused = self._order(opened, asked)
            if refused:
                opened.page.owe_answer(answer(asked, False, refused))
        opened.ready.set()

    def _order(self, opened: _Open, order: Order) -> str:
        """Why it is not given; empty if it is, and an answer will come."""
        if not self._commands:
            return OFF
        if order.verb not in VERBS:
            return f"there is no order {order.verb[:40]!r} here; there are {', '.join(VERBS)}"
        if not takes_orders(self.hub.fleet, self.hub.watched, order.vehicle):
            return f"{order.vehicle[:64]} takes no orders by zenoh (zenoh.commands in its configuration)"
        late_s = self._clock_ns() * 1e-9 - order.as_of_s
        if order.verb in MOVING and not late_s <= LATE_S:
            return f"it was {late_s:.0f} s on its way and is not given: look at the state, then order again"
        try:
            given = self._network.ask(order.vehicle, order.verb, order.fields, "dashboard")
        except (ValueError, TypeError) as error:
            return str(error)
        self._given[given] = _Given(opened, order, self._clock_ns())
        return ""


def _response(status: HTTPStatus, body: bytes | str, kind: str = "text/plain; charset=utf-8") -> Response:
    content = body.encode() if isinstance(body, str) else body
    headers = Headers(
        [
            ("Content-Type", kind),
            ("Content-Length", str(len(content))),
            ("Cache-Control", "no-cache"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
            ("Content-Security-Policy", _POLICY),
            ("Connection", "close"),
        ]
    )
    return Response(status.value, status.phrase, headers, content)
