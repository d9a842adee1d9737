"""Bytes to frames: pymavlink is the oracle; arbitrary bytes neither raise nor cost nor pass for a message."""

from __future__ import annotations

import re
import struct
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.codec import Frame, FrameReader, PacketWriter, Payload
from guidance.mavlink.messages import CRC_EXTRA, DECODERS, MESSAGE_IDS
from tests.mavlink_peer import SIGNATURE_BYTES, Sender, checksum, frame_by_hand
from tests.strategies import properties

READ = sorted(MESSAGE_IDS.items())
SPAN = {f"{sign}{bits}": (0 if sign else -(2 ** (bits - 1)), 2**bits - 1 if sign else 2 ** (bits - 1) - 1)
        for sign in ("u", "") for bits in (8, 16, 32, 64)}  # fmt: skip
#: An id that the dialect does not know.
UNKNOWN_ID = 0xABCDE


def _value(kind: str, length: int) -> st.SearchStrategy[Any]:
    if kind == "char":
        return st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=length).map(str.encode)
    if kind in ("float", "double"):
        one: st.SearchStrategy[Any] = st.floats(width=32 if kind == "float" else 64, allow_nan=False)
    else:
        low, high = SPAN[kind.removesuffix("_t").replace("int", "")]
        one = st.integers(low, high) | st.just(0)
    return one if length == 0 else st.lists(one, min_size=length, max_size=length)


@st.composite
def messages(draw: st.DrawFn, name: str | None = None) -> Any:
    """A message of one of the types that are read, with any values in its fields."""
    chosen = draw(st.sampled_from(READ))[0] if name is None else name
    message = dialect.mavlink_map[MESSAGE_IDS[chosen]]
    fields = zip(message.fieldnames, message.fieldtypes, strict=True)
    lengths = dict(zip(message.ordered_fieldnames, message.array_lengths, strict=True))
    return message(**{field: draw(_value(kind, lengths[field])) for field, kind in fields})


def whole(data: bytes, *, stream: bool = False) -> list[Frame]:
    return FrameReader(stream=stream).feed(data)


def expected(packet: bytes) -> Any:
    """pymavlink's reading of one packet."""
    (message,) = dialect.MAVLink(None).parse_buffer(packet)
    return message


def assert_same(frame: Frame, packet: bytes) -> None:
    message = expected(packet)
    assert frame.known
    assert (frame.message_id, frame.system, frame.component, frame.sequence) == (
        message.get_msgId(),
        message.get_srcSystem(),
        message.get_srcComponent(),
        message.get_seq(),
    )
    body = DECODERS[frame.message_id](frame.payload)
    for field, value in zip(body._fields, body, strict=True):
        element = re.fullmatch(r"q([1-4])", field)
        oracle = (
            message.q[int(element[1]) - 1] if hasattr(message, "q") and element else getattr(message, field)
        )
        read = value
        if isinstance(value, bytes):  # a text, or the bytes of what need not be a float
            is_text = field != "param_value"
            read = value.split(b"\0")[0].decode() if is_text else struct.unpack("<f", value)[0]
        assert read == oracle, field


@properties
@given(messages(), st.integers(0, 255), st.integers(1, 255), st.integers(1, 255), st.booleans())
def test_every_message_that_is_read_is_read_as_pymavlink_reads_it(
    message: Any, sequence: int, system: int, component: int, mavlink1: bool
) -> None:
    packet = Sender(system, component, mavlink1=mavlink1 and message.get_msgId() < 256).pack(
        message, sequence
    )
    (frame,) = whole(packet)
    assert_same(frame, packet)


