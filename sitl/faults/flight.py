"""One flight with hands on everything that can fail: the line, the vehicle, its pilot, the process."""

from __future__ import annotations

import math
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from pymavlink.dialects.v20 import all as mavlink

import guidance
from guidance.commands import Abort, Engage, Hold, Resume, Shutdown
from guidance.config import Config, load
from guidance.mavlink.profiles import Profile
from guidance.records import Event, Level, Record
from guidance.se3 import Vec3, add, norm, subtract
from guidance.supervisor import State
from guidance.trajectory import sample
from sitl.faults.asked import OWN_LIMITS
from sitl.faults.crafts import CRAFTS, DEPLOY
from sitl.faults.tampering import Stage
from sitl.faults.witness import Witness
from sitl.lockstep import SECOND, Channel, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

DEMO: Final = Path(guidance.__file__).with_name("demo.toml")
#: What every flight has in common, and what makes the demo's configuration one for the other firmware.
COMMON: Final = (
    "trajectory.radius_m=5",
    "trajectory.speed_m_s=1",
    "supervisor.engage_max_error_m=2",
    "guards.error_max_m=3",
    "guards.error_s=1",
)
BY_FIRMWARE: Final[dict[Firmware, tuple[str, ...]]] = {
    Firmware.PX4_UUV: (),
    Firmware.ARDUPILOT_ROVER: (
        "vehicle.profile=ardupilot-rover",
        "limits.yaw_rate_max_rad_s=2.0",
    ),
}
CONTROL_MODES: Final = {
    firmware: "OFFBOARD" if firmware.startswith("px4") else "GUIDED" for firmware in Firmware
}
DEAD: Final = Channel(loss=1.0)
#: A line on which nothing is wrong.
SOUND: Final = Channel(delay_s=0.002)
_FORCE: Final = 21196.0
_LOOK_NS: Final = 20_000_000
_LOUD: Final = (Level.WARNING, Level.ERROR, Level.CRITICAL)


def settings(firmware: Firmware) -> tuple[str, ...]:
    """What makes the demo's configuration one for this firmware, as `--set` takes it."""
    return (*COMMON, *BY_FIRMWARE[firmware])


def configured(firmware: Firmware, *overrides: str) -> Config:
    """The demo's configuration for this firmware, with overrides as `--set` takes them."""
    return load(DEMO, [*settings(firmware), *overrides])


def as_it_ships(firmware: Firmware, *overrides: str) -> Config:
    """The configuration that ships for this profile, with its craft's settings and these on top."""
    return load(DEPLOY / f"{firmware}.toml", [*CRAFTS[firmware].settings, *overrides])


