"""The tasks of PX4's rover: those of ArduPilot's, driven by velocity."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from sitl.scenarios import rover
from sitl.scenarios.flight import DEPLOY
from sitl.scenarios.table import Row

PX4: Final = rover.Rover("px4-rover", "rover_px4")


def rows(directory: Path = DEPLOY) -> tuple[Row, ...]:
    """All of them; raises ConfigError."""
    return rover.rows(directory, PX4)
