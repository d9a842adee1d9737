"""What `guidance watch` shows, rendered to text: at 80 columns and at 200, whatever the vehicles do."""

from __future__ import annotations

import re

import pytest
from rich.console import Console
from rich.text import Text

from guidance.fleet import Fleet
from guidance.records import Level
from guidance.watch_view import Connection, duration, ignored_line, line, screen
from tests.fleet_rig import UNIX_OFFSET_NS, S, Sky, event, session, status

T0 = 100 * S
HERE = Connection("", 1, connect=("tcp/192.168.1.2:7447",))
ROUTER_LOST = "heartbeats of 1/1, none of 2/1: is vehicle.system_id right, does the router forward?"


def rendered(
    fleet: Fleet, now_ns: int, width: int, height: int = 40, connection: Connection = HERE
) -> list[str]:
    """The lines of the screen, as wide as they are on it."""
    console = Console(
        width=width, height=height, force_terminal=True, color_system=None, legacy_windows=False
    )
    whole = screen(
        fleet.look(now_ns),
        fleet.notes,
        fleet.ignored,
        connection,
        width=width,
        height=height,
        unix_offset_ns=UNIX_OFFSET_NS,
    )
    with console.capture() as capture:
        console.print(whole)
    lines = [Text.from_ansi(text).plain.rstrip() for text in capture.get().splitlines()]
    assert max(map(len, lines)) <= width
    assert len(lines) <= height
    return lines


def a_busy_sky() -> Sky:
    """One tracks, one fell silent 3 s ago, one has gone, one is of another version, one is refused."""
    sky = Sky()
    sky.fly("uuv-silent", T0 - 5 * S, T0 - 3 * S)
    sky.look(T0 - 3 * S, "uuv-silent")
    sky.fly("uuv-gone", T0 - 5 * S, T0 - 4 * S)
    sky.token(T0 - 4 * S, "uuv-gone", here=False)
    sky.say(T0 - S, "uuv-1", session("aa"), event(T0 - S, "engaged", Level.WARNING))
    sky.fly("uuv-1", T0 - 2 * S, T0)
    lost = status(T0, state="disconnected", reason=ROUTER_LOST, armed=None, mode="")
    sky.say(T0, "rover-1", lost)
    sky.payload(T0, "guidance/newer/status", "application/json;guidance.Status/2")
    return sky


@pytest.mark.parametrize("width", [80, 200])
def test_what_matters_of_each_vehicle_is_on_the_screen(width: int) -> None:
    lines = rendered(a_busy_sky().fleet, T0, width)
    text = "\n".join(lines)
    (row,) = (k for k, shown in enumerate(lines) if shown.startswith("uuv-1 "))
    tracking = " ".join(lines[row : row + 2]) if width == 80 else lines[row]
    words = ("tracking", "offboard", "yes", "0.123", "50.0", "200   12", "50   34", "confirmed")
    for word in (
        *words,
        *(("round trip 0.4 ms", "lost 7", "heartbeat 0.2 s") if width == 80 else ("0.4", "7")),
    ):
        assert word in tracking, (word, tracking)
    assert re.search(
        r"^uuv-silent +silent 3 s$" if width == 80 else r"^uuv-silent +silent 3 s +was", text, re.M
    )
    assert "was tracking (offboard, armed): offboard and armed, confirmed" in text
    assert re.search(r"^uuv-gone +gone 4 s", text, re.M)
    assert re.search(r"^newer +schema 2", text, re.M)
    assert "publishes schema version 2, this reads 1: update the older" in text
    assert re.search(r"^rover-1 +disconnected +\? ", text, re.M)
    assert ROUTER_LOST[:60] in text
    assert re.search(r"^\d\d:\d\d:\d\d uuv-1 engaged$", text, re.M)
    assert "uuv-gone gone: its service ended or left the network" in text
    assert "connected to 1 other (connect tcp/192.168.1.2:7447)" in text
    assert "ignored: newer: schema version 2 x 1 (status: guidance.Status)" in text


def test_columns_stand_under_their_heads() -> None:
    for width in (80, 200):
        lines = rendered(a_busy_sky().fleet, T0, width)
        (row,) = (shown for shown in lines if shown.startswith("uuv-1 "))
        for head, cell in (("setpoints", "50.0"), ("attitude", "200   12"), ("position", "50   34")):
            assert lines[0].index(head) + len(head) == row.index(cell) + len(cell)
        for head, cell in (("state", "tracking"), ("mode", "offboard"), ("armed", "yes")):
            assert lines[0].index(head) == row.index(cell)


