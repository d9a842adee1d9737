"""What a line carries against what is asked of it, in bytes a second.

The need is an upper bound: every frame with its whole payload (MAVLink 2 cuts trailing zeros off) and signed.
What it is too high by is left for what the autopilot sends unasked.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.connection import BAUD_MAX, BAUD_RATES, BITS_PER_BYTE
from guidance.mavlink.streams import Stream, state_hz

#: Header, checksum and signature of a MAVLink 2 frame.
OVERHEAD_BYTES: Final = 10 + 2 + 13
#: HEARTBEAT and TIMESYNC, each way.
_ALWAYS_HZ: Final = (("HEARTBEAT", 1.0), ("TIMESYNC", 25.0))
_SETPOINT: Final = "SET_ATTITUDE_TARGET"
#: Above this part of its capacity a line counts as full.
FULL: Final = 0.9

_WINDOW_NS: Final = 1_000_000_000
_PAYLOAD_BYTES: Final[dict[str, int]] = {
    message.msgname: message.unpacker.size for message in dialect.mavlink_map.values()
}


def frame_bytes(message: str) -> int:
    """The longest frame of a message."""
    return OVERHEAD_BYTES + _PAYLOAD_BYTES[message]


def needed_bytes_per_s(streams: Iterable[Stream], setpoints_hz: float) -> float:
    """Of the busier direction: the wanted streams in, or setpoints out; with HEARTBEAT and TIMESYNC."""
    always = sum(frame_bytes(message) * hz for message, hz in _ALWAYS_HZ)
    # What is asked for only if another does not come takes that one's place.
    wanted = sum(frame_bytes(s.message) * s.wanted_hz for s in streams if s.instead_of is None)
    return always + max(wanted, frame_bytes(_SETPOINT) * setpoints_hz)


def affords_odometry(capacity_bytes_per_s: float | None, rate_hz: float) -> bool:
    """Whether ODOMETRY for setpoints at `rate_hz` leaves half of the line free (None: of no known end).

    It takes three times as much as ATTITUDE_QUATERNION and LOCAL_POSITION_NED together, which do as well.
    """
    return capacity_bytes_per_s is None or frame_bytes("ODOMETRY") * state_hz(rate_hz) <= 0.5 * (
        capacity_bytes_per_s
    )


def too_slow(capacity_bytes_per_s: float, rate_hz: float, needed_at: Callable[[float], float]) -> str | None:
    """Why a serial line cannot carry setpoints at `rate_hz`, and what could; None if it can.

    `needed_at` gives the bytes a second that are needed at a rate in Hz.
    """
    needed = needed_at(rate_hz)
    if needed <= capacity_bytes_per_s:
        return None
    bauds = [baud for baud in BAUD_RATES if baud / BITS_PER_BYTE >= needed]
    remedies = [f"a baud rate of {min(bauds, default=BAUD_MAX)} at both ends"]
    fitting = [hz for hz in range(5, int(rate_hz) + 1) if needed_at(hz) <= capacity_bytes_per_s]
    if fitting:
        remedies.append(f"link.rate_hz = {fitting[-1]}")
    return (
        f"the serial line is too slow: it carries {capacity_bytes_per_s:.0f} bytes/s, and "
        f"{rate_hz:g} Hz need up to {needed:.0f}; it takes {' or '.join(remedies)}"
    )


class Traffic:
    """Bytes a second over the last second or a little more, from counts that are looked at now and then."""

    def __init__(self) -> None:
        self._looks: deque[tuple[int, int, int]] = deque()

    def look(self, received_bytes: int, sent_bytes: int, now_ns: int) -> tuple[float, float]:
        """The counts since the start are these now; received and sent bytes a second."""
        self._looks.append((now_ns, received_bytes, sent_bytes))
        while len(self._looks) > 2 and now_ns - self._looks[1][0] >= _WINDOW_NS:
            self._looks.popleft()
        then_ns, received_then, sent_then = self._looks[0]
        span_s = (now_ns - then_ns) * 1e-9
        if span_s <= 0.0:
            return 0.0, 0.0
        return (received_bytes - received_then) / span_s, (sent_bytes - sent_then) / span_s