class Flight:
    """A guide, a vehicle that stands at the start of the trajectory, and a witness.

    `since_ns` is when the fault began; from then on events, the deviation and the states are noted.
    """

    def __init__(self, config: Config, options: dict[str, Any], seed: int, key: bytes | None = None) -> None:
        start = sample(config.trajectory, 0.0)
        options = {
            "initial_position_ned_m": tuple(start.position),
            "initial_yaw_rad": math.atan2(start.velocity.y, start.velocity.x),
            **options,
        }
        self.firmware = Firmware(config.vehicle.profile)
        vehicle = VehicleOptions(firmware=self.firmware, seed=seed, signing_key=key or b"", **options)
        self.line = Lockstep(
            config,
            Vehicle(vehicle, boot_ns=SECOND),
            start_ns=SECOND,
            seed=seed,
            to_guide=SOUND,
            to_vehicle=SOUND,
            on_record=self._record,
            signing_key=key,
        )
        self.config = config
        self.profile: Profile = self.line.guide.profile
        told = {}
        for name in OWN_LIMITS:
            with suppress(KeyError):
                told[name] = self.line.vehicle.parameter(name)
        self.witness = Witness(config, self.profile, round(SECOND / config.link.rate_hz), told)
        self.line.tap = self.witness
        self.since_ns: int | None = None
        self.codes: list[str] = []
        self.states: list[State] = [self.state]
        self.left_ns: int | None = None
        self.deviation_m = 0.0
        self.late_m = 0.0  # the largest deviation since `lately`
        self.airspeed_min_m_s = math.inf  # while tracking,
        self.lowest_down_m = -math.inf  # too
        self.travel_m = 0.0
        self._looked_ns = 0
        self._began_at = self.line.truth().position_ned_m
        self._mav = mavlink.MAVLink(None, 255, 190)

    # Time --------------------------------------------------------------------------------------------

    @property
    def state(self) -> State:
        """The supervisor's."""
        return self.line.guide.engagement.state

    def run(self, seconds: float, until: State | None = None) -> bool:
        """Let time pass, watching; True as soon as the supervisor is in the state `until`."""

        def look() -> bool:
            self._look()
            return until is not None and self.state is until

        return self.line.run(seconds, until=look)

    def begin(self) -> None:
        """The fault begins now."""
        self.since_ns = self.line.now_ns
        self._began_at = self.line.truth().position_ned_m
        self.states = [self.state]

    def lately(self) -> None:
        """What was is forgotten: `late_m` is of what comes."""
        self.late_m = 0.0

    def _look(self) -> None:
        vehicle = self.line.vehicle
        self.witness.look(vehicle.mode == CONTROL_MODES[self.firmware], vehicle.armed)
        if self.since_ns is None:
            return
        state = self.state
        if state is not self.states[-1]:
            if self.left_ns is None:
                self.left_ns = self.line.now_ns
            self.states.append(state)
        if self.line.now_ns >= self._looked_ns + _LOOK_NS:
            self._looked_ns = self.line.now_ns
            self._measure()

    def _measure(self) -> None:
        position = Vec3(*self.line.truth().position_ned_m)
        self.travel_m = max(self.travel_m, math.dist(position, self._began_at))
        tracker = self.line.guide.tracker
        if self.state is not State.TRACKING or tracker.start_ns is None or tracker.origin_ned_m is None:
            return
        truth = self.line.truth()
        self.airspeed_min_m_s = min(self.airspeed_min_m_s, truth.airspeed_m_s)
        self.lowest_down_m = max(self.lowest_down_m, position.z)
        time_s = (self.line.now_ns - tracker.start_ns) / SECOND - tracker.handler.waited_s
        wanted = add(tracker.origin_ned_m, sample(self.config.trajectory, time_s).position)
        error = subtract(position, wanted)
        error_m = math.hypot(error.x, error.y) if self.profile.planar else norm(error)
        self.deviation_m = max(self.deviation_m, error_m)
        self.late_m = max(self.late_m, error_m)

    def _record(self, record: Record) -> None:
        if self.since_ns is not None and isinstance(record, Event) and record.level in _LOUD:
            self.codes.append(record.code)

    # The line ----------------------------------------------------------------------------------------

    def link(self, to_guide: Channel = SOUND, to_vehicle: Channel = SOUND) -> None:
        """The line is so from now on."""
        self.line.to_guide, self.line.to_vehicle = to_guide, to_vehicle
        late_s = max(way.delay_s + way.jitter_s for way in (to_guide, to_vehicle))
        # Half of what a round trip takes is taken for one way, whichever way it really was.
        self.witness.slack_s = max(self.witness.slack_s, late_s)
        self.witness.copies |= to_vehicle.duplication > 0.0

    def stage(self, stage: Stage | None) -> None:
        """This becomes of the vehicle's messages from now on; None: nothing."""
        self.line.on_the_way = stage

    # The pilot, the operator, the process ------------------------------------------------------------

    def send(self, command: int, *params: float) -> None:
        """A COMMAND_LONG of a ground station to the vehicle, now."""
        filled = [*params, *[0.0] * (7 - len(params))]
        options = self.line.vehicle.options
        message = mavlink.MAVLink_command_long_message(
            options.system_id, options.component_id, command, 0, *filled
        )
        self.line.vehicle.receive(message.pack(self._mav), self.line.now_ns, peer="pilot")

    def switch(self, name: str) -> None:
        """The pilot chooses a mode by transmitter: a name of the profile's, or "control"."""
        mode = self.profile.control_mode if name == "control" else self.profile.mode(name)
        assert mode is not None, name
        if name == "control":
            self.witness.permit(self.line.now_ns)
        self.line.vehicle.choose(self.line.now_ns, mode.custom_mode)

    def arm(self, armed: bool) -> None:
        """The pilot arms, or disarms by force."""
        self.send(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, float(armed), 0.0 if armed else _FORCE)

    def engage(self) -> None:
        """The operator commands to engage."""
        self.witness.permit(self.line.now_ns)
        self.line.guide.command(Engage(), self.line.now_ns)

    def hold(self) -> None:
        """The operator commands to hold."""
        self.line.guide.command(Hold(), self.line.now_ns)

    def resume(self) -> None:
        """The operator commands to go on, which permits nothing where nothing is held."""
        if self.state is State.HOLDING:
            self.witness.permit(self.line.now_ns)
        self.line.guide.command(Resume(), self.line.now_ns)

    def abort(self) -> None:
        """The operator commands to abort."""
        self.line.guide.command(Abort(), self.line.now_ns)

    def shut_down(self) -> None:
        """The operator stops the service."""
        self.line.guide.command(Shutdown(), self.line.now_ns)

    def kill_and_restart(self) -> None:
        """The process is killed, and another one starts."""
        self.line.restart_guide()
        self.witness.restarted(self.line.now_ns)

    def reboot(self) -> None:
        """The autopilot reboots."""
        self.line.vehicle.reboot(self.line.now_ns)
        self.witness.rebooted()
