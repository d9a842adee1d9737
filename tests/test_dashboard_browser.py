"""The dashboard as an operator meets it: in a browser, with a mouse or keys, on a laptop and on a phone.

Pictures of the main states are kept in tests/artefacts, to be looked at.
"""

from __future__ import annotations

import json
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
import zenoh
from playwright.sync_api import Browser, Locator, Page, expect

from guidance.records import Status
from guidance.telemetry.zenoh_sink import zenoh_config
from tests.browser_rig import (
    PATIENCE_MS,
    PATIENCE_S,
    PHONE,
    Ghost,
    chromium,
    dashboard,
    endpoint,
    flying,
    picture,
    process,
    visiting,
)
from tests.page_measures import (
    brightness,
    drawn_part,
    faint_texts,
    focused,
    overflow_px,
    too_wide,
    wait_until_drawn,
)

#: So long the vehicle that only talks has flown when the first looks.
FLOWN_S = 45.0


@pytest.fixture(name="browser", scope="module")
def one_browser() -> Iterator[Browser]:
    expect.set_options(timeout=PATIENCE_MS)
    with chromium() as browser:
        yield browser


def test_without_a_browser_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("shutil.which", lambda name: None)
    with pytest.raises(AssertionError, match="apt-get install -y chromium"), chromium():
        pass


class Watched(NamedTuple):
    """A dashboard, and what it shows: a vehicle that only talks, and a stranger on the keys."""

    url: str
    ghost: Ghost
    stranger: zenoh.Session


@pytest.fixture(name="watched", scope="module")
def a_dashboard_with_something_to_show() -> Iterator[Watched]:
    places = [endpoint(), endpoint()]
    with ExitStack() as stack:
        ghost = Ghost("uuv-1", places[0], FLOWN_S)
        stack.callback(ghost.close)
        ghost.start()
        stranger = stack.enter_context(zenoh.open(zenoh_config(listen=[places[1]])))
        yield Watched(stack.enter_context(dashboard(connect=places)), ghost, stranger)


def row_of(page: Page, vehicle: str) -> Locator:
    return page.locator("#fleet tbody tr", has_text=vehicle)


def tab_to(page: Page, wanted: str) -> None:
    """Press Tab until an element has the keyboard; what has it is seen on the way."""
    for _ in range(60):
        page.keyboard.press("Tab")
        assert page.evaluate(
            """() => { const element = document.activeElement, style = getComputedStyle(element);
            return element === document.body
                || (style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2); }"""
        ), focused(page)
        if focused(page) == wanted:
            return
    raise AssertionError(f"{wanted} is not reached by Tab")


def error_of(page: Page, vehicle: str) -> float:
    """As the fleet's table shows it, m; nan if it is not known."""
    text = row_of(page, vehicle).locator("td").last.inner_text().split()[0]
    return float(text) if text[0].isdigit() else float("nan")


def test_a_flight_is_seen_from_its_start_and_aborted_from_the_page(browser: Browser, tmp_path: Path) -> None:
    place = endpoint()
    with dashboard(listen=[place]) as url, visiting(browser, url) as page:
        expect(page.locator("#nobody")).to_be_visible()
        picture(page, "nobody")
        with flying(place, tmp_path):
            expect(page.locator("#name")).to_have_text("demo")
            expect(page.locator("#state-word")).to_contain_text("tracking")
            expect(row_of(page, "demo")).to_contain_text("tracking")
            expect(page.locator("#reason")).not_to_be_empty()
            expect(page.locator("#event-list")).to_contain_text("tracking")
            first_m = error_of(page, "demo")
            wait_until_drawn(page, "#scene", 0.05)
            page.wait_for_function(
                """(limit) => parseFloat(document.querySelector("#fleet tbody tr td:last-child").innerText)
                    < limit""",
                arg=first_m / 4,
            )
            assert drawn_part(page, "#charts canvas") > 0.01
            expect(page.locator("#streams")).to_contain_text("CURRENT_MODE")
            assert page.locator("#streams .poor").all_inner_texts() == []  # nothing is wrong: no alarm
            picture(page, "tracking")

            page.get_by_role("button", name="Abort").click()  # at once: it is not asked for twice
            expect(page.locator("#answer")).to_contain_text("demo: abort accepted")
            expect(page.locator("#state-word")).to_contain_text("aborted")
            expect(row_of(page, "demo")).to_contain_text("aborted")
            expect(page.locator("#blocks")).to_contain_text("To engage again")
            expect(page.locator("#event-list")).to_contain_text("abort commanded (by zenoh dashboard)")
            assert faint_texts(page) == []
            picture(page, "aborted")

            # And on with it, by the keyboard alone.
            tab_to(page, "order-engage")
            page.keyboard.press("Enter")
            expect(page.locator("#confirm")).to_contain_text("Engage demo?")
            assert focused(page) == "confirm-no"
            picture(page, "engage-asked")
            page.emulate_media(color_scheme="dark")
            assert faint_texts(page) == []
            picture(page, "engage-asked-dark")
            expect(page.locator("#state-word")).to_contain_text("aborted")  # nothing was ordered yet
            page.keyboard.press("Shift+Tab")
            assert focused(page) == "confirm-yes"
            page.keyboard.press("Enter")
            expect(page.locator("#answer")).to_contain_text("demo: engage accepted")
            expect(page.locator("#state-word")).to_contain_text("tracking")
        expect(row_of(page, "demo")).to_contain_text("gone")


