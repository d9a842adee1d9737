"""The turn that is missing between two attitudes: what an attitude loop acts on."""

from __future__ import annotations

from math import sqrt

from sitl.plant import Triple, Wxyz


def attitude_error(now: Wxyz, wanted: Wxyz) -> Triple:
    """Twice the vector part of now^-1 wanted, the short way round: rad in body axes for small errors."""
    norm = sqrt(sum(part * part for part in wanted))
    if norm < 1e-6:
        return (0.0, 0.0, 0.0)
    w, x, y, z = now
    a, b, c, d = (part / norm for part in wanted)
    sign = 2.0 if w * a + x * b + y * c + z * d >= 0.0 else -2.0
    return (
        sign * (w * b - x * a - y * d + z * c),
        sign * (w * c + x * d - y * a - z * b),
        sign * (w * d - x * c + y * b - z * a),
    )
