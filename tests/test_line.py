"""What the line carries against what is asked of it, streams that fall back, and two autopilots of one id."""

from __future__ import annotations

import random
from typing import Any

import pytest
from msgspec.structs import replace
from pymavlink.dialects.v20 import all as mavlink

from guidance.mavlink.budget import Traffic, frame_bytes
from guidance.mavlink.line import LineWatch
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.messages import MESSAGE_IDS
from guidance.records import Event, InputKind, Link
from sitl.lockstep import Channel
from tests.helpers import events_of, fly_until_tracking, make_flight, records_of

SECOND = 1_000_000_000


def serial(baud: int) -> str:
    return f'link.connection="serial:///dev/ttyUSB0?baud={baud}"'


def slow_line(baud: int, *overrides: str) -> list[Event]:
    guide = make_flight(serial(baud), *overrides).guide
    guide.note(InputKind.LINK_UP, "opened", SECOND)
    return [r for r in guide.records() if isinstance(r, Event) and r.code == "slow_line"]


def test_frames_are_as_long_as_the_longest_that_pymavlink_packs() -> None:
    mav = mavlink.MAVLink(None, 1, 1)
    mav.signing.secret_key = b"k" * 32
    mav.signing.sign_outgoing = True
    longest = mavlink.MAVLink_attitude_quaternion_message(2**32 - 1, *[1.1] * 7, [1.1] * 4)
    assert len(longest.pack(mav)) == frame_bytes("ATTITUDE_QUATERNION")


def test_a_line_that_is_too_slow_is_said_when_it_opens_with_what_would_do() -> None:
    (event,) = slow_line(57600)
    assert event.level == "warning"
    assert "it carries 5760 bytes/s, and 50 Hz need up to 76" in event.text
    assert event.text.endswith("it takes a baud rate of 115200 at both ends or link.rate_hz = 34")
    assert slow_line(57600, "link.rate_hz=34") == []
    assert slow_line(115200) == []


def test_where_no_rate_would_do_only_the_baud_rate_is_named() -> None:
    (event,) = slow_line(9600)
    assert event.text.endswith("it takes a baud rate of 115200 at both ends")


def test_the_link_record_says_what_the_line_carries() -> None:
    flight = make_flight(serial(115200))
    fly_until_tracking(flight)
    flight.run(3.0)
    link = records_of(flight, Link)[-1]
    assert (link.transport, link.capacity_bytes_per_s) == ("serial", 11520)
    carried = [r for r in flight.records if SECOND <= flight.now_ns - r.t_ns < 2 * SECOND]
    received = sum(len(getattr(r, "data", b"")) for r in carried if type(r).__name__ == "Input")
    sent = sum(len(getattr(r, "data", b"")) for r in carried if type(r).__name__ == "Packet")
    assert link.received_bytes_per_s == pytest.approx(received, rel=0.1)
    assert link.sent_bytes_per_s == pytest.approx(sent, rel=0.1)
    assert 7000 < link.needed_bytes_per_s < 8000


def test_traffic_is_that_of_the_last_second() -> None:
    traffic = Traffic()
    assert traffic.look(100, 10, 0) == (0.0, 0.0)
    for i in range(1, 11):
        rates = traffic.look(100 + 500 * i, 10 + 5 * i, i * SECOND // 2)
        assert rates == (1000.0, 10.0)
    assert traffic.look(5100, 60, 7 * SECOND) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("connection", "stream", "cause"),
    [
        ("", "ODOMETRY", "another program may have reset it; it is asked for again"),
        (serial(115200), "LOCAL_POSITION_NED", "the line is full"),
    ],
)
def test_a_stream_that_falls_back_is_named_once(connection: str, stream: str, cause: str) -> None:
    flight = make_flight(*filter(None, [connection]))
    fly_until_tracking(flight)
    flight.run(2.0)
    assert events_of(flight, "rate_fell") == []
    lose_most(stream, flight)
    full = b"\0" * 1300 if connection else b""
    for _ in range(40):
        flight.run(0.1)
        flight.inject(full)
    (fallen,) = events_of(flight, "rate_fell")
    assert fallen.startswith(f"{stream} fell back to ")
    assert "Hz of 50: " in fallen
    assert cause in fallen


def test_a_stream_that_is_not_needed_may_fall() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(2.0)
    assert flight.guide.link.streams["LOCAL_POSITION_NED"].status(flight.now_ns).at_rate
    lose_most("LOCAL_POSITION_NED", flight)
    flight.run(4.0)
    assert not flight.guide.link.streams["LOCAL_POSITION_NED"].status(flight.now_ns).at_rate
    assert events_of(flight, "rate_fell") == []


def test_a_short_dip_of_a_rate_is_nothing_to_tell() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(2.0)
    record, link = records_of(flight, Link)[-1], flight.guide.link
    low = replace(record, streams=tuple(replace(s, at_rate=False) for s in record.streams))
    watch = LineWatch(flight.guide.connection, 50.0, lambda hz: [])
    told = [len(watch.news(each, link)) for each in (low, low, record, low, record, low, low, low)]
    assert told == [0, 0, 0, 0, 0, 0, 1, 0]  # one stream is needed for its rate: ODOMETRY


