"""`guidance demo --dashboard` without a browser: what it refuses, where it is served, what it opens."""

from __future__ import annotations

import socket
import sys
import webbrowser

import pytest
from typer.testing import CliRunner

from guidance import demo_page
from guidance.cli import app
from guidance.demo_page import dashboard_command, open_page


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
    asked: list[str] = []
    said: list[str] = []

    def browse(url: str) -> bool:
        asked.append(url)
        return True

    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(webbrowser, "open", browse)
    open_page("http://127.0.0.1:8080/", environment, said.append)
    assert asked == ["http://127.0.0.1:8080/"] * opened
    assert bool(said) is not opened
