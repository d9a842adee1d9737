"""The timing autopilot: engages the service, and its setpoints tell which state they answer."""

from __future__ import annotations

import sys
from typing import Final

import pytest

from guidance.core import Guide
from guidance.records import Event
from guidance.supervisor import State
from sitl.bench_latency import UnavailableError, fly, free_port
from sitl.stopwatch import answered_us
from sitl.timing_autopilot import HEADINGS_RAD, SETTINGS, Conversation, heading_of, yaw_rates
from tests.helpers import make_config

PERIOD_NS: Final = 20_000_000


def answers() -> list[float]:
    return yaw_rates(make_config(*SETTINGS))


def test_every_state_is_answered_at_once_with_its_own_heading() -> None:
    guide = Guide(make_config(*SETTINGS))
    autopilot = Conversation(answers(), boot_ns=0)
    came: list[int] = []
    told: list[str] = []

    def exchange(datagrams: list[bytes], now_ns: int) -> None:
        for datagram in datagrams:
            guide.receive(datagram, now_ns)
        if guide.deadline() <= now_ns:
            guide.tick(now_ns)
        came.extend(h for packet in guide.packets() if (h := autopilot.take(packet, now_ns)) is not None)
        told.extend(record.code for record in guide.records() if isinstance(record, Event))

    for i in range(300):
        now_ns = 1_000_000_000 + i * PERIOD_NS
        autopilot.tick(now_ns)
        exchange(autopilot.drain(), now_ns)
        exchange(autopilot.drain(), now_ns)  # the answers to what it asked
        came.clear()
        exchange([autopilot.state(i % 8, now_ns)], now_ns)
        if i >= 200:
            assert guide.engagement.state is State.TRACKING
            assert came == [i % 8]
    assert told[0] == "state_connected"
    assert "estimator_reset" not in told  # as in a flight: its headings are no jumps


def test_headings_are_told_from_the_yaw_rate_and_a_neutral_one_is_none_of_them() -> None:
    rates = answers()
    assert len(set(rates)) == len(HEADINGS_RAD)
    for heading, rate in enumerate(rates):
        assert heading_of(rate + 0.005, rates) == heading
    assert heading_of(0.0, rates) is None
    assert heading_of(5.0, rates) is None


def test_an_echo_is_told_by_its_bytes_until_they_are_forgotten() -> None:
    autopilot = Conversation(answers(), boot_ns=0)
    states = [autopilot.state(i % 8, i * PERIOD_NS) for i in range(16)]
    assert len(set(states)) == 16
    assert [autopilot.take(state, 0) for state in states] == [i % 8 for i in range(16)]
    autopilot.forget()
    assert autopilot.take(states[0], 0) is None


def test_a_real_echo_is_timed() -> None:
    port = free_port()
    flight = fly("echo", [sys.executable, "-m", "sitl.bench_echo", str(port)], port, 200, 0.1)
    times_us = answered_us(flight)
    assert len(times_us) == len(flight.states) == len(flight.late_ns) == 20
    assert all(0.0 < time_us < 1e6 for time_us in times_us)


def test_a_process_that_ends_is_named_with_its_last_words() -> None:
    command = [sys.executable, "-c", "import sys; sys.exit('nothing works')"]
    with pytest.raises(UnavailableError, match="the mavsdk ended with status 1: nothing works"):
        fly("mavsdk", command, free_port(), 200, 0.1)
