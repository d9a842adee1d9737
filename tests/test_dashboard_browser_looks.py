"""What is drawn, and how it looks: nothing old as if it were new, nothing cut off, on laptop and phone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser, Page, expect

from tests.browser_rig import PATIENCE_MS, PHONE, chromium, picture
from tests.page_measures import drawn_part, faint_texts, overflow_px
from tests.page_script import scripted, seen

POSE = {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "field_x": 1.0, "field_y": 0.0, "field_z": 0.0}
AT = {"north": -1.52, "east": 3.7, "down": -3.0, **POSE}
LONG = "a-name-as-long-as-a-name-may-be-and-without-a-space-in-it-anywhere"[:64]
NOTE_TEXTS = """() => { window.texts = new Set();
    const brush = CanvasRenderingContext2D.prototype, fill = brush.fillText;
    brush.fillText = function (text, ...at) { texts.add(text); fill.call(this, text, ...at); }; }"""


#: Hull, fin and the heads of arrows are filled, and nothing else.
COUNT_FILLED = """() => { window.filled = 0;
    const brush = CanvasRenderingContext2D.prototype, fill = brush.fill;
    brush.fill = function () { filled += 1; fill.call(this); }; }"""
PIXELS = "document.getElementById('scene').toDataURL()"


@pytest.fixture(name="browser", scope="module")
def one_browser() -> Iterator[Browser]:
    expect.set_options(timeout=PATIENCE_MS)
    with chromium() as browser:
        yield browser


def texts(page: Page) -> set[str]:
    """What was written in canvases since the last look."""
    written = set(page.evaluate("[...texts]"))
    page.evaluate("texts.clear()")
    return written


def test_a_pose_that_is_old_says_so_beside_what_is_new(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        page.evaluate(NOTE_TEXTS)
        script.rows(20, error=0.2, **AT)
        script.flow(0.2)
        assert not any(text.startswith("position") for text in texts(page))
        script.rows(count=40, error=0.2)  # two seconds without a state
        script.flow(0.2)
        assert any(text.startswith("position 2.") for text in texts(page))
        page.evaluate(COUNT_FILLED)
        script.rows(count=2, error=0.2)
        script.flow(0.2)
        assert page.evaluate("filled") == 0, "an outline, and no arrow to where it was to go"
        expect(page.locator("#readings")).to_contain_text("0.200")
        expect(page.locator("#readings")).to_contain_text("Last north\N{MINUS SIGN}1.52")
        script.rows(2, error=0.2, **AT)
        script.flow(0.2)
        assert page.evaluate("filled") > 0


def test_of_a_vehicle_that_is_lost_the_way_and_the_last_place_stay(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        script.rows(20, error=0.2, **AT)
        script.flow(0.2)
        live = drawn_part(page, "#scene")
        page.locator("[data-window='30']").click()
        script.fleet[0] = seen("alpha", contact="silent", quiet_s=34.0)
        for _ in range(34):
            script.flow(1.0)
            script.tell()
        readings = page.locator("#readings")
        expect(readings).to_contain_text("Last up3.00")
        expect(readings).to_contain_text("Last north\N{MINUS SIGN}1.52")
        expect(readings).to_contain_text("Last east3.70")
        expect(page.locator("#veil")).to_contain_text("silent for 34 s")
        assert drawn_part(page, "#scene") > 0.5 * live
        assert faint_texts(page, "#veil") == []
        picture(page, "lost")


FITS = """async () => {
  const { Camera } = await import("/camera.js");
  const out = [];
  for (const [width, height] of [[900, 470], [360, 320]])
    for (const [turn, tilt] of [[-0.6, 0.95], [0, 0], [1.2, 0.4], [0.3, 1.57]])
      for (const box of [[80, 8, 3], [8, 80, 1], [5, 5, 40]]) {
        const camera = new Camera();
        Object.assign(camera, { turn, tilt });
        camera.frame(box); camera.lens(width, height);
        const places = [-1, 1].flatMap((n) => [-1, 1].flatMap((e) => [-1, 1].map((d) =>
          camera.place(n * box[0] / 2, e * box[1] / 2, d * box[2] / 2))));
        const xs = places.map(([x]) => x), ys = places.map(([, y]) => y);
        const [left, right] = [Math.min(...xs) / width, Math.max(...xs) / width];
        const [top, bottom] = [Math.min(...ys), Math.max(...ys)];
        out.push([left, right, top, height - bottom, Math.max(right - left, (bottom - top) / height)]);
      }
  return out; }"""


def test_fit_shows_all_of_it_and_as_large_as_there_is_room(browser: Browser) -> None:
    with scripted(browser) as (_, page):
        for left, right, above_px, below_px, filled in page.evaluate(FITS):
            assert left >= 0.0499
            assert right <= 0.9501
            assert above_px >= 54.9, "buttons and keys are there"
            assert below_px >= 34.9, "the scale is there"
            assert filled > 0.7


def test_what_is_near_goes_with_the_hand(browser: Browser) -> None:
    moved = """async () => {
      const { Camera, handle } = await import("/camera.js");
      const canvas = document.createElement("canvas"), camera = new Camera();
      handle(camera, canvas, document.getElementById("camera"), () => {});
      canvas.setPointerCapture = () => {};
      const send = (kind, x, y, more) =>
        canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, clientX: x, clientY: y, ...more }));
      Object.assign(camera, { turn: 0, tilt: 0.8 });
      const near = () => { camera.lens(400, 400); return camera.place(-1, 0, 0); };
      const at = near(); send("pointerdown", 0, 0); send("pointermove", 20, 0); const turned = near();
      send("pointermove", 20, 0); send("pointermove", 50, 10, { shiftKey: true }); const panned = near();
      return [turned[0] - at[0], panned[0] - turned[0], panned[1] - turned[1]]; }"""
    with scripted(browser) as (_, page):
        turned, *panned = page.evaluate(moved)
        assert turned > 0.0
        assert panned == pytest.approx([30.0, 10.0])


@pytest.mark.parametrize("gap_s", [1.0, 2000.0, 3000.0, 4000.0])
def test_time_goes_on_however_long_nothing_came(browser: Browser, gap_s: float) -> None:
    times = """async (gap) => {
      const { Rows } = await import("/rows.js");
      const rows = new Rows(); rows.begin(["t"], 4096, 100);
      rows.take(new Float32Array([4000.0])); rows.take(new Float32Array([(4000.0 + gap) % 4096]));
      rows.take(new Float32Array([(4000.0 + gap + 0.05) % 4096]));
      return [...rows.times.slice(0, 3)]; }"""
    with scripted(browser) as (_, page):
        at = page.evaluate(times, gap_s)
        assert at == pytest.approx([4000.0, 4000.0 + gap_s, 4000.05 + gap_s], abs=1e-3)


@pytest.mark.parametrize(
    ("asked", "shown", "hidden"),
    [
        ("rates_speed", ["yaw-rate", "speed", "thrust"], ["v-north", "bank"]),
        ("rates_throttle", ["yaw-rate", "thrust"], ["speed", "v-north", "bank"]),
        ("attitude_throttle", ["bank", "pitch", "thrust"], ["yaw-rate", "v-north"]),
        ("velocity", ["v-north", "v-east", "v-down", "yaw-rate"], ["thrust", "bank"]),
        ("level_velocity", ["v-north", "v-east"], ["v-down", "yaw-rate", "thrust"]),
        ("__proto__", ["yaw-rate", "speed"], []),
    ],
)
def test_charts_are_of_what_the_vehicle_is_told(
    browser: Browser, asked: str, shown: list[str], hidden: list[str]
) -> None:
    with scripted(browser) as (script, page):
        script.about("alpha", asked=asked)
        for chart in shown:
            expect(page.locator(f"#chart-{chart}")).to_be_attached()
        for chart in hidden:
            expect(page.locator(f"#chart-{chart}")).not_to_be_attached()


CUT_OFF = """() => [...document.querySelectorAll("#fleet tbody tr")].flatMap((line) => {
  const table = document.getElementById("fleet").parentElement.getBoundingClientRect();
  const cells = [...line.cells].filter((cell) => cell.checkVisibility());
  return cells.flatMap((cell, k) => {
    const at = cell.getBoundingClientRect(), next = cells[k + 1]?.getBoundingClientRect();
    const inside = cell.querySelector("button")?.getBoundingClientRect() ?? at;
    const told = k > 0 && cell.cellIndex !== 2;
    if (told && cell.scrollWidth > cell.clientWidth) return [cell.textContent];
    return at.right > table.right + 1 || (next && inside.right > next.left + 1) ? [cell.textContent] : [];
  });
})"""


@pytest.mark.parametrize(("width", "height"), [(1440, 900), (390, 844), (360, 740)])
def test_ten_vehicles_of_any_name_fit(browser: Browser, width: int, height: int) -> None:
    with scripted(browser, viewport={"width": width, "height": height}) as (script, page):
        odd: list[dict[str, Any]] = [
            seen(LONG, error_m=1234.56, mode="AUTO.LOITER", round_trip_s=0.0123),
            seen("guided", error_m=0.1, mode="offboard", round_trip_s=0.0123),
            seen("holder", "holding", error_m=0.1),
            seen("lost", contact="silent", quiet_s=34.0),
            seen("deaf", heartbeat_age_s=5.0, error_m=0.2),
            seen("twins", doubled=True),
        ]
        script.fleet += [*odd, *(seen(f"rover-{k}", error_m=0.25) for k in range(2))]
        script.tell()
        expect(page.locator("#fleet tbody tr")).to_have_count(10)
        assert overflow_px(page) <= 0
        assert page.evaluate(CUT_OFF) == []
        mode = page.locator("#fleet tr[data-vehicle=guided] td").nth(1)
        assert mode.evaluate("(cell) => cell.scrollWidth <= cell.clientWidth")
        for name in ("deaf", "twins", "lost"):
            expect(page.locator(f"#fleet tr[data-vehicle={name}]")).to_have_attribute("data-tone", "bad")
        expect(page.locator("#fleet tr[data-vehicle=deaf] .state")).to_contain_text("link quiet 5.0 s")
        assert faint_texts(page) == []
        picture(page, f"fleet-{width}")


def test_what_is_kept_of_a_vehicle_that_is_lost_is_as_old_as_it_is(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        page.evaluate(NOTE_TEXTS)
        script.fleet[0] = seen("alpha", contact="silent", quiet_s=600.0)
        script.tell()
        script.begin("alpha", kept=20, age_s=600.0)
        script.rows(20, error=0.2, **AT)
        script.flow(0.3)
        page.wait_for_function("[...texts].some((text) => text.startsWith('position'))")
        assert "position 10 min old" in texts(page)
        expect(page.locator("#readings")).to_contain_text("Last north\N{MINUS SIGN}1.52")
        script.rows(1, error=0.2, **AT)  # it is back
        texts(page)
        script.flow(0.2)
        assert not any(text.startswith("position") for text in texts(page))


def test_another_vehicle_is_fitted_anew_wherever_the_last_one_was_left(browser: Browser) -> None:
    with scripted(browser) as (script, page):
        script.rows(20, error=0.2, **AT)
        script.flow(0.2)
        first = page.evaluate(PIXELS)
        at = page.locator("#scene").bounding_box()
        assert at is not None
        page.keyboard.down("Shift")
        page.mouse.move(at["x"] + 100, at["y"] + 100)
        page.mouse.down()
        page.mouse.move(at["x"] + 5000, at["y"] + 100)
        page.mouse.up()
        page.keyboard.up("Shift")
        script.flow(0.2)
        assert page.evaluate(PIXELS) != first
        page.locator("#fleet tr[data-vehicle=bravo]").click()
        script.introduce("bravo")
        script.rows(20, error=0.2, **AT)
        script.flow(0.2)
        assert page.evaluate(PIXELS) == first


def test_on_a_phone_abort_is_in_reach_wherever_the_page_is(browser: Browser) -> None:
    with scripted(browser, viewport=PHONE) as (script, page):
        script.rows(20, error=0.2, **AT)
        script.flow(0.2)
        script.fleet += [seen(f"rover-{k}") for k in range(8)]
        script.tell()
        abort = page.locator("#order-abort")
        expect(page.locator("#fleet tbody tr")).to_have_count(10)
        expect(abort).to_be_in_viewport(ratio=1)
        page.locator("#fleet tr[data-vehicle=bravo]").click()
        expect(page.locator("#name")).to_be_in_viewport()
        script.introduce("bravo")
        page.evaluate("scrollTo(0, document.body.scrollHeight)")
        expect(abort).to_be_in_viewport(ratio=1)
        expect(page.locator("#event-list")).to_be_in_viewport()
        picture(page, "phone-abort")
        before = abort.bounding_box()
        script.flow(1.0)
        expect(page.locator("#alarm")).to_be_visible()
        assert abort.bounding_box() == before, "it does not move away under a thumb"
        abort.click()
        script.until(lambda: script.orders() == [("bravo", "abort")])
