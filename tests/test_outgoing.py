"""Packets into a stream that does not keep up: whole and at once, or never."""

from __future__ import annotations

from typing import NamedTuple

from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as mavlink

from guidance.transport.outgoing import Outgoing
from guidance.transport.peer import Peer


class Line:
    """Takes `room` bytes and no more; `waiting` of them have not left yet."""

    def __init__(self) -> None:
        self.room = 0
        self.waiting = 0
        self.taken = b""

    def write(self, data: bytes) -> int:
        taken = data[: self.room]
        self.room -= len(taken)
        self.taken += taken
        return len(taken)


def packets(count: int) -> list[bytes]:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=191)
    made = []
    for i in range(count):
        made.append(bytes(mavlink.MAVLink_timesync_message(0, i + 1).pack(mav)))
        mav.seq = (mav.seq + 1) % 256
    return made


def heard(data: bytes) -> tuple[list[int], int]:
    """What a parser that trusts lengths, as autopilots' do, hears: sequence numbers, and how much is bad."""
    parser = mavlink.MAVLink(None)
    parser.robust_parsing = True
    messages = [parser.parse_char(bytes([byte])) for byte in data]
    good = [m.get_seq() for m in messages if m is not None and m.get_type() != "BAD_DATA"]
    return good, sum(m is not None and m.get_type() == "BAD_DATA" for m in messages)


@given(st.lists(st.integers(0, 60), max_size=60))
def test_a_packet_arrives_if_it_was_taken_whole_at_once_and_takes_no_other_along(
    rooms: list[int],
) -> None:
    line = Line()
    outgoing = Outgoing(line.write, lambda: 0, 0)
    whole = []
    for i, (packet, room) in enumerate(zip(packets(len(rooms)), rooms, strict=True)):
        line.room = room
        before = outgoing.dropped
        outgoing.send(packet)
        if outgoing.dropped == before:
            assert line.taken.endswith(packet)
            whole.append(i)
    line.room = 10**6
    outgoing.send(packets(1)[0])  # finishes what was begun
    arrived, bad = heard(line.taken)
    assert arrived == [*whole, 0]
    assert outgoing.dropped == len(rooms) - len(whole)
    assert bad <= outgoing.dropped


def test_while_too_much_waits_in_the_system_nothing_is_added() -> None:
    line = Line()
    line.room = 10**6
    outgoing = Outgoing(line.write, lambda: line.waiting, 100)
    sent = packets(3)
    for packet, line.waiting in zip(sent, (100, 101, 0), strict=True):
        outgoing.send(packet)
    assert line.taken == sent[0] + sent[2]
    assert outgoing.dropped == 1


class Words(NamedTuple):
    address: tuple[str, int]
    at_s: float
    refused: bool


def test_an_autopilot_is_answered_where_it_speaks_and_another_only_when_it_has_fallen_silent() -> None:
    peer = Peer(3.0)
    assert peer.silent(0)
    here, there = ("10.0.0.1", 1), ("fe80::1", 2)
    for words in (
        Words(here, 0.0, refused=False),
        Words(there, 3.0, refused=True),
        Words(there, 3.01, refused=False),
        Words(here, 4.0, refused=True),
        Words(there, 5.0, refused=False),
    ):
        told = peer.heard(words.address, round(words.at_s * 1e9))
        assert ("two vehicles of one id?" in told) is words.refused
    assert peer.address == there
    assert not peer.silent(round(8.0e9))
    assert peer.silent(round(8.01e9))
