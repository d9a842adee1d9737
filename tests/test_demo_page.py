"""`guidance demo --dashboard` without a browser: what it refuses, where it is served, what it opens."""

from __future__ import annotations

import queue
import socket
import sys
import threading
import webbrowser
from typing import Final

import pytest
from typer.testing import CliRunner

from guidance import demo_page
from guidance.browser import open_page
from guidance.cli import app
from guidance.demo_page import dashboard_command

PATIENCE_S: Final = 20.0


def test_without_its_extra_it_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_page, "find_spec", lambda name: None)
    outcome = CliRunner().invoke(app, ["demo", "--dashboard"])
    assert outcome.exit_code == 2
    assert "pip install 'se3-guidance[dashboard]'" in outcome.output


def test_what_is_flown_from_a_page_is_not_judged() -> None:
    outcome = CliRunner().invoke(app, ["demo", "--dashboard", "--json"])
    assert outcome.exit_code == 2
    assert "give either" in outcome.output


def test_a_wrong_setting_is_refused_before_anything_starts() -> None:
    outcome = CliRunner().invoke(app, ["demo", "--dashboard", "--set", "law.k=-1"])
    assert outcome.exit_code == 2
    assert "law.k" in outcome.output


def test_a_taken_port_is_not_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as somebody:
        port = somebody.getsockname()[1]
        monkeypatch.setattr(demo_page, "PORT", port)
        assert dashboard_command("tcp/127.0.0.1:7447")[-2:] == ["--port", "0"]
    assert dashboard_command("tcp/127.0.0.1:7447")[-2:] == ["--port", str(port)]


@pytest.mark.parametrize(
    ("platform", "environment", "opened"),
    [
        ("linux", {}, False),
        ("linux", {"DISPLAY": ":0"}, True),
        ("linux", {"WAYLAND_DISPLAY": "wayland-0"}, True),
        ("darwin", {}, True),
    ],
)
def test_a_browser_is_opened_where_there_is_a_display(
    platform: str, environment: dict[str, str], opened: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: queue.Queue[str] = queue.Queue()
    said: list[str] = []

    def browse(url: str) -> bool:
        asked.put(url)
        return True

    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(webbrowser, "open", browse)
    open_page("http://127.0.0.1:8080/", environment, said.append)
    if opened:
        assert asked.get(timeout=PATIENCE_S) == "http://127.0.0.1:8080/"
    assert asked.empty()
    assert bool(said) is not opened


def test_a_browser_that_comes_back_when_it_is_closed_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as one that BROWSER names; the page that it waits for is served by who opened it."""
    closed, ended = threading.Event(), threading.Event()

    def browse(_: str) -> bool:
        closed.wait(PATIENCE_S)
        ended.set()
        return True

    monkeypatch.setattr(webbrowser, "open", browse)
    open_page("http://127.0.0.1:8080/", {"DISPLAY": ":0"}, pytest.fail)
    assert not ended.is_set()
    closed.set()
    assert ended.wait(PATIENCE_S)


@pytest.mark.parametrize("error", [None, webbrowser.Error("could not locate runnable browser")])
def test_without_a_browser_it_says_what_to_do(
    error: webbrowser.Error | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def browse(_: str) -> bool:
        if error is not None:
            raise error
        return False

    said: queue.Queue[str] = queue.Queue()
    monkeypatch.setattr(webbrowser, "open", browse)
    open_page("http://127.0.0.1:8080/", {"DISPLAY": ":0"}, said.put)
    assert said.get(timeout=PATIENCE_S) == "--open: no browser found; open the page by hand"
