"""A real browser in front of a real dashboard: Debian's chromium, and the processes that it is shown."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import msgspec
from msgspec.structs import replace
from playwright.sync_api import Browser, ConsoleMessage, Page, Request, sync_playwright

from guidance.demo import CONFIG_FILE
from guidance.records import LOG_ONLY, TOPICS, Event, Record, Setpoint, Status
from guidance.service import new_session
from guidance.telemetry import Sample
from guidance.telemetry.zenoh_sink import ZenohSink
from tests.helpers import make_config, make_flight

PATIENCE_MS: Final = 15_000
PATIENCE_S: Final = 20.0
#: What the pages looked like, to be looked at; not kept by git.
ARTEFACTS: Final = Path(__file__).with_name("artefacts")
LAPTOP: Final = {"width": 1366, "height": 900}
PHONE: Final = {"width": 390, "height": 844}
#: Without a GPU, without calls home, and without a sandbox, which a root of a container cannot have.
_ARGUMENTS: Final = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def chromium() -> Iterator[Browser]:
    """The browser of the tests; AssertionError with what to do if there is none."""
    found = shutil.which("chromium")
    assert found, "these tests look at the dashboard in Debian's chromium: apt-get install -y chromium"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=found, args=list(_ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def visiting(
    browser: Browser, url: str, before: Callable[[Page], object] | None = None, **context: Any
) -> Iterator[Page]:
    """The page, in a browser profile of its own; that it asks nobody else and logs no error is asserted.

    `before` is done with the page before it is loaded.
    """
    errors: list[str] = []
    elsewhere: list[str] = []
    home = url.partition("#")[0]

    def note_request(request: Request) -> None:
        if not request.url.startswith((home, home.replace("http:", "ws:"), "data:", "blob:")):
            elsewhere.append(request.url)

    def note_message(message: ConsoleMessage) -> None:
        if message.type in ("error", "warning"):
            errors.append(message.text)

    profile = browser.new_context(**{"viewport": LAPTOP, **context})
    profile.set_default_timeout(PATIENCE_MS)
    page = profile.new_page()
    page.on("request", note_request)
    page.on("console", note_message)
    page.on("pageerror", lambda error: errors.append(str(error)))
    if before is not None:
        before(page)
    try:
        page.goto(url)
        yield page
        assert (errors, elsewhere) == ([], []), f"{errors} {elsewhere}"
    finally:
        profile.close()


def picture(page: Page, name: str) -> None:
    """Keep what the page looks like."""
    ARTEFACTS.mkdir(exist_ok=True)
    path = ARTEFACTS / f"{name}.png"
    page.screenshot(path=path, full_page=True)
    sys.stdout.write(f"{path}\n")


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def endpoint() -> str:
    return f"tcp/127.0.0.1:{free_port()}"


@contextmanager
def process(*words: str, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A module of ours as a process, killed at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", *words],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        **{"stderr": subprocess.DEVNULL, **options},
    ) as child:
        try:
            yield child
        finally:
            child.kill()


@contextmanager
def flying(place: str, folder: Path, *overrides: str) -> Iterator[subprocess.Popen[str]]:
    """The demo's flight, service and built-in vehicle, which takes orders; gives the service."""
    port = free_port(socket.SOCK_DGRAM)
    settings = (
        f'link.connection="udpin://127.0.0.1:{port}"',
        f'zenoh.connect=["{place}"]',
        "zenoh.commands=true",
        "log.enabled=false",
        *overrides,
    )
    service = ["guidance", "run", "--config", str(CONFIG_FILE)]
    service += [word for setting in settings for word in ("--set", setting)]
    vehicle = ["sitl", "vehicle", "--firmware", "px4-uuv", "--full-thrust-speed", "5", "--port", "0"]
    with (
        process(*vehicle, "--to", f"127.0.0.1:{port}", "--exit-with-stdin"),
        process(*service, cwd=folder) as child,
    ):
        yield child


@contextmanager
def dashboard(*, connect: Sequence[str] = (), listen: Sequence[str] = ()) -> Iterator[str]:
    """The dashboard of what publishes there, with buttons; gives its address once it answers."""
    port = free_port()
    words = ["--commands", "--port", str(port)]
    words += [word for place in connect for word in ("--connect", place)]
    words += [word for place in listen for word in ("--listen", place)]
    with process("guidance", "dashboard", *words) as child:
        wait_for(port, child)
        yield f"http://127.0.0.1:{port}/"


def wait_for(port: int, child: subprocess.Popen[str]) -> None:
    """Until somebody listens there."""
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            return socket.create_connection(("127.0.0.1", port), 1.0).close()
        except OSError:
            assert child.poll() is None, f"it ended with status {child.returncode}"
            assert time.monotonic() < end, "nobody listens"
            time.sleep(0.02)


class Ghost:
    """A vehicle that is none: a flight made beforehand, told by a service's own sink as if it ended now.

    It is told at once, so that who looks finds it in the service's cache; its end is repeated from then on.
    """

    def __init__(self, name: str, place: str, seconds: float) -> None:
        config = make_config(f"vehicle.name={name}")
        flight = make_flight(config=config)
        flight.run(seconds)
        self._sink = ZenohSink(name, listen=[place], capacity=100_000, capacity_bytes=1 << 26)
        self._records = [record for record in flight.records if TOPICS[type(record)] not in LOG_ONLY]
        self._offset_ns = time.monotonic_ns() - flight.now_ns
        self._config = config
        self._quiet = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        self.say(new_session(self._config))
        for record in self._records:
            self.say(_moved(record, self._offset_ns))
        self._sink.start()
        self._thread.start()

    def say(self, record: Record) -> None:
        self._sink.offer(Sample(TOPICS[type(record)], record.t_ns, msgspec.json.encode(record)))

    def fall_silent(self) -> None:
        """From the return on nothing is said; its service is still there."""
        self._quiet.set()
        self._thread.join()

    def close(self) -> None:
        self.fall_silent()
        self._sink.close(PATIENCE_S)

    def _run(self) -> None:
        newest = {type(record): record for record in self._records if not isinstance(record, Event)}
        number = 0
        while not self._quiet.wait(0.05):
            number += 1
            for record in newest.values():
                moved = _moved(record, time.monotonic_ns() - record.t_ns)
                if isinstance(moved, Setpoint):
                    moved = replace(moved, seq=moved.seq + number)
                self.say(moved)


def _moved(record: Record, by_ns: int) -> Record:
    """The same at another time."""
    moved = replace(record, t_ns=record.t_ns + by_ns)
    if isinstance(moved, Status):
        start_ns = moved.trajectory_start_ns
        return replace(
            moved,
            since_ns=moved.since_ns + by_ns,
            trajectory_start_ns=None if start_ns is None else start_ns + by_ns,
        )
    return moved
