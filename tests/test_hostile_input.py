"""Whatever arrives, the service neither stops nor believes it.

Invariant, held against random sequences of hostile datagrams in a flight that tracks:

1. `Guide` raises nothing, and what it keeps does not grow with the input.
2. Every setpoint is within the configured limits, in the very bytes that are sent, and computed from the
   true state: the state in the record is the plant's own to within the measurement's grain.
3. Each hostile datagram is counted under a name, unless it is indistinguishable from a good one.
"""

from __future__ import annotations

import math
import struct
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import all as dialect

from guidance.core import Guide
from guidance.records import Input, InputKind, Packet, Record, Setpoint, State
from sitl.lockstep import Lockstep
from tests.helpers import fly_until_tracking, make_config, make_flight, state_of
from tests.sent_setpoints import asked, float32, sent_setpoint, within

NAN = math.nan
INF = math.inf

bad_number = st.sampled_from([NAN, INF, -INF, 1e30])
any_float = st.floats(width=32)
#: Not a unit quaternion, by more than float32 rounding.
bad_quaternion = st.sampled_from(
    [(0.0, 0.0, 0.0, 0.0), (0.9, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (NAN, 0.0, 0.0, 0.0), (1e20, 0, 0, 0)]
)
OLD_MS = st.integers(0, 400)


def frame(message: Any, system: int = 1, component: int = 1, sequence: int = 0) -> bytes:
    """The packet that such a sender would send."""
    mav = dialect.MAVLink(None, srcSystem=system, srcComponent=component)
    mav.seq = sequence
    return bytes(message.pack(mav))


def attitude(boot_ms: int, q: tuple[float, ...], rate: float, sequence: int = 0) -> bytes:
    message = dialect.MAVLink_attitude_quaternion_message(boot_ms, *q, rate, rate, rate)
    return frame(message, sequence=sequence)


def position(boot_ms: int, value: float, speed: float, sequence: int = 0) -> bytes:
    message = dialect.MAVLink_local_position_ned_message(boot_ms, value, value, value, speed, speed, speed)
    return frame(message, sequence=sequence)


def heartbeat(system: int, component: int, mode: int) -> bytes:
    return frame(dialect.MAVLink_heartbeat_message(12, 12, 0x81, mode, 4, 3), system, component)


def cut(data: bytes, length: int) -> bytes:
    return data[: max(len(data) - 1 - length, 1)]


def flip(data: bytes, bit: int) -> bytes:
    index = bit // 8 % len(data)
    return data[:index] + bytes([data[index] ^ 1 << bit % 8]) + data[index + 1 :]


GOOD = attitude(10**6, (1.0, 0.0, 0.0, 0.0), 0.0)

SEQUENCE = st.integers(0, 255)
FUTURE_MS = st.integers(10**7, 2**32 - 1)
ANY_MS = st.integers(0, 2**32 - 1)
LEVEL = st.just((1.0, 0.0, 0.0, 0.0))
ROLLED = st.just((0.0, 1.0, 0.0, 0.0))

hostile = st.one_of(
    st.binary(max_size=400),
    st.binary(max_size=64).map(lambda tail: b"\xfd" * 8 + tail),
    st.builds(cut, st.just(GOOD), st.integers(0, 40)),
    st.builds(flip, st.just(GOOD), st.integers(0, 8 * len(GOOD) - 1)),
    st.builds(attitude, ANY_MS, bad_quaternion, st.just(0.0), SEQUENCE),
    st.builds(attitude, ANY_MS, LEVEL, bad_number, SEQUENCE),
    st.builds(position, ANY_MS, bad_number, st.just(0.0), SEQUENCE),
    st.builds(position, ANY_MS, st.just(0.0), bad_number, SEQUENCE),
    st.builds(attitude, OLD_MS, ROLLED, st.just(1.0), SEQUENCE),
    st.builds(position, OLD_MS, any_float, any_float, SEQUENCE),
    st.builds(attitude, FUTURE_MS, ROLLED, st.just(1.0), SEQUENCE),
    st.builds(position, FUTURE_MS, any_float, any_float, SEQUENCE),
    st.builds(heartbeat, st.integers(2, 255), st.integers(1, 255), st.integers(0, 2**32 - 1)),
    st.builds(heartbeat, st.just(1), st.integers(2, 255), st.integers(0, 2**32 - 1)),
    st.builds(
        lambda tc1, ts1, sequence: frame(dialect.MAVLink_timesync_message(tc1, ts1), sequence=sequence),
        st.integers(-(2**63), 2**63 - 1),
        st.integers(-(2**63), 2**63 - 1),
        SEQUENCE,
    ),
    st.builds(
        lambda command, result: frame(dialect.MAVLink_command_ack_message(command, result)),
        st.sampled_from([176, 400, 511, 512, 31999]),
        st.integers(0, 255),
    ),
    st.builds(lambda text: frame(dialect.MAVLink_statustext_message(4, text)), st.binary(max_size=50)),
)


#: Below what the vehicle does by itself, so that it is these limits which hold and not the plant's.
NARROW = (
    "limits.speed_min_m_s=-1",
    "limits.speed_max_m_s=3",
    "limits.roll_rate_max_rad_s=0.5",
    "limits.pitch_rate_max_rad_s=1",
    "limits.yaw_rate_max_rad_s=1.5",
)


def watched_flight() -> Lockstep:
    """A flight in which every state is held against the plant, and every setpoint's bytes against the limits.

    The setpoint in the packet must be that of its record, too: what is written down is what was sent.
    """
    flight = make_flight(*NARROW)
    config = flight.guide.config
    recorded: list[Setpoint] = []

    def check(record: Record) -> None:
        if isinstance(record, State):
            # 3 m/s for one period is what a change of speed within it can make.
            assert math.dist(record.position_ned_m, flight.truth().position_ned_m) < 0.07
        elif isinstance(record, Setpoint):
            recorded.append(record)
        elif isinstance(record, Packet) and (message := sent_setpoint(record)) is not None:
            assert within(message, config), message
            setpoint = recorded.pop()
            assert setpoint.t_ns == record.t_ns
            assert asked(message) == tuple(map(float32, (*setpoint.body_rates_frd_rad_s, setpoint.thrust)))
            assert not recorded, "a setpoint that was not sent"

    flight.on_record = check
    fly_until_tracking(flight)
    return flight


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.lists(st.tuples(st.integers(0, 30), hostile), min_size=1, max_size=40))
def test_a_flight_goes_on_through_hostile_datagrams(barrage: list[tuple[int, bytes]]) -> None:
    flight = watched_flight()
    for wait_ms, data in barrage:
        sent = flight.guide.setpoints_sent
        flight.run(wait_ms * 1e-3)
        flight.inject(data)
        flight.run(0.05)
        assert flight.guide.setpoints_sent > sent, "the flight must go on"
    assert state_of(flight) == "tracking"


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.one_of(st.binary(max_size=300), hostile), max_size=30))
def test_before_any_autopilot_is_known_nothing_is_raised_or_streamed(barrage: list[bytes]) -> None:
    guide = Guide(make_config())
    now_ns = 0
    for data in barrage:
        now_ns += 10_000_000
        guide.receive(data, now_ns)
        guide.tick(now_ns)
        guide.packets()
        guide.records()
    assert guide.setpoints_sent == 0


