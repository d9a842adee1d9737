"""A copter that nobody here wrote: one of rotorpy's, flown by the inner loops that PX4 has.

rotorpy (MIT, `pip install se3-guidance[rotorpy]`) brings rotors with lag and limits, their drag and that of
the body, the rigid body, the ground; here are the loops from a velocity and a yaw rate to a collective thrust
and moments, once a step. World NED, body FRD, R from body to world; u is where the rotors push, -z of R:

    f = P (v_w - v) + I integral(v_w - v) - D v' - g       within tilt and thrust; the collective is m f.u
    w_w = R^T (tilt_per_s (angle from u to f) (axis of u x f) + (0, 0, yaw rate))
    moments = J a + w x J w, with a = rate_per_s (w_w - w) - rate_damping w'; of the yaw PI, bounded

Nothing holds a heading: the nose goes where the yaw rate brings it. Or w_w and the thrust are told.
rotorpy's world has x, y and z = up, its body x to the front and z up: here x is north, y west.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from math import atan2, sqrt, tan
from typing import Any, Final, NamedTuple

from sitl.models.attitude import Triple, Wxyz, tilted
from sitl.models.gusts import Wind
from sitl.plant import rotation

#: The collective that velocities ask for is at least this part of the weight and at most this part of what
#: there is, so that something is left to turn with.
LEAST_THRUST: Final = 0.1
MOST_THRUST: Final = 0.9

_STILL: Final = (0.0, 0.0, 0.0)


class Parameters(NamedTuple):
    """The loops as the module says, `down_` is of the vertical.

    For a yaw rate the nose is turned by `yaw_rate_per_s` times what is missing and `yaw_rate_integral_per_s2`
    times the integral of that, by `yaw_slew_rad_s2` at most.
    `hover_thrust` of 1 carries the weight, as PX4's MPC_THR_HOVER.
    """

    velocity_p: float
    velocity_i: float
    velocity_d: float
    down_velocity_p: float
    down_velocity_i: float
    down_velocity_d: float
    tilt_max_rad: float
    tilt_per_s: float
    tilt_rate_max_rad_s: float
    rate_per_s: float
    rate_damping: float
    yaw_rate_per_s: float
    yaw_rate_integral_per_s2: float
    yaw_slew_rad_s2: float
    hover_thrust: float


#: Parameters that must be above 0; none may be negative.
POSITIVE: Final = frozenset(
    {
        "tilt_max_rad",
        "tilt_per_s",
        "tilt_rate_max_rad_s",
        "rate_per_s",
        "yaw_rate_per_s",
        "yaw_slew_rad_s2",
        "hover_thrust",
    }
)
SIGNED: Final[frozenset[str]] = frozenset()


class Asked(NamedTuple):
    """A velocity (NED, m/s), `turn` a yaw rate about down (rad/s); or, with `by_rates`, body rates (FRD,
    rad/s), `turn` a thrust (0 to 1)."""

    by_rates: bool
    x: float
    y: float
    z: float
    turn: float


class State(NamedTuple):
    """rotorpy's state, which nobody changes, and what the loops remember: how fast the velocity and the body
    rates changed in the last step, the integrals of velocity and yaw rate, and what is asked for."""

    flown: dict[str, Any]
    velocity_change_m_s2: Triple
    rates_change_rad_s2: Triple
    integral_m_s2: Triple
    yaw_integral_rad_s2: float
    asked: Asked


def position_ned_m(state: State) -> Triple:
    """Where it is."""
    return _turned(state.flown["x"].tolist())


def velocity_ned_m_s(state: State) -> Triple:
    """Over ground."""
    return _turned(state.flown["v"].tolist())


def body_rates_frd_rad_s(state: State) -> Triple:
    """Of the body, in its axes."""
    return _turned(state.flown["w"].tolist())


def attitude_wxyz(state: State) -> Wxyz:
    """Body FRD to world NED."""
    x, y, z, w = state.flown["q"].tolist()
    return (w, *_turned((x, y, z)))


def stands(state: State) -> bool:
    """Whether it is on the ground, at height 0."""
    return position_ned_m(state)[2] >= 0.0


class RotorpyCopter:
    """One of rotorpy's vehicles. It has no state: `step` is a function.

    Raises:
        ModuleNotFoundError: rotorpy is not installed; the message says how it is.
    """

    def __init__(self, vehicle: str, parameters: Parameters) -> None:
        multirotor, airframe, self._array = _loaded(vehicle)
        self._parameters = parameters
        # its noise on the rotors would be drawn from the whole program's dice
        self._vehicle = multirotor(
            {**airframe, "motor_noise_std": 0.0},
            control_abstraction="cmd_ctbm",
            enable_ground=True,
            integrator_kwargs={"method": "RK23"},
        )
        self._gravity_m_s2 = float(self._vehicle.g)
        self._weight_n = float(self._vehicle.mass) * self._gravity_m_s2
        self._newton_s2 = float(self._vehicle.k_eta)
        self._rotors = int(self._vehicle.num_rotors)
        self._thrust_max_n = self._rotors * self._newton_s2 * float(self._vehicle.rotor_speed_max) ** 2

    def hovering(self, at_ned_m: Triple, heading_rad: float, wind: Wind) -> State:
        """At rest there, tilted about as it holds against this wind; at height 0 its rotors rest, too."""
        on_ground = at_ned_m[2] >= 0.0
        speed = 0.0 if on_ground else sqrt(self._weight_n / (self._rotors * self._newton_s2))
        flown = {
            "x": self._array(_turned(at_ned_m)),
            "v": self._array(_STILL),
            "q": self._quaternion(tilted(0.0, 0.0, 0.0, heading_rad)),
            "w": self._array(_STILL),
            "wind": self._array(_turned((wind.north_m_s, wind.east_m_s, wind.down_m_s))),
            "rotor_speeds": self._array((speed,) * self._rotors),
        }
        north = east = down = 0.0
        if not on_ground:
            level = self._vehicle.statedot(flown, self._controls(self._weight_n, _STILL), 0.0)
            north, east, down = (-a for a in _turned(level["vdot"].tolist()))
            flown["q"] = self._quaternion(tilted(north, east, down, heading_rad))
        return State(flown, _STILL, _STILL, (north, east, down), 0.0, Asked(False, 0.0, 0.0, 0.0, 0.0))

    def step(self, state: State, wind: Wind, dt_s: float) -> State:
        """The state `dt_s` (> 0, milliseconds) later: rotorpy's, under what the loops make of it now."""
        velocity, rates = velocity_ned_m_s(state), body_rates_frd_rad_s(state)
        asked = state.asked
        if asked.by_rates:
            integral = _STILL
            most_n = self._thrust_max_n
            thrust_n = _clamp(asked.turn * self._weight_n / self._parameters.hover_thrust, 0.0, most_n)
            wanted = (asked.x, asked.y, asked.z)
        else:
            integral, thrust_n, wanted = self._by_velocity(state, velocity, dt_s)
        turning, yaw_integral = self._turning(state, wanted, rates, dt_s)
        controls = self._controls(thrust_n, self._moments(turning, rates))
        blows = self._array(_turned((wind.north_m_s, wind.east_m_s, wind.down_m_s)))
        flown = self._vehicle.step({**state.flown, "wind": blows}, controls, dt_s)
        return State(
            flown,
            _change(velocity, _turned(flown["v"].tolist()), dt_s),
            _change(rates, _turned(flown["w"].tolist()), dt_s),
            integral,
            yaw_integral,
            asked,
        )

    def throttle(self, state: State) -> float:
        """The collective thrust that it flies by, 0 to 1."""
        thrust_n = self._newton_s2 * sum(speed * speed for speed in state.flown["rotor_speeds"].tolist())
        return _clamp(thrust_n / self._weight_n * self._parameters.hover_thrust, 0.0, 1.0)

    def _by_velocity(self, state: State, velocity: Triple, dt: float) -> tuple[Triple, float, Triple]:
        """The integral, the collective (N) and the wanted body rates."""
        p, asked, g = self._parameters, state.asked, self._gravity_m_s2
        i_n, i_e, i_d = state.integral_m_s2
        c_n, c_e, c_d = state.velocity_change_m_s2
        miss_n, miss_e, miss_d = asked.x - velocity[0], asked.y - velocity[1], asked.z - velocity[2]
        a_n = p.velocity_p * miss_n + i_n - p.velocity_d * c_n
        a_e = p.velocity_p * miss_e + i_e - p.velocity_d * c_e
        a_d = p.down_velocity_p * miss_d + i_d - p.down_velocity_d * c_d

        # the weight comes first, then the level; an integral rests while its part is cut
        most = MOST_THRUST * g * self._thrust_max_n / self._weight_n
        up = _clamp(g - a_d, LEAST_THRUST * g, most)
        level = min(up * tan(p.tilt_max_rad), sqrt(most * most - up * up))
        length = sqrt(a_n * a_n + a_e * a_e)
        part = level / length if length > level else 1.0
        gain = p.velocity_i * dt if part == 1.0 else 0.0
        gain_d = p.down_velocity_i * dt if up == g - a_d else 0.0
        integral = (i_n + gain * miss_n, i_e + gain * miss_e, i_d + gain_d * miss_d)
        if stands(state):
            integral = _STILL

        rows = rotation(attitude_wxyz(state))
        along, across, down = _in_axes(rows, (part * a_n, part * a_e, -up))
        # u x f in the axes of the body, where u is -z: (across, -along, 0)
        sine = sqrt(along * along + across * across)
        rate = min(p.tilt_per_s * atan2(sine, -down), p.tilt_rate_max_rad_s) / sine if sine > 0.0 else 0.0
        turn_x, turn_y, turn_z = _in_axes(rows, (0.0, 0.0, asked.turn))
        rates = (rate * across + turn_x, turn_y - rate * along, turn_z)
        return integral, self._weight_n / g * _clamp(-down, LEAST_THRUST * g, most), rates

    def _turning(self, state: State, wanted: Triple, rates: Triple, dt: float) -> tuple[Triple, float]:
        """The angular acceleration (FRD) to ask for, and the integral of the yaw rate."""
        p, change = self._parameters, state.rates_change_rad_s2
        miss, most = wanted[2] - rates[2], p.yaw_slew_rad_s2
        integral = _clamp(state.yaw_integral_rad_s2 + p.yaw_rate_integral_per_s2 * miss * dt, -most, most)
        turning = (
            p.rate_per_s * (wanted[0] - rates[0]) - p.rate_damping * change[0],
            p.rate_per_s * (wanted[1] - rates[1]) - p.rate_damping * change[1],
            _clamp(p.yaw_rate_per_s * miss + integral, -most, most),
        )
        return turning, 0.0 if stands(state) else integral

    def _moments(self, turning: Triple, rates: Triple) -> Triple:
        """What gives this angular acceleration, FRD, N m; rotorpy's inertia is in its own axes."""
        p, q, r = _turned(rates)
        inertia = self._vehicle.inertia
        x, y, z = (inertia @ self._array(_turned(turning))).tolist()
        j_p, j_q, j_r = (inertia @ self._array((p, q, r))).tolist()
        return _turned((x + q * j_r - r * j_q, y + r * j_p - p * j_r, z + p * j_q - q * j_p))

    def _controls(self, thrust_n: float, moments_frd_nm: Triple) -> dict[str, Any]:
        return {"cmd_thrust": thrust_n, "cmd_moment": self._array(_turned(moments_frd_nm))}

    def _quaternion(self, attitude_wxyz: Wxyz) -> Any:
        """As rotorpy has it: its own axes, xyzw."""
        w, x, y, z = attitude_wxyz
        return self._array((*_turned((x, y, z)), w))


