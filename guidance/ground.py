"""What ground stations ask of this component over MAVLink is answered: commands and parameters.

Only systems of `link.commands_from` are heard at all (with a key, only signed), see `mavlink.company`. Each
command is an order like any other, with an id, so that a transmission that repeats (`confirmation`, or the
same packet twice) does nothing twice and is answered the same. Parameters go out one at a time. One goes out
unasked to a ground station that has come, for some take the autopilot's as a file and ask nobody else.

MAVLink's guides: https://mavlink.io/en/services/command.html and parameter.html.
"""

from __future__ import annotations

from typing import Final

from pymavlink.dialects.v20 import all as dialect

from guidance.changing import settings
from guidance.commands import Order, Set
from guidance.component import PARAMETERS, as_real32, from_real32, order_of
from guidance.engagement import Engagement
from guidance.mavlink.asking import (
    CommandInt,
    CommandLong,
    ParamRequestList,
    ParamRequestRead,
    ParamSet,
    once,
    read,
)
from guidance.mavlink.codec import Frame
from guidance.mavlink.link import AutopilotLink
from guidance.orders import Orders
from guidance.records import Answer, Event

#: A transmission of a command that comes so much after the first is a new order;
REPEAT_NS: Final = 10_000_000_000
#: and so is a packet that looks like a copy of one, its sequence number having come round.
COPY_NS: Final = 2_000_000_000
#: Between two PARAM_VALUEs: 20 a second are 760 bytes/s.
PARAMETER_NS: Final = 50_000_000
#: A refusal's reason takes up to five packets: so many reasons at once, and then one in so long.
TEXTS_AT_ONCE: Final = 8
TEXT_NS: Final = 250_000_000
#: A ground station is told unasked that there are parameters when it has had time to begin with the
#: autopilot's; and again when it was away for so long.
SETTLED_NS: Final = 10_000_000_000
GONE_NS: Final = 5_000_000_000
#: The index of a PARAM_VALUE that nobody asked for. QGroundControl does not take it for the answer to its
#: question for the autopilot's list, which it would then not repeat; and asks for all indices it has not.
UNASKED: Final = 0xFFFF
_TRANSMISSIONS_KEPT: Final = 256

Told = tuple[Event | None, Answer]


