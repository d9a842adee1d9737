"""Where the vehicle is and how it lies, from whatever the autopilot offers.

`samples` turns messages into attitudes and positions or refuses them, `sources` chooses whose are used,
`resets` finds where the autopilot's estimator jumped, `origin` where the origin of its local frame moved, and
`estimator` makes one state of one instant of them.
"""

from __future__ import annotations

from guidance.estimate.estimator import BLEND_TIME_S, Estimate, Estimator
from guidance.estimate.resets import ATTITUDE_JUMP_RAD, POSITION_JUMP_M, Reset, together
from guidance.estimate.samples import AttitudeSample, PositionSample
from guidance.estimate.sources import ATTITUDES, FUTURE_NS, POSITIONS, SILENT_NS, STEADY_NS, Switch

__all__ = [
    "ATTITUDES",
    "ATTITUDE_JUMP_RAD",
    "BLEND_TIME_S",
    "FUTURE_NS",
    "POSITIONS",
    "POSITION_JUMP_M",
    "SILENT_NS",
    "STEADY_NS",
    "AttitudeSample",
    "Estimate",
    "Estimator",
    "PositionSample",
    "Reset",
    "Switch",
    "together",
]
