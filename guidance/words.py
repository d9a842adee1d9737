"""What the autopilot says to people: its texts as events, and its refusals as reasons."""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import CommandAck, StatusText
from guidance.records import Event, Level

#: MAV_SEVERITY of each level, for STATUSTEXT both ways.
SEVERITY: Final = {
    Level.INFO: dialect.MAV_SEVERITY_INFO,
    Level.NOTICE: dialect.MAV_SEVERITY_NOTICE,
    Level.WARNING: dialect.MAV_SEVERITY_WARNING,
    Level.ERROR: dialect.MAV_SEVERITY_ERROR,
    Level.CRITICAL: dialect.MAV_SEVERITY_CRITICAL,
}
#: So many texts a second become events; a flood tells nobody anything.
TEXTS_PER_S_MAX: Final = 10

_LEVELS: Final = {
    dialect.MAV_SEVERITY_EMERGENCY: Level.CRITICAL,
    dialect.MAV_SEVERITY_ALERT: Level.CRITICAL,
    **{severity: level for level, severity in SEVERITY.items()},
}


class Words:
    """The last refusal and the last complaint since `forget`, in words; texts above the limit are counted."""

    def __init__(self) -> None:
        self.not_shown = 0
        self._second = 0
        self._in_second = 0
        self._result = ""
        self._complaint = ""

    def forget(self) -> None:
        """A new step of engaging begins: what was refused before says nothing about it."""
        self._result = ""
        self._complaint = ""

    @property
    def answer(self) -> str:
        """Why what was commanded is refused, as far as the autopilot says it."""
        return ", ".join(filter(None, (self._result, self._complaint)))

    def acknowledged(self, ack: CommandAck) -> None:
        """COMMAND_ACK (77) of a mode or arming command of ours."""
        if ack.result != dialect.MAV_RESULT_ACCEPTED:
            entry = dialect.enums["MAV_RESULT"].get(ack.result)
            self._result = str(ack.result) if entry is None else entry.name.removeprefix("MAV_RESULT_")

    def said(self, text: StatusText, now_ns: int) -> Event | None:
        """STATUSTEXT (253) as an event, None above the limit."""
        second = now_ns // 1_000_000_000
        self._in_second = self._in_second + 1 if second == self._second else 1
        self._second = second
        if self._in_second > TEXTS_PER_S_MAX:
            self.not_shown += 1
            return None
        words = text.text.rstrip(b"\0").decode("utf-8", "replace")
        if text.severity <= dialect.MAV_SEVERITY_WARNING:
            self._complaint = words
        level = _LEVELS.get(text.severity, Level.INFO)
        return Event(t_ns=now_ns, level=level, code="autopilot", text=f"autopilot: {words}")