class Ground:
    """Answers by `link.outbox`; what was ordered is carried out by `orders`."""

    def __init__(self, link: AutopilotLink, orders: Orders, engagement: Engagement) -> None:
        link.company.commands_from = frozenset(orders.config.link.commands_from)
        self._link = link
        self._orders = orders
        self._engagement = engagement
        self._config = orders.config
        values = settings(orders.config)
        #: The order in which they are numbered; it is the same for the whole run.
        self._names = [name for name, key in PARAMETERS.items() if key in values]
        self._due: dict[int, None] = {}  # numbers of the parameters to tell, in order
        self._due_ns = 0
        self._text_ns = 0  # when all the reasons so far would be told, one in `TEXT_NS`
        self._asked_once = False
        self._beats_ns: dict[tuple[int, int], int] = {}  # when each ground station was last heard
        self._unaware: dict[tuple[int, int], int] = {}  # those that are to be told, and when
        self._ids: dict[tuple[int, int, int, bytes, int], tuple[str, int]] = {}  # with the first one's ns
        self._newest: dict[tuple[int, int], tuple[int, int, int, bytes]] = {}  # order of each sender
        self._orders_seen = 0

    def take(self, now_ns: int) -> list[Told]:
        """Answer what was asked since the last time; what became of the orders among it."""
        company = self._link.company
        if company.beats:
            self._appear(company.beats, now_ns)
            company.beats = []
        frames = company.asked
        if not frames:
            return []
        company.asked = []
        self._asked_once = True
        return [told for frame in frames if (told := self._take(frame, now_ns)) is not None]

    def tick(self, now_ns: int) -> None:
        """Queue one parameter, if one is due; the core comes round often enough without being told."""
        if self._config is not self._orders.config:
            self._changed()
        for station in [station for station, due_ns in self._unaware.items() if now_ns >= due_ns]:
            del self._unaware[station]
            self._due[UNASKED] = None
        if not self._due or now_ns < self._due_ns:
            return
        number = next(iter(self._due))
        del self._due[number]
        self._due_ns = now_ns + PARAMETER_NS
        name = self._names[0 if number == UNASKED else number]
        value = as_real32(settings(self._orders.config)[PARAMETERS[name]])
        kind = dialect.MAV_PARAM_TYPE_REAL32
        message = dialect.MAVLink_param_value_message(name.encode(), value, kind, len(self._names), number)
        self._link.outbox.send(message)

    def _appear(self, stations: list[tuple[int, int]], now_ns: int) -> None:
        """Note which ground stations are here, and which of them have just come."""
        for station in stations:
            if now_ns - self._beats_ns.get(station, now_ns - GONE_NS) >= GONE_NS:
                self._unaware[station] = now_ns + SETTLED_NS
            self._beats_ns[station] = now_ns

    def _changed(self) -> None:
        """Whoever set it: ground stations that have shown themselves hear of a value that is another."""
        before, after = settings(self._config), settings(self._orders.config)
        self._config = self._orders.config
        if self._asked_once:
            for number, name in enumerate(self._names):
                if before[PARAMETERS[name]] != after[PARAMETERS[name]]:
                    self._due[number] = None

    def _take(self, frame: Frame, now_ns: int) -> Told | None:
        match read(frame):
            case CommandLong() as command:
                return self._command(frame, command, now_ns)
            case CommandInt() as command:
                self._acknowledge(frame, command.command, dialect.MAV_RESULT_COMMAND_LONG_ONLY)
            case ParamRequestList():
                self._unaware.pop((frame.system, frame.component), None)
                self._due |= dict.fromkeys(range(len(self._names)))  # not from the start, lest it never ends
            case ParamRequestRead(number=number, name=name):
                self._tell(number if number >= 0 else self._number(name))
            case ParamSet(name=name, value=value):
                return self._set(frame, name, value, now_ns)
        return None

    def _command(self, frame: Frame, command: CommandLong, now_ns: int) -> Told | None:
        wanted = order_of(command, self._engagement.state)
        if wanted is None:
            self._acknowledge(frame, command.command, dialect.MAV_RESULT_UNSUPPORTED)
            return None
        if isinstance(wanted, str):
            self._acknowledge(frame, command.command, dialect.MAV_RESULT_DENIED)
            self._refuse(wanted, now_ns)
            return None
        if command.confirmation > 0 and self._overtaken(frame, now_ns):
            self._acknowledge(frame, command.command, dialect.MAV_RESULT_TEMPORARILY_REJECTED)
            self._refuse("repeated, but another order came in between: send it anew", now_ns)
            return None
        identity = self._id(frame, now_ns, repeats=command.confirmation > 0)
        told = self._carry_out(wanted(id=identity, source=_source(frame)), now_ns)
        accepted = told[1].accepted
        self._acknowledge(
            frame,
            command.command,
            dialect.MAV_RESULT_ACCEPTED if accepted else dialect.MAV_RESULT_TEMPORARILY_REJECTED,
        )
        if not accepted:
            self._refuse(f"{told[1].order} refused: {told[1].reason}", now_ns)
        return told

    def _carry_out(self, order: Order, now_ns: int) -> Told:
        """The id is ours: what repeats is the same order, though it would mean another by now."""
        before = self._orders.again(order.source, order.id, now_ns)
        return self._orders.carry_out(order, now_ns) if before is None else (None, before)

    def _set(self, frame: Frame, name: str, value: float | None, now_ns: int) -> Told | None:
        number = self._number(name)
        if number is None:
            if not name.startswith("_"):  # such as _HASH_CHECK, which only an autopilot has
                self._refuse(f"there is no parameter {name}", now_ns)
            return None
        self._tell(number)  # what it is then, new or old
        if value is None:
            self._refuse(f"{name} is a REAL32", now_ns)
            return None
        key, identity = PARAMETERS[name], self._id(frame, now_ns, repeats=False)
        order = Set(id=identity, source=_source(frame), key=key, value=from_real32(name, value))
        told = self._carry_out(order, now_ns)
        if not told[1].accepted:
            self._refuse(f"{name}: {told[1].reason}", now_ns)
        return told

    def _number(self, name: str) -> int | None:
        return self._names.index(name) if name in self._names else None

    def _tell(self, number: int | None) -> None:
        if number is not None and number < len(self._names):
            self._due[number] = None

    def _overtaken(self, frame: Frame, now_ns: int) -> bool:
        """Whether this command came before, and another one since: obeyed now it might undo that one."""
        what = _what(frame)
        known = self._ids.get((*what, -1))
        if known is None or now_ns - known[1] >= REPEAT_NS:
            return False
        return self._newest.get((frame.system, frame.component)) != what

    def _id(self, frame: Frame, now_ns: int, *, repeats: bool) -> str:
        """The id of an order: the same for every transmission of one command, and for a packet's copies."""
        what = _what(frame)
        packet, any_packet = (*what, frame.sequence), (*what, -1)
        known = self._ids.get(any_packet if repeats else packet)
        if known is not None and now_ns - known[1] < (REPEAT_NS if repeats else COPY_NS):
            return known[0]
        self._orders_seen += 1
        for key in (packet, any_packet):
            self._ids.pop(key, None)  # so that it becomes the newest
            self._ids[key] = str(self._orders_seen), now_ns
        while len(self._ids) > _TRANSMISSIONS_KEPT:
            del self._ids[next(iter(self._ids))]
        self._newest[what[:2]] = what
        return str(self._orders_seen)

    def _acknowledge(self, frame: Frame, command: int, result: int) -> None:
        self._link.outbox.send(
            dialect.MAVLink_command_ack_message(command, result, 0, 0, frame.system, frame.component)
        )

    def _refuse(self, why: str, now_ns: int) -> None:
        if self._text_ns > now_ns + (TEXTS_AT_ONCE - 1) * TEXT_NS:
            self._link.company.counters["refusals_not_said"] += 1
            return
        self._text_ns = max(self._text_ns, now_ns) + TEXT_NS
        self._link.outbox.long_text(dialect.MAV_SEVERITY_WARNING, f"guidance: {why}")


def _what(frame: Frame) -> tuple[int, int, int, bytes]:
    return frame.system, frame.component, frame.message_id, once(frame)


def _source(frame: Frame) -> str:
    return f"mavlink {frame.system}/{frame.component}"
