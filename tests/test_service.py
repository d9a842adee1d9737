"""The service's shell on real sockets of the loopback: who is answered, in which order, and how it ends."""

from __future__ import annotations

import asyncio
import errno
import time
from collections.abc import Callable, Coroutine
from functools import partial
from typing import Any

import pytest
import uvloop
from pymavlink.dialects.v20 import all as mavlink

from guidance import shell
from guidance.commands import Engage, Shutdown
from guidance.records import Packet, State
from guidance.shell import Shell
from guidance.telemetry import Sample
from guidance.transport import Lost
from tests.helpers import make_config
from tests.service_rig import PATIENCE_S, Rig, VehicleEnd, a_socket, received, running, vehicle_for

Runner = Callable[[Coroutine[Any, Any, None]], None]
on_both_loops = pytest.mark.parametrize("runner", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])


def heartbeat(system: int) -> bytes:
    data: bytes = mavlink.MAVLink_heartbeat_message(12, 12, 81, 0, 4, 3).pack(
        mavlink.MAVLink(None, system, 1)
    )
    return data


@on_both_loops
def test_only_the_configured_autopilot_is_answered_and_nobody_can_divert_its_setpoints(
    runner: Runner,
) -> None:
    async def main() -> None:
        with a_socket() as stranger:
            async with running('supervisor.engage="pilot"') as rig:
                address = await rig.address()
                for data in (b"who are you?", heartbeat(2)):  # before the autopilot
                    stranger.sendto(data, address)
                async with vehicle_for(rig) as vehicle:
                    await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > 5, "a stream")
                    for data in (b"\xfe\x00", heartbeat(2), heartbeat(1)):  # after it, even in its name
                        stranger.sendto(data, address)
                    await rig.bell.until(lambda: rig.memory.events("note"), "word of the second address")
                    count = vehicle.count("SET_ATTITUDE_TARGET")
                    await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > count + 5, "more")
            assert received(stranger) == []
            assert len(rig.memory.events("note")) == 1
            assert "two vehicles of one id?" in rig.memory.events("note")[0]

    runner(main())


def test_a_way_that_is_found_lost_by_writing_is_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading may go on as if nothing were: a USB adapter's two directions fail one by one."""
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02,))

    def lost(packet: bytes) -> None:
        raise Lost("no way out")

    async def main() -> None:
        async with running('supervisor.engage="pilot"') as rig, vehicle_for(rig) as vehicle:
            await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > 5, "a stream")
            monkeypatch.setattr(rig.shell._transport, "send", lost)
            await rig.bell.until(lambda: len(rig.memory.events("link_up")) == 2, "a new transport")
        (down,) = rig.memory.events("link_down")
        assert down.endswith("failed: no way out; again in 0.02 s")

    asyncio.run(main())


def test_a_vehicle_that_comes_back_from_another_port_is_answered_there() -> None:
    async def main() -> None:
        async with running('supervisor.engage="pilot"', "link.heartbeat_timeout_s=1.5") as rig:
            for _ in range(2):
                async with vehicle_for(rig) as vehicle:
                    await rig.bell.until(partial(vehicle.count, "HEARTBEAT"), "an answer")

    uvloop.run(main())


@on_both_loops
def test_udpout_writes_first_and_packets_leave_before_their_records_are_made(runner: Runner) -> None:
    async def main() -> None:
        with a_socket() as autopilot:
            seen: list[tuple[bytes, bytes]] = []
            connection = f'link.connection="udpout://127.0.0.1:{autopilot.getsockname()[1]}"'
            async with running(connection) as rig:
                keep = rig.memory.offer

                def offer(sample: Sample) -> None:
                    keep(sample)
                    record = rig.memory.records[-1]
                    if isinstance(record, Packet):
                        try:
                            seen.append((record.data, autopilot.recv(2048)))
                        except BlockingIOError:
                            seen.append((record.data, b"nothing was sent yet"))

                rig.memory.offer = offer  # type: ignore[method-assign]
                await rig.bell.until(lambda: seen, "a packet")
            assert [recorded for recorded, _ in seen] == [sent for _, sent in seen]
            first = mavlink.MAVLink(None).parse_buffer(seen[0][1])[0]
            assert (first.get_type(), first.get_srcComponent()) == ("HEARTBEAT", 191)

    runner(main())


