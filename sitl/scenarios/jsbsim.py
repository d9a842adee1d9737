"""The tasks of airplanes that others wrote: JSBSim's, flown by settings and autopilot parameters alone.

The autopilot is set up as the aircraft's manual has it (`sitl.vehicle.manual_parameters`), and so is the
service. Each flies its tasks at its cruise, as large as a bank of `TASK_BANK_RAD` makes them.
"""

from __future__ import annotations

from importlib.util import find_spec
from math import inf, pi, radians, tan
from pathlib import Path
from typing import Final

from guidance.handling.airplane_bank import GRAVITY_M_S2
from guidance.handling.airplane_defaults import Airframe, handling
from sitl.models.files import JSBSIM_PREFIX
from sitl.models.manuals import MANUALS, Manual
from sitl.scenarios.airplane import WIND, Airplane, near, on_a_circle, on_a_helix, on_an_eight, task
from sitl.scenarios.flight import DEPLOY
from sitl.scenarios.table import AS_IT_IS, Limits, Row

#: The bank of the tightest turn of each task.
TASK_BANK_RAD: Final = radians(27.0)
#: Who flies which.
PROFILES: Final = {"J3Cub": "ardupilot-plane", "c172p": "px4-plane", "t6texan2": "px4-plane"}
#: What ships is for the small airplanes: a fast one that begins with its bank the wrong way is farther off
#: until it has turned.
SHIPPED_ERROR_M: Final = 400.0
TURN_BACK_S: Final = 10.0
#: Demands are taken to act so much later: about half of the inner loops' lag.
ACTS_S: Final = 0.3


def airframe(manual: Manual) -> Airframe:
    """As `guidance.handling` takes it."""
    m = manual
    return Airframe(
        airspeed_min_m_s=m.airspeed_min_m_s,
        airspeed_cruise_m_s=m.airspeed_cruise_m_s,
        airspeed_max_m_s=m.airspeed_max_m_s,
        climb_max_m_s=m.climb_max_m_s,
        sink_max_m_s=m.sink_max_m_s,
        climb_full_m_s=m.climb_full_m_s,
        throttle_cruise=m.throttle_cruise,
        bank_max_rad=radians(m.bank_max_deg),
        pitch_cruise_rad=radians(m.pitch_cruise_deg),
        roll_rate_rad_s=m.roll_rate_rad_s,
        lag_s=m.bank_lag_s,
        throttle_lag_s=m.throttle_lag_s,
    )


def settings(manual: Manual) -> tuple[str, ...]:
    """The service's configuration for this airplane, on top of the one that ships."""
    m, p = manual, handling(airframe(manual))
    return (
        f"airplane.airspeed_min_m_s={m.airspeed_min_m_s}",
        f"airplane.airspeed_cruise_m_s={m.airspeed_cruise_m_s}",
        f"airplane.airspeed_max_m_s={m.airspeed_max_m_s}",
        f"airplane.bank_max_deg={m.bank_max_deg}",
        f"airplane.climb_max_m_s={m.climb_max_m_s}",
        f"airplane.sink_max_m_s={m.sink_max_m_s}",
        f"airplane.climb_full_m_s={m.climb_full_m_s}",
        f"airplane.throttle_cruise={m.throttle_cruise}",
        f"airplane.pitch_cruise_deg={m.pitch_cruise_deg}",
        f"airplane.bank_lag_s={m.bank_lag_s}",
        f"airplane.throttle_lag_s={m.throttle_lag_s}",
        f"law.k={p.k_per_s}",
        f"law.rho2_per_s={p.rho_per_s}",
        f"law.rho3_per_s={p.rho_per_s}",
        f"limits.speed_min_m_s={m.airspeed_min_m_s}",
        f"limits.speed_max_m_s={m.airspeed_max_m_s}",
        f"limits.roll_rate_max_rad_s={m.roll_rate_rad_s}",
        f"vehicle.speed_at_full_thrust_m_s={m.airspeed_max_m_s}",
        f"link.actuation_delay_s={ACTS_S}",
        f"guards.speed_max_m_s={1.5 * m.airspeed_max_m_s}",
        f"guards.error_max_m={max(SHIPPED_ERROR_M, TURN_BACK_S * m.airspeed_cruise_m_s)}",
    )


def rows(directory: Path = DEPLOY) -> tuple[Row, ...]:
    """All of them; none where JSBSim is not installed."""
    if find_spec("jsbsim") is None:
        return ()
    return tuple(row for aircraft in MANUALS for row in _rows(aircraft))


def _rows(aircraft: str) -> list[Row]:
    manual = MANUALS[aircraft]
    v = manual.airspeed_cruise_m_s
    plane = Airplane(
        PROFILES[aircraft], JSBSIM_PREFIX + aircraft, v, manual.airspeed_min_m_s, settings(manual)
    )
    radius_m = round(v * v / (GRAVITY_M_S2 * tan(TASK_BANK_RAD)))
    circle, beside = on_a_circle(plane, radius_m), near(radius_m, 0.0, 0.5 * pi)
    helix, abeam = on_a_helix(plane, radius_m), near(0.0, radius_m, 0.0)
    # an eight's tightest turn is an eighth of its length
    eight, amid = on_an_eight(plane, 8.0 * radius_m), near(0.0, 0.0, 0.25 * pi)
    limits = Limits(converged_s=60.0, rms_m=1.5, saturated=0.01, airspeed_min_m_s=manual.airspeed_min_m_s)
    windy = Limits(rms_m=1.5, saturated=inf, airspeed_min_m_s=manual.airspeed_min_m_s)
    tasks = (
        (f"circle r {radius_m} m", circle, beside, limits, AS_IT_IS),
        (f"circle r {radius_m} m", circle, beside, windy, WIND),
        (f"helix r {radius_m} m, 1 m/s up", helix, abeam, limits, AS_IT_IS),
        (f"eight {8 * radius_m} x {4 * radius_m} m", eight, amid, limits, AS_IT_IS),
    )
    return [
        Row(
            name=f"JSBSim's {aircraft} at {v:g} m/s: {name}",
            task=task(plane, settings_of, start, 90.0),
            limits=allowed,
            variations=(variation,),
        )
        for name, settings_of, start, allowed, variation in tasks
    ]