def test_the_path_ahead_is_drawn_and_is_another_when_another_is_loaded(
    browser: Browser, tmp_path: Path
) -> None:
    place = endpoint()
    plans: list[dict[str, Any]] = []

    def note(text: str | bytes) -> None:
        if isinstance(text, str) and (said := json.loads(text))["kind"] == "plan":
            plans.append(said)

    with dashboard(listen=[place]) as url, visiting(browser, url) as page:
        expect(page.locator("#network")).to_contain_text("vehicle")  # its first connection stands
        page.on("websocket", lambda socket: socket.on("framereceived", note))
        page.reload()
        with flying(place, tmp_path, "supervisor.engage=pilot"):
            expect(page.locator("#state-word")).to_contain_text("ready")
            expect(page.locator("#blocks")).to_contain_text("may be engaged")
            page.get_by_role("button", name="Load trajectory").first.click()
            page.locator("#load-name").select_option("circle")
            page.locator("#load [name=radius_m]").fill("4")
            page.locator("#load button[type=submit]").click()
            page.locator("#confirm-yes").click()
            expect(page.locator("#answer")).to_contain_text("demo: load accepted")
            wait_until_drawn(page, "#scene", 0.1)  # nothing is flown: it is the planned path
            picture(page, "planned")
    helix, circle = ([plan for plan in plans if plan["points"]] or [{}])[0], plans[-1]
    assert not helix["whole"]
    assert circle["whole"]
    assert max(circle["points"]) == pytest.approx(4.0, abs=1e-3)


def test_who_opens_the_page_late_sees_the_last_minute(browser: Browser, watched: Watched) -> None:
    with visiting(browser, watched.url) as page:
        expect(page.locator("#state-word")).to_contain_text("tracking")
        expect(page.locator("#event-list")).to_contain_text("tracking")
        wait_until_drawn(page, "#charts canvas", 0.6)  # of a minute
        picture(page, "late")


