"""A page that is open while the dashboard is installed anew: it must not go on as what it was."""

from __future__ import annotations

import pytest
from playwright.sync_api import expect

from guidance.dashboard import server
from guidance.dashboard.server import File, files, fingerprint
from tests.browser_rig import PATIENCE_MS, chromium, free_port
from tests.test_dashboard_server import Sky, kind, page, serving, until


def test_every_file_counts_and_the_same_files_are_the_same_page() -> None:
    whole = files()
    assert fingerprint(whole) == fingerprint(dict(reversed(whole.items())))
    for path, file in whole.items():
        assert fingerprint({**whole, path: File(file.kind, file.body + b" ")}) != fingerprint(whole)
        assert fingerprint({other: whole[other] for other in whole if other != path}) != fingerprint(whole)


def test_the_server_says_which_page_it_has() -> None:
    with serving(Sky()) as served, page(served.port) as one:
        assert until(one, kind("welcome"))["page"] == fingerprint(files())


def test_an_open_page_loads_the_new_one_and_stays_as_it_is_after_a_restart(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = free_port()
    with chromium() as browser:
        open_page = browser.new_page()
        open_page.set_default_timeout(PATIENCE_MS)
        with serving(Sky(), port=port):
            open_page.goto(f"http://127.0.0.1:{port}/")
            expect(open_page.locator("#network")).to_contain_text("0 of 0")
            open_page.evaluate("window.itself = true")
        expect(open_page.locator("#alarm")).to_be_visible()
        with serving(Sky(), port=port):
            expect(open_page.locator("#alarm")).to_be_hidden(timeout=PATIENCE_MS)
            assert open_page.evaluate("window.itself") is True
        changed = files()
        changed["/page.css"] = File(changed["/page.css"].kind, changed["/page.css"].body + b"\n")
        monkeypatch.setattr(server, "files", lambda: changed)
        with serving(Sky(), port=port):
            open_page.wait_for_function("() => window.itself === undefined")
            expect(open_page.locator("#network")).to_contain_text("0 of 0")