@on_both_loops
def test_a_port_in_use_is_said_and_opened_as_soon_as_it_is_free(
    runner: Runner, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02, 0.04))

    async def main() -> None:
        with a_socket() as other:
            port = other.getsockname()[1]
            async with running(f'link.connection="udpin://127.0.0.1:{port}"') as rig:
                await rig.bell.until(lambda: len(rig.memory.events("link_down")) > 2, "three attempts")
                assert rig.memory.events("link_up") == []
                other.close()
                await rig.bell.until(lambda: rig.memory.events("link_up"), "an open socket")
        first, second, third = rig.memory.events("link_down")[:3]
        assert first == f"udpin://127.0.0.1:{port} cannot be opened: Address already in use; again in 0.02 s"
        assert second.endswith("0.04 s")
        assert third.endswith("0.04 s")

    runner(main())


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b"])
def test_a_host_that_has_no_address_is_said_and_tried_again(
    host: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02,))

    async def main() -> None:
        async with running(f'link.connection="udpout://{host}:14540"') as rig:
            await rig.bell.until(lambda: len(rig.memory.events("link_down")) > 1, "two attempts")
        assert rig.memory.events("link_down")[0].startswith(f"udpout://{host}:14540 cannot be opened: ")

    asyncio.run(main())


def test_a_socket_that_fails_is_closed_and_opened_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02,))

    async def main() -> None:
        async with running() as rig:
            host, port = await rig.address()

            def fail(size: int) -> tuple[bytes, Any]:
                raise OSError(errno.EIO, "Input/output error")

            monkeypatch.setattr(rig.shell._transport, "_recvfrom", fail)
            with a_socket() as sock:
                sock.sendto(b"wake up", (host, port))
                await rig.bell.until(lambda: len(rig.memory.events("link_up")) > 1, "a new socket")
        assert rig.memory.events("link_down") == [
            "udpin://127.0.0.1:0 failed: Input/output error; again in 0.02 s"
        ]

    asyncio.run(main())


def test_a_refusal_is_said_once_and_the_service_goes_on() -> None:
    async def main() -> None:
        with a_socket() as closed:
            port = closed.getsockname()[1]
        async with running(f'link.connection="udpout://127.0.0.1:{port}"') as rig:

            def refused() -> int:
                return sum(isinstance(record, Packet) for record in rig.memory.records)

            await rig.bell.until(lambda: refused() > 1, "two heartbeats to nobody")
            vehicle = VehicleEnd(None, rig.bell.ring)
            await vehicle.open(port)
            await rig.bell.until(lambda: rig.memory.events("state_tracking"), "a flight")
            vehicle.close()
            await rig.bell.until(lambda: rig.memory.events("state_handed-over"), "the end of it")
        assert len(rig.memory.events("note")) == 1
        assert "refused" in rig.memory.events("note")[0]

    uvloop.run(main())


@on_both_loops
def test_after_a_refusal_the_socket_still_wakes_the_service(runner: Runner) -> None:
    """uvloop stops waiting on a descriptor that had an error (found with a timer that never fires)."""

    async def main() -> None:
        with a_socket() as closed:
            port = closed.getsockname()[1]
        async with running(f'link.connection="udpout://127.0.0.1:{port}"') as rig:
            await rig.bell.until(lambda: rig.memory.events("note"), "a refusal")
            guide = rig.shell._guide
            deadline = guide.deadline
            guide.deadline = lambda: time.monotonic_ns() + 10**12  # type: ignore[method-assign]
            with a_socket(port) as autopilot:
                assert rig.shell.address is not None
                autopilot.sendto(heartbeat(1), rig.shell.address)
                await rig.bell.until(lambda: guide.link.received, "the heartbeat to be read")
            guide.deadline = deadline  # type: ignore[method-assign]

    runner(main())