@pytest.mark.parametrize(("name", "message_id"), READ)
def test_trailing_zeros_may_be_cut_or_kept(name: str, message_id: int) -> None:
    size = dialect.mavlink_map[message_id].unpacker.size
    kept = frame_by_hand(message_id, bytes([7]) + bytes(size - 1), CRC_EXTRA[message_id])
    cut = frame_by_hand(message_id, bytes([7]), CRC_EXTRA[message_id])
    longer = frame_by_hand(message_id, bytes([7]) + bytes(size - 1) + b"\x05\x06", CRC_EXTRA[message_id])
    bodies = [DECODERS[message_id](frame.payload) for frame in whole(kept + cut + longer)]
    assert len(bodies) == 3, name
    assert bodies[0] == bodies[1] == bodies[2]
    assert_same(whole(cut)[0], cut)


def test_all_zero_payload_of_one_byte_or_none() -> None:
    message_id = MESSAGE_IDS["LOCAL_POSITION_NED"]
    for payload in (b"", b"\0"):
        (frame,) = whole(frame_by_hand(message_id, payload, CRC_EXTRA[message_id]))
        assert DECODERS[message_id](frame.payload) == (0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@properties
@given(messages(), st.binary(max_size=20), st.booleans())
def test_a_signed_frame_is_read_with_its_signature(message: Any, after: bytes, stream: bool) -> None:
    plain = Sender().pack(message)
    signed = frame_by_hand(message.get_msgId(), plain[10:-2], message.crc_extra, flags=1)
    assert len(signed) == len(plain) + SIGNATURE_BYTES
    following = Sender().pack(message, 9)
    reader = FrameReader(stream=stream)
    assert len(reader.feed(signed + following)) == 2
    assert not reader.counters, "the signature is part of the frame"
    frames = whole(signed + following + after, stream=stream)
    assert [frame.sequence for frame in frames[:2]] == [0, 9]
    assert frames[0].payload == frames[1].payload == plain[10:-2]


#: Between good frames of a stream: noise, and what looks like a frame that nobody knows, followed by text.
odd = st.one_of(
    st.binary(max_size=30),
    st.builds(
        lambda payload, after: frame_by_hand(UNKNOWN_ID, payload, 0) + after,
        st.binary(max_size=9),
        st.sampled_from([b"", b"text"]),
    ),
)


@properties
@given(st.lists(messages(), min_size=1, max_size=5), odd, st.data())
def test_a_stream_is_read_alike_however_it_is_cut(sent: list[Any], tail: bytes, data: st.DataObject) -> None:
    sender = Sender()
    packets = [sender.pack(message) for message in sent]
    packets.insert(data.draw(st.integers(0, len(sent))), tail)
    stream = b"".join(packets)
    at_once, bytewise, pieces = (FrameReader(stream=True) for _ in range(3))
    frames = at_once.feed(stream)
    assert [frame for n in range(len(stream)) for frame in bytewise.feed(stream[n : n + 1])] == frames
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=6)))
    parts = [stream[a:b] for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True)]
    assert [frame for part in parts for frame in pieces.feed(part)] == frames
    assert at_once.counters == bytewise.counters == pieces.counters


@properties
@given(st.lists(messages(), min_size=1, max_size=6))
def test_a_datagram_of_several_frames_gives_them_in_order(sent: list[Any]) -> None:
    sender = Sender()
    packets = [sender.pack(message) for message in sent]
    reader = FrameReader()
    frames = reader.feed(b"".join(packets))
    assert len(frames) == len(packets)
    for frame, packet in zip(frames, packets, strict=True):
        assert_same(frame, packet)
    assert not reader.counters


#: Bytes that look like MAVLink more often than chance would have it.
treacherous = st.one_of(
    st.binary(max_size=60),
    st.sampled_from(
        [b"\xfd", b"\xfe", b"\xfd\x09\x00", b"\xfe\x09", b"\xfd\xff\x01", b"\xfd" * 30, b"\xfe" * 30]
    ),
    messages().map(lambda message: Sender().pack(message)),
    messages().map(lambda message: Sender().pack(message)[:-1]),
    st.builds(
        lambda message, at, bit: _flip(Sender().pack(message), at, bit),
        messages(),
        st.integers(0, 400),
        st.integers(0, 7),
    ),
    st.builds(lambda payload: frame_by_hand(UNKNOWN_ID, payload, 0), st.binary(max_size=30)),
)


