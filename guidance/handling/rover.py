"""What the handling of a rover counts on, of what its autopilot allows.

What binds each number, in the order in which they should be set:

- the yaw slew and the yaw rate are the autopilot's; of the slew, the turn profile of `alignment` counts on a
  part;
- rho times (delay + lag) stays below a half: 3 with 0.1 s left after prediction, and room for 60 ms unknown;
- lambda k is at most 1/s, because speed answers in about a second; with 1.2 a delay that nobody knows of
  makes a limit cycle of a metre, with 1.0 it does not;
- the speed is asked to change a little more slowly than the autopilot lets it, so that it can follow;
- the approach needs room, not damping: it is nearly as fast as the vehicle;
- the crawl is the speed at which the tightest turn takes the highest yaw rate: slower turns take longer on
  the same arc, and faster ones a wider arc.
"""

from __future__ import annotations

from typing import Final

from guidance.handling import waiting

GRAVITY_M_S2: Final = 9.81
#: Of what the autopilot allows, so much is asked for; the rest is for the loops.
ACCELERATION_PART: Final = 0.95
LATERAL_PART: Final = 0.7
#: Fastest approach, as a part of the highest speed.
APPROACH_PART: Final = 0.8
#: A clock that waits as long as the vehicle is behind. Rising 0.3 a second asks 0.6 m/s^2 at 2 m/s.
WAITING: Final = waiting.Parameters(slowest=0.5, fastest=1.15, per_m=3.0, falls_per_s=2.5, rises_per_s=0.3)
