"""MAVLink 2 signing beside pymavlink's: what is signed, what is believed, and nothing twice."""

from __future__ import annotations

from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import FrameReader, PacketWriter
from guidance.mavlink.link import AutopilotLink
from guidance.mavlink.signing import (
    LATE,
    NEW_STREAM_BEHIND,
    TIMESTAMP_MAX,
    Refusal,
    Signing,
    SigningClock,
    wall_timestamp,
    without_hash,
)

KEY: Final = bytes(range(32))
OTHER_KEY: Final = bytes(range(1, 33))
NOW: Final = 35_000_000_000_000  # a timestamp, of 2026
SECOND: Final = 1_000_000_000
BEAT: Final = dialect.MAVLink_heartbeat_message(12, 12, 0x81, 0, 4, 3)
#: Made by pymavlink: HEARTBEAT of 1/1, link 7, timestamp NOW, by KEY.
GOLDEN: Final = bytes.fromhex("fd090100000101000000000000000c0c810403264d0700309112d51f35f1e0e162fb")


START: Final = SigningClock(NOW)


class Oracle:
    """pymavlink, signing and verifying by itself."""

    def __init__(
        self, key: bytes | None = KEY, *, system: int = 1, component: int = 1, link_id: int = 7, at: int = NOW
    ) -> None:
        self.mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
        self.mav.signing.secret_key = key
        self.mav.signing.sign_outgoing = key is not None
        self.mav.signing.link_id = link_id
        self.mav.signing.timestamp = at

    def pack(self, message: Any = BEAT) -> bytes:
        packet = bytes(message.pack(self.mav))
        self.mav.seq = (self.mav.seq + 1) % 256
        return packet

    def read(self, packet: bytes) -> Any:
        (message,) = self.mav.parse_buffer(packet)
        return message


class End:
    """A link with a key, and what it believes of the bytes that it is given."""

    def __init__(self, key: bytes | None = KEY, clock: SigningClock = START) -> None:
        self.signing = Signing(key, 3)
        self.signing.set(clock, 0)
        self.link = AutopilotLink(1, 1, 3.0, [], signing=self.signing)

    def hears(self, packet: bytes, now_ns: int = 1) -> bool:
        return bool(self.link.receive(packet, now_ns))

    def refuses(self, packet: bytes, why: Refusal, now_ns: int = 1) -> bool:
        """It is not believed, for this reason alone, and the autopilot is not heard by it."""
        before, received = self.link.counters.copy(), self.link.received
        believed = self.hears(packet, now_ns)
        new = self.link.counters - before
        return not believed and new == {why.value: 1} and self.link.received == received


# What goes out ---------------------------------------------------------------------------------------


def test_a_signed_packet_is_pymavlinks_to_the_bit() -> None:
    signing, writer, oracle = Signing(KEY, 7), PacketWriter(1, 1), Oracle(at=NOW + 1)
    signing.set(SigningClock(NOW), 0)
    for message in (BEAT, dialect.MAVLink_timesync_message(5, 6), dialect.MAVLink_set_mode_message(1, 1, 0)):
        assert signing.sign(writer.pack(message)) == oracle.pack(message)


def test_the_golden_packet() -> None:
    signing = Signing(KEY, 7)
    signing.set(SigningClock(NOW - 1), 0)
    assert signing.sign(PacketWriter(1, 1).pack(BEAT)) == GOLDEN
    assert End().hears(GOLDEN)


def test_pymavlink_verifies_what_the_link_sends() -> None:
    end, oracle = End(), Oracle(at=0)
    for now_ns in range(0, 3 * SECOND, SECOND):
        end.link.tick(now_ns)
        for packet in end.link.outbox.drain():
            assert oracle.read(packet).get_type() == "HEARTBEAT"
    assert (oracle.mav.signing.goodsig_count, oracle.mav.signing.badsig_count) == (3, 0)


def timestamp_of(packet: bytes) -> int:
    return int.from_bytes(packet[-12:-6], "little")


def test_our_timestamps_grow_with_every_packet_and_with_the_time() -> None:
    end, writer = End(), PacketWriter(1, 191)
    first, second = (timestamp_of(end.signing.sign(writer.pack(BEAT))) for _ in range(2))
    assert (first, second) == (NOW + 1, NOW + 2)
    end.signing.advance(SECOND)
    assert timestamp_of(end.signing.sign(writer.pack(BEAT))) == NOW + 100_000 + 1


def test_our_timestamp_moves_up_to_what_is_believed_and_no_other() -> None:
    end, writer = End(), PacketWriter(1, 191)
    assert end.hears(Oracle(at=NOW + 500).pack())
    assert end.refuses(Oracle(OTHER_KEY, at=NOW + 900_000).pack(), Refusal.BAD_SIGNATURE)
    assert timestamp_of(end.signing.sign(writer.pack(BEAT))) == NOW + 501