def _flip(packet: bytes, at: int, bit: int) -> bytes:
    position = at % len(packet)
    return packet[:position] + bytes([packet[position] ^ 1 << bit]) + packet[position + 1 :]


def _is_sound(data: bytes, frame: Frame) -> bool:
    """Whether `data` holds this frame with a checksum that holds, found without the code under test."""
    if frame.message_id not in CRC_EXTRA:
        return True
    ids = bytes([frame.sequence, frame.system, frame.component])
    v2 = bytes([len(frame.payload)]), ids + frame.message_id.to_bytes(3, "little")
    candidates = [v2[0] + flags + v2[1] for flags in (bytes([f, c]) for f in (0, 1) for c in range(256))]
    if frame.message_id < 256:
        candidates.append(v2[0] + ids + bytes([frame.message_id]))
    for head in candidates:
        body = head + frame.payload
        crc = checksum(body + bytes([CRC_EXTRA[frame.message_id]])) if body in data else -1
        if crc >= 0 and body + crc.to_bytes(2, "little") in data:
            return True
    return False


@properties
@given(st.lists(treacherous, max_size=12), st.booleans())
def test_arbitrary_bytes_never_raise_and_every_byte_is_accounted_for(
    parts: list[bytes], stream: bool
) -> None:
    reader = FrameReader(stream=stream)
    data = b"".join(parts)
    frames: list[Frame] = []
    for part in parts if stream else [data]:
        frames += reader.feed(part)
        assert len(reader._rest) <= (280 if stream else 0)
    garbage = reader.counters["garbage_bytes"]
    # The overhead of a frame is 8 (MAVLink 1), 12 or, signed, 25 bytes.
    framed = len(data) - garbage - len(reader._rest)
    payloads = sum(len(frame.payload) for frame in frames)
    assert payloads + 8 * len(frames) <= framed <= payloads + 25 * len(frames)
    for frame in frames:
        assert _is_sound(data, frame)
        if frame.message_id in DECODERS:
            DECODERS[frame.message_id](frame.payload)
    assert reader.counters["unknown_message"] == sum(not frame.known for frame in frames)
    blamed = sum(reader.counters[why] for why in ("bad_checksum", "truncated", "unsupported_flags"))
    assert blamed <= garbage


@properties
@given(st.lists(treacherous, max_size=8), messages())
def test_a_valid_datagram_is_found_whatever_came_before_it(parts: list[bytes], message: Any) -> None:
    reader = FrameReader()
    for part in parts:
        reader.feed(part)
    packet = Sender().pack(message, 200)
    (frame,) = reader.feed(packet)
    assert_same(frame, packet)


@properties
@given(st.binary(max_size=80).filter(lambda b: not {0xFD, 0xFE} & set(b)), messages(), st.booleans())
def test_a_frame_behind_text_in_the_same_datagram_is_found(banner: bytes, message: Any, stream: bool) -> None:
    packet = Sender().pack(message, 3)
    reader = FrameReader(stream=stream)
    (frame,) = reader.feed(banner + packet)
    assert_same(frame, packet)
    assert reader.counters["garbage_bytes"] == len(banner)


@properties
@given(messages(), st.integers(1, 400), st.integers(0, 7))
def test_a_flipped_bit_costs_one_frame_and_not_the_next(message: Any, at: int, bit: int) -> None:
    packet = Sender().pack(message)
    at = 7 + at % (len(packet) - 7)  # behind the header's length and flags
    following = Sender().pack(message, 77)
    frames = whole(_flip(packet, at, bit) + following)
    assert frames[-1].sequence == 77
    assert all(not frame.known for frame in frames[:-1]), "a damaged id may become one that nobody knows"


