"""An airplane that nobody here wrote: one of JSBSim's, flown by the inner loops that an autopilot has.

JSBSim (LGPL, `pip install se3-guidance[jsbsim]`) brings engine, propeller, aerodynamics and the rotating
ellipsoid; here are a trimmed start in the air, the wind, and loops from the wanted roll and pitch to
the surfaces, once a step of JSBSim. With s = V_0/V, which keeps a surface's angle in proportion to its rate:

    p_w = limit(k_roll (phi_w - phi), +-p_max) + p_turn        aileron = s (k_ff p_w + k_p (p_w - p)) + I
    q_w = limit(k_pitch (theta_w - theta), +-q_max) + q_turn   elevator = s (k_ff q_w + k_p (q_w - q)) + I
    rudder = s k_r (r_turn - r) - k_a (side force per mass)

(p, q, r)_turn are the body rates of a coordinated turn, psi' = g tan(phi)/V; I is the integral of the wanted
rate less the measured, and begins with the surface of the trim. Or p_w and q_w are what it is told.
"""

from __future__ import annotations

from importlib import import_module
from math import atan2, cos, degrees, floor, hypot, pi, radians, sin, sqrt, tan, tau
from typing import Any, Final, NamedTuple

from sitl.models.gusts import CALM, Wind

GRAVITY_M_S2: Final = 9.80665
M_PER_FT: Final = 0.3048
#: WGS 84, as JSBSim's earth: equatorial radius (m) and first eccentricity squared.
EQUATOR_M: Final = 6_378_137.0
ECCENTRICITY2: Final = 6.694379990141e-3
#: The loops take the airspeed (m/s) as no less; in a coordinated turn at more than this bank there is none.
SLOWEST_M_S: Final = 10.0
STEEPEST_RAD: Final = 1.2
#: JSBSim's `tFull`: a trim of all six axes.
FULL_TRIM: Final = 1


class Parameters(NamedTuple):
    """The loops as the module says, gains per rad and rad/s at `trim_speed_m_s`; one of them may be 0.

    JSBSim steps `rate_hz` times a second. A piston engine's mixture stays where it is.
    """

    rate_hz: float
    trim_speed_m_s: float
    roll_per_s: float
    roll_rate_max_rad_s: float
    aileron_forward_s: float
    aileron_damping_s: float
    aileron_integral: float
    pitch_per_s: float
    pitch_rate_max_rad_s: float
    elevator_forward_s: float
    elevator_damping_s: float
    elevator_integral: float
    rudder_damping_s: float
    rudder_slip_s2_m: float
    roll_max_rad: float
    pitch_max_rad: float
    mixture: float


#: Parameters that must be above 0; none may be negative.
POSITIVE: Final = frozenset({"rate_hz", "trim_speed_m_s", "roll_max_rad", "pitch_max_rad"})
SIGNED: Final[frozenset[str]] = frozenset()


class Place(NamedTuple):
    """Origin of the local frame: geodetic degrees, metres above the ellipsoid."""

    latitude_deg: float = 47.397742
    longitude_deg: float = 8.545594
    altitude_m: float = 489.0


#: The built-in vehicle's.
HOME: Final = Place()


class State(NamedTuple):
    """As `sitl.models.airplane.State` has it: NED from the origin, velocity over ground, angles of ATTITUDE,
    body rates (FRD), true airspeed, throttle of the first engine."""

    time_s: float
    north_m: float
    east_m: float
    down_m: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    velocity_down_m_s: float
    roll_rad: float
    pitch_rad: float
    heading_rad: float
    body_rates_frd_rad_s: tuple[float, float, float]
    airspeed_m_s: float
    throttle: float