@pytest.mark.parametrize(("width", "height"), [(80, 24), (80, 10), (200, 12), (40, 20), (20, 5)])
def test_too_many_vehicles_for_the_terminal_are_counted(width: int, height: int) -> None:
    sky = Sky()
    for k in range(50):
        sky.say(T0, f"uuv-{k:02d}", status(T0), *(event(i, "x" * 300) for i in range(5)))
    lines = rendered(sky.fleet, T0, width, height)
    shown = sum(shown.startswith("uuv-") for shown in lines)
    assert shown >= 1
    if height >= 10:
        assert f"and {50 - shown} more:"[: width - 1] in "\n".join(lines)


def test_long_names_keep_their_end() -> None:
    sky = Sky()
    for name in ("uuv-of-the-northern-fleet-01", "uuv-of-the-northern-fleet-02"):
        sky.say(T0, name, status(T0))
    for width in (80, 200):
        text = "\n".join(rendered(sky.fleet, T0, width))
        assert "…t-01 " in text
        assert "…t-02 " in text


def test_an_empty_screen_says_where_it_looks_and_what_to_pass() -> None:
    nobody = Connection("", 0, connect=("tcp/127.0.0.1:7447",), scouting=True)
    text = "\n".join(rendered(Fleet(), T0, 80, connection=nobody))
    assert "no vehicle yet" in text
    assert "guidance watch --connect tcp/HOST:PORT" in text
    assert "connected to nobody yet (connect tcp/127.0.0.1:7447; scouting)" in text
    opening = nobody._replace(trouble="no session: address in use; trying again every 1 s", vehicle="uuv-1")
    text = "\n".join(rendered(Fleet(), T0, 120, connection=opening))
    assert "no uuv-1 yet" in text
    assert "no session: address in use; trying again every 1 s (connect" in text


def test_what_comes_over_the_network_does_not_steer_the_terminal() -> None:
    sky = Sky()
    evil = "\x1b[2J\x9b31m\rboo\u202e\n[red]"
    sky.say(T0, "uuv-1", status(T0, state=evil, reason=evil, mode=evil), event(T0, evil))
    sky.payload(T0, f"guidance/{evil}/status", evil)
    sky.payload(T0, "guidance/uuv-1/status", evil)
    console = Console(width=200, height=40, force_terminal=True, color_system=None)
    with console.capture() as capture:
        seen = sky.fleet.look(T0)
        console.print(
            screen(seen, sky.fleet.notes, sky.fleet.ignored, HERE, width=200, height=40, unix_offset_ns=0)
        )
    for text in (
        re.sub(r"\x1b\[[0-9;]*m", "", capture.get()),
        line(seen[0]),
        ignored_line(sky.fleet.ignored),
    ):
        assert "boo" in text
        assert "[red]" in text
        assert not set(text) & set("\x1b\x9b\r\u202e")


def test_two_services_under_one_name_are_shouted_about() -> None:
    sky = Sky()
    for k in range(6):
        sky.say(T0 + k, "twin", status(T0, since_ns=k % 2))
    assert "TWO SERVICES publish under this name; offboard" in "\n".join(rendered(sky.fleet, T0, 80))


def test_one_line_for_a_pipe() -> None:
    sky = a_busy_sky()
    lines = {seen.vehicle: line(seen) for seen in sky.fleet.look(T0)}
    assert lines["uuv-1"] == (
        "uuv-1 tracking: offboard and armed, confirmed; offboard, armed; error 0.123 m; setpoints 50.0 Hz; "
        "round trip 0.4 ms, lost 7, heartbeat 0.2 s"
    )
    assert lines["uuv-silent"].startswith("uuv-silent silent 3 s: was tracking (offboard, armed): ")
    assert lines["rover-1"].endswith("; mode unknown, arming unknown")


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.7, "1 s"), (99.4, "99 s"), (100.0, "2 min"), (5999.0, "100 min"), (7200.0, "2 h")],
)
def test_durations_are_short(seconds: float, words: str) -> None:
    assert duration(seconds) == words
