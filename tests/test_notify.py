"""What the service manager is told, on a fake socket of its own, and that nothing there disturbs a flight."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.notify import RETRY_NS, STATUS_CHARACTERS, Notifier
from guidance.records import Answer, Event, InputKind, Level, Record, Status
from tests.manager_rig import PID, Manager, a_manager

MS: Final = 1_000_000


@pytest.fixture
def manager() -> Iterator[Manager]:
    with a_manager() as made:
        yield made


def link(up: bool, text: str = "listening on 0.0.0.0:14540 (UDP)") -> Event:
    code = InputKind.LINK_UP if up else InputKind.LINK_DOWN
    return Event(t_ns=0, level=Level.INFO, code=code, text=text)


def answer(order: str) -> Answer:
    return Answer(t_ns=0, order=order, id="", source="SIGTERM", accepted=True, reason="")


def status(state: str, reason: str) -> Status:
    return Status(
        t_ns=0,
        state=state,
        reason=reason,
        since_ns=0,
        armed=None,
        mode="",
        intended_mode="",
        trajectory_start_ns=None,
        origin_ned_m=None,
        setpoints_sent=0,
    )


OPEN: Final[list[Record]] = [status("disconnected", "no bytes yet"), link(True)]


# What is said -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["a path", "an abstract name"])
def test_ready_is_said_once_the_link_is_open_and_not_before(kind: str, tmp_path: Path) -> None:
    with a_manager(str(tmp_path / "s") if kind == "a path" else "") as manager:
        notifier = manager.notifier()
        notifier.turn([status("disconnected", "no bytes yet")], 0)
        assert manager.read() == []
        notifier.turn(OPEN, 1)
        assert manager.read() == [{"READY": "1", "STATUS": "disconnected: no bytes yet"}]
        notifier.turn([*OPEN, link(False, "unplugged"), link(True)], 2)
        manager.read()
        assert manager.all("READY") == ["1"]


def test_a_port_that_cannot_be_opened_holds_up_no_boot_and_is_the_status_until_it_is_open(
    manager: Manager,
) -> None:
    notifier = manager.notifier()
    why = "/dev/ttyACM0 cannot be opened: No such file or directory; again in 0.5 s"
    notifier.turn([status("disconnected", "no bytes yet"), link(False, why)], 0)
    assert manager.read() == [{"READY": "1", "STATUS": f"disconnected: {why}"}]
    notifier.turn([link(True)], 1)
    assert manager.read() == [{"STATUS": "disconnected: no bytes yet"}]


def test_status_follows_state_and_reason_and_is_not_repeated(manager: Manager) -> None:
    notifier = manager.notifier()
    notifier.turn(OPEN, 0)
    for state, reason in [("connected", "no origin"), ("connected", "no origin"), ("ready", "waiting")]:
        notifier.turn([status(state, reason)], 1)
    manager.read()
    assert manager.all("STATUS")[1:] == ["connected: no origin", "ready: waiting"]


def test_stopping_is_said_when_the_service_is_told_to_stop_and_when_it_fails(manager: Manager) -> None:
    notifier = manager.notifier()
    notifier.turn([answer("engage"), *OPEN], 0)
    notifier.turn([Event(t_ns=0, level=Level.INFO, code="note", text="shutdown")], 0)
    manager.read()
    assert manager.all("STOPPING") == []
    notifier.turn([answer("shutdown")], 0)
    assert manager.read() == [{"STOPPING": "1"}]
    notifier.failed("a bug")
    assert manager.read() == [{"STOPPING": "1", "STATUS": "a bug"}]


@given(st.text())
def test_no_text_of_the_autopilot_becomes_an_order_to_the_manager(text: str) -> None:
    with a_manager() as manager:
        notifier = manager.notifier()
        notifier.turn([status("aborted", f"refused: {text}\nMAINPID=1\0{'é' * 5000}"), link(True)], 0)
        (message,) = manager.read()  # one datagram, of UTF-8, that fits
    assert message.keys() == {"READY", "STATUS"}
    assert message["STATUS"].startswith("aborted: refused: ")
    assert message["STATUS"].isprintable()
    assert len(message["STATUS"]) == STATUS_CHARACTERS


# The watchdog -------------------------------------------------------------------------------------------


def test_the_watchdog_is_fed_four_times_in_its_period_and_only_by_turns(manager: Manager) -> None:
    notifier = manager.notifier(watchdog_usec=400_000)
    fed_ms = []
    for now_ms in range(1000):
        notifier.turn([], now_ms * MS)
        fed_ms += [now_ms] * len(manager.read())
    assert fed_ms == list(range(0, 1000, 100))
    assert set(manager.all("WATCHDOG")) == {"1"}


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"WATCHDOG_USEC": "0"},
        {"WATCHDOG_USEC": "-5"},
        {"WATCHDOG_USEC": "soon"},
        {"WATCHDOG_USEC": "9" * 5000},
        {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(PID + 1)},
        {"WATCHDOG_USEC": "1000", "WATCHDOG_PID": ""},
    ],
)
def test_a_watchdog_that_is_off_or_of_another_process_is_not_fed(
    manager: Manager, environment: dict[str, str]
) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": manager.named, **environment}, PID)
    for now_ms in range(100):
        notifier.turn(OPEN, now_ms * MS)
    assert manager.read() == [{"READY": "1", "STATUS": "disconnected: no bytes yet"}]


def test_the_watchdog_of_this_process_is_fed(manager: Manager) -> None:
    environment = {"NOTIFY_SOCKET": manager.named, "WATCHDOG_USEC": "1000", "WATCHDOG_PID": str(PID)}
    Notifier(environment, PID).turn([], 0)
    assert manager.read() == [{"WATCHDOG": "1"}]


# A manager that does not listen -------------------------------------------------------------------------


@pytest.mark.parametrize(
    "address", ["", "/no/such/socket", "@nobody", f"/{'x' * 200}", "@", "vsock:2:1234", "relative", "/"]
)
def test_a_socket_that_is_missing_or_refuses_disturbs_nobody(address: str) -> None:
    notifier = Notifier({"NOTIFY_SOCKET": address, "WATCHDOG_USEC": "1000"}, PID)
    for now_ms in range(200):
        notifier.turn(OPEN, now_ms * MS)
    notifier.failed("a bug")


def test_a_sandbox_that_forbids_unix_sockets_disturbs_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: object) -> socket.socket:
        raise PermissionError

    monkeypatch.setattr(socket, "socket", forbidden)
    notifier = Notifier({"NOTIFY_SOCKET": "/run/systemd/notify", "WATCHDOG_USEC": "1000"}, PID)
    notifier.turn(OPEN, 0)
    notifier.failed("a bug")


def test_what_a_full_queue_did_not_take_is_said_later_and_of_the_status_only_the_newest(
    manager: Manager,
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as other:
        other.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                other.sendto(b"X=1", manager.socket.getsockname())
    notifier = manager.notifier(watchdog_usec=1_000_000)
    notifier.turn(OPEN, 0)
    notifier.turn([status("connected", "no origin")], RETRY_NS - 1)
    assert {tuple(message) for message in manager.read()} == {("X",)}
    notifier.turn([], RETRY_NS - 1)  # not at every turn
    assert manager.read() == []
    notifier.turn([], RETRY_NS)
    assert manager.read() == [{"READY": "1", "STATUS": "connected: no origin", "WATCHDOG": "1"}]


def test_a_manager_that_comes_back_is_told_again(tmp_path: Path) -> None:
    path = tmp_path / "s"
    with a_manager(str(path)) as first:
        notifier = first.notifier()
        notifier.turn(OPEN, 0)
    path.unlink()
    notifier.turn([status("ready", "waiting")], 1)
    with a_manager(str(path)) as second:
        notifier.turn([], 1 + RETRY_NS)
        assert second.read() == [{"STATUS": "ready: waiting"}]


def test_at_the_end_the_port_that_failed_is_no_matter_any_more(manager: Manager) -> None:
    notifier = manager.notifier()
    notifier.turn([*OPEN, link(False, "tcp://127.0.0.1:5760 failed: it ended; again in 5 s")], 0)
    notifier.turn([status("finished", "the service was told to stop")], 1)
    assert manager.read()[-1] == {"STATUS": "finished: the service was told to stop"}
    notifier.turn([link(False, "tcp://127.0.0.1:5760 failed")], 2)
    assert manager.read() == []