def test_damage_is_counted_by_its_kind() -> None:
    packet = Sender().pack(dialect.MAVLink_heartbeat_message(12, 12, 0, 0, 3, 3))
    for data, kinds in (
        (packet[:-1] + bytes([packet[-1] ^ 1]), {"bad_checksum"}),
        (packet[:-1], {"truncated"}),
        (packet[:2] + b"\x02" + packet[3:], {"unsupported_flags"}),
        (b"ArduPilot", set()),
    ):
        reader = FrameReader()
        assert reader.feed(data) == []
        assert {kind for kind, count in reader.counters.items() if count} == {"garbage_bytes", *kinds}
        assert reader.counters["garbage_bytes"] == len(data)


def test_an_unknown_message_is_skipped_whole_and_only_up_to_another_start() -> None:
    inner = Sender().pack(dialect.MAVLink_heartbeat_message(12, 12, 0, 0, 3, 3))
    unknown = frame_by_hand(UNKNOWN_ID, inner, 0)
    following = Sender().pack(dialect.MAVLink_heartbeat_message(12, 12, 0, 0, 3, 3), 5)
    for stream in (False, True):
        reader = FrameReader(stream=stream)
        frames = reader.feed(unknown + following)
        assert [(frame.known, frame.sequence) for frame in frames] == [(False, 0), (True, 5)]
        assert reader.counters == {"unknown_message": 1}
    # Garbage that looks like one, and claims less or more than it has: what is inside is found.
    fake = unknown[:1] + bytes([unknown[1] - 3]) + unknown[2:]
    frames = whole(fake + following)
    assert [(frame.known, frame.sequence) for frame in frames] == [(True, 0), (True, 5)]


@pytest.mark.parametrize("pattern", [b"\xfd", b"\xfe\x00", b"\xfd\xff\x00", b"\xfd" + bytes(9)], ids=repr)
@pytest.mark.parametrize("stream", [False, True])
def test_start_bytes_without_frames_cost_linear_work(pattern: bytes, stream: bool) -> None:
    def cpu_seconds(size: int) -> float:
        reader = FrameReader(stream=stream)
        data = pattern * (size // len(pattern))
        began = time.process_time()
        reader.feed(data)
        assert len(reader._rest) <= 280
        return time.process_time() - began

    small = min(cpu_seconds(64_000) for _ in range(3))
    # At most 280 bytes are looked at for each one, so 16 times as much costs 16 times as much.
    assert cpu_seconds(1_024_000) < 36.0 * small + 0.02


def test_packets_of_the_writer_are_what_pymavlink_reads_in_sequence() -> None:
    writer = PacketWriter(7, 191)
    packets = [writer.pack(dialect.MAVLink_timesync_message(n, 2 * n)) for n in range(300)]
    read = [expected(packet) for packet in packets]
    assert [message.get_seq() for message in read] == [n % 256 for n in range(300)]
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in read} == {(7, 191)}
    assert [(message.tc1, message.ts1) for message in read] == [(n, 2 * n) for n in range(300)]


@properties
@given(st.sampled_from(sorted(CRC_EXTRA)), st.binary(min_size=1, max_size=255))
def test_a_payload_is_framed_with_its_trailing_zeros_cut(message_id: int, payload: bytes) -> None:
    writer = PacketWriter(7, 191)
    writer.pack(dialect.MAVLink_timesync_message(1, 2))
    packet = writer.pack(Payload(message_id, payload))
    cut = payload.rstrip(b"\0") or b"\0"
    assert packet == frame_by_hand(message_id, cut, CRC_EXTRA[message_id], sequence=1, ids=(7, 191))


def test_tables_cover_the_messages_that_are_read() -> None:
    assert len(READ) == 23
    assert all(dialect.mavlink_map[message_id].msgname == name for name, message_id in READ)
    assert UNKNOWN_ID not in CRC_EXTRA
