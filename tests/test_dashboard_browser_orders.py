"""What an operator relies on: which vehicle a button is of, what is sent, that all that is shown is fresh."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser_rig import PATIENCE_MS, chromium, picture, visiting
from tests.page_measures import drawn_part, faint_texts, focused
from tests.page_script import URL, Script, scripted, seen


@pytest.fixture(name="browser", scope="module")
def one_browser() -> Iterator[Browser]:
    expect.set_options(timeout=PATIENCE_MS)
    with chromium() as browser:
        yield browser


def choose(page: Page, vehicle: str) -> None:
    page.locator(f"#fleet tr[data-vehicle={vehicle}]").click()


def press(page: Page, verb: str) -> None:
    page.locator(f"#order-{verb}").click()


def test_nothing_of_one_vehicle_stands_under_the_name_of_another_and_no_order_goes_astray(
    browser: Browser,
) -> None:
    with scripted(browser) as (script, page):
        script.about("alpha", session={"profile": "make-of-alpha", "version": "1"}, status=caution("leaks"))
        expect(page.get_by_role("button", name="Abort alpha")).to_be_visible()
        expect(page.locator("#cautions")).to_contain_text("leaks")
        script.flow(0.2)
        expect(page.locator("#readings")).to_contain_text("0.250")
        assert drawn_part(page, "#scene") > 0.0

        choose(page, "bravo")  # and the server has not heard of it yet
        expect(page.locator("#name")).to_have_text("bravo")
        script.rows(error=0.25, north=1.0, east=2.0, down=3.0)
        script.about("alpha", session={"profile": "make-of-alpha", "version": "1"}, status=caution("leaks"))
        script.begin("alpha")
        script.rows(error=0.25, north=1.0, east=2.0, down=3.0)
        script.tell()
        script.flow(0.2)
        expect(page.locator("#orders")).to_be_hidden()
        expect(page.locator("#identity")).to_be_empty()
        expect(page.locator("#cautions")).to_be_hidden()
        assert set(page.locator("#readings b").all_inner_texts()) == {"\N{EN DASH}"}
        assert drawn_part(page, "#scene") == drawn_part(page, "#charts canvas") == 0.0

        script.introduce("bravo")
        expect(page.locator("#identity")).to_contain_text("make-of-bravo")
        page.get_by_role("button", name="Abort bravo").click()
        script.until(lambda: bool(script.orders()))
        assert script.orders() == [("bravo", "abort")]


def caution(text: str) -> dict[str, object]:
    return {"fresh": True, "cautions": [text], "for_s": 1.0, "armed": True, "mode": "", "intended_mode": ""}


def test_a_vehicle_is_asked_for_until_it_comes(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        choose(page, "bravo")
        script.until(lambda: script.looks() == ["alpha", "bravo"])
        choose(page, "bravo")  # whoever clicks again is not ignored
        script.until(lambda: script.looks() == ["alpha", "bravo", "bravo"])
        for _ in range(3):  # what was asked may have been lost
            script.flow(1.1)
            script.tell()
        script.until(lambda: script.looks().count("bravo") == 5)
        script.introduce("bravo")
        expect(page.locator("#order-abort")).to_have_text("Abort bravo")
        script.flow(1.1)
        script.tell()
        choose(page, "bravo")
        press(page, "hold")
        script.until(lambda: script.orders() == [("bravo", "hold")])
        assert script.looks().count("bravo") == 5


def test_a_connection_that_says_nothing_is_named_and_given_up_for_another(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        expect(page.locator("#order-abort")).to_be_visible()
        script.flow(0.25)
        expect(page.locator("#alarm")).to_be_hidden()
        script.flow(0.75)  # the network is gone, and nothing is closed
        expect(page.locator("#alarm")).to_contain_text("what is shown is old")
        expect(page.locator("body")).to_have_class("old")
        assert faint_texts(page, "#alarm") == []
        picture(page, "alarm")
        script.flow(5.0)
        script.until(lambda: len(script.sockets) == 2)
        script.until(lambda: script.looks() == ["alpha", "alpha"])

        def well() -> bool:
            script.tell()
            script.flow(0.25)
            return page.locator("#alarm").is_hidden()

        script.until(well)
        script.introduce("alpha")
        press(page, "hold")
        script.until(lambda: script.orders() == [("alpha", "hold")])


def test_a_connection_that_does_not_come_about_is_given_up_too(browser: Browser) -> None:
    hanging = """window.tries = 0; window.WebSocket = class {
        static OPEN = 1; static CLOSED = 3; readyState = 0;
        constructor() { window.tries += 1; } close() {} };"""

    def hang(page: Page) -> None:
        Script().attach(page)
        page.add_init_script(hanging)

    with visiting(browser, URL, hang) as page:
        page.clock.run_for(2_000)
        expect(page.locator("#alarm")).to_contain_text("does not answer")
        assert page.evaluate("tries") == 1
        page.clock.run_for(10_000)
        assert page.evaluate("tries") == 3


def test_what_stops_goes_at_once_over_a_silent_connection_and_what_moves_does_not(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        expect(page.locator("#order-abort")).to_be_visible()
        script.flow(3.5)
        press(page, "engage")
        page.locator("#confirm-yes").click()
        expect(page.locator("#answer")).to_contain_text("alpha: engage was NOT sent")
        press(page, "hold")
        press(page, "abort")
        expect(page.locator("#answer")).to_contain_text("alpha: abort …")
        script.until(lambda: len(script.orders()) == 2)
        assert script.orders() == [("alpha", "hold"), ("alpha", "abort")]
        script.flow(2.0)
        expect(page.locator("#answer")).to_contain_text("the connection was lost before the answer")


@pytest.mark.parametrize("verb", ["engage", "resume"])
def test_what_moves_a_vehicle_is_asked_once_more(browser: Browser, verb: str) -> None:
    with scripted(browser) as (script, page):
        press(page, verb)
        question = page.get_by_role("alertdialog", name="alpha?")
        expect(question).to_be_visible()
        assert focused(page) == "confirm-no"
        page.keyboard.press("Escape")
        expect(question).to_be_hidden()
        assert focused(page) == f"order-{verb}"
        press(page, verb)
        script.flow(16.0)  # nobody answers
        script.until(lambda: len(script.sockets) > 1)
        script.introduce("alpha")
        expect(question).to_be_hidden()
        press(page, verb)
        page.locator("#confirm-yes").click()
        script.until(lambda: bool(script.orders()))
        assert script.orders() == [("alpha", verb)]


def test_what_is_loaded_is_what_the_question_lists_and_the_form_shows(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        press(page, "load")
        radius = page.locator("#load [name=radius_m]")
        expect(radius).to_have_value("4")
        page.locator("#load button[type=submit]").click()
        expect(page.locator("#confirm-question")).to_have_text("Load circle into alpha?")
        expect(page.locator("#confirm-values")).to_contain_text(
            re.compile("radius, m: 4.*speed, m/s: 1.*clockwise, seen from above: yes", re.DOTALL)
        )
        picture(page, "load-asked")
        page.emulate_media(color_scheme="dark")
        assert faint_texts(page, "#status") == []
        picture(page, "load-asked-dark")
        radius.fill("9")
        expect(page.locator("#confirm")).to_be_hidden()
        page.locator("#load button[type=submit]").click()
        page.locator("#load [name=clockwise]").uncheck()
        expect(page.locator("#confirm")).to_be_hidden()
        page.locator("#load button[type=submit]").click()
        expect(page.locator("#confirm-values")).to_contain_text(
            re.compile("radius, m: 9.*speed, m/s: 1.*clockwise, seen from above: no", re.DOTALL)
        )
        page.locator("#confirm-yes").click()
        script.until(lambda: bool(script.orders()))
        (order,) = [asked for asked in script.asked if asked["ask"] == "order"]
        assert order["vehicle"] == "alpha"
        assert order["fields"]["trajectory"]["radius_m"] == 9.0
        assert order["fields"]["trajectory"]["clockwise"] is False


def test_a_question_goes_with_its_vehicle(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        press(page, "load")
        page.locator("#load button[type=submit]").click()
        expect(page.locator("#confirm")).to_be_visible()
        choose(page, "bravo")
        expect(page.locator("#confirm")).to_be_hidden()
        expect(page.locator("#load")).to_be_hidden()
        script.introduce("bravo")
        expect(page.locator("#order-abort")).to_be_visible()
        expect(page.locator("#confirm")).to_be_hidden()
        expect(page.locator("#load")).to_be_hidden()


def test_an_answer_has_a_time_and_is_news_for_half_a_minute(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        press(page, "abort")
        script.until(lambda: bool(script.orders()))
        script.say(kind="answer", number=1, vehicle="alpha", verb="abort", accepted=True, reason="it is")
        expect(page.locator("#answer")).to_have_class("accepted")
        expect(page.locator("#answer")).to_contain_text("alpha: abort accepted: it is")
        assert page.locator("#answer").inner_text()[2] == ":"  # a time of day stands before it
        script.flow(31.0)
        expect(page.locator("#answer")).to_have_class("")
        expect(page.locator("#answer")).to_contain_text("alpha: abort accepted: it is")


@pytest.mark.parametrize("figure", [1e17, -3e38])
def test_figures_of_any_size_leave_the_page_alive(browser: Browser, figure: float) -> None:
    with scripted(browser) as (script, page):
        script.rows(
            error=figure, error_peak=figure, north=figure, east=figure, down=figure, speed=figure, v1=figure
        )
        script.flow(0.2)
        script.rows(error=figure, speed=2.0)
        script.flow(0.2)
        page.wait_for_function("drawn.frames > 0")
        expect(page.locator("#readings")).to_contain_text("2.00")


def test_what_cannot_be_drawn_leaves_the_rest(browser: Browser) -> None:
    broken = (
        "() => { CanvasRenderingContext2D.prototype.setLineDash = () => { throw new Error('no dashes') }; }"
    )

    def show() -> None:
        with scripted(browser) as (script, page):
            page.evaluate(broken)
            script.rows(error=0.75)
            script.flow(0.2)
            expect(page.locator("#readings")).to_contain_text("0.750")

    with pytest.raises(AssertionError, match="no dashes"):  # the page logged what was wrong
        show()


def test_what_converged_is_drawn_as_at_most_the_least_figure(browser: Browser) -> None:
    texts = """() => { window.texts = new Set();
        const brush = CanvasRenderingContext2D.prototype, fill = brush.fillText;
        brush.fillText = function (text, ...at) { texts.add(text); fill.call(this, text, ...at); }; }"""
    with scripted(browser) as (script, page):
        page.evaluate(texts)
        script.rows(v1=1e-13, v2=1e-5)
        script.flow(0.2)
        assert "≤1e\N{MINUS SIGN}9" in page.evaluate("[...texts]")


def test_a_browser_that_keeps_nothing_shows_all_the_same(browser: Browser) -> None:
    denied = """Object.defineProperty(window, "localStorage", {
        get() { throw new DOMException("denied", "SecurityError"); } });"""
    script = Script()

    def deny(page: Page) -> None:
        script.attach(page)
        page.add_init_script(denied)

    with visiting(browser, URL, deny) as page:
        script.until(lambda: script.looks() == ["alpha"])
        script.introduce("alpha")
        script.flow(0.2)
        assert drawn_part(page, "#scene") > 0.0
        page.locator("#theme").click()
        page.locator("[data-camera=follow]").click()
        expect(page.locator("[data-camera=follow]")).to_have_attribute("aria-pressed", "true")


def test_an_address_of_a_vehicle_that_is_not_there_says_so_and_waits_for_it(browser: Browser) -> None:
    script = Script()
    with visiting(browser, f"{URL}#rov-9", script.attach) as page:
        expect(page.locator("#absent")).to_contain_text("rov-9 is not heard")
        expect(page.locator("#vehicle")).to_be_hidden()
        picture(page, "absent")
        script.fleet.append(seen("rov-9"))
        script.tell()
        expect(page.locator("#name")).to_have_text("rov-9")
        expect(page.locator("#absent")).to_be_hidden()
        page.evaluate("location.hash = '#bravo'")
        expect(page.locator("#name")).to_have_text("bravo")
        script.until(lambda: script.looks()[-1] == "bravo")


def test_by_keyboard_the_orders_are_reached_past_the_fleet(browser: Browser) -> None:
    with scripted(browser) as (_, page):
        expect(page.locator("#order-abort")).to_be_visible()
        expect(page.locator("#spoken")).to_have_text("alpha tracking")
        page.keyboard.press("Tab")
        assert focused(page) == "skip"
        page.keyboard.press("Enter")
        page.keyboard.press("Tab")
        assert focused(page) == "order-engage"


def test_a_reason_that_blocks_is_told_once(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        script.fleet[0] = seen("alpha", "withheld", reason="the compass is off")
        script.tell()
        expect(page.locator("#blocks")).to_contain_text("the compass is off")
        expect(page.locator("#reason")).to_have_text("not ready")
