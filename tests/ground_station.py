"""A ground station as pymavlink makes one (255/190), on the guide's link and on virtual time."""

from __future__ import annotations

from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

from guidance.records import Packet
from guidance.supervisor import State
from sitl.lockstep import Lockstep
from tests.helpers import fly_until, fly_until_tracking, make_flight

COMPONENT: Final = mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
MAY: Final = ("link.commands_from=[255]",)
PILOT: Final = (*MAY, "supervisor.engage=pilot")


class GroundStation:
    """Says things to the guide, and hears all that the guide sends."""

    def __init__(self, flight: Lockstep, system: int = 255, key: bytes | None = None) -> None:
        self.flight = flight
        self._mav = mavlink.MAVLink(None, system, 190)
        self._in = mavlink.MAVLink(None)
        self._heard = len(flight.records)
        if key is not None:
            assert flight.guide.link.signing is not None
            self._mav.signing.secret_key = key
            self._mav.signing.sign_outgoing = True
            self._mav.signing.timestamp = flight.guide.link.signing.clock.timestamp

    def pack(self, message: Any) -> bytes:
        """A packet with the next sequence number."""
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data

    def say(self, message: Any) -> None:
        """Now."""
        self.flight.inject(self.pack(message))

    def command(
        self, command: int, *params: float, confirmation: int = 0, component: int = COMPONENT
    ) -> list[tuple[int, int]]:
        """A COMMAND_LONG; the command and the result of each answer to us that comes at once."""
        self.hear()
        filled = [*params, *[0.0] * (7 - len(params))]
        self.say(mavlink.MAVLink_command_long_message(1, component, command, confirmation, *filled))
        return [(ack.command, ack.result) for ack in self.acks()]

    def acks(self) -> list[Any]:
        """The COMMAND_ACKs to us since the last time that anything was heard."""
        return [
            m
            for m in self.hear()
            if m.get_type() == "COMMAND_ACK" and (m.target_system, m.target_component) == (255, 190)
        ]

    def set(self, name: str, value: float, kind: int = mavlink.MAV_PARAM_TYPE_REAL32) -> None:
        """A PARAM_SET."""
        self.say(mavlink.MAVLink_param_set_message(1, COMPONENT, name.encode(), value, kind))

    def hear(self, name: str | None = None) -> list[Any]:
        """The guide's messages (of one name) since the last time."""
        packets = [r.data for r in self.flight.records[self._heard :] if isinstance(r, Packet)]
        self._heard = len(self.flight.records)
        messages = [m for data in packets for m in self._in.parse_buffer(data) or []]
        return [m for m in messages if name in (None, m.get_type())]


def texts_of(messages: list[Any]) -> list[str]:
    """The STATUSTEXTs among them, those in parts put together."""
    texts: dict[int, str] = {}
    whole = []
    for message in messages:
        if message.get_type() == "STATUSTEXT":
            if message.id == 0:
                whole.append(str(message.text))
            else:
                texts[message.id] = texts.get(message.id, "") + str(message.text)
    return whole + list(texts.values())


def ready(*overrides: str) -> tuple[Lockstep, GroundStation]:
    """A flight that may be engaged, and who may command it."""
    flight = make_flight(*PILOT, *overrides)
    fly_until(flight, State.READY)
    return flight, GroundStation(flight)


def tracking(*overrides: str) -> tuple[Lockstep, GroundStation]:
    """A flight that has tracked for 1 s, and who may command it."""
    flight = make_flight(*MAY, *overrides)
    fly_until_tracking(flight)
    flight.run(1.0)
    return flight, GroundStation(flight)