@on_both_loops
def test_a_burst_of_old_datagrams_leads_to_one_setpoint_from_the_newest(runner: Runner) -> None:
    async def main() -> None:
        async with running('supervisor.engage="pilot"') as rig, vehicle_for(rig) as vehicle:
            await rig.bell.until(lambda: len(rig.memory.setpoints()) > 20, "a stream")
            stall_ns = time.monotonic_ns()
            while time.monotonic_ns() < stall_ns + 100_000_000:
                pass  # neither runs: the loop is busy elsewhere
            sent = len(vehicle.sent)
            vehicle.live()  # all that the vehicle has said meanwhile, at once
            burst_ns = time.monotonic_ns()
            burst = [m for m in vehicle.sent[sent:] if m.get_type() == "ODOMETRY"]
            assert len(burst) >= 4
            before = len(rig.memory.setpoints())
            await rig.bell.until(lambda: len(rig.memory.setpoints()) > before + 1, "two more setpoints")
            states = [r for r in rig.memory.records if isinstance(r, State) and r.t_ns >= burst_ns]
            assert states[0].vehicle_time_ms == burst[-1].time_usec // 1000
            assert states[1].t_ns - states[0].t_ns > 10_000_000

    runner(main())


@pytest.mark.parametrize("where", ["receive", "tick"])
def test_a_bug_ends_the_service_and_no_packet_follows(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        rig = Rig(make_config('link.connection="udpin://127.0.0.1:0"'))
        async with vehicle_for(rig):
            await rig.bell.until(lambda: rig.memory.events("state_tracking"), "a flight")

            def broken(*_: object) -> None:
                monkeypatch.undo()  # whatever is called after this would work again
                raise OSError("a bug")

            monkeypatch.setattr(rig.shell._guide, where, broken)
            with pytest.raises(OSError, match="a bug"):
                await asyncio.wait_for(rig.run, PATIENCE_S)
            count = len(rig.memory.records)
            rig.shell.command(Engage())
            rig.shell._turn()
            assert len(rig.memory.records) == count
            assert rig.shell.address is None

    uvloop.run(main())


def test_a_bug_in_a_task_of_the_shell_ends_it_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "WATCH_S", 0.01)

    def broken(_: Shell) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(Shell, "look_at_sinks", broken)

    async def main() -> None:
        rig = Rig(make_config('link.connection="udpin://127.0.0.1:0"'))
        with pytest.raises(ZeroDivisionError):
            await asyncio.wait_for(rig.run, PATIENCE_S)

    asyncio.run(main())


def test_what_is_wrong_with_a_sink_is_noted_once_and_once_when_it_is_well_again() -> None:
    async def main() -> None:
        async with running() as rig:
            for seconds in (3, 4, 5):
                rig.memory.problem = f"the disk has not answered for {seconds} s; {seconds}00 records lost"
                rig.shell.look_at_sinks()
            rig.memory.problem = "no log is written any more: 3 MiB free"
            rig.shell.look_at_sinks()
            for rig.memory.problem in ("", ""):
                rig.shell.look_at_sinks()
        assert rig.memory.events("note") == [
            "memory: the disk has not answered for 3 s; 300 records lost",
            "memory: no log is written any more: 3 MiB free",
            "memory: well again",
        ]

    asyncio.run(main())


def test_a_shutdown_before_anything_is_connected_is_immediate_and_a_second_one_changes_nothing() -> None:
    async def main() -> None:
        async with running() as rig:
            await rig.address()
            rig.shell.command(Shutdown())
            assert rig.shell.finished
            count = len(rig.memory.records)
            rig.shell.command(Shutdown())
            assert len(rig.memory.records) == count

    asyncio.run(main())


def test_a_flood_of_garbage_does_not_stop_the_setpoints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "READ_AT_MOST_NS", 0)  # a turn after every datagram

    async def main() -> None:
        with a_socket() as stranger:
            async with running('supervisor.engage="pilot"') as rig, vehicle_for(rig) as vehicle:
                address = await rig.address()
                await rig.bell.until(lambda: rig.memory.setpoints(), "a stream")
                for _ in range(20):
                    vehicle.heard.clear()
                    for _ in range(50):
                        stranger.sendto(b"\x00" * 300, address)
                    await rig.bell.until(partial(vehicle.count, "SET_ATTITUDE_TARGET"), "a setpoint")

    asyncio.run(main())