class JsbsimAirplane:
    """One of JSBSim's aircraft in flight; it has state, and its time starts at 0.

    Raises:
        ModuleNotFoundError: jsbsim is not installed; the message says how it is.
        ValueError: there is no such aircraft, or it cannot fly straight and level as asked.
    """

    def __init__(
        self,
        aircraft: str,
        parameters: Parameters,
        position_ned_m: tuple[float, float, float],
        heading_rad: float,
        airspeed_m_s: float,
        *,
        wind: Wind = CALM,
        place: Place = HOME,
    ) -> None:
        """In trimmed level flight there, the nose to `heading_rad`, at this true airspeed in this wind."""
        self._parameters = parameters
        self.rate_hz = parameters.rate_hz
        self._frame = _Frame(place)
        self._fdm = fdm = _loaded(aircraft)
        fdm.set_dt(1.0 / parameters.rate_hz)
        latitude_deg, longitude_deg, altitude_m = self._frame.geodetic(position_ned_m)
        fdm["ic/lat-geod-deg"] = latitude_deg
        fdm["ic/long-gc-deg"] = longitude_deg
        fdm["ic/terrain-elevation-ft"] = 0.0
        fdm["ic/h-sl-ft"] = altitude_m / M_PER_FT
        fdm["ic/psi-true-deg"] = degrees(heading_rad)
        # in this order: each of these keeps what those before it said
        fdm["ic/vt-fps"] = airspeed_m_s / M_PER_FT
        fdm["ic/vw-mag-fps"] = hypot(wind.north_m_s, wind.east_m_s) / M_PER_FT
        fdm["ic/vw-dir-deg"] = degrees(atan2(wind.east_m_s, wind.north_m_s)) % 360.0
        fdm["ic/vn-fps"] = (airspeed_m_s * cos(heading_rad) + wind.north_m_s) / M_PER_FT
        fdm["ic/ve-fps"] = (airspeed_m_s * sin(heading_rad) + wind.east_m_s) / M_PER_FT
        fdm["ic/vd-fps"] = 0.0
        fdm.run_ic()
        self._engines = fdm.get_propulsion().get_num_engines()
        fdm["propulsion/set-running"] = -1.0
        fdm["propulsion/fuel_freeze"] = 1.0
        fdm["gear/gear-cmd-norm"] = 0.0
        for engine in range(self._engines):
            fdm[f"fcs/mixture-cmd-norm[{engine}]"] = parameters.mixture
            fdm[f"fcs/throttle-cmd-norm[{engine}]"] = 0.6
        try:
            fdm.do_trim(FULL_TRIM)
        except RuntimeError as error:
            raise ValueError(
                f"JSBSim's {aircraft} cannot fly level at {airspeed_m_s:.1f} m/s and {altitude_m:.0f} m"
            ) from error
        self._aileron = fdm["fcs/aileron-cmd-norm"]
        self._elevator = -fdm["fcs/elevator-cmd-norm"]
        self._rudder = -fdm["fcs/rudder-cmd-norm"]
        # None while the rates are told
        self._angles: tuple[float, float] | None = (fdm["attitude/phi-rad"], fdm["attitude/theta-rad"])
        self._rates = (0.0, 0.0)
        self._throttle: float = fdm["fcs/throttle-cmd-norm[0]"]
        self._steps = 0
        self._asked_s = 0.0
        self.blow(wind)

    def tell(self, roll_rad: float, pitch_rad: float, throttle: float) -> None:
        """Hold these from the next step on; all finite."""
        p = self._parameters
        self._angles = (
            _clamp(roll_rad, -p.roll_max_rad, p.roll_max_rad),
            _clamp(pitch_rad, -p.pitch_max_rad, p.pitch_max_rad),
        )
        self._throttle = _clamp(throttle, 0.0, 1.0)

    def tell_rates(self, roll_rad_s: float, pitch_rad_s: float, throttle: float) -> None:
        """Hold these body rates (p, q) from the next step on; the yaw rate stays that of the turn."""
        self._angles = None
        self._rates = (roll_rad_s, pitch_rad_s)
        self._throttle = _clamp(throttle, 0.0, 1.0)

    def blow(self, wind: Wind) -> None:
        """The wind from the next step on, gusts and all."""
        self._fdm["atmosphere/wind-north-fps"] = wind.north_m_s / M_PER_FT
        self._fdm["atmosphere/wind-east-fps"] = wind.east_m_s / M_PER_FT
        self._fdm["atmosphere/wind-down-fps"] = wind.down_m_s / M_PER_FT

    def advance(self, dt_s: float) -> None:
        """Fly `dt_s` (>= 0) on, in whole steps of JSBSim; what is left of one is flown by a later call.

        Raises:
            RuntimeError: JSBSim gave up: the airplane has crashed, or its state is no number.
        """
        self._asked_s += dt_s
        # sums of steps: a nanosecond is no step
        until = floor(self._asked_s * self.rate_hz + 1e-6)
        while self._steps < until:
            self._run()

    def step(self) -> None:
        """Fly one step of JSBSim on; otherwise as `advance`."""
        self._asked_s += 1.0 / self.rate_hz
        self._run()

    def _run(self) -> None:
        self._steer()
        if not self._fdm.run():
            raise RuntimeError("JSBSim ended the flight")
        self._steps += 1

    def state(self) -> State:
        """As of now: the position moved on by what the last step lacks, all else as that step left it."""
        g = self._fdm.get_property_value
        late_s = self._asked_s - self._steps / self.rate_hz
        north, east, down = self._frame.ned(
            g("position/lat-geod-rad"), g("position/long-gc-rad"), M_PER_FT * g("position/geod-alt-ft")
        )
        velocity = (
            M_PER_FT * g("velocities/v-north-fps"),
            M_PER_FT * g("velocities/v-east-fps"),
            M_PER_FT * g("velocities/v-down-fps"),
        )
        return State(
            self._asked_s,
            north + late_s * velocity[0],
            east + late_s * velocity[1],
            down + late_s * velocity[2],
            *velocity,
            g("attitude/phi-rad"),
            g("attitude/theta-rad"),
            g("attitude/psi-rad"),
            (g("velocities/p-rad_sec"), g("velocities/q-rad_sec"), g("velocities/r-rad_sec")),
            M_PER_FT * g("velocities/vt-fps"),
            g("fcs/throttle-cmd-norm[0]"),
        )

    def _steer(self) -> None:
        """The loops, for one step."""
        p, fdm = self._parameters, self._fdm
        g = fdm.get_property_value
        roll, pitch = g("attitude/phi-rad"), g("attitude/theta-rad")
        airspeed = max(M_PER_FT * g("velocities/vt-fps"), SLOWEST_M_S)
        s = p.trim_speed_m_s / airspeed
        dt_s = 1.0 / p.rate_hz
        turn = GRAVITY_M_S2 / airspeed * tan(_clamp(roll, -STEEPEST_RAD, STEEPEST_RAD))
        if self._angles is None:
            p_wanted, q_wanted = self._rates
        else:
            roll_wanted, pitch_wanted = self._angles
            most = p.roll_rate_max_rad_s
            p_wanted = _clamp(p.roll_per_s * (roll_wanted - roll), -most, most) - turn * sin(pitch)
            most = p.pitch_rate_max_rad_s
            # the pitch changes at q cos(phi) - r sin(phi)
            q_wanted = _clamp(p.pitch_per_s * (pitch_wanted - pitch), -most, most) * cos(roll)
            q_wanted += turn * sin(roll) * cos(pitch)

        missing = p_wanted - g("velocities/p-rad_sec")
        self._aileron = _clamp(self._aileron + p.aileron_integral * missing * dt_s, -1.0, 1.0)
        aileron = s * (p.aileron_forward_s * p_wanted + p.aileron_damping_s * missing) + self._aileron

        missing = q_wanted - g("velocities/q-rad_sec")
        self._elevator = _clamp(self._elevator + p.elevator_integral * missing * dt_s, -1.0, 1.0)
        elevator = s * (p.elevator_forward_s * q_wanted + p.elevator_damping_s * missing) + self._elevator

        missing = turn * cos(roll) * cos(pitch) - g("velocities/r-rad_sec")
        # in a slip to the right, air from the right, the side force is to the left: right rudder
        side_m_s2 = GRAVITY_M_S2 * g("accelerations/Ny")
        rudder = self._rudder + s * p.rudder_damping_s * missing - p.rudder_slip_s2_m * side_m_s2

        fdm["fcs/aileron-cmd-norm"] = _clamp(aileron, -1.0, 1.0)
        # JSBSim's aircraft take both of these the other way round
        fdm["fcs/elevator-cmd-norm"] = -_clamp(elevator, -1.0, 1.0)
        fdm["fcs/rudder-cmd-norm"] = -_clamp(rudder, -1.0, 1.0)
        for engine in range(self._engines):
            fdm[f"fcs/throttle-cmd-norm[{engine}]"] = self._throttle


