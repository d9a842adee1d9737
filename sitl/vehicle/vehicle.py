"""The sans-IO vehicle: a plant, a firmware, and a clock that is an argument.

The driver hands in datagrams and the time, and takes datagrams out:

    vehicle.receive(data, now_ns)             # a setpoint acts at that instant, to the nanosecond
    for datagram in vehicle.advance(now_ns):  # all that was sent until then
        ...
    sleep until vehicle.deadline()

Everything happens at fixed instants of the vehicle's boot clock (its loop) or at a receipt, never at the
instants of `advance`: how often that is called changes nothing.
"""

from __future__ import annotations

import random
from collections.abc import Hashable
from typing import Final, NamedTuple

from sitl.plant import PlantCommand, PlantParameters, PlantState, Triple, step
from sitl.vehicle.ardupilot import ArduRover
from sitl.vehicle.autopilot import Autopilot
from sitl.vehicle.clock import BootClock
from sitl.vehicle.command import ACCEPTED
from sitl.vehicle.options import Firmware, Truth, VehicleOptions
from sitl.vehicle.projection import Projection, azimuthal_equidistant, equirectangular
from sitl.vehicle.px4 import Px4
from sitl.vehicle.sample import RIGHT, Astray, Sample
from sitl.vehicle.telemetry import ID

_PILOTS: dict[Firmware, type[Autopilot]] = {
    Firmware.PX4_UUV: Px4,
    Firmware.ARDUPILOT_ROVER: ArduRover,
}
_PROJECTIONS: dict[Firmware, Projection] = {
    Firmware.PX4_UUV: azimuthal_equidistant,
    Firmware.ARDUPILOT_ROVER: equirectangular,
}
_MS = 1_000_000
STILL: Final[Triple] = (0.0, 0.0, 0.0)


class Effect(NamedTuple):
    """The part of what is asked that each actuator still does: 1 works, 0 failed, -1 is wired backwards."""

    roll: float = 1.0
    pitch: float = 1.0
    yaw: float = 1.0
    speed: float = 1.0

    def of(self, command: PlantCommand) -> PlantCommand:
        """What becomes of a command."""
        p, q, r = command.body_rates_frd_rad_s
        return PlantCommand((p * self.roll, q * self.pitch, r * self.yaw), command.speed_m_s * self.speed)


WORKING: Final = Effect()