def test_a_flood_of_garbage_costs_no_memory() -> None:
    guide = Guide(make_config())
    for i in range(200):
        guide.receive(b"\xfd" * 1400, i)
        guide.receive(bytes(range(256)) * 5, i)
        guide.records()
    assert guide.link.reader.counters["garbage_bytes"] > 200 * 1400
    assert len(guide.link.reader._rest) == 0
    assert len(guide.link.counters) < 20


def test_hostile_state_is_counted_by_name() -> None:
    flight = make_flight(without_messages=("ODOMETRY",))  # whose state would be used instead, unlooked at
    fly_until_tracking(flight)
    now_ms = flight.guide.link.vehicle_time_ms
    assert now_ms is not None
    counters = flight.guide.link.counters
    before = counters.copy()
    for data in (
        attitude(now_ms + 1, (NAN, 0.0, 0.0, 0.0), 0.0, 201),
        attitude(now_ms + 2, (0.5, 0.0, 0.0, 0.0), 0.0, 202),
        position(now_ms + 3, INF, 0.0, 203),
        attitude(now_ms + 600_000, (1.0, 0.0, 0.0, 0.0), 0.0, 204),
        attitude(now_ms - 1, (1.0, 0.0, 0.0, 0.0), 0.0, 205),
        attitude(now_ms - 1, (1.0, 0.0, 0.0, 0.0), 0.0, 205),
        heartbeat(7, 1, 0),
        heartbeat(1, 154, 0),
    ):
        flight.inject(data)
    counters -= before
    assert counters["ATTITUDE_QUATERNION:not_finite"] == 1
    assert counters["ATTITUDE_QUATERNION:not_a_unit_quaternion"] == 1
    assert counters["LOCAL_POSITION_NED:not_finite"] == 1
    assert counters["from_the_future"] == 1
    assert counters["ATTITUDE_QUATERNION:late"] == 1
    assert counters["duplicate"] == 1
    assert counters["other_system"] == 1
    assert counters["other_component"] == 1


def test_an_input_of_the_core_is_made_of_bytes_alone() -> None:
    """What is fuzzed here is all there is: a datagram enters as bytes, with a time."""
    guide = Guide(make_config())
    guide.handle(Input(t_ns=5, seq=0, kind=InputKind.DATAGRAM, data=struct.pack("<I", 7)))
    assert len(guide.records()) == 1
