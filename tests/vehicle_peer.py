"""A companion in virtual time: talks MAVLink to the sans-IO vehicle and keeps what it hears."""

from __future__ import annotations

from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from sitl.plant import PlantParameters
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

SECOND = 1_000_000_000
MS = 1_000_000
OFFBOARD = 393216
POSCTL = 196608
RATES = 0x80
"""SET_ATTITUDE_TARGET.type_mask: rates and thrust, no attitude (PX4)."""
YAW_RATE = 0x83
"""SET_ATTITUDE_TARGET.type_mask: yaw rate and thrust (ArduRover)."""


class Peer:
    """The vehicle, the time, and one companion (1/191)."""

    def __init__(self, firmware: Firmware = Firmware.PX4_UUV, **options: Any) -> None:
        self.vehicle = Vehicle(VehicleOptions(firmware=firmware, **options))
        self.now_ns = 0
        self.heard: list[Any] = []
        self.times_ns: list[int] = []
        self._out = mavlink.MAVLink(None, 1, 191)
        self._in = mavlink.MAVLink(None)

    def pack(self, message: Any, system: int = 1, component: int = 191) -> bytes:
        """The bytes of a message from the companion, or from somebody else."""
        self._out.srcSystem, self._out.srcComponent = system, component
        data: bytes = message.pack(self._out)
        self._out.seq = (self._out.seq + 1) % 256
        return data

    def send(self, message: Any, system: int = 1, component: int = 191) -> list[Any]:
        """Hand a message over now; what the vehicle answers at once."""
        self.vehicle.receive(self.pack(message, system, component), self.now_ns)
        return self.hear()

    def hear(self) -> list[Any]:
        """What the vehicle has sent until now."""
        new = [
            message
            for datagram in self.vehicle.advance(self.now_ns)
            for message in self._in.parse_buffer(datagram) or []
        ]
        self.heard += new
        self.times_ns += [self.now_ns] * len(new)
        return new

    def run(self, seconds: float) -> list[Any]:
        """Let time pass from deadline to deadline; what the vehicle sent meanwhile."""
        end_ns = self.now_ns + round(seconds * SECOND)
        heard: list[Any] = []
        while self.vehicle.deadline() <= end_ns:
            self.now_ns = max(self.now_ns, self.vehicle.deadline())
            heard += self.hear()
        self.now_ns = end_ns
        return heard + self.hear()

    def command(self, command: int, *params: float, **target: int) -> list[int]:
        """Send a COMMAND_LONG; the results of its ACKs, in order."""
        values = [*params, *[0.0] * (7 - len(params))]
        system, component = target.get("target_system", 1), target.get("target_component", 1)
        heard = self.send(mavlink.MAVLink_command_long_message(system, component, command, 0, *values))
        return [m.result for m in heard if m.get_type() == "COMMAND_ACK" and m.command == command]

    def setpoint(
        self,
        mask: int = RATES,
        *,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
        thrust: float = 0.0,
        q: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0),
        system: int = 1,
        component: int = 1,
    ) -> None:
        """Send a SET_ATTITUDE_TARGET."""
        self.send(
            mavlink.MAVLink_set_attitude_target_message(0, system, component, mask, list(q), *rates, thrust)
        )

    def stream(self, seconds: float, mask: int = RATES, hz: float = 50.0, **values: Any) -> list[Any]:
        """Setpoints at `hz` for a while, one of them now."""
        heard: list[Any] = []
        for _ in range(max(1, round(seconds * hz))):
            self.setpoint(mask, **values)
            heard += self.run(1.0 / hz)
        return heard

    def last(self, name: str) -> Any:
        """The newest message of a type."""
        return next(m for m in reversed(self.heard) if m.get_type() == name)

    def texts(self) -> list[str]:
        """The STATUSTEXTs heard so far."""
        return [m.text for m in self.heard if m.get_type() == "STATUSTEXT"]


def px4_in_offboard(**options: Any) -> Peer:
    """A PX4 UUV, armed in OFFBOARD, heard by a ground station, its newest setpoint zero and just sent."""
    peer = Peer(Firmware.PX4_UUV, **options)
    peer.send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
    peer.setpoint()
    assert peer.command(176, 1, 6) == [0, 0]
    assert peer.command(400, 1) == [0]
    peer.setpoint()
    return peer


def rover_in_guided(**options: Any) -> Peer:
    """An ArduRover, armed in GUIDED, without a setpoint."""
    peer = Peer(Firmware.ARDUPILOT_ROVER, **options)
    assert peer.command(176, 1, 15) == [0]
    assert peer.command(400, 1) == [0]
    return peer


def lagging(rate_lag_s: float, speed_lag_s: float) -> PlantParameters:
    """A plant with lags."""
    return PlantParameters(rate_lag_s=rate_lag_s, speed_lag_s=speed_lag_s)


GCS_HEARTBEAT = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
ATTITUDE_THRUST = 0x07
"""SET_ATTITUDE_TARGET: attitude and thrust, no rates."""
VELOCITY_YAW_RATE = 0x5C7
"""SET_POSITION_TARGET_LOCAL_NED: velocity and yaw rate."""


def airborne(firmware: Firmware, **options: Any) -> Peer:
    """What flies, armed at 60 m in the mode that circles or stands; a ground station was heard."""
    peer = Peer(firmware, airborne=True, **options)
    peer.send(GCS_HEARTBEAT)
    return peer


def height(peer: Peer) -> float:
    """Above the origin, m."""
    return -peer.vehicle.truth().position_ned_m[2]


def velocity_target(
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw_rate: float = 0.0,
    *,
    mask: int = VELOCITY_YAW_RATE,
    frame: int = 1,
    position: tuple[float, float, float] = (0.0, 0.0, 0.0),
    yaw: float = 0.0,
) -> Any:
    """A SET_POSITION_TARGET_LOCAL_NED."""
    return mavlink.MAVLink_set_position_target_local_ned_message(
        0, 1, 1, frame, mask, *position, *velocity, 0.0, 0.0, 0.0, yaw, yaw_rate
    )


def stream_velocity(peer: Peer, seconds: float, *args: Any, **values: Any) -> None:
    """Such setpoints at 50 Hz."""
    for _ in range(round(seconds * 50.0)):
        peer.send(velocity_target(*args, **values))
        peer.run(0.02)