def test_the_last_timestamp_of_all_is_survived() -> None:
    end = End()
    assert end.hears(Oracle(at=TIMESTAMP_MAX).pack())
    for _ in range(3):
        assert timestamp_of(end.signing.sign(PacketWriter(1, 191).pack(BEAT))) == TIMESTAMP_MAX
    end = End(clock=SigningClock(TIMESTAMP_MAX - 1))
    end.signing.advance(10 * SECOND)
    assert end.signing.clock.timestamp == TIMESTAMP_MAX


@pytest.mark.parametrize(
    ("unix_s", "timestamp"), [(0, 0), (1_420_070_399, 0), (1_420_070_400, 0), (1_420_070_401, 100_000)]
)
def test_timestamps_count_10_us_since_2015(unix_s: int, timestamp: int) -> None:
    assert wall_timestamp(unix_s * SECOND) == timestamp


# What comes in ---------------------------------------------------------------------------------------


def test_what_the_key_signed_is_believed() -> None:
    end, oracle = End(), Oracle()
    assert all(end.hears(oracle.pack()) for _ in range(300))
    assert end.link.connected(1)
    assert not end.link.counters
    assert end.link.refusal is None


def mavlink1(sequence: int) -> bytes:
    mav = dialect.MAVLink(None, 1, 1)
    mav.seq = sequence
    return bytes(BEAT.pack(mav, force_mavlink1=True))


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        (Oracle(None).pack(), Refusal.UNSIGNED),
        (mavlink1(sequence=0), Refusal.UNSIGNED),
        (mavlink1(sequence=1), Refusal.UNSIGNED),
        (Oracle(OTHER_KEY).pack(), Refusal.BAD_SIGNATURE),
        (Oracle(at=NOW - NEW_STREAM_BEHIND - 1).pack(), Refusal.REPLAYED),
    ],
    ids=["unsigned", "mavlink1", "mavlink1, number 1", "another key", "over a minute old"],
)
def test_nothing_else_is_believed(packet: bytes, why: Refusal) -> None:
    end = End()
    assert end.refuses(packet, why)
    assert end.link.refusal is why
    assert end.link.heartbeat is None
    assert not end.link.connected(1)


def test_a_new_stream_may_be_a_minute_behind() -> None:
    assert End().hears(Oracle(at=NOW - NEW_STREAM_BEHIND).pack())


TIMESYNC: Final = dialect.MAVLink_timesync_message(0, 1)


def test_a_packet_may_be_overtaken_and_comes_only_once() -> None:
    end = End()
    early, late, later = (Oracle(at=NOW + at).pack(TIMESYNC) for at in (LATE, 1, 2))
    assert end.hears(early)
    for packet in (late, later):
        assert end.hears(packet)
        assert end.refuses(packet, Refusal.REPLAYED)
    assert end.refuses(early, Refusal.REPLAYED)


def test_later_than_a_second_is_too_late() -> None:
    end = End()
    assert end.hears(Oracle(at=NOW + LATE).pack())
    assert end.refuses(Oracle(at=NOW).pack(), Refusal.REPLAYED)


