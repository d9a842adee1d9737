"""The sans-IO vehicle: a body, a firmware, and a clock that is an argument.

The driver hands in datagrams and the time, and takes datagrams out:

    vehicle.receive(data, now_ns)             # a setpoint acts at that instant, to the nanosecond
    for datagram in vehicle.advance(now_ns):  # all that was sent until then
        ...
    sleep until vehicle.deadline()

Everything happens at fixed instants of the vehicle's boot clock (its loop) or at a receipt, never at the
instants of `advance`: how often that is called changes nothing.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

from sitl.plant import PlantParameters, Triple
from sitl.vehicle.ardupilot_copter import ArduCopter
from sitl.vehicle.ardupilot_plane import ArduPlane
from sitl.vehicle.ardupilot_rover import ArduRover
from sitl.vehicle.autopilot import Autopilot
from sitl.vehicle.bodies.ideal import IdealBody
from sitl.vehicle.bodies.making import body_of, takes
from sitl.vehicle.body import BodyState
from sitl.vehicle.clock import BootClock
from sitl.vehicle.command import ACCEPTED
from sitl.vehicle.controls import WORKING, Drive, Effect
from sitl.vehicle.estimator import RIGHT, Astray, Estimator
from sitl.vehicle.options import Firmware, Truth, VehicleOptions
from sitl.vehicle.projection import Projection, azimuthal_equidistant, equirectangular
from sitl.vehicle.px4_copter import Px4Copter
from sitl.vehicle.px4_plane import Px4Plane
from sitl.vehicle.px4_rover import Px4Rover
from sitl.vehicle.px4_uuv import Px4Uuv
from sitl.vehicle.sample import Sample
from sitl.vehicle.telemetry import ID

_PILOTS: dict[Firmware, type[Autopilot]] = {
    Firmware.PX4_UUV: Px4Uuv,
    Firmware.PX4_PLANE: Px4Plane,
    Firmware.PX4_COPTER: Px4Copter,
    Firmware.PX4_ROVER: Px4Rover,
    Firmware.ARDUPILOT_ROVER: ArduRover,
    Firmware.ARDUPILOT_PLANE: ArduPlane,
    Firmware.ARDUPILOT_COPTER: ArduCopter,
}
#: Who flew it when its parameters were recorded, where others could.
_RECORDED_WITH: Final = {
    "airplane_20": "ardupilot",
    "copter_ardupilot": "ardupilot",
    "rover": "ardupilot",
    "boat": "ardupilot",
}
_MS = 1_000_000


class Vehicle:
    """A MAVLink autopilot around a body, booting at `boot_ns`.

    `now_ns` is any monotonic clock in integer nanoseconds; it must not run backwards (an earlier instant
    counts as the latest one seen).

    Raises:
        ValueError: `options` name an unknown mode or parameter, a model that cannot be read or that does not
            fit the firmware.
    """

    def __init__(self, options: VehicleOptions, boot_ns: int = 0) -> None:
        _check_fit(options)
        self.options = options
        self._effect = WORKING
        self._pilot = _PILOTS[options.firmware](options)
        self._planar = Drive in self._pilot.gives or options.plant.planar
        self._body = body_of(options, planar=self._planar, start_ns=boot_ns)
        self._estimator = Estimator(options.noise, options.seed, boot_ns)
        self._state = self._body.ahead(boot_ns)
        self._state_ns = boot_ns
        self._pilot.seen = self._estimate
        self._next_ns = self._next_boot_ns = self._wake_boot_ns = 0
        self._boot(boot_ns, options.clock_offset_ns)
        if options.initially_armed or options.airborne:
            self._pilot.armed = True
        self._tell()

    def _boot(self, now_ns: int, offset_ns: int) -> None:
        self._estimator.astray = RIGHT
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
        self._tell()
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
        self._tell()

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

        The firmware's closed loops go on seeing the truth, but where they compare headings or attitudes.
        """
        self._run_to(max(now_ns, self._state_ns))
        self._estimator.astray = Astray(moved_ned_m, turned_rad, faster_ned_m_s)
        self._pilot.reset_counter += 1

    def refit(
        self, now_ns: int, *, plant: PlantParameters | None = None, effect: Effect | None = None
    ) -> None:
        """Change the actuators from `now_ns` on: the ideal body's bounds and lags, or what is left of them.

        Raises:
            ValueError: `plant` for another body than the ideal one.
        """
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        if plant is not None:
            if not isinstance(self._body, IdealBody):
                raise ValueError(f"{self.options.model} has the bounds and lags of its file")
            self._body.refit(plant._replace(planar=self._planar), now_ns)
        if effect is not None:
            self._effect = effect
        self._tell()

    def current(self, now_ns: int, ned_m_s: Triple) -> None:
        """Let the water, for an airplane the air, carry the vehicle along so from `now_ns` on."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        self._body.carry(ned_m_s, now_ns)

    def choose(self, now_ns: int, custom_mode: int) -> bool:
        """The pilot chooses a mode by the transmitter; whether the firmware enters it."""
        now_ns = max(now_ns, self._state_ns)
        self._run_to(now_ns)
        self._integrate(now_ns)
        self._pilot.now_ns = self._clock.at(now_ns)
        chosen = self._pilot.select_mode(custom_mode) == ACCEPTED
        self._tell()
        self._plan()
        return chosen

    def refuse(self, *, modes: bool = False, arming: bool = False) -> None:
        """Refuse such commands from now on, as `VehicleOptions.refuses_modes` and `refuses_arming` say."""
        self._pilot.refuses_modes, self._pilot.refuses_arming = modes, arming

    # --- looking at it ----------------------------------------------------------------------------------

    def truth(self, now_ns: int | None = None) -> Truth:
        """The plant at `now_ns` (not before the last instant that did something), or at that last instant."""
        at_ns = self._state_ns if now_ns is None else max(now_ns, self._state_ns)
        state = self._body.ahead(at_ns)
        return Truth(
            at_ns,
            self._clock.at(at_ns) / _MS,
            state.position_ned_m,
            state.attitude_wxyz,
            state.body_rates_frd_rad_s,
            state.speed_m_s,
            self._pilot.armed,
            self._pilot.mode_name,
            state.velocity_ned_m_s,
            state.airspeed_m_s,
            state.wind_ned_m_s,
        )

    @property
    def position_bias_ned_m(self) -> Triple:
        """How far its estimator's position is off for longer than one estimate, m."""
        return self._estimator.position_bias_ned_m

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

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Of the firmware's parameters, as `parameter` takes them."""
        return tuple(self._pilot.parameters)

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
                self._tell()
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
        self._state = self._body.advance(to_ns)
        self._state_ns = to_ns

    def _tell(self) -> None:
        control = self._pilot.command(self._state)
        self._body.tell(control if self._effect is WORKING else self._effect.of(control), self._state_ns)

    def _estimate(self) -> BodyState:
        return self._estimator.estimate(self._state, self._state_ns)

    def _sample(self, boot_ns: int) -> Sample:
        return Sample(boot_ns, self._estimate(), self.options.origin, _projection(self.options.firmware))


def _projection(firmware: Firmware) -> Projection:
    """How the firmware makes geodetic positions of local ones."""
    return azimuthal_equidistant if firmware.startswith("px4") else equirectangular


def fitting(model: str) -> list[Firmware]:
    """The firmwares whose every kind of `Control` the model takes, the one to be preferred first.

    Raises:
        ValueError: the model's file is missing or wrong.
    """
    taken = set(takes(model))
    fit = [firmware for firmware, pilot in _PILOTS.items() if set(pilot.gives) <= taken]
    recorded_with = _RECORDED_WITH.get(model, "")
    return sorted(fit, key=lambda firmware: not firmware.startswith(recorded_with))


def _check_fit(options: VehicleOptions) -> None:
    fit = fitting(options.model)
    if options.firmware not in fit:
        raise ValueError(
            f"the model {options.model} does not fit the firmware {options.firmware}: "
            + (f"it needs {' or '.join(fit)}" if fit else "there is none for it yet")
        )
