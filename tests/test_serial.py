"""Serial ports, over pseudo-terminals: both ways, unplugged and back, busy, and what cannot be opened."""

from __future__ import annotations

import asyncio
import errno
import itertools
import os
import select
import subprocess
import termios
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import uvloop
from pymavlink.dialects.v20 import all as mavlink

from guidance import shell
from guidance.connection import SerialLine
from guidance.mavlink.codec import FrameReader
from guidance.transport import Lost, diagnosis, open_transport
from guidance.transport.base import Transport
from guidance.transport.diagnosis import not_allowed, why_not_opened
from tests.line_rig import LineEnd, PseudoPort
from tests.service_rig import Rig, running

Runner = Callable[[Coroutine[Any, Any, None]], None]
on_both_loops = pytest.mark.parametrize("runner", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])


@pytest.fixture
def port(tmp_path: Path) -> Iterator[PseudoPort]:
    with PseudoPort(tmp_path / "usb-Autopilot-if00") as plugged:
        yield plugged


def opened(line: SerialLine) -> Transport:
    return asyncio.run(open_transport(line, 3.0))


def refusal(path: Path | str) -> str:
    with pytest.raises(Lost) as lost:
        opened(SerialLine(str(path)))
    return str(lost.value)


@contextmanager
def another_program(port: PseudoPort) -> Iterator[str]:
    """Has the port open, and nothing else to do."""
    with subprocess.Popen(["sleep", "60"], stdin=port.slave) as program:
        yield f"sleep (pid {program.pid})"
        program.kill()


@on_both_loops
def test_a_device_that_vanishes_is_said_and_flown_again_when_it_is_back_under_its_name(
    runner: Runner, port: PseudoPort, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02,))

    async def main() -> None:
        async with running(f'link.connection="serial://{port.path}?baud=921600"') as rig:
            vehicle = LineEnd(rig.bell.ring)
            vehicle.speak_over(port.master)
            await rig.bell.until(lambda: rig.memory.events("state_tracking"), "a flight")
            await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > 20, "setpoints")
            before = os.ttyname(port.slave)
            await unplugged_and_back(rig, vehicle, before)
            assert port.path.readlink() != Path(before)
            vehicle.heard.clear()
            await rig.bell.until(partial(vehicle.count, "TIMESYNC"), "an answer over the new device")
            vehicle.close()
        first, second = rig.memory.events("link_down")[:2]
        text = f"serial://{port.path}?baud=921600"
        assert first == f"{text} failed: the device is gone: unplugged, or without power?; again in 0.02 s"
        assert second.startswith(f"{text} cannot be opened: there is no such device: is it plugged in")
        assert len(rig.memory.events("link_up")) == 2
        assert rig.memory.events("link_up")[0] == f"opened {port.path} ({before}) at 921600 baud (serial)"

    async def unplugged_and_back(rig: Rig, vehicle: LineEnd, before: str) -> None:
        vehicle.hang_up()
        port.unplug()
        await rig.bell.until(lambda: len(rig.memory.events("link_down")) > 1, "word of it")
        others = [os.openpty()]  # so that the device comes back by another number
        while os.ttyname(others[-1][1]) != before and len(others) < 20:  # lower ones may have become free
            others.append(os.openpty())
        port.plug()
        vehicle.speak_over(port.master)
        await rig.bell.until(lambda: len(rig.memory.events("link_up")) > 1, "the device")
        for descriptor in itertools.chain(*others):
            os.close(descriptor)

    runner(main())


def test_a_line_that_nobody_reads_blocks_nothing_and_gets_no_late_packet(port: PseudoPort) -> None:
    line = opened(SerialLine(str(port.path)))
    mav = mavlink.MAVLink(None, 1, 191)
    sent = [bytes(mavlink.MAVLink_timesync_message(0, i).pack(mav)) for i in range(1, 10_001)]
    whole = []
    for packet in sent:
        before = line.dropped
        line.send(packet)
        if line.dropped == before:
            whole.append(packet[10:-2])
    assert 0 < len(whole) < len(sent) - 100
    reader = FrameReader(stream=True)
    arrived: list[bytes] = []

    def comes_within(seconds: float) -> bool:
        return bool(select.select([port.master], [], [], seconds)[0])

    for last in (b"", sent[0]):
        if last:  # behind the end of what was begun
            line.send(last)
            whole.append(last[10:-2])
        while comes_within(5.0 if len(arrived) < len(whole) else 0.0):  # the kernel passes it on in its time
            arrived += [frame.payload for frame in reader.feed(os.read(port.master, 65536))]
    assert arrived == whole
    line.close()


@pytest.mark.parametrize("baud", [57600, 921600, 420000])
def test_how_the_port_is_set_up(port: PseudoPort, baud: int) -> None:
    as_found = termios.tcgetattr(port.slave)
    as_found[2] |= termios.HUPCL
    termios.tcsetattr(port.slave, termios.TCSANOW, as_found)
    line = opened(SerialLine(str(port.path), baud, rtscts=True))
    iflag, oflag, cflag, lflag, _, _, cc = termios.tcgetattr(port.slave)
    assert not lflag & (termios.ICANON | termios.ECHO | termios.ISIG)
    assert not iflag & (termios.ICRNL | termios.IXON | termios.ISTRIP)
    assert not oflag & termios.OPOST
    assert cflag & termios.CRTSCTS
    assert not cflag & termios.HUPCL
    assert cc[termios.VMIN] in (1, b"\x01")
    os.write(port.master, bytes(range(256)))
    assert line.receive() == (bytes(range(256)), ())
    assert line.receive() is None
    assert line.address is None
    line.close()


