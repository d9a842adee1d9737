"""TCP and UDP broadcast on the loopback: refused, cut, stalled, found."""

from __future__ import annotations

import asyncio
import os
import socket
import struct
import sys
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
import uvloop
from pymavlink.dialects.v20 import all as mavlink

from guidance import shell
from guidance.connection import Network
from guidance.mavlink.codec import FrameReader
from guidance.transport import Lost, open_transport, tcp
from tests.line_rig import LineEnd, a_server
from tests.service_rig import Rig, VehicleEnd, a_socket, received, running

Runner = Callable[[Coroutine[Any, Any, None]], None]
on_both_loops = pytest.mark.parametrize("runner", [asyncio.run, uvloop.run], ids=["asyncio", "uvloop"])
SOL = socket.SOL_SOCKET
RESET = struct.pack("ii", 1, 0)


def port_of(sock: socket.socket) -> int:
    return int(sock.getsockname()[1])


@on_both_loops
@pytest.mark.parametrize("reset", [False, True])
def test_a_connection_that_ends_is_made_again_and_flown_over(
    runner: Runner, reset: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shell, "BACK_OFF_S", (0.02,))

    async def main() -> None:
        with a_server() as server:
            url = f"tcp://127.0.0.1:{port_of(server)}"
            async with running(f'link.connection="{url}"') as rig:
                vehicle = LineEnd(rig.bell.ring)
                await talk(server, vehicle, rig, "SET_ATTITUDE_TARGET")
                await talk(server, vehicle, rig, "TIMESYNC")
                server.close()
                await rig.bell.until(lambda: len(rig.memory.events("link_down")) > 2, "a refusal")
                vehicle.close()
        assert rig.memory.events("link_up") == [f"connected to {url.removeprefix('tcp://')} (TCP)"] * 2
        down = rig.memory.events("link_down")
        why = "Connection reset by peer" if reset else "the other end closed the connection"
        assert down[:2] == [f"{url} failed: {why}; again in 0.02 s"] * 2
        refused = "Connection refused: nobody listens there"
        assert down[2] == f"{url} cannot be opened: {refused}; again in 0.02 s"

    async def talk(server: socket.socket, vehicle: LineEnd, rig: Rig, until: str) -> None:
        connection, _ = await asyncio.get_running_loop().sock_accept(server)
        with connection:
            vehicle.heard.clear()
            vehicle.speak_over(connection.fileno())
            await rig.bell.until(lambda: vehicle.count(until) > 5, until)
            vehicle.hang_up()
            if reset:
                connection.setsockopt(SOL, socket.SO_LINGER, RESET)

    runner(main())


def test_an_address_that_does_not_answer_is_given_up_in_time_and_blocks_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(tcp, "CONNECT_S", 0.05)

    async def main() -> None:
        with a_server() as server, socket.socket() as first, socket.socket() as second:
            server.listen(0)  # from the second on, they wait
            for waiting in (first, second):
                waiting.setblocking(False)
                waiting.connect_ex(server.getsockname())
            with pytest.raises(Lost, match=r"no answer within 0\.05 s"):
                await open_transport(Network("tcp", "127.0.0.1", port_of(server)), 3.0)

    asyncio.run(main())


@pytest.mark.parametrize("host", ["no-such-host.invalid", "a..b"])
@pytest.mark.parametrize("scheme", ["tcp", "udpout"])
def test_a_host_that_has_no_address_is_said(scheme: Any, host: str) -> None:
    with pytest.raises(Lost, match=r".+"):
        asyncio.run(open_transport(Network(scheme, host, 1), 3.0))


def test_a_peer_that_does_not_read_blocks_nothing_and_gets_little_late() -> None:
    async def main() -> None:
        with a_server(receive_bytes=1) as server:
            line = await open_transport(Network("tcp", "127.0.0.1", port_of(server)), 3.0)
            peer, _ = server.accept()
            with socket.socket(fileno=os.dup(line.fileno())) as ours:
                for level, option in ((socket.IPPROTO_TCP, socket.TCP_NODELAY), (SOL, socket.SO_KEEPALIVE)):
                    assert ours.getsockopt(level, option)
                if hasattr(socket, "TCP_USER_TIMEOUT"):  # Linux
                    assert ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 5000  # ms
            mav = mavlink.MAVLink(None, 1, 191)
            sent = 0
            while line.dropped < 1000:
                mav.seq = sent % 256
                line.send(bytes(mavlink.MAVLink_timesync_message(0, sent + 1).pack(mav)))
                sent += 1
                assert sent < 5000
            line.close()
            data = b""
            with peer:
                while came := await asyncio.to_thread(peer.recv, 65536):
                    data += came
            reader = FrameReader(stream=True)
            arrived = [frame.sequence for frame in reader.feed(data)]
            assert arrived == [i % 256 for i in range(sent - 1000)]
            assert len(data) < 3 * tcp.WAITING_MAX_BYTES + 5000  # and what the peer's own buffer takes

    asyncio.run(main())


