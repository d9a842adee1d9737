"""What is measured inside the page: contrast, overflow, what is drawn, and who has the keyboard."""

from __future__ import annotations

from typing import Any, Final

from playwright.sync_api import Page

#: WCAG 2: contrast of text with what is behind it, and of large text (24 px, or bold from 18.66 px on).
CONTRAST: Final = 4.5
CONTRAST_LARGE: Final = 3.0

_CONTRASTS: Final = """(within) => {
  const brush = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
  const rgba = (colour) => {
    brush.clearRect(0, 0, 1, 1); brush.fillStyle = colour; brush.fillRect(0, 0, 1, 1);
    const [r, g, b, a] = brush.getImageData(0, 0, 1, 1).data; return [r, g, b, a / 255];
  };
  const over = (top, under) => [0, 1, 2].map((k) => top[k] * top[3] + under[k] * (1 - top[3]));
  const light = (c) => {
    const [r, g, b] = c.map((v) => (v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    const layers = [];
    for (let e = element; e; e = e.parentElement) layers.push(rgba(getComputedStyle(e).backgroundColor));
    return layers.reduceRight((under, top) => over(top, under), [255, 255, 255]);
  };
  const found = [], words = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (words.nextNode()) {
    const text = words.currentNode.textContent.trim(), element = words.currentNode.parentElement;
    if (!text || !element.checkVisibility({visibilityProperty: true, opacityProperty: true})) continue;
    if (!element.closest(within) || element.closest(":disabled, script, style")) continue;
    const style = getComputedStyle(element), back = behind(element);
    let opacity = 1;
    for (let e = element; e; e = e.parentElement) opacity *= Number(getComputedStyle(e).opacity);
    const ink = rgba(style.color); ink[3] *= opacity;
    const [a, b] = [light(over(ink, back)), light(back)].sort((x, y) => y - x);
    const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && style.fontWeight >= 700);
    found.push([text.slice(0, 40), (a + 0.05) / (b + 0.05), large]);
  }
  return found;
}"""


def faint_texts(page: Page, within: str = "body") -> list[Any]:
    """Visible texts that are not told from what is behind them well enough, with their contrast."""
    texts = page.evaluate(_CONTRASTS, within)
    assert texts, f"no text in {within}"
    return [
        (text, round(ratio, 2))
        for text, ratio, large in texts
        if ratio < (CONTRAST_LARGE if large else CONTRAST)
    ]


def overflow_px(page: Page) -> int:
    """How much wider than the window the page is."""
    return int(page.evaluate("document.documentElement.scrollWidth - innerWidth"))


def too_wide(page: Page) -> list[str]:
    """Visible elements that leave the window sideways, those that scroll by themselves excepted."""
    found: list[str] = page.evaluate(
        """() => [...document.body.querySelectorAll("*")].filter((e) => {
            if (!e.checkVisibility()) return false;
            for (let p = e.parentElement; p && p !== document.body; p = p.parentElement)
                if (getComputedStyle(p).overflowX !== "visible") return false;
            const {left, right, width} = e.getBoundingClientRect();
            return width && (right > innerWidth + 1 || left < -1);
        }).map((e) => `${e.tagName} ${e.id || e.className}`)"""
    )
    return found


#: The part of a canvas's columns in which something coloured is drawn: lines of a chart, no axes.
_DRAWN: Final = """(selector) => {
  const canvas = document.querySelector(selector);
  if (!canvas || !canvas.width) return 0;
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", {willReadFrequently: true});
  copy.drawImage(canvas, 0, 0);  // the page's own would be drawn without the graphics card from now on
  const {data} = copy.getImageData(0, 0, canvas.width, canvas.height);
  const columns = new Set();
  for (let k = 0; k < data.length; k += 4) {
    const [low, high] = [Math.min(...data.slice(k, k + 3)), Math.max(...data.slice(k, k + 3))];
    if (data[k + 3] > 128 && high - low > 60) columns.add((k / 4) % canvas.width);
  }
  return columns.size / canvas.width;
}"""


def wait_until_drawn(page: Page, canvas: str, part: float) -> None:
    """Until something coloured is drawn in this part of a canvas's columns."""
    page.wait_for_function(f"([selector, part]) => ({_DRAWN})(selector) > part", arg=[canvas, part])


def drawn_part(page: Page, canvas: str) -> float:
    """The part of a canvas's columns in which something coloured is drawn now."""
    return float(page.evaluate(_DRAWN, canvas))


def brightness(page: Page) -> float:
    """Of the page's background, 0 to 1."""
    return float(
        page.evaluate(
            """() => { const c = document.createElement("canvas").getContext("2d");
            c.fillStyle = getComputedStyle(document.body).backgroundColor; c.fillRect(0, 0, 1, 1);
            const {data} = c.getImageData(0, 0, 1, 1); return (data[0] + data[1] + data[2]) / 765; }"""
        )
    )


def focused(page: Page) -> str:
    """What has the keyboard: its id, or its text."""
    return str(page.evaluate("document.activeElement.id || document.activeElement.innerText || ''"))