def test_a_port_in_use_names_who_has_it(port: PseudoPort) -> None:
    first = opened(SerialLine(str(port.path)))
    assert "it is in use by another program (to see which: sudo fuser" in refusal(port.path)
    with another_program(port) as program:
        assert f"it is in use by {program}: end that program" in refusal(port.path)
    first.close()
    opened(SerialLine(str(port.path))).close()


def test_who_comes_later_and_asks_for_no_lock_is_kept_out(port: PseudoPort) -> None:
    """The system lets root in all the same, so another user tries."""
    os.chmod(port.slave, 0o666)
    nobody = 65534 if os.geteuid() == 0 else None

    def another() -> str:
        command = ["sh", "-c", ': <>"$0"', os.ttyname(port.slave)]
        tried = subprocess.run(command, user=nobody, env={"LC_ALL": "C"}, capture_output=True, text=True)
        return tried.stderr

    assert another() == ""
    line = opened(SerialLine(str(port.path)))
    assert "busy" in another()
    line.close()


def test_closing_throws_away_what_is_not_sent_yet(port: PseudoPort) -> None:
    line = opened(SerialLine(str(port.path)))
    packet = bytes(mavlink.MAVLink_timesync_message(0, 1).pack(mavlink.MAVLink(None, 1, 191)))
    sent = 0
    while not line.dropped:
        line.send(packet)
        sent += len(packet)
    line.close()
    os.set_blocking(port.master, False)
    arrived = 0
    with suppress(BlockingIOError):
        while True:
            arrived += len(os.read(port.master, 65536))
    assert arrived < sent / 2


def test_a_program_that_reads_along_without_a_lock_is_named(port: PseudoPort) -> None:
    with another_program(port) as program:
        line = opened(SerialLine(str(port.path)))
        assert line.opened.endswith(f"; {program} has it open too and takes bytes away: end it")
        line.close()


def test_what_is_no_serial_port_is_said_to_be_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(diagnosis, "_PORTS", (f"{tmp_path}/by-id/*", f"{tmp_path}/ttyACM*"))
    assert refusal(tmp_path / "ttyACM9").endswith("present: no USB serial port")
    (tmp_path / "ttyACM0").touch()
    assert refusal(tmp_path / "ttyACM9") == (
        f"there is no such device: is it plugged in and powered? present: {tmp_path}/ttyACM0"
    )
    (tmp_path / "round").symlink_to(tmp_path / "about")
    (tmp_path / "about").symlink_to(tmp_path / "round")
    assert refusal(tmp_path / "round") == "its symbolic links lead in a circle"
    (tmp_path / "dangling").symlink_to(tmp_path / "ttyACM9")
    assert refusal(tmp_path / "dangling").startswith("there is no such device")
    for path in (tmp_path / "ttyACM0", tmp_path, tmp_path / "ttyACM0" / "x", Path("/dev/null")):
        assert refusal(path) == "this is not a serial port"


@pytest.mark.parametrize(
    ("mode", "group", "words"),
    [
        (
            0o660,
            20,
            "not allowed (nobody:dialout, mode 0660): sudo usermod -aG dialout root, then log",
        ),
        (0o660, 99999, "sudo usermod -aG 99999 root"),
        (
            0o620,
            5,
            "if a login console has it, sudo systemctl disable --now serial-getty@ttyS9.service",
        ),
        (0o600, 0, 'a udev rule: KERNEL=="ttyS9", GROUP="dialout", MODE="0660"'),
        (0o660, 65534, "the unit hides which group may (PrivateUsers=): look outside the unit: ls -l /"),
        (0o620, 65534, "[Service] SupplementaryGroups=GROUP"),
    ],
)
def test_who_may_not_open_it_is_told_which_group_or_rule_lets_them_in(
    mode: int, group: int, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = {20: "dialout", 0: "root", 5: "tty"}
    users = {0: "root", 65534: "nobody"}
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(
        diagnosis, "_name", lambda i, groups=False: (names if groups else users).get(i, str(i))
    )
    found = os.stat_result((mode, 0, 0, 1, 65534, group, 0, 0, 0, 0))
    with monkeypatch.context() as patched:
        patched.setattr(os, "stat", lambda path: found)
        told = not_allowed(str(tmp_path / "ttyS9"))
    assert words in told
    assert "nogroup" not in told
    assert "65534" not in told


def test_a_device_that_the_unit_does_not_list_is_allowed_there_and_by_no_group(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyXR0")
    told = why_not_opened(str(tmp_path / "by-id"), PermissionError(errno.EPERM, "Operation not permitted"))
    assert told.startswith(
        "not allowed by the systemd unit or the container (DevicePolicy=): DeviceAllow= of "
    )
    assert told.endswith(f"[Service] DeviceAllow={tmp_path}/ttyXR0 rw")
    assert "usermod" not in told


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.EIO, "Input/output error"), "the device does not answer (Input/output error): unplug"),
        (termios.error(errno.ENOTTY, "no"), "this is not a serial port"),
        (PermissionError(errno.EACCES, "no"), "not allowed, not even to look at it: No such file"),
        (OSError(errno.EMFILE, "Too many open files"), "Too many open files"),
        (ValueError("Failed to set custom baud rate"), "Failed to set custom baud rate"),
    ],
)
def test_every_error_at_opening_has_words(error: Exception, words: str, tmp_path: Path) -> None:
    assert why_not_opened(str(tmp_path / "none"), error).startswith(words)
