"""The service's job done with MAVSDK: state in, the same law, body rates and thrust out.

The quickest way that `mavsdk` 4 offers: its synchronous interface, whose callbacks run in MAVSDK's own
thread, so that a setpoint is computed and sent where the attitude arrives (its asyncio interface hands every
update to the loop, and every setpoint to another thread). It predicts, checks, records and supervises
nothing. `sitl bench latency` starts it with a port.
"""

from __future__ import annotations

import math
import sys
import threading
import time
from typing import Any

from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.offboard import AttitudeRate, Offboard
from mavsdk.plugins.telemetry import Telemetry

from guidance.config import Config, load
from guidance.demo import CONFIG_FILE
from guidance.law import evaluate
from guidance.se3 import Pose, Quaternion, Vec3
from guidance.trajectory import sample
from sitl.timing_autopilot import SETTINGS

_PATIENCE_S = 10.0


def main(port: int) -> None:
    """Until it is ended."""
    mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
    mavsdk.add_any_connection(f"udpin://127.0.0.1:{port}")
    system = mavsdk.first_autopilot(_PATIENCE_S)
    if system is None:
        sys.exit("no autopilot found")
    telemetry = Telemetry(system)
    follow(load(CONFIG_FILE, SETTINGS), telemetry, Offboard(system))
    threading.Event().wait()


def follow(config: Config, telemetry: Any, offboard: Any) -> None:
    """Answer each attitude with the law's setpoint."""
    gains, limits = config.law.gains(), config.limits.limits()
    full_m_s = config.vehicle.speed_at_full_thrust_m_s
    started_s = time.monotonic()
    position: Vec3 | None = None

    def take_position(update: Any, _: object) -> None:
        nonlocal position
        position = Vec3(update.position.north_m, update.position.east_m, update.position.down_m)

    def take_attitude(q: Any, _: object) -> None:
        if position is None:
            return
        pose = Pose(position, Quaternion(q.w, q.x, q.y, q.z))
        u = evaluate(gains, limits, pose, sample(config.trajectory, time.monotonic() - started_s)).controls
        rates_deg_s = (math.degrees(u.u1), math.degrees(u.u2), math.degrees(u.u3))
        offboard.set_attitude_rate(AttitudeRate(*rates_deg_s, u.u4 / full_m_s))

    telemetry.subscribe_position_velocity_ned(take_position)
    telemetry.subscribe_attitude_quaternion(take_attitude)


if __name__ == "__main__":
    main(int(sys.argv[1]))
