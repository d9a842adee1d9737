"""What came of a vehicle's flight: from its record, a row a guide's step, to its outcomes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sitl.campaign.vehicle_plan import OUTCOMES, VehiclePlan


def judged(
    plan: VehiclePlan, record: NDArray[np.float64], columns: tuple[str, ...], dt_s: float
) -> NDArray[np.float64]:
    """`OUTCOMES`, of the columns of these names; what a vehicle has no column for is NaN.

    A flight is below the radius at a step or not; a number that is not finite is not.
    """
    column = {name: record[:, i] for i, name in enumerate(columns)}
    error = column["error_m"]
    steps = len(error)
    inside = error < plan.within_m
    first_in = int(np.argmax(inside)) if inside.any() else steps
    outside = np.flatnonzero(~inside)
    settled = int(outside[-1]) + 1 if outside.size else 0
    counted = min(settled + round(plan.settling_s / dt_s), steps // 2)
    late = error[counted:]
    nothing = np.full(1, np.nan)
    found = {
        "start_error_m": error[0],
        "start_heading_error_rad": np.nan,
        "entered_s": first_in * dt_s if first_in < steps else np.nan,
        "settled_s": settled * dt_s if settled < steps else np.nan,
        "final_error_m": error[-1],
        "excursion_m": error[first_in:].max() if first_in < steps else np.nan,
        "rms_m": np.sqrt(np.mean(late * late)),
        "max_m": late.max(),
        "saturated": column["saturated"][counted:].mean(),
        "reverse_m_s": max(0.0, -column.get("speed_asked_m_s", np.zeros(1)).min()),
        "airspeed_min_m_s": column.get("airspeed_m_s", nothing).min(),
        "height_min_m": column.get("height_m", nothing).min(),
        "stuck": column.get("stuck", np.zeros(1)).max(),
        "finite": float(np.isfinite(record).all()),
    }
    return np.array([found[name] for name in OUTCOMES])
