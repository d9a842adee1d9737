"""What a firmware gives to the body that it drives: one kind for each kind of vehicle.

A firmware names the kinds that it gives (`Autopilot.gives`), a body those that it takes (`Body.takes`); they
fit when the body takes all that is given.
"""

from __future__ import annotations

from typing import NamedTuple

from sitl.plant import PlantCommand, Triple


class Drive(NamedTuple):
    """A ground vehicle's: yaw rate, positive to the right, and forward speed."""

    yaw_rate_rad_s: float = 0.0
    speed_m_s: float = 0.0


class Attitude(NamedTuple):
    """An airplane's: roll, pitch, and throttle from 0 to 1; it turns by banking."""

    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    throttle: float = 0.0


class RatesThrottle(NamedTuple):
    """An airplane's, too: body rates (FRD) and throttle from 0 to 1."""

    body_rates_frd_rad_s: Triple = (0.0, 0.0, 0.0)
    throttle: float = 0.0


class Velocity(NamedTuple):
    """A copter's: velocity over ground (NED) and yaw rate."""

    velocity_ned_m_s: Triple = (0.0, 0.0, 0.0)
    yaw_rate_rad_s: float = 0.0


class RatesThrust(NamedTuple):
    """A copter's, too: body rates (FRD) and thrust upward from 0 to 1."""

    body_rates_frd_rad_s: Triple = (0.0, 0.0, 0.0)
    thrust: float = 0.0


Control = PlantCommand | Drive | Attitude | RatesThrottle | Velocity | RatesThrust


class Effect(NamedTuple):
    """The part of what is asked that each actuator still does: 1 works, 0 failed, -1 is wired backwards.

    `roll`, `pitch` and `yaw` are parts of rates or angles, `speed` of a speed, a velocity or a throttle.
    """

    roll: float = 1.0
    pitch: float = 1.0
    yaw: float = 1.0
    speed: float = 1.0

    def of(self, control: Control) -> Control:
        """What becomes of it."""
        match control:
            case PlantCommand(rates, speed):
                return PlantCommand(self._rates(rates), speed * self.speed)
            case Drive(yaw_rate, speed):
                return Drive(yaw_rate * self.yaw, speed * self.speed)
            case Attitude(roll, pitch, throttle):
                return Attitude(roll * self.roll, pitch * self.pitch, throttle * self.speed)
            case Velocity((north, east, down), yaw_rate):
                part = self.speed
                return Velocity((north * part, east * part, down * part), yaw_rate * self.yaw)
            case RatesThrottle(rates, throttle):
                return RatesThrottle(self._rates(rates), throttle * self.speed)
            case RatesThrust(rates, thrust):
                return RatesThrust(self._rates(rates), thrust * self.speed)

    def _rates(self, rates: Triple) -> Triple:
        p, q, r = rates
        return (p * self.roll, q * self.pitch, r * self.yaw)


WORKING = Effect()
