"""What the manuals of JSBSim's aircraft say: what an operator would tell an autopilot, and a service."""

from __future__ import annotations

from typing import Final, NamedTuple


class Manual(NamedTuple):
    """Airspeeds (true, m/s), climb and sink that are asked for at most, climb at full throttle, throttle and
    pitch of level flight at the cruise; how fast the bank changes, and from a bank and from a throttle that
    are asked for to the middle of their answers."""

    airspeed_min_m_s: float
    airspeed_cruise_m_s: float
    airspeed_max_m_s: float
    climb_max_m_s: float
    sink_max_m_s: float
    climb_full_m_s: float
    throttle_cruise: float
    pitch_cruise_deg: float
    throttle_lag_s: float
    bank_max_deg: float = 45.0
    roll_rate_rad_s: float = 0.6
    bank_lag_s: float = 0.5


#: J-3 Cub (440 kg), Cessna 172 (850 kg), T-6 Texan II (2.7 t, turbine).
MANUALS: Final = {
    "J3Cub": Manual(21.0, 28.0, 34.0, 1.5, 2.0, 1.9, 0.57, 0.0, 1.2),
    "c172p": Manual(33.0, 45.0, 58.0, 2.5, 3.0, 4.5, 0.65, 2.0, 0.9),
    "t6texan2": Manual(60.0, 90.0, 120.0, 5.0, 5.0, 16.0, 0.5, 1.0, 0.2),
}
