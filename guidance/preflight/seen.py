"""All that was looked at, for the checks to judge."""

from __future__ import annotations

from typing import NamedTuple

from guidance.config import Config
from guidance.preflight.observation import Observation
from guidance.preflight.surroundings import DiskLook, PortLook, ZenohLook


class Seen(NamedTuple):
    """`source` names the configuration. `refused` says why the line is not open, `opened` what was opened.

    `zenoh` or `disk` is None where the configuration has switched it off.
    """

    source: str
    observation: Observation
    port: PortLook = PortLook()
    opened: str = ""
    refused: str = ""
    zenoh: ZenohLook | None = None
    disk: DiskLook | None = None

    @property
    def config(self) -> Config:
        """What is to be flown."""
        return self.observation.config