def _turned(vector: Sequence[float]) -> Triple:
    """From rotorpy's axes to ours and back, of the world as of the body: half a turn about x."""
    x, y, z = vector
    return (x, -y, -z)


def _in_axes(rows: tuple[Triple, Triple, Triple], vector: Triple) -> Triple:
    """R^T times it."""
    a, b, c = rows
    x, y, z = vector
    return (
        a[0] * x + b[0] * y + c[0] * z,
        a[1] * x + b[1] * y + c[1] * z,
        a[2] * x + b[2] * y + c[2] * z,
    )


def _change(before: Triple, after: Triple, dt: float) -> Triple:
    return ((after[0] - before[0]) / dt, (after[1] - before[1]) / dt, (after[2] - before[2]) / dt)


def _loaded(vehicle: str) -> tuple[Any, dict[str, Any], Any]:
    """rotorpy's class of multirotors, this vehicle's numbers, and what makes an array of numpy."""
    try:
        multirotor: Any = import_module("rotorpy.vehicles.multirotor")
        airframe: Any = import_module(f"rotorpy.vehicles.{vehicle}_params")
        numpy: Any = import_module("numpy")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            f"the model rotorpy:{vehicle} needs rotorpy: pip install 'se3-guidance[rotorpy]'"
        ) from error
    return multirotor.Multirotor, airframe.quad_params, numpy.array


def _clamp(value: float, lowest: float, highest: float) -> float:
    return lowest if value < lowest else highest if value > highest else value
