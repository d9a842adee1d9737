"""The message streams that the service needs: asked for, watched, and asked for again.

Other programs on the vehicle reset message rates (ArduPilot/ardupilot#17046) and autopilots refuse rates
above what their loop can do (ArduRover at its default answers 50 Hz with DENIED and takes 40 Hz), so a
request is repeated while the rate is not met and lowered when it is denied.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import Final

from msgspec.structs import replace

from guidance.records import StreamStatus

#: Of the wanted rate: less than this is "not at rate" (so 30 % of loss is still at rate).
AT_RATE: Final = 0.5
#: Of the wanted rate: less than this, and the autopilot is asked again.
SATISFIED: Final = 0.8
#: A denied rate is lowered to this part of itself, and never below the slowest useful one.
LOWERED: Final = 0.8
SLOWEST_HZ: Final = 5.0

#: Attitude and position are asked for at the setpoints' rate, or its smallest multiple of at least this.
STATE_HZ_MIN: Final = 20.0

_WINDOW_NS: Final = 1_000_000_000
#: So many arrivals are kept: five times the fastest rate that is asked for. A flood takes no more memory.
_ARRIVALS_MAX: Final = 1000
_ALIVE_NS: Final = 500_000_000
_ASK_AGAIN_NS: Final = 2_000_000_000
_ANSWER_NS: Final = 300_000_000
_PATIENCE_NS: Final = 1_000_000_000


class Stream:
    """One message at a wanted rate: when it came, whether it was usable, when it was last asked for."""

    def __init__(
        self,
        message: str,
        wanted_hz: float,
        *,
        alive_s: float | None = None,
        instead_of: str | None = None,
        insist: bool = True,
    ) -> None:
        self.message = message
        self._insist = insist  # False: any rate will do, as long as it comes
        self.instead_of = instead_of  # asked for only if that stream does not come
        self.wanted_hz = wanted_hz
        self.rejected = 0
        self.last_ns: int | None = None  # when the newest came
        self._alive_ns = _ALIVE_NS if alive_s is None else round(alive_s * 1e9)
        self._asked_hz = wanted_hz
        self._asked_ns: int | None = None
        self._refused = False
        self._arrivals_ns: deque[int] = deque(maxlen=_ARRIVALS_MAX)
        self._last_valid = False
        self._usable_ns: int | None = None
        self._first_asked_ns: int | None = None

    @property
    def insistent(self) -> bool:
        """Whether the rate matters, and not only that it comes."""
        return self._insist

    @property
    def asked_hz(self) -> float:
        """The rate that is asked for: lower than the wanted one after a refusal."""
        return self._asked_hz

    def reset(self) -> None:
        """The autopilot rebooted or is a new one: its rates are back at its defaults."""
        self._asked_hz = self.wanted_hz
        self._asked_ns = None
        self._refused = False
        self._arrivals_ns.clear()
        self.last_ns = None
        self._last_valid = False
        self._usable_ns = None
        self._first_asked_ns = None

    def arrived(self, now_ns: int, *, valid: bool) -> None:
        """A message came; `valid` says whether its content could be used."""
        self._arrivals_ns.append(now_ns)
        self.last_ns = now_ns
        self._last_valid = valid
        if valid:
            self._usable_ns = now_ns
        else:
            self.rejected += 1
        self._forget(now_ns)

    def alive(self, now_ns: int) -> bool:
        """Whether the newest message is young."""
        return self.last_ns is not None and now_ns - self.last_ns <= self._alive_ns

    def absent(self, now_ns: int) -> bool:
        """Whether it was asked for and nothing usable came, or stopped coming."""
        if self._usable_ns is not None:
            return now_ns - self._usable_ns > self._alive_ns
        waited = self._first_asked_ns is not None and now_ns - self._first_asked_ns >= _PATIENCE_NS
        return waited or self._refused

    def rate_hz(self, now_ns: int) -> float:
        """Messages a second over the last second (or since the first one)."""
        self._forget(now_ns)
        count = len(self._arrivals_ns)
        if count < 2:
            return 0.0
        # An interval that has just begun counts once it is longer than the mean of the others.
        span_ns = self._arrivals_ns[-1] - self._arrivals_ns[0]
        open_ns = now_ns - self._arrivals_ns[-1]
        if span_ns <= 0:
            return 0.0
        if open_ns * (count - 1) > span_ns:
            return count * 1e9 / (span_ns + open_ns)
        return (count - 1) * 1e9 / span_ns

    def status(self, now_ns: int) -> StreamStatus:
        """Alive, at rate, valid: the three verdicts, apart."""
        rate_hz = self.rate_hz(now_ns)
        age_ns = None if self.last_ns is None else now_ns - self.last_ns
        alive = self.alive(now_ns)
        return StreamStatus(
            message=self.message,
            wanted_hz=self.wanted_hz,
            rate_hz=round(rate_hz, 3),
            age_s=None if age_ns is None else age_ns * 1e-9,
            alive=alive,
            at_rate=alive and rate_hz >= AT_RATE * self.wanted_hz,
            valid=alive and self._last_valid,
            rejected=self.rejected,
        )

    def denied(self, *, known: bool = True) -> None:
        """The autopilot refused the rate: ask for a lower one next, and not at all below the slowest.

        Not at all either if it does not even know the message.
        """
        if self._asked_hz <= SLOWEST_HZ or not known:
            self._refused = True
        self._asked_hz = max(self._asked_hz * LOWERED, SLOWEST_HZ)
        self._asked_ns = None

    def cap(self, most_hz: float) -> None:
        """The autopilot grants no more than `most_hz`: ask for that, if it is less than what is wanted."""
        possible_hz = min(self.wanted_hz, most_hz)
        if self._asked_hz != possible_hz and (most_hz < self.wanted_hz):
            self._asked_hz = possible_hz
            self._asked_ns = None

    def due(self, now_ns: int) -> bool:
        """Whether the autopilot should be asked (again) for this stream now."""
        if self._refused:
            return False
        if self._asked_ns is None:
            return True
        enough = self.rate_hz(now_ns) >= SATISFIED * self._asked_hz if self._insist else self.alive(now_ns)
        return now_ns - self._asked_ns >= _ASK_AGAIN_NS and not enough

    def ask(self, now_ns: int) -> float:
        """Note that the request goes out now; the rate in Hz to ask for."""
        self._asked_ns = now_ns
        if self._first_asked_ns is None:
            self._first_asked_ns = now_ns
        return self._asked_hz

    def _forget(self, now_ns: int) -> None:
        while self._arrivals_ns and now_ns - self._arrivals_ns[0] > _WINDOW_NS:
            self._arrivals_ns.popleft()


class Streams:
    """All wanted streams of one autopilot. Requests go one by one: COMMAND_ACK does not name the message."""

    def __init__(self, wanted: Iterable[Stream]) -> None:
        self._by_message = {stream.message: stream for stream in wanted}
        self._asking: Stream | None = None
        self._asking_ns = 0

    def __getitem__(self, message: str) -> Stream:
        return self._by_message[message]

    def get(self, message: str) -> Stream | None:
        """The stream of that message, None if it is not wanted."""
        return self._by_message.get(message)

    def all(self) -> tuple[Stream, ...]:
        """Each of them, the most wanted first."""
        return tuple(self._by_message.values())

    def reset(self) -> None:
        """Start over with a rebooted autopilot."""
        self._asking = None
        for stream in self._by_message.values():
            stream.reset()

    def request(self, now_ns: int) -> tuple[str, float] | None:
        """The message and rate (Hz) to ask for now; None if nothing is due or an answer is awaited."""
        if self._asking is not None and now_ns - self._asking_ns < _ANSWER_NS:
            return None
        self._asking = next((s for s in self._by_message.values() if self._wanted(s, now_ns)), None)
        if self._asking is None:
            return None
        self._asking_ns = now_ns
        return self._asking.message, self._asking.ask(now_ns)

    def _wanted(self, stream: Stream, now_ns: int) -> bool:
        return self.needed(stream, now_ns) and stream.due(now_ns)

    def needed(self, stream: Stream, now_ns: int) -> bool:
        """Whether nothing better comes."""
        if stream.instead_of is None:
            return True
        better = self._by_message[stream.instead_of]
        return better.absent(now_ns) and self.needed(better, now_ns)

    def cap(self, most_hz: float) -> None:
        """The autopilot grants none of them faster than this."""
        for stream in self._by_message.values():
            stream.cap(most_hz)

    def acknowledged(self, accepted: bool, known: bool = True) -> None:
        """COMMAND_ACK of SET_MESSAGE_INTERVAL came; `known` is false if there is no such message."""
        if self._asking is not None and not accepted:
            self._asking.denied(known=known)
        self._asking = None

    def status(self, now_ns: int) -> tuple[StreamStatus, ...]:
        """The verdicts of all."""
        return tuple(
            replace(stream.status(now_ns), insisted=self._insisted(stream, now_ns)) for stream in self.all()
        )

    def _insisted(self, stream: Stream, now_ns: int) -> bool:
        """Whether it is to come at its rate: no better one comes, nor a lesser one in its place."""
        if not (stream.insistent and self.needed(stream, now_ns)):
            return False
        return not (stream.absent(now_ns) and self._replaced(stream, now_ns))

    def _replaced(self, stream: Stream, now_ns: int) -> bool:
        lesser = (other for other in self.all() if other.instead_of == stream.message)
        return any(other.alive(now_ns) or self._replaced(other, now_ns) for other in lesser)


def state_hz(rate_hz: float) -> float:
    """The rate of attitude and position for setpoints at `rate_hz`."""
    return rate_hz * math.ceil(STATE_HZ_MIN / rate_hz)


def wanted_streams(
    rate_hz: float,
    attitude_timeout_s: float,
    position_timeout_s: float,
    mode_hz: float,
    *,
    odometry: bool,
    air: Iterable[tuple[str, float]] = (),
) -> list[Stream]:
    """What setpoints at `rate_hz` need: a lesser message is asked for only where the better is absent.

    ODOMETRY only where it can be asked for, CURRENT_MODE only where `mode_hz` is not 0, and `air` besides.
    An ODOMETRY takes 245 bytes on the wire, ATTITUDE_QUATERNION and LOCAL_POSITION_NED together 84.
    """
    hz = state_hz(rate_hz)

    def state(message: str, alive_s: float, instead_of: str | None) -> Stream:
        return Stream(message, hz, alive_s=alive_s, instead_of=instead_of)

    best = "ODOMETRY" if odometry else None
    streams = [
        state("ATTITUDE_QUATERNION", attitude_timeout_s, best),
        state("LOCAL_POSITION_NED", position_timeout_s, best),
        state("ATTITUDE", attitude_timeout_s, "ATTITUDE_QUATERNION"),
        state("GLOBAL_POSITION_INT", position_timeout_s, "LOCAL_POSITION_NED"),
    ]
    if best is not None:
        streams.insert(0, state(best, min(attitude_timeout_s, position_timeout_s), None))
    if mode_hz:
        streams.append(Stream("CURRENT_MODE", mode_hz, alive_s=3.0, insist=False))
    return [*streams, *(Stream(message, hz, alive_s=3.0, insist=False) for message, hz in air)]
