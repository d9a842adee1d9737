"""Streams are asked for one by one, watched by three verdicts, lowered when denied and asked for again."""

from __future__ import annotations

import pytest

from guidance.mavlink.budget import affords_odometry
from guidance.mavlink.streams import SLOWEST_HZ, Stream, Streams, wanted_streams
from guidance.records import StreamStatus
from sitl.fuzzing.sizes import longest

SECOND = 1_000_000_000
MS = 1_000_000
ATTITUDE, POSITION, EULER = "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "ATTITUDE"


def play(stream: Stream, since_ns: int, seconds: float, hz: float, *, valid: bool = True) -> int:
    """Messages at a steady rate; the instant of the last one."""
    count = round(seconds * hz)
    for n in range(1, count + 1):
        stream.arrived(since_ns + round(n * SECOND / hz), valid=valid)
    return since_ns + round(count * SECOND / hz)


def verdicts(status: StreamStatus) -> tuple[bool, bool, bool]:
    return status.alive, status.at_rate, status.valid


def test_a_stream_that_never_came_is_none_of_the_three() -> None:
    status = Stream(ATTITUDE, 50.0).status(5 * SECOND)
    assert verdicts(status) == (False, False, False)
    assert (status.rate_hz, status.age_s, status.rejected) == (0.0, None, 0)


@pytest.mark.parametrize(
    ("hz", "at_rate"), [(50.0, True), (40.0, True), (26.0, True), (24.0, False), (4.0, False)]
)
def test_at_rate_is_half_of_what_is_wanted(hz: float, at_rate: bool) -> None:
    stream = Stream(ATTITUDE, 50.0)
    now = play(stream, 0, 3.0, hz)
    status = stream.status(now)
    assert verdicts(status) == (True, at_rate, True)
    assert status.rate_hz == pytest.approx(hz, rel=1e-3)


def test_the_verdicts_fall_apart_one_by_one() -> None:
    stream = Stream(ATTITUDE, 50.0, alive_s=0.2)
    now = play(stream, 0, 2.0, 50.0)
    assert verdicts(stream.status(now)) == (True, True, True)
    assert verdicts(stream.status(now + 221 * MS)) == (False, False, False)
    stream.arrived(now + 20 * MS, valid=False)
    assert verdicts(stream.status(now + 20 * MS)) == (True, True, False)
    assert stream.status(now + 20 * MS).rejected == 1
    assert stream.alive(now + 220 * MS)
    assert not stream.alive(now + 221 * MS)
    assert verdicts(stream.status(now + 221 * MS)) == (False, False, False)


def test_a_flood_within_a_second_takes_no_more_memory_and_keeps_its_rate() -> None:
    stream = Stream(ATTITUDE, 50.0)
    now = play(stream, 0, 1.0, 20_000.0)
    assert stream.rate_hz(now) == pytest.approx(20_000.0, rel=0.01)
    assert longest(stream).length <= 1000


def test_the_rate_falls_while_nothing_comes_and_is_not_fooled_by_bursts() -> None:
    stream = Stream(ATTITUDE, 50.0)
    now = play(stream, 0, 2.0, 50.0)
    rates = [stream.rate_hz(now + wait * MS) for wait in (0, 20, 100, 300, 600, 990, 1500)]
    assert rates[0] == pytest.approx(50.0)
    assert rates == sorted(rates, reverse=True)
    assert rates[3] == pytest.approx(36.0, abs=1.5)
    assert rates[4] == pytest.approx(21.0, abs=1.5)
    assert rates[-1] == 0.0
    burst = Stream(ATTITUDE, 50.0)
    for _ in range(40):
        burst.arrived(now, valid=True)
    assert burst.rate_hz(now) == 0.0
    assert burst.rate_hz(now + 500 * MS) <= 80.0


def asked(streams: Streams, now: int) -> tuple[str, float] | None:
    return streams.request(now)


def test_one_request_is_outstanding_until_it_is_answered_or_given_up() -> None:
    streams = Streams([Stream(ATTITUDE, 50.0), Stream(POSITION, 30.0)])
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    assert asked(streams, 100 * MS) is None
    streams.acknowledged(accepted=True)
    assert asked(streams, 110 * MS) == (POSITION, 30.0)
    assert asked(streams, 200 * MS) is None
    assert asked(streams, 409 * MS) is None
    # The second was not answered: nothing else is due, and it is asked for again after its time.
    assert asked(streams, 420 * MS) is None
    streams[ATTITUDE].arrived(2000 * MS, valid=True)
    assert asked(streams, 2001 * MS) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=True)
    assert asked(streams, 2111 * MS) == (POSITION, 30.0)


