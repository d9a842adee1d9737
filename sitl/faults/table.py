"""All faults that are flown in lockstep, in the order in which they are shown."""

from __future__ import annotations

from typing import Final

from sitl.faults.fault import Fault
from sitl.faults.link_faults import LINK_FAULTS
from sitl.faults.people_faults import PEOPLE_FAULTS
from sitl.faults.state_faults import STATE_FAULTS
from sitl.faults.vehicle_faults import VEHICLE_FAULTS

TABLE: Final[tuple[Fault, ...]] = (*LINK_FAULTS, *STATE_FAULTS, *VEHICLE_FAULTS, *PEOPLE_FAULTS)