def test_a_stream_of_which_any_rate_will_do_does_not_fall_back() -> None:
    """PX4 sends CURRENT_MODE with each change, and else twice a second, whatever it was asked for."""
    flight = make_flight()
    fly_until_tracking(flight)
    flight.run(2.0)
    record, link = records_of(flight, Link)[-1], flight.guide.link
    watch = LineWatch(flight.guide.connection, 50.0, lambda hz: [])

    def with_modes(at_rate: bool) -> Link:
        streams = (replace(s, at_rate=at_rate) if s.message == "CURRENT_MODE" else s for s in record.streams)
        return replace(record, streams=tuple(streams))

    assert [watch.news(with_modes(at_rate), link) for at_rate in (True, False, False)] == [[], [], []]


def lose_most(stream: str, flight: Any) -> None:
    """Every eighth message of it gets through, as after another program asked for a lower rate."""
    receive, count = flight.guide.receive, [0]
    message_id = MESSAGE_IDS[stream].to_bytes(3, "little")

    def thinned(data: bytes, now_ns: int) -> None:
        if data[7:10] == message_id:
            count[0] += 1
            if count[0] % 8:
                return
        receive(data, now_ns)

    flight.guide.receive = thinned


class Sender:
    """An autopilot of id 1/1 with a sequence of its own; each of its frames differs from those before."""

    def __init__(self, sequence: int, x_m: float = 0.0) -> None:
        self._x_m = x_m
        self._mav = mavlink.MAVLink(None, 1, 1)
        self._mav.seq = sequence
        self._boot_ms = sequence * 1000

    def frame(self) -> bytes:
        self._boot_ms += 20
        message = mavlink.MAVLink_local_position_ned_message(self._boot_ms, self._x_m, 2, 3, 4, 5, 6)
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data


@pytest.mark.parametrize("apart", [0, 1, 5, 100, 160, 200, 255])
@pytest.mark.parametrize("twin", [True, False])
def test_two_senders_of_one_id_are_told_from_one_that_is_lossy_late_and_twice(apart: int, twin: bool) -> None:
    link = AutopilotLink(1, 1, 3.0, [])
    dice = random.Random(apart)
    one, two = Sender(7), Sender((7 + apart) % 256, 1.0)
    late: list[bytes] = []
    seen = 0
    for i in range(2000):  # 20 s, 100 frames/s of each
        now_ns = SECOND + i * 10_000_000
        frames = [one.frame(), two.frame()] if twin else [one.frame()]
        for frame in frames:
            if dice.random() < 0.2:
                late.append(frame)
            elif dice.random() < 0.8:
                link.receive(frame * dice.choice([1, 1, 2]), now_ns)
        if dice.random() < 0.1:
            for frame in late:
                link.receive(frame, now_ns)
            late.clear()
        seen += link.twins.seen(now_ns)
    assert (seen > 1000) is twin
    assert (seen == 0) is not twin


def test_a_sender_that_starts_again_and_again_is_no_second_one() -> None:
    link = AutopilotLink(1, 1, 3.0, [])
    for start in range(50):
        one = Sender(5, start)
        for i in range(300):
            now_ns = SECOND + (start * 300 + i) * 2_500_000
            link.receive(one.frame(), now_ns)
            assert not link.twins.seen(now_ns)
    assert link.counters["late"] > 2000


def test_two_vehicles_of_one_id_behind_a_router_are_an_event() -> None:
    flight = make_flight()
    fly_until_tracking(flight)
    twin = Sender(99)
    for _ in range(200):
        flight.run(0.02)
        flight.inject(twin.frame())
    (event,) = events_of(flight, "two_autopilots")
    assert "two senders speak as 1/1: two vehicles of one id" in event


def test_a_bad_link_is_not_mistaken_for_two_vehicles() -> None:
    flight = make_flight(to_guide=Channel(0.03, 0.05, loss=0.3, duplication=0.2))
    flight.run(20.0)
    assert events_of(flight, "two_autopilots") == []


def test_a_frame_may_span_two_reads_but_not_an_interruption() -> None:
    guide = make_flight(serial(115200)).guide
    frames = [Sender(i).frame() for i in range(2)]
    guide.receive(frames[0][:20], SECOND)
    guide.receive(frames[0][20:], SECOND)
    assert guide.link.received == 1
    guide.receive(b"\xfd\xff\0" + frames[0][3:20], SECOND)  # claims 267 bytes
    guide.note(InputKind.LINK_DOWN, "gone", SECOND)
    guide.note(InputKind.LINK_UP, "back", SECOND)
    guide.receive(frames[1], SECOND)
    assert guide.link.received == 2
    assert guide.link.reader.counters["garbage_bytes"] == 20