def test_a_denied_rate_is_lowered_rung_by_rung_and_given_up_below_the_slowest() -> None:
    streams = Streams([Stream(ATTITUDE, 50.0)])
    rates = []
    for n in range(40):
        request = asked(streams, n * 100 * MS)
        if request is None:
            break
        rates.append(request[1])
        streams.acknowledged(accepted=False)
    assert rates[:3] == pytest.approx([50.0, 40.0, 32.0])
    assert rates == sorted(rates, reverse=True)
    assert rates[-1] == SLOWEST_HZ
    assert len(rates) < 15
    assert all(asked(streams, minute * 60 * SECOND) is None for minute in range(1, 10)), "refused for good"
    streams.reset()
    assert asked(streams, 601 * SECOND) == (ATTITUDE, 50.0), "another boot, another answer"


def test_forty_of_fifty_is_what_ardurover_grants_and_it_is_enough() -> None:
    stream = Stream(ATTITUDE, 50.0)
    streams = Streams([stream])
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=False)
    assert asked(streams, 100 * MS) == (ATTITUDE, 40.0)
    streams.acknowledged(accepted=True)
    now = play(stream, 100 * MS, 5.0, 40.0)
    assert stream.status(now).at_rate
    assert asked(streams, now) is None


def test_it_is_asked_for_again_when_another_program_resets_the_rate() -> None:
    stream = Stream(ATTITUDE, 50.0)
    streams = Streams([stream])
    asked(streams, 0)
    streams.acknowledged(accepted=True)
    now = play(stream, 0, 5.0, 50.0)
    assert asked(streams, now) is None
    now = play(stream, now, 2.0, 4.0)
    assert asked(streams, now) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=True)
    assert asked(streams, now + 1500 * MS) is None, "not more often than every two seconds"
    assert asked(streams, now + 2000 * MS) == (ATTITUDE, 50.0)


def test_a_stream_that_does_not_insist_is_asked_for_once_as_long_as_it_comes() -> None:
    stream = Stream("CURRENT_MODE", 10.0, alive_s=3.0, insist=False)
    streams = Streams([stream])
    assert asked(streams, 0) == ("CURRENT_MODE", 10.0)
    streams.acknowledged(accepted=True)
    now = play(stream, 0, 20.0, 2.0)  # PX4 publishes it at 2 Hz, whatever is asked
    assert asked(streams, now) is None
    assert asked(streams, now + 2900 * MS) is None
    assert asked(streams, now + 3100 * MS) == ("CURRENT_MODE", 10.0)


def pair() -> Streams:
    return Streams([Stream(ATTITUDE, 50.0), Stream(EULER, 50.0, instead_of=ATTITUDE)])


def test_the_substitute_is_not_asked_for_while_the_stream_comes() -> None:
    streams = pair()
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=True)
    now = play(streams[ATTITUDE], 0, 10.0, 50.0)
    assert asked(streams, now) is None


def test_the_substitute_is_asked_for_when_the_stream_does_not_come() -> None:
    streams = pair()
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=True)
    assert asked(streams, 900 * MS) is None
    assert asked(streams, 1000 * MS) == (EULER, 50.0)


def test_the_substitute_is_asked_for_when_the_stream_is_refused_for_good() -> None:
    streams = pair()
    requests = []
    for n in range(40):
        request = asked(streams, n * 10 * MS)
        if request is not None:
            requests.append(request)
            streams.acknowledged(accepted=request[0] == EULER)
    assert requests[-1] == (EULER, 50.0)
    assert {name for name, _ in requests[:-1]} == {ATTITUDE}


def test_the_substitute_is_asked_for_at_once_when_the_stream_stops_or_is_unusable() -> None:
    for valid in (True, False):
        streams = pair()
        assert asked(streams, 0) == (ATTITUDE, 50.0)
        streams.acknowledged(accepted=True)
        now = play(streams[ATTITUDE], 0, 5.0, 50.0)
        assert asked(streams, now) is None
        if valid:
            now += 600 * MS
        else:  # it comes, and nothing of it can be used
            now = play(streams[ATTITUDE], now, 0.6, 50.0, valid=False)
        requests = {asked(streams, now + 310 * MS * n) for n in range(2)}
        assert (EULER, 50.0) in requests