@given(st.permutations([LATE * number // 7 for number in range(40)]))
def test_in_whatever_order_they_come_each_is_believed_at_most_once(order: list[int]) -> None:
    end = End()
    believed = [at for at in [*order, *order] if end.hears(Oracle(at=NOW + at).pack(TIMESYNC))]
    assert len(believed) == len(set(believed))
    newest = [max(order[: number + 1]) for number in range(len(order))]
    assert set(believed) == {at for at, top in zip(order, newest, strict=True) if at > top - LATE}


def test_what_is_remembered_of_a_stream_has_an_end() -> None:
    end = End()
    for number in range(3000):
        assert end.signing.refusals(FrameReader().feed(Oracle(at=NOW + number * 1000).pack()), 1) == {}
    (stream,) = end.signing._streams.values()
    assert len(stream._seen) < 1000


def test_each_stream_has_its_own_time() -> None:
    end = End()
    assert end.hears(Oracle(link_id=1).pack())
    assert end.hears(Oracle(link_id=2).pack())
    assert end.refuses(Oracle(link_id=2).pack(), Refusal.REPLAYED)
    assert {stream[:3] for stream in end.signing.clock.streams} == {(1, 1, 1), (1, 1, 2)}


def test_a_forger_cannot_move_a_streams_time() -> None:
    """pymavlink's own parser can be shut out so: it takes the time before it has looked at the signature."""
    end, oracle = End(), Oracle()
    assert end.hears(oracle.pack())
    assert end.refuses(Oracle(OTHER_KEY, at=NOW + 10**9).pack(), Refusal.BAD_SIGNATURE)
    assert end.hears(oracle.pack())


def test_a_capture_is_refused_after_a_restart_though_it_is_seconds_old() -> None:
    end, oracle = End(), Oracle()
    capture = [oracle.pack() for _ in range(20)]
    assert all(map(end.hears, capture))
    again = End(clock=end.signing.clock)
    assert all(again.refuses(packet, Refusal.REPLAYED) for packet in capture)
    assert again.hears(oracle.pack())


def test_a_clock_that_is_set_forgets_nothing() -> None:
    end, oracle = End(clock=SigningClock(0)), Oracle()
    packet = oracle.pack()
    assert end.hears(packet)
    for clock in (SigningClock(5), SigningClock(NOW * 2, ((1, 1, 7, 3),))):
        end.signing.set(clock, 2)
        assert end.refuses(packet, Refusal.REPLAYED)
    assert end.signing.clock.timestamp == NOW * 2


@given(st.integers(0, 33), st.integers(1, 255))
def test_no_changed_byte_is_believed(place: int, flip: int) -> None:
    packet = bytearray(Oracle().pack())
    packet[place] ^= flip
    end = End()
    assert not end.hears(bytes(packet))
    assert end.link.heartbeat is None
    assert end.hears(Oracle(at=NOW + 1).pack())


@pytest.mark.parametrize("stream", [False, True])
@pytest.mark.parametrize("cut", range(1, 14))
def test_a_signature_that_is_cut_off_is_none(cut: int, stream: bool) -> None:
    signing = Signing(KEY, 0)
    link = AutopilotLink(1, 1, 3.0, [], byte_stream=stream, signing=signing)
    oracle = Oracle(at=NOW)
    assert not link.receive(oracle.pack()[:-cut], 1)
    assert not link.received
    # A datagram's rest is forgotten; a stream's is taken from the next packet, which is spoilt.
    oracle.pack()
    packets = [oracle.pack() for _ in range(2)]
    assert [r.name for packet in packets for r in link.receive(packet, 2)][-1:] == ["HEARTBEAT"]


def test_a_flag_nobody_knows_discards_the_packet_whatever_its_signature() -> None:
    packet = bytearray(Oracle().pack())
    packet[2] |= 0x02
    end = End()
    assert not end.hears(bytes(packet))
    assert end.link.reader.counters["unsupported_flags"] == 1


def test_radios_may_speak_unsigned() -> None:
    end = End()
    radio = dialect.MAVLink_radio_status_message(180, 170, 100, 40, 40, 0, 0)
    end.hears(Oracle(None, system=51, component=68).pack(radio))
    assert not end.signing.refused
    assert str(end.link.company) == "a telemetry radio (51/68)"


def test_strangers_without_the_key_are_nobody() -> None:
    end = End()
    beat = dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)
    end.hears(Oracle(None, system=255, component=190).pack(beat))
    assert not str(end.link.company)
    assert end.link.counters == {"unsigned": 1, "other_system": 1}
    end.hears(Oracle(system=255, component=190).pack(beat))
    assert str(end.link.company) == "a ground station (255/190)"


def test_without_a_key_signatures_are_not_looked_at() -> None:
    link = AutopilotLink(1, 1, 3.0, [])
    packets = [Oracle(OTHER_KEY).pack(), Oracle(None).pack()]
    signs = []
    for now_ns, packet in enumerate(packets):
        assert link.receive(packet, now_ns * SECOND)
        signs.append(link.signs)
    assert signs == [True, False]


# Without the key, as a replay ------------------------------------------------------------------------


def test_a_replay_without_the_key_believes_the_same() -> None:
    end, replayed, oracle = End(), End(None), Oracle()
    forger = Oracle(OTHER_KEY)
    for number in range(40):
        datagram = b"".join(source.pack() for source in (oracle, forger, oracle, forger)[: 1 + number % 4])
        received = end.link.receive(datagram, number)
        assert replayed.link.receive(datagram, number, end.signing.forged) == received
    assert end.link.counters["bad_signature"] == 40
    assert replayed.link.counters == end.link.counters
    assert replayed.signing.clock == end.signing.clock


def test_a_replay_differs_from_what_was_sent_only_in_the_six_bytes_of_the_key() -> None:
    packet = PacketWriter(1, 191).pack(BEAT)
    signed, replayed = (Signing(key, 3).sign(packet) for key in (KEY, None))
    assert signed != replayed
    assert without_hash(signed) == replayed
    assert signed[:-6] == replayed[:-6]


def test_a_frame_is_kept_whole_only_if_it_is_signed() -> None:
    packet = Oracle().pack()
    (signed,) = FrameReader().feed(packet)
    (unsigned,) = FrameReader().feed(Oracle(None).pack())
    assert (signed.signed, unsigned.signed) == (packet, b"")
