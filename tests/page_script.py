"""The dashboard's server as a page meets it, in the hands of a test: it says what the test says, and when.

The page's clock stands, and goes on as the test lets it: what takes seconds takes none.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import nan
from typing import Any, Final

from playwright.sync_api import Browser, Page, Route, WebSocketRoute

from guidance.dashboard.pages import begins
from guidance.dashboard.rows import COLUMNS, ROW
from guidance.dashboard.said import trajectories_told
from guidance.dashboard.server import files
from tests.browser_rig import PATIENCE_S, visiting

URL: Final = "http://dashboard.test/"
#: As often as the server looks, ms.
TURN_MS: Final = 50


def seen(vehicle: str, state: str = "tracking", **more: object) -> dict[str, object]:
    """A vehicle as the fleet is told of it."""
    return {
        "vehicle": vehicle,
        "contact": "live",
        "quiet_s": 0.0,
        "state": state,
        "reason": None,
        "versions": [],
        "doubled": False,
        **more,
    }


class Script:
    """A server, and the page that it has."""

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.sockets: list[WebSocketRoute] = []
        self.fleet = [seen("alpha"), seen("bravo")]
        self._row_s = 100.0
        self._files = files()

    def attach(self, page: Page) -> None:
        self.page = page
        page.route(f"{URL}**", self._serve)
        page.route_web_socket(f"{URL.replace('http', 'ws')}live", self._opened)
        page.clock.install(time=1_800_000_000)
        page.clock.pause_at(1_800_000_001)

    def _serve(self, route: Route) -> None:
        file = self._files["/" + route.request.url.removeprefix(URL).partition("#")[0]]
        route.fulfill(body=file.body, content_type=file.kind)

    def _opened(self, socket: WebSocketRoute) -> None:
        self.sockets.append(socket)
        socket.on_message(lambda text: self.asked.append(json.loads(text)))
        self.say(kind="welcome", commands=True, trajectories=trajectories_told())
        self.tell()

    def say(self, **said: object) -> None:
        self.sockets[-1].send(json.dumps(said))

    def tell(self) -> None:
        """The fleet, as 5 times a second."""
        self.say(
            kind="fleet",
            fleet=self.fleet,
            notes=[],
            ignored=[],
            trouble="",
            neighbours=1,
            at_s=7.0,
        )

    def begin(self, vehicle: str, kept: int = 0, age_s: float = 0.0) -> None:
        self.sockets[-1].send(begins(vehicle, kept, age_s))

    def rows(self, count: int = 20, **figures: float) -> None:
        """Rows of 20 Hz: nothing but these figures is known."""
        packed = b""
        for _ in range(count):
            self._row_s += 0.05
            packed += ROW.pack(*({"t": self._row_s, **figures}.get(name, nan) for name in COLUMNS))
        self.sockets[-1].send(packed)

    def about(self, vehicle: str, **more: object) -> None:
        self.say(
            kind="about",
            vehicle=vehicle,
            commands=True,
            fence=None,
            origin=None,
            **{"trajectory": {"name": "circle", "radius_m": 4.0}, **more},
        )

    def introduce(self, vehicle: str, **about: object) -> None:
        """All that is told of a vehicle that a page begins to show."""
        self.begin(vehicle)
        self.rows(error=0.25, north=1.0, east=2.0, down=3.0, qw=1.0, qx=0.0, qy=0.0, qz=0.0)
        self.about(vehicle, session={"profile": f"make-of-{vehicle}", "version": "1"}, **about)

    def flow(self, seconds: float) -> None:
        """The page's clock goes on."""
        self.page.clock.run_for(round(1000 * seconds))

    def until(self, true: Callable[[], bool]) -> None:
        """What the page sends has a way to go."""
        end = time.monotonic() + PATIENCE_S
        while not true():
            assert time.monotonic() < end, self.asked
            self.page.wait_for_timeout(5)

    def orders(self) -> list[tuple[str, str]]:
        """What was ordered so far, once what the page has sent is here."""
        return [(one["vehicle"], one["verb"]) for one in self.asked if one["ask"] == "order"]

    def looks(self) -> list[str]:
        """Which vehicles were asked for."""
        return [one["vehicle"] for one in self.asked if one["ask"] == "see"]


@contextmanager
def scripted(browser: Browser, **context: Any) -> Iterator[tuple[Script, Page]]:
    """A page that shows alpha, of alpha and bravo."""
    script = Script()
    with visiting(browser, URL, script.attach, **context) as page:
        script.until(lambda: script.looks() == ["alpha"])
        script.introduce("alpha")
        yield script, page