def test_an_unknown_message_is_not_asked_for_again_at_a_lower_rate() -> None:
    streams = pair()
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=False, known=False)
    assert asked(streams, 10 * MS) == (EULER, 50.0)
    streams.acknowledged(accepted=True)
    assert asked(streams, 20 * MS) is None


def test_the_third_is_asked_for_only_if_both_better_ones_are_absent() -> None:
    streams = Streams(
        [
            Stream("ODOMETRY", 50.0),
            Stream(ATTITUDE, 50.0, instead_of="ODOMETRY"),
            Stream(EULER, 50.0, instead_of=ATTITUDE),
        ]
    )
    assert asked(streams, 0) == ("ODOMETRY", 50.0)
    streams.acknowledged(accepted=False, known=False)
    assert asked(streams, 10 * MS) == (ATTITUDE, 50.0)
    streams.acknowledged(accepted=False, known=False)
    play(streams["ODOMETRY"], 0, 1.0, 50.0)  # it comes all the same, as some other program asked for it
    assert asked(streams, 1000 * MS) is None
    assert asked(streams, 1600 * MS) == (EULER, 50.0)


def insisted(streams: Streams, now_ns: int) -> set[str]:
    return {status.message for status in streams.status(now_ns) if status.insisted}


def test_insisted_is_on_the_best_that_can_be_had_and_on_no_stream_whose_rate_does_not_matter() -> None:
    streams = Streams(
        [
            Stream("ODOMETRY", 50.0),
            Stream(ATTITUDE, 50.0, instead_of="ODOMETRY"),
            Stream(EULER, 50.0, instead_of=ATTITUDE),
            Stream("CURRENT_MODE", 10.0, alive_s=3.0, insist=False),
        ]
    )
    assert insisted(streams, 0) == {"ODOMETRY"}
    assert asked(streams, 0) == ("ODOMETRY", 50.0)
    streams.acknowledged(accepted=False, known=False)
    assert insisted(streams, 10 * MS) == {"ODOMETRY", ATTITUDE}, "neither comes"
    now = play(streams[ATTITUDE], 10 * MS, 1.0, 50.0)
    assert insisted(streams, now) == {ATTITUDE}
    now += 1000 * MS
    assert insisted(streams, now) == {"ODOMETRY", ATTITUDE, EULER}, "it stopped, and nothing stands in"
    now = play(streams[EULER], now, 1.0, 50.0)
    assert insisted(streams, now) == {EULER}
    now = play(streams["ODOMETRY"], now, 1.0, 50.0)
    assert insisted(streams, now) == {"ODOMETRY"}


def test_odometry_is_wanted_where_it_can_be_asked_for() -> None:
    def wanted(*, odometry: bool) -> dict[str, str | None]:
        streams = wanted_streams(50.0, 0.2, 0.3, 0.0, odometry=odometry)
        return {stream.message: stream.instead_of for stream in streams}

    lesser = {EULER: ATTITUDE, "GLOBAL_POSITION_INT": POSITION}
    best = "ODOMETRY"
    assert wanted(odometry=True) == {best: None, ATTITUDE: best, POSITION: best, **lesser}
    assert next(iter(wanted(odometry=True))) == best
    assert wanted(odometry=False) == {ATTITUDE: None, POSITION: None, **lesser}


def test_an_answer_that_nobody_waits_for_changes_nothing() -> None:
    streams = Streams([Stream(ATTITUDE, 50.0)])
    streams.acknowledged(accepted=False)
    assert asked(streams, 0) == (ATTITUDE, 50.0)
    assert streams.get(EULER) is None
    assert [status.message for status in streams.status(0)] == [ATTITUDE]


def test_memory_does_not_grow_with_the_messages() -> None:
    stream = Stream(ATTITUDE, 50.0)
    play(stream, 0, 60.0, 100.0)
    assert len(stream._arrivals_ns) <= 101


def test_a_line_that_odometry_would_fill_is_left_to_the_smaller_messages() -> None:
    """At 50 Hz it takes 12.9 kB/s with its signature: more than 115200 baud carry."""
    assert affords_odometry(None, 50.0)
    assert not affords_odometry(11_520.0, 50.0)
    assert affords_odometry(92_160.0, 50.0)
    assert not affords_odometry(92_160.0, 200.0)
