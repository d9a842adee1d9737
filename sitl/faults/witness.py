"""What must hold in every flight, whatever fails: by the bytes that arrive, not by what the guide says.

The witness stands at both ends of the line. It knows of every datagram when it was sent and when it came, and
of the vehicle the truth. It decodes on its own the few messages that it needs.
"""

from __future__ import annotations

import hashlib
import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from itertools import pairwise
from struct import Struct
from typing import Final, NamedTuple

from guidance.config import Config
from guidance.mavlink.codec import Frame, FrameReader
from guidance.mavlink.profiles import Profile
from sitl.faults.asked import SETPOINTS, numbers, ranges, stays

HEARTBEAT: Final = 0
STATUSTEXT: Final = 253
CURRENT_MODE: Final = 436
#: ATTITUDE, ATTITUDE_QUATERNION, ODOMETRY; LOCAL_POSITION_NED, GLOBAL_POSITION_INT, ODOMETRY.
ATTITUDES: Final = frozenset({30, 31, 331})
POSITIONS: Final = frozenset({32, 33, 331})

_BEAT: Final = Struct("<I3B")
_MODE: Final = Struct("<I")
_ARMED: Final = 128
_NANOSECONDS: Final = 1_000_000_000
#: A silence of so many stream time-outs of the firmware ends a flight: what comes later would resume it.
_RESUMED: Final = 1.2
#: Of the clock of the state: telling it in milliseconds, and what a filter of delays does not know.
CLOCK_SLACK_S: Final = 0.02


class Setpoint(NamedTuple):
    """As it came: when it was sent, its own time, and what it asks for (`asked.numbers`)."""

    sent_ns: int
    boot_ms: int
    asked: tuple[float, ...]
    sequence: int