def test_a_vehicle_that_takes_no_orders_has_no_buttons(browser: Browser, watched: Watched) -> None:
    with visiting(browser, watched.url) as page:
        expect(page.locator("#name")).to_have_text("uuv-1")
        expect(page.locator("#no-orders")).to_be_visible()
        expect(page.get_by_role("button", name="Abort")).to_have_count(0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_both_themes_are_readable_and_can_be_switched(
    browser: Browser, watched: Watched, scheme: str
) -> None:
    with visiting(browser, watched.url, color_scheme=scheme) as page:
        expect(page.locator("#state-word")).to_contain_text("tracking")
        back = brightness(page)
        assert (back > 0.5) is (scheme == "light")
        assert faint_texts(page) == []
        picture(page, scheme)
        page.locator("#theme").click()
        assert (brightness(page) > 0.5) is (scheme == "dark")
        assert faint_texts(page) == []
        page.reload()  # it is kept
        expect(page.locator("#state-word")).to_contain_text("tracking")
        assert (brightness(page) > 0.5) is (scheme == "dark")


def test_a_phone_shows_all_of_it_without_scrolling_sideways(browser: Browser, watched: Watched) -> None:
    with visiting(browser, watched.url, viewport=PHONE, has_touch=True, color_scheme="light") as page:
        expect(page.locator("#state-word")).to_contain_text("tracking")
        assert overflow_px(page) <= 0
        assert too_wide(page) == []
        small = page.evaluate(
            """() => [...document.querySelectorAll("button")].filter((b) => b.checkVisibility())
                .map((b) => [b.innerText, b.getBoundingClientRect().height]).filter(([, h]) => h < 24)"""
        )
        assert small == []  # the least of WCAG 2.2 for a finger
        picture(page, "phone")


def test_garbage_on_the_keys_is_named_and_the_page_goes_on(browser: Browser, watched: Watched) -> None:
    later = zenoh.Encoding("application/json;guidance.Status/9")
    ours = zenoh.Encoding("application/json;guidance.Status/1")
    with visiting(browser, watched.url) as page:
        expect(page.locator("#state-word")).to_contain_text("tracking")
        for _ in range(3):
            watched.stranger.put("guidance/uuv-9/status", b"{}", encoding=later)
            watched.stranger.put("guidance/uuv-1/status", b"\xff\x00<script>alert(1)</script>", encoding=ours)
            watched.stranger.put("guidance/<b>uuv/status", b"noise")
        expect(page.locator("#ignored")).to_be_visible()
        page.locator("#ignored summary").click()
        for words in ("garbage", "schema version 9", "no name of a vehicle"):
            expect(page.locator("#ignored")).to_contain_text(words)
        expect(row_of(page, "uuv-9")).to_be_visible()
        expect(row_of(page, "uuv-1")).to_contain_text("tracking")
        unheard_of = Status(
            t_ns=time.monotonic_ns(),
            state="constructor",
            reason="",
            since_ns=0,
            armed=None,
            mode="",
            intended_mode="",
            trajectory_start_ns=None,
            origin_ned_m=None,
            setpoints_sent=0,
        )
        watched.stranger.put("guidance/uuv-7/status", msgspec.json.encode(unheard_of), encoding=ours)
        expect(row_of(page, "uuv-7")).to_contain_text("constructor")
        assert error_of(page, "uuv-1") < 0.01
        assert faint_texts(page) == []
        picture(page, "garbage")


def test_an_address_that_names_no_vehicle_opens_the_page(browser: Browser, watched: Watched) -> None:
    for garbage in ("#%", "#<b>"):
        with visiting(browser, watched.url) as page:
            page.goto("about:blank")
            page.goto(watched.url + garbage)
            expect(page.locator("#state-word")).to_contain_text("tracking")


def test_a_vehicle_that_falls_silent_looks_silent_within_a_second(browser: Browser, watched: Watched) -> None:
    """The last test with this vehicle."""
    with visiting(browser, watched.url) as page:
        expect(row_of(page, "uuv-1")).to_contain_text("tracking")
        page.evaluate(
            """() => { window.silentAt = 0; const look = () => {
                const rows = [...document.querySelectorAll("#fleet tbody tr")].map((row) => row.innerText);
                if (rows.some((text) => /uuv-1[^]*silent/.test(text))) window.silentAt = Date.now();
                else requestAnimationFrame(look);
            }; look(); }"""
        )
        watched.ghost.fall_silent()
        fell_s = time.time()
        page.wait_for_function("() => window.silentAt > 0")
        after_s = page.evaluate("window.silentAt") / 1000.0 - fell_s
        assert after_s < 1.5  # within 1 s; a test does not judge the machine
        expect(page.locator("#state-word")).to_contain_text("silent")
        expect(page.locator("#veil")).to_be_visible()
        assert faint_texts(page, "#fleet, #status, #veil") == []  # the figures are dimmed: they are old
        picture(page, "silent")


def test_the_demo_opens_with_it_and_says_where(browser: Browser, tmp_path: Path) -> None:
    with process("guidance", "demo", "--dashboard", cwd=tmp_path, stderr=subprocess.PIPE) as demo:
        assert demo.stderr is not None
        url = next(line.split()[1] for line in demo.stderr if line.startswith("Dashboard: "))
        with visiting(browser, url) as page:
            expect(page.locator("#state-word")).to_contain_text("tracking")
            page.get_by_role("button", name="Abort").click()
            expect(page.locator("#answer")).to_contain_text("demo: abort accepted")
            expect(page.locator("#state-word")).to_contain_text("aborted")
        demo.send_signal(signal.SIGINT)
        rest = demo.stderr.read()
        assert demo.wait(PATIENCE_S) == 130, rest
        assert "log: logs/" in rest