class _Frame:
    """A local frame by the ellipsoid's radii at the origin: NED metres, true to 0.02 % a kilometre away."""

    def __init__(self, place: Place) -> None:
        self._place = place
        latitude = radians(place.latitude_deg)
        w = sqrt(1.0 - ECCENTRICITY2 * sin(latitude) ** 2)
        self._north_m = EQUATOR_M * (1.0 - ECCENTRICITY2) / w**3 + place.altitude_m
        self._east_m = (EQUATOR_M / w + place.altitude_m) * cos(latitude)

    def ned(self, latitude_rad: float, longitude_rad: float, altitude_m: float) -> tuple[float, float, float]:
        """NED (m) of this geodetic place."""
        turn = (longitude_rad - radians(self._place.longitude_deg) + pi) % tau - pi
        return (
            (latitude_rad - radians(self._place.latitude_deg)) * self._north_m,
            turn * self._east_m,
            self._place.altitude_m - altitude_m,
        )

    def geodetic(self, position_ned_m: tuple[float, float, float]) -> tuple[float, float, float]:
        """Latitude, longitude (deg) and altitude (m) of this NED position."""
        north, east, down = position_ned_m
        longitude_deg = self._place.longitude_deg + degrees(east / self._east_m)
        return (
            self._place.latitude_deg + degrees(north / self._north_m),
            (longitude_deg + 180.0) % 360.0 - 180.0,
            self._place.altitude_m - down,
        )


def _loaded(aircraft: str) -> Any:
    """JSBSim with this aircraft."""
    try:
        jsbsim: Any = import_module("jsbsim")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"the model jsbsim:{aircraft} needs JSBSim: pip install 'se3-guidance[jsbsim]'"
        ) from error
    # it speaks on standard output, and says the same again in its exceptions
    jsbsim.set_logger(jsbsim.DefaultLogger(jsbsim.LogLevel.FATAL))
    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    try:
        found = fdm.load_model(aircraft)
    except RuntimeError:
        found = False
    if not found:
        raise ValueError(f"JSBSim {jsbsim.__version__} has no aircraft {aircraft!r} that can be loaded")
    return fdm


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value