class Witness:
    """Watches one flight of one service; `broken` says what did not hold, each once, in words.

    `slack_s` is how much older than configured a state may be: what the link's delay hides from any clock.
    `copies` says that the line itself may bring a datagram twice, `deceived` that another speaks as the
    autopilot, so that nobody can tell from a message what the vehicle does. `told` are the autopilot's own
    limits (`asked.OWN_LIMITS`).
    """

    def __init__(
        self, config: Config, profile: Profile, loop_ns: int, told: Mapping[str, float] | None = None
    ) -> None:
        self.broken: list[str] = []
        self.setpoints: list[Setpoint] = []
        self.slack_s = CLOCK_SLACK_S
        self.copies = False
        self.deceived = False
        self._config = config
        self._profile = profile
        self._loop_ns = loop_ns
        self._digest = hashlib.sha256()
        self._ranges = ranges(config, profile, told or {})
        self._readers = {True: FrameReader(), False: FrameReader()}
        self._restarts_ns: list[int] = []
        self._first: dict[tuple[int, int], int] = {}  # when a state of this time was sent first
        self._attitude = _Newest()
        self._position = _Newest()
        self._shown_ns = -1  # when the newest word on the mode was sent
        self._mode: int | None = None
        self._armed = False
        self._held = False  # what was shown is armed and in the control mode,
        self._flown = False  # and setpoints came to it
        self._forbidden_ns: int | None = None
        self._forbidden: list[tuple[int, int]] = []
        self._in_control = self.was_in_control = False
        self._came_ns: int | None = None

    # What happens ------------------------------------------------------------------------------------

    def permit(self, now_ns: int) -> None:
        """Somebody commands to engage or switches to the control mode: control may be taken again."""
        if self._forbidden_ns is not None:
            self._forbidden.append((self._forbidden_ns, now_ns))
        self._forbidden_ns = self._came_ns = None
        self._held = self.was_in_control = False

    def restarted(self, now_ns: int) -> None:
        """Another process of the service: its times begin anew, and it inherits no permission."""
        self._restarts_ns.append(now_ns)
        self._forbidden_ns = now_ns

    def rebooted(self) -> None:
        """The autopilot begins anew, and so do its times, by which it is to be seen."""
        self._first.clear()
        self._held = False

    def arrived(self, data: bytes, sent_ns: int, now_ns: int, *, to_guide: bool) -> None:
        """A datagram came."""
        look: Callable[[Frame, int, int], None] = self._at_guide if to_guide else self._at_vehicle
        if not to_guide:
            self._digest.update(now_ns.to_bytes(8, "little") + data)
        for frame in self._readers[to_guide].feed(data):
            if frame.known and frame.system == self._config.vehicle.system_id:
                look(frame, sent_ns, now_ns)

    def look(self, mode_is_control: bool, armed: bool) -> None:
        """The vehicle itself, after each thing that happened."""
        in_control = mode_is_control and armed
        if in_control and not self._in_control and self.was_in_control:
            self._break("control was taken back without a command or a switch")
        self._in_control = in_control
        self.was_in_control |= in_control

    def finish(self) -> str:
        """The last look, when the flight is over; a digest of all that came to the vehicle."""
        self._in_order()
        return self._digest.hexdigest()[:16]

    # At the guide's end ------------------------------------------------------------------------------

    def _at_guide(self, frame: Frame, sent_ns: int, now_ns: int) -> None:
        if frame.component != self._config.vehicle.component_id:
            return
        kind = frame.message_id
        if kind == HEARTBEAT:
            mode, _, _, base = _unpacked(_BEAT, frame)
            self._show(mode, bool(base & _ARMED), sent_ns, now_ns)
        elif kind == CURRENT_MODE:
            self._show(_unpacked(_MODE, frame)[0], self._armed, sent_ns, now_ns)
        elif kind in ATTITUDES or kind in POSITIONS:
            stamp = int.from_bytes(frame.payload[: 8 if kind == 331 else 4], "little")
            made_ns = self._first.setdefault((kind, stamp), sent_ns)
            if kind in ATTITUDES:
                self._attitude.came(made_ns, now_ns)
            if kind in POSITIONS:
                self._position.came(made_ns, now_ns)

    def _show(self, mode: int, armed: bool, sent_ns: int, now_ns: int) -> None:
        if sent_ns < self._shown_ns or self.deceived:
            return  # overtaken, or perhaps not the vehicle's
        self._shown_ns, self._mode, self._armed = sent_ns, mode, armed
        if self._restarts_ns and not armed and not self._is_control():
            self.permit(now_ns)  # put down and out of the control mode: the new process is a new start
        held = armed and mode == self._profile.control_mode.custom_mode
        if self._held and not held and self._flown:
            self._forbid(now_ns)
        self._held = held
        self._flown &= held

    def _forbid(self, now_ns: int) -> None:
        """From one loop period after this, nothing may be sent."""
        if self._forbidden_ns is None:
            self._forbidden_ns = now_ns + self._loop_ns

    # At the vehicle's end ----------------------------------------------------------------------------

    def _at_vehicle(self, frame: Frame, sent_ns: int, now_ns: int) -> None:
        if frame.message_id == STATUSTEXT and frame.payload[1:].startswith(b"guidance: handed-over"):
            self._forbid(sent_ns)
        if frame.message_id not in SETPOINTS:
            return
        boot_ms, asked = numbers(self._profile, frame.message_id, frame.payload)
        setpoint = Setpoint(sent_ns, boot_ms, asked, frame.sequence)
        if self.copies and setpoint in self.setpoints[-64:]:
            return  # the line's copy, not the guide's
        self.setpoints.append(setpoint)
        self._limits(setpoint)
        self._ages(setpoint)
        self._permission(setpoint, now_ns)

    def _limits(self, setpoint: Setpoint) -> None:
        if len(setpoint.asked) != len(self._ranges):
            self._break("a setpoint was sent that is no such vehicle's")
            return
        for value, (name, low, high) in zip(setpoint.asked, self._ranges, strict=True):
            if not low <= value <= high:  # nor is what is no number
                self._break(f"a {name} of {value:g} was sent, outside {low:g} to {high:g}")

    def _ages(self, setpoint: Setpoint) -> None:
        link = self._config.link
        for name, newest, limit_s in (
            ("attitude", self._attitude, link.attitude_timeout_s),
            ("position", self._position, link.position_timeout_s),
        ):
            age_s = newest.age_s(setpoint.sent_ns)
            if not age_s <= limit_s + self.slack_s:
                self._break(f"a setpoint was made of a {name} {age_s:.2f} s old")

    def _permission(self, setpoint: Setpoint, now_ns: int) -> None:
        sent_ns = setpoint.sent_ns
        harmless = stays(self._profile, setpoint.asked) and not self._is_control()
        open_ns = math.inf if self._forbidden_ns is None else self._forbidden_ns
        if sent_ns > open_ns or any(begin < sent_ns < end for begin, end in self._forbidden):
            # A neutral stream that cannot take control is offered to a pilot, who may switch to it. Who was
            # handed over in flight waits until the vehicle is down, with `auto` until it is commanded.
            waited = not self._armed and self._config.supervisor.engage != "auto"
            if not (harmless and (waited or self._restarts_ns)):
                self._break("a setpoint was sent after a hand-over")
        if self.was_in_control and self._came_ns is not None and not harmless:
            silence_s = (now_ns - self._came_ns) / _NANOSECONDS
            if silence_s > _RESUMED * self._profile.stream_timeout_s:
                self._break(f"setpoints were resumed after {silence_s:.1f} s")
        self._came_ns = now_ns
        self._flown |= self._held

    def _is_control(self) -> bool:
        return self._mode == self._profile.control_mode.custom_mode

    def _in_order(self) -> None:
        """Each setpoint is of its own instant: in the order of sending, their times increase."""
        for earlier, later in pairwise(sorted(self.setpoints)):
            another = any(earlier.sent_ns < at_ns <= later.sent_ns for at_ns in self._restarts_ns)
            if later.boot_ms <= earlier.boot_ms and not another:
                self._break("a setpoint was sent twice, or with an older time")

    def _break(self, what: str) -> None:
        if what not in self.broken and len(self.broken) < 8:
            self.broken.append(what)


class _Newest:
    """The newest state that had come by any instant."""

    def __init__(self) -> None:
        self._came_ns: list[int] = []
        self._made_ns: list[int] = []

    def came(self, made_ns: int, now_ns: int) -> None:
        """A state of `made_ns` came now."""
        if not self._made_ns or made_ns > self._made_ns[-1]:
            self._came_ns.append(now_ns)
            self._made_ns.append(made_ns)

    def age_s(self, now_ns: int) -> float:
        """How old the newest was then; infinite if none had come."""
        count = bisect_right(self._came_ns, now_ns)
        return (now_ns - self._made_ns[count - 1]) / _NANOSECONDS if count else math.inf


def _unpacked(form: Struct, frame: Frame) -> tuple[int, ...]:
    """The first fields of a payload, whose last zeros are not sent."""
    return form.unpack(frame.payload[: form.size].ljust(form.size, b"\0"))