class Vehicle:
    """A MAVLink autopilot around the kinematic plant, booting at `boot_ns`.

    `now_ns` is any monotonic clock in integer nanoseconds; it must not run backwards (an earlier instant
    counts as the latest one seen).

    Raises:
        ValueError: `options` name an unknown mode or parameter.
    """

    def __init__(self, options: VehicleOptions, boot_ns: int = 0) -> None:
        rover = options.firmware is Firmware.ARDUPILOT_ROVER
        self.options = options
        self._planar = rover or options.plant.planar
        self._plant_parameters = options.plant._replace(planar=self._planar)
        self._effect = WORKING
        self._current_ned_m_s: Triple = STILL
        self._pilot = _PILOTS[options.firmware](options)
        noisy = options.position_noise_m > 0.0 or options.attitude_noise_rad > 0.0
        self._dice = random.Random(options.seed) if noisy else None
        self._state = PlantState(options.start_position_ned_m(), options.start_attitude_wxyz())
        self._state_ns = boot_ns
        self._next_ns = self._next_boot_ns = self._wake_boot_ns = 0
        self._boot(boot_ns, options.clock_offset_ns)
        if options.initially_armed:
            self._pilot.armed = True
        self._command = self._pilot.command(self._state)

    def _boot(self, now_ns: int, offset_ns: int) -> None:
        self._astray = RIGHT
        self._clock = BootClock(now_ns, offset_ns, round(self.options.clock_drift_ppm * 1000.0))
        self._pilot.restart(offset_ns)
        self._plan()

    # --- driving it -------------------------------------------------------------------------------------

    def receive(self, data: bytes, now_ns: int, peer: Hashable | None = None) -> None:
        """Take one datagram (or any piece of a byte stream) from `peer` at `now_ns`; garbage is counted."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._pilot.link.set_time(self.options.unix_at_zero_ns + self._clock.at(now_ns))
        messages = self._pilot.link.parse(data, peer)
        if not messages:
            return
        self._integrate(now_ns)
        boot_ns = self._clock.at(now_ns)
        sample = self._sample(boot_ns)
        for message in messages:
            self._pilot.receive(message, boot_ns, sample)
        self._pilot.link.end_of_loop()
        self._command = self._pilot.command(self._state)
        if self._pilot.reboot_requested:
            self.reboot(now_ns)
        self._plan()

    def advance(self, now_ns: int) -> list[bytes]:
        """Live until `now_ns` and return the datagrams sent since the last call, in order."""
        self._run_to(max(now_ns, self._state_ns))
        return self._pilot.link.take()

    def deadline(self) -> int:
        """When `advance` next has something to do or to hand out (ns, the clock of `now_ns`)."""
        return self._state_ns if self._pilot.link.pending else self._next_ns

    def reboot(self, now_ns: int) -> None:
        """Restart the firmware: disarmed, first mode, boot time and sequence numbers from zero.

        Parameters are kept. The vehicle stays where it is and stands still.
        """
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        self._boot(now_ns, 0)
        self._command = self._pilot.command(self._state)

    def withhold(self, *names: str) -> None:
        """Send these messages no more, and all others again; asking for them is still accepted."""
        self._pilot.withheld = {ID[name] for name in names}

    def reset_estimator(
        self,
        now_ns: int,
        moved_ned_m: Triple = (0.0, 0.0, 0.0),
        turned_rad: float = 0.0,
        faster_ned_m_s: Triple = (0.0, 0.0, 0.0),
    ) -> None:
        """Let the estimator jump off the truth by so much from `now_ns` on, and count it in ODOMETRY.

        The firmware's closed loops go on seeing the truth.
        """
        self._run_to(max(now_ns, self._state_ns))
        self._astray = Astray(moved_ned_m, turned_rad, faster_ned_m_s)
        self._pilot.reset_counter += 1

    def refit(
        self, now_ns: int, *, plant: PlantParameters | None = None, effect: Effect | None = None
    ) -> None:
        """Change the actuators from `now_ns` on: their bounds and lags, or what is left of them."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        if plant is not None:
            self._plant_parameters = plant._replace(planar=self._planar)
        if effect is not None:
            self._effect = effect

    def current(self, now_ns: int, ned_m_s: Triple) -> None:
        """Let the water or the air carry the vehicle along with this velocity from `now_ns` on."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        self._current_ned_m_s = ned_m_s

    def choose(self, now_ns: int, custom_mode: int) -> bool:
        """The pilot chooses a mode by the transmitter; whether the firmware enters it."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        self._pilot.now_ns = self._clock.at(now_ns)
        chosen = self._pilot.select_mode(custom_mode) == ACCEPTED
        self._command = self._pilot.command(self._state)
        self._plan()
        return chosen

    def refuse(self, *, modes: bool = False, arming: bool = False) -> None:
        """Refuse such commands from now on, as `VehicleOptions.refuses_modes` and `refuses_arming` say."""
        self._pilot.refuses_modes, self._pilot.refuses_arming = modes, arming

    # --- looking at it ----------------------------------------------------------------------------------

    def truth(self, now_ns: int | None = None) -> Truth:
        """The plant at `now_ns` (not before the last instant that did something), or at that last instant."""
        at_ns = self._state_ns if now_ns is None else max(now_ns, self._state_ns)
        state = self._at(at_ns)
        return Truth(
            at_ns,
            self._clock.at(at_ns) / _MS,
            state.position_ned_m,
            state.attitude_wxyz,
            state.body_rates_frd_rad_s,
            state.speed_m_s,
            self._pilot.armed,
            self._pilot.mode_name,
        )

    @property
    def armed(self) -> bool:
        """Whether the actuators are on."""
        return self._pilot.armed

    @property
    def mode(self) -> str:
        """The mode now flown, in the firmware's words."""
        return self._pilot.mode_name

    @property
    def bad_packets(self) -> int:
        """Pieces of input that were no good MAVLink packet."""
        return self._pilot.link.bad_packets

    @property
    def ignored(self) -> dict[str, int]:
        """Messages that the firmware silently dropped, by reason."""
        return dict(self._pilot.ignored)

    def parameter(self, name: str) -> float:
        """The value of a firmware parameter.

        Raises:
            KeyError: there is none of that name.
        """
        return self._pilot.parameters[name]

    # --- inside -----------------------------------------------------------------------------------------

    def _run_to(self, now_ns: int) -> None:
        """Do all that falls due until `now_ns`, each thing at its own instant."""
        while self._next_ns <= now_ns:
            due_ns = self._next_ns
            self._integrate(due_ns)
            boot_ns = self._next_boot_ns
            pilot = self._pilot
            pilot.now_ns = boot_ns
            pilot.link.set_time(self.options.unix_at_zero_ns + boot_ns)
            if boot_ns >= self._wake_boot_ns:
                pilot.wake()
                self._wake_boot_ns = pilot.next_wake_ns()
                self._command = pilot.command(self._state)
            message_ids = pilot.streams.due(boot_ns // _MS)
            if message_ids:
                pilot.stream(message_ids, self._sample(boot_ns))
            self._plan(keep_wake=True)

    def _plan(self, *, keep_wake: bool = False) -> None:
        """Find the next instant: a stream's or the firmware's own."""
        if not keep_wake:
            self._wake_boot_ns = self._pilot.next_wake_ns()
        boot_ns = self._wake_boot_ns
        stream_ms = self._pilot.streams.next_ms()
        if stream_ms is not None and stream_ms * _MS < boot_ns:
            boot_ns = stream_ms * _MS
        self._next_boot_ns = boot_ns
        self._next_ns = max(self._clock.when(boot_ns), self._state_ns)

    def _integrate(self, to_ns: int) -> None:
        self._state = self._at(to_ns)
        self._state_ns = to_ns

    def _at(self, now_ns: int) -> PlantState:
        dt_s = (now_ns - self._state_ns) * 1e-9
        command = self._command if self._effect is WORKING else self._effect.of(self._command)
        state = step(self._plant_parameters, self._state, command, dt_s)
        if self._current_ned_m_s is STILL:
            return state
        x, y, z = (at + by * dt_s for at, by in zip(state.position_ned_m, self._current_ned_m_s, strict=True))
        return state._replace(position_ned_m=(x, y, z))

    def _sample(self, boot_ns: int) -> Sample:
        options = self.options
        return Sample(
            boot_ns,
            self._state,
            options.origin,
            self._dice,
            options.position_noise_m,
            options.attitude_noise_rad,
            _PROJECTIONS[options.firmware],
            self._astray,
            self._current_ned_m_s,
        )