def test_a_vehicle_that_stops_reading_gets_a_quarter_of_a_second_of_setpoints_when_it_reads_again() -> None:
    """The system acknowledges for it, so that only its own answers tell what it has read."""

    async def main() -> None:
        with a_server() as server:
            async with running(f'link.connection="tcp://127.0.0.1:{port_of(server)}"') as rig:
                connection, _ = await asyncio.get_running_loop().sock_accept(server)
                with connection:
                    vehicle = LineEnd(rig.bell.ring)
                    vehicle.speak_over(connection.fileno())
                    await rig.bell.until(lambda: rig.memory.events("state_tracking"), "a flight")
                    await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > 20, "setpoints")
                    vehicle.stop_reading()
                    await rig.bell.until(lambda: rig.memory.events("state_handed-over"), "a hand-over")
                    vehicle.heard.clear()
                    vehicle.speak_over(connection.fileno())
                    await rig.bell.until(lambda: vehicle.count("TIMESYNC") > 30, "all that has waited")
                    assert 5 <= vehicle.count("SET_ATTITUDE_TARGET") <= 20
                    assert rig.shell._guide.dropped_packets == 0
                    vehicle.close()
        (silent,) = rig.memory.events("silent")
        assert "the other end has not answered for 0.2" in silent

    asyncio.run(main())


def test_packets_that_the_line_does_not_take_are_told_and_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shell, "WATCH_S", 0.02)
    monkeypatch.setattr(tcp, "WAITING_MAX_BYTES", -1)

    async def main() -> None:
        with a_server() as server:
            url = f"tcp://127.0.0.1:{port_of(server)}"
            async with running(f'link.connection="{url}"') as rig:
                await rig.bell.until(lambda: rig.memory.events("note"), "word of it")
                assert rig.shell._guide.dropped_packets > 0
        (note,) = rig.memory.events("note")
        assert note.startswith(f"{url}: packets are dropped, as the line does not take them in time")

    asyncio.run(main())


def listener(host: str, port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    sock.bind((host, port))
    sock.setblocking(False)
    return sock


@on_both_loops
def test_the_autopilot_is_found_by_broadcast_and_nobody_else_gets_a_setpoint(runner: Runner) -> None:
    async def main() -> None:
        with a_socket() as probe:
            port = port_of(probe)
        everybody = "127.255.255.255"
        with listener(everybody, port) as bystander:
            async with running(f'link.connection="udpbcast://{everybody}:{port}"') as rig:
                await rig.bell.until(lambda: rig.memory.events("link_up"), "an open socket")
                vehicle = VehicleEnd(None, rig.bell.ring)
                await vehicle.open(sock=listener("0.0.0.0", port))
                await rig.bell.until(lambda: vehicle.count("SET_ATTITUDE_TARGET") > 20, "a flight")
                heartbeats = received(bystander)
                assert 1 <= len(heartbeats) <= 3
                assert all(mavlink.MAVLink(None).decode(bytearray(d)).get_msgId() == 0 for d in heartbeats)
                count = vehicle.count("HEARTBEAT")
                await rig.bell.until(lambda: vehicle.count("HEARTBEAT") > count, "a heartbeat to it alone")
                assert received(bystander) == []
                vehicle.close()
        (up,) = rig.memory.events("link_up")
        assert up == f"broadcasting to {everybody}:{port} (UDP) until the autopilot answers"

    runner(main())


def test_before_the_autopilot_is_found_and_after_it_is_lost_only_heartbeats_go_to_all() -> None:
    async def main() -> None:
        with listener("127.255.255.255", 0) as everybody, a_socket() as autopilot:
            connection = Network("udpbcast", "127.255.255.255", port_of(everybody))
            line = await open_transport(connection, 0.0)
            mav = mavlink.MAVLink(None, 1, 191)
            beat = bytes(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(mav))
            question = bytes(mavlink.MAVLink_timesync_message(0, 1).pack(mav))
            line.send(question)
            line.send(beat)
            assert received(everybody) == [beat]
            assert line.heard(autopilot.getsockname(), 0) == ""
            line.send(question)
            line.send(beat)  # the autopilot has been silent for longer than 0 s
            assert received(everybody) == [beat]
            assert received(autopilot) == [question]
            line.close()

    asyncio.run(main())


def test_who_has_a_udp_port_is_named() -> None:
    program = (
        "import socket; s = socket.socket(2, 2); s.bind(('127.0.0.1', 0)); print(s.getsockname()[1]); input()"
    )

    async def main() -> None:
        holder = await asyncio.create_subprocess_exec(
            sys.executable, "-uc", program, stdout=asyncio.subprocess.PIPE, stdin=asyncio.subprocess.PIPE
        )
        assert holder.stdout is not None
        port = int(await holder.stdout.readline())
        with pytest.raises(Lost, match=rf"^Address already in use by python[^ ]* \(pid {holder.pid}\)$"):
            await open_transport(Network("udpin", "127.0.0.1", port), 3.0)
        await holder.communicate(b"\n")

    asyncio.run(main())
