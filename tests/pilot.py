"""A pilot at a ground station, and flights for the pilot to take over."""

from __future__ import annotations

from typing import Any, Final

import pytest
from pymavlink.dialects.v20 import all as mavlink

from guidance.mavlink.profiles import PROFILES
from sitl.lockstep import Channel, Lockstep
from tests.helpers import ROVER, fly_until_tracking, make_flight, setpoints_since

S: Final = 1_000_000_000
DEAD: Final = Channel(loss=1.0)
PX4: Final[tuple[str, ...]] = ()
BOTH: Final = pytest.mark.parametrize("firmware", [PX4, ROVER], ids=["px4", "rover"])
PILOT: Final = ("supervisor.engage=pilot", "supervisor.arm=false")
AUTO: Final = ("supervisor.engage=auto", "supervisor.arm=true")
#: In the words of the firmwares: of PX4's underwater vehicle, of ArduRover, of other vehicles of PX4.
NAMES: Final = {
    "hold": ("MANUAL", "HOLD", "AUTO.LOITER"),
    "manual": ("MANUAL", "MANUAL"),
    "acro": ("ACRO", "ACRO"),
    "control": ("OFFBOARD", "GUIDED"),
}


class Pilot:
    """A ground station (255/190) on the vehicle's link."""

    def __init__(self, flight: Lockstep) -> None:
        self.flight = flight
        self._mav = mavlink.MAVLink(None, 255, 190)
        self._profile = PROFILES[flight.guide.config.vehicle.profile]

    def send(self, command: int, *params: float) -> None:
        """A COMMAND_LONG to the vehicle, now."""
        filled = [*params, *[0.0] * (7 - len(params))]
        data = mavlink.MAVLink_command_long_message(1, 1, command, 0, *filled).pack(self._mav)
        self.flight.vehicle.receive(data, self.flight.now_ns, peer="pilot")

    def switch(self, name: str) -> None:
        """To a mode; it must have worked."""
        mode = self._profile.control_mode if name == "control" else self._profile.mode(name)
        assert mode is not None
        self.send(mavlink.MAV_CMD_DO_SET_MODE, 1, mode.main, mode.sub)
        assert self.flight.vehicle.mode in NAMES[name], self.flight.vehicle.mode

    def arm(self, armed: bool = True) -> None:
        """Arm or (by force, as in flight) disarm; it must have worked."""
        self.send(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, float(armed), 0.0 if armed else 21196.0)
        assert self.flight.vehicle.armed is armed


def tracking(firmware: tuple[str, ...], *overrides: str, **options: Any) -> tuple[Lockstep, Pilot]:
    """A flight that has tracked for 2 s."""
    flight = make_flight(*firmware, *AUTO, *overrides, **options)
    fly_until_tracking(flight)
    flight.run(2.003)  # between two messages
    return flight, Pilot(flight)


def silent_for(flight: Lockstep, seconds: float) -> bool:
    """Whether no setpoint leaves for so long from now on."""
    now_ns = flight.now_ns
    flight.run(seconds)
    return not setpoints_since(flight, now_ns)


def reason(flight: Lockstep) -> str:
    """The supervisor's."""
    return flight.guide.engagement.reason
