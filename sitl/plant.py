"""The kinematic plant, equation (1) of the paper: R' = R hat(u1, u2, u3), x' = u4 b1.

World NED in metres, body FRD. The pose is advanced by the exponential of the twist, so that a step is exact
whatever its length while the inputs are constant. The text is apart from the guidance on purpose: a sign
error here must not cancel against the same error there.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

Triple = tuple[float, float, float]
Wxyz = tuple[float, float, float, float]

#: Below this angle the coefficients of the exponential come from their series: the quotients lose digits.
SERIES_BELOW_RAD: Final = 1e-2
#: Longest sub-step while a lag bends the twist; the rule in it is of fourth order.
LAG_SUBSTEP_S: Final = 0.004
#: A lag counts as settled when its remainder is below this part of full scale.
SETTLED: Final = 1e-14


class PlantParameters(NamedTuple):
    """Bounds on |u1..u3| and |u4|, first-order lags (0 is none), and whether the vehicle is planar.

    A planar vehicle (the paper's SE(2) case, a rover) has no roll and no pitch rate; it stays level when
    it starts level.
    """

    max_rate_rad_s: float = 5.0
    max_speed_m_s: float = 5.0
    rate_lag_s: float = 0.0
    speed_lag_s: float = 0.0
    planar: bool = False


class PlantState(NamedTuple):
    """Pose, and the rates and speed that act now: those of the command, or of the lags behind it."""

    position_ned_m: Triple = (0.0, 0.0, 0.0)
    attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
    body_rates_frd_rad_s: Triple = (0.0, 0.0, 0.0)
    speed_m_s: float = 0.0


class PlantCommand(NamedTuple):
    """u1, u2, u3 (roll, pitch, yaw rate, FRD) and u4 (forward speed) as asked for, before the bounds."""

    body_rates_frd_rad_s: Triple = (0.0, 0.0, 0.0)
    speed_m_s: float = 0.0


STOP: Final = PlantCommand()


def step(parameters: PlantParameters, state: PlantState, command: PlantCommand, dt_s: float) -> PlantState:
    """Advance `state` by `dt_s` seconds under a constant command; one long step equals many short ones.

    Raises:
        ValueError: `dt_s` is negative or not finite, or the command is not finite.
    """
    if not 0.0 <= dt_s < math.inf:
        raise ValueError(f"dt_s must be finite and not negative, not {dt_s}")
    rates, speed = bounded(parameters, command)
    if parameters.rate_lag_s > 0.0 or parameters.speed_lag_s > 0.0:
        return _step_with_lags(parameters, state, rates, speed, dt_s)
    position, attitude = _advance(
        state.position_ned_m,
        state.attitude_wxyz,
        (rates[0] * dt_s, rates[1] * dt_s, rates[2] * dt_s),
        (speed * dt_s, 0.0, 0.0),
    )
    return PlantState(position, attitude, rates, speed)


def bounded(parameters: PlantParameters, command: PlantCommand) -> tuple[Triple, float]:
    """The rates and the speed that the actuators can give; a planar vehicle only yaws.

    Raises:
        ValueError: the command is not finite.
    """
    p, q, r = command.body_rates_frd_rad_s
    u = command.speed_m_s
    if not math.isfinite(p + q + r + u):
        raise ValueError(f"not a finite command: {command}")
    limit = parameters.max_rate_rad_s
    r = limit if r > limit else -limit if r < -limit else r
    if parameters.planar:
        p = q = 0.0
    else:
        p = limit if p > limit else -limit if p < -limit else p
        q = limit if q > limit else -limit if q < -limit else q
    limit = parameters.max_speed_m_s
    u = limit if u > limit else -limit if u < -limit else u
    return (p, q, r), u


def rotation(attitude_wxyz: Wxyz) -> tuple[Triple, Triple, Triple]:
    """The rows of R, which maps body (FRD) to world (NED) coordinates; its columns are b1, b2, b3."""
    w, x, y, z = attitude_wxyz
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)),
        (2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)),
        (2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


def attitude_from_euler(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Wxyz:
    """The attitude reached by yaw, then pitch, then roll about the moving axes (the aerospace order)."""
    cr, sr = math.cos(0.5 * roll_rad), math.sin(0.5 * roll_rad)
    cp, sp = math.cos(0.5 * pitch_rad), math.sin(0.5 * pitch_rad)
    cy, sy = math.cos(0.5 * yaw_rad), math.sin(0.5 * yaw_rad)
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )


def euler_from_attitude(attitude_wxyz: Wxyz) -> Triple:
    """Roll, pitch and yaw in rad; at pitch +-90 degrees roll and yaw are one angle, reported somehow."""
    w, x, y, z = attitude_wxyz
    sin_pitch = 2.0 * (w * y - x * z)
    return (
        math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
        math.asin(max(-1.0, min(1.0, sin_pitch))),
        math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
    )


def _advance(position: Triple, attitude: Wxyz, turn: Triple, shift: Triple) -> tuple[Triple, Wxyz]:
    """The pose times exp of the twist (`turn` rad, `shift` m, both in body axes).

    The translation part is R V shift, with V = 1 + (1 - cos a)/a^2 hat(turn) + (a - sin a)/a^3 hat(turn)^2.
    """
    tx, ty, tz = turn
    sx, sy, sz = shift
    angle2 = tx * tx + ty * ty + tz * tz
    if angle2 < SERIES_BELOW_RAD * SERIES_BELOW_RAD:
        c1 = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0))
        c2 = 1.0 / 6.0 - angle2 * (1.0 / 120.0 - angle2 * (1.0 / 5040.0))
        half_sinc = 0.5 - angle2 * (1.0 / 48.0 - angle2 * (1.0 / 3840.0))
        cosine = 1.0 - angle2 * (0.125 - angle2 * (1.0 / 384.0))
    else:
        angle = math.sqrt(angle2)
        sine = math.sin(0.5 * angle)
        cosine = math.cos(0.5 * angle)
        half_sinc = sine / angle
        c1 = 2.0 * half_sinc * half_sinc
        c2 = (angle - 2.0 * sine * cosine) / (angle2 * angle)
    # turn x shift, and turn x (turn x shift)
    ax, ay, az = ty * sz - tz * sy, tz * sx - tx * sz, tx * sy - ty * sx
    bx = sx + c1 * ax + c2 * (ty * az - tz * ay)
    by = sy + c1 * ay + c2 * (tz * ax - tx * az)
    bz = sz + c1 * az + c2 * (tx * ay - ty * ax)
    # into the world: v + 2 w (q x v) + 2 q x (q x v)
    w, x, y, z = attitude
    kx, ky, kz = 2.0 * (y * bz - z * by), 2.0 * (z * bx - x * bz), 2.0 * (x * by - y * bx)
    moved = (
        position[0] + bx + w * kx + y * kz - z * ky,
        position[1] + by + w * ky + z * kx - x * kz,
        position[2] + bz + w * kz + x * ky - y * kx,
    )
    ex, ey, ez = half_sinc * tx, half_sinc * ty, half_sinc * tz
    qw = w * cosine - x * ex - y * ey - z * ez
    qx = w * ex + x * cosine + y * ez - z * ey
    qy = w * ey - x * ez + y * cosine + z * ex
    qz = w * ez + x * ey - y * ex + z * cosine
    scale = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    return moved, (qw * scale, qx * scale, qy * scale, qz * scale)


def _step_with_lags(
    parameters: PlantParameters, state: PlantState, rates: Triple, speed: float, dt_s: float
) -> PlantState:
    """Lags discretised exactly; the twist that changes within a sub-step by a fourth-order Magnus rule."""
    position, attitude, now_rates, now_speed = state
    tau_rate, tau_speed = parameters.rate_lag_s, parameters.speed_lag_s
    full_scale = parameters.max_rate_rad_s + parameters.max_speed_m_s
    remaining = dt_s
    while True:
        gap = max(
            abs(rates[0] - now_rates[0]) if tau_rate > 0.0 else 0.0,
            abs(rates[1] - now_rates[1]) if tau_rate > 0.0 else 0.0,
            abs(rates[2] - now_rates[2]) if tau_rate > 0.0 else 0.0,
            abs(speed - now_speed) if tau_speed > 0.0 else 0.0,
        )
        # A settled twist is constant: one exact step, however long.
        settled = gap <= SETTLED * full_scale
        h = remaining if settled else min(remaining, LAG_SUBSTEP_S)
        g1, g2 = h * (0.5 - math.sqrt(3.0) / 6.0), h * (0.5 + math.sqrt(3.0) / 6.0)
        w1, v1 = _lagged(now_rates, rates, tau_rate, g1), _lag(now_speed, speed, tau_speed, g1)
        w2, v2 = _lagged(now_rates, rates, tau_rate, g2), _lag(now_speed, speed, tau_speed, g2)
        # R' = R hat(w) multiplies from the right, so the commutator enters with a plus sign.
        c = math.sqrt(3.0) / 12.0 * h * h
        turn = (
            0.5 * h * (w1[0] + w2[0]) + c * (w1[1] * w2[2] - w1[2] * w2[1]),
            0.5 * h * (w1[1] + w2[1]) + c * (w1[2] * w2[0] - w1[0] * w2[2]),
            0.5 * h * (w1[2] + w2[2]) + c * (w1[0] * w2[1] - w1[1] * w2[0]),
        )
        shift = (
            0.5 * h * (v1 + v2),
            c * (w1[2] * v2 - w2[2] * v1),
            -c * (w1[1] * v2 - w2[1] * v1),
        )
        position, attitude = _advance(position, attitude, turn, shift)
        now_rates = _lagged(now_rates, rates, tau_rate, h)
        now_speed = _lag(now_speed, speed, tau_speed, h)
        remaining -= h
        if remaining <= 0.0:
            return PlantState(position, attitude, now_rates, now_speed)


def _lag(now: float, target: float, tau_s: float, dt_s: float) -> float:
    """The output of a first-order lag after `dt_s` of a constant target; no lag follows at once."""
    return target if tau_s <= 0.0 else target + (now - target) * math.exp(-dt_s / tau_s)


def _lagged(now: Triple, target: Triple, tau_s: float, dt_s: float) -> Triple:
    if tau_s <= 0.0:
        return target
    decay = math.exp(-dt_s / tau_s)
    return (
        target[0] + (now[0] - target[0]) * decay,
        target[1] + (now[1] - target[1]) * decay,
        target[2] + (now[2] - target[2]) * decay,
    )
