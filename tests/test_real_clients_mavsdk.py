"""MAVSDK flies the built-in vehicle over a socket: telemetry, arming, take-off, body rates, landing."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any, Final

import pytest
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.action import Action, ActionError
from mavsdk.plugins.offboard import AttitudeRate, Offboard
from mavsdk.plugins.telemetry import FlightMode, Telemetry

from sitl.plant import euler_from_attitude
from tests.service_rig import PATIENCE_S, Bell, VehicleEnd, a_socket

SETPOINT: Final = "SET_ATTITUDE_TARGET"
#: What is subscribed to, in the names of the telemetry plugin.
TOPICS: Final = (
    "armed",
    "attitude_angular_velocity_body",
    "attitude_euler",
    "flight_mode",
    "health",
    "health_all_ok",
    "home",
    "in_air",
    "position",
    "position_velocity_ned",
    "status_text",
)


class Client:
    """MAVSDK as an application uses it: calls wait for the answer, callbacks come in a thread of its own."""

    def __init__(self, system: Any, ring: Callable[[], object]) -> None:
        self.action, self.offboard = Action(system), Offboard(system)
        self.seen: dict[str, Any] = dict.fromkeys(TOPICS)  # the newest of each topic
        self.texts: list[str] = []
        self._ring = ring
        self._telemetry = Telemetry(system)
        for topic in TOPICS:
            getattr(self._telemetry, f"subscribe_{topic}")(self._take, topic)

    def _take(self, value: Any, topic: str) -> None:
        self.seen[topic] = value
        if topic == "status_text":
            self.texts.append(value.text.strip())
        self._ring()

    @property
    def rates_deg_s(self) -> tuple[int, ...]:
        """The body rates that telemetry tells, in whole degrees per second; empty before the first."""
        told = self.seen["attitude_angular_velocity_body"]
        rates_rad_s = () if told is None else (told.roll_rad_s, told.pitch_rad_s, told.yaw_rad_s)
        return tuple(round(math.degrees(rate)) for rate in rates_rad_s)


@asynccontextmanager
async def connected(**options: Any) -> AsyncIterator[tuple[Client, VehicleEnd, Bell]]:
    """The vehicle on a socket of this loop, and MAVSDK as the ground station that has found it."""
    loop, bell = asyncio.get_running_loop(), Bell()
    vehicle = VehicleEnd(None, bell.ring, **options)
    with a_socket() as sock:
        port = sock.getsockname()[1]
        await vehicle.open(sock=sock)
        mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
        try:
            mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}")
            system = await asyncio.to_thread(mavsdk.first_autopilot, PATIENCE_S)
            assert system is not None, "MAVSDK finds no autopilot"
            yield Client(system, lambda: loop.call_soon_threadsafe(bell.ring)), vehicle, bell
        finally:
            await asyncio.to_thread(mavsdk.destroy)
            vehicle.close()


def test_mavsdk_reads_arms_takes_off_flies_body_rates_lands_and_disarms() -> None:
    async def main() -> None:
        async with connected(parameters={"COM_DISARM_LAND": -1.0}) as (client, vehicle, bell):
            seen = client.seen

            async def shows(topic: str, value: object) -> None:
                await bell.until(lambda: seen[topic] == value, f"{topic} {value!r}")

            # Before the flight: the vehicle as it stands there.
            await bell.until(lambda: None not in [seen[t] for t in TOPICS if t != "status_text"], "telemetry")
            await shows("health_all_ok", True)
            assert seen["health"].is_armable
            assert (seen["armed"], seen["in_air"]) == (False, False)
            assert seen["flight_mode"] == FlightMode.HOLD
            assert seen["home"].latitude_deg == pytest.approx(47.397742)
            assert seen["position"].relative_altitude_m == pytest.approx(5.0)
            local = seen["position_velocity_ned"].position
            assert (local.north_m, local.east_m, local.down_m) == (-10.0, -30.0, -5.0)

            await asyncio.to_thread(client.action.arm)
            await shows("armed", True)
            await asyncio.to_thread(client.action.takeoff)
            await shows("flight_mode", FlightMode.TAKEOFF)

            # A level turn to the right is a circle about a point on the right.
            client.offboard.set_attitude_rate(AttitudeRate(0.0, 0.0, 30.0, 0.4))
            await bell.until(lambda: vehicle.count(SETPOINT), "a setpoint")
            await asyncio.to_thread(client.offboard.start)
            await shows("flight_mode", FlightMode.OFFBOARD)
            await bell.until(lambda: seen["attitude_euler"].yaw_deg > 45.0, "a turn")
            assert client.rates_deg_s == (0, 0, 30)
            truth = vehicle.vehicle.truth()
            assert truth.body_rates_frd_rad_s == pytest.approx((0.0, 0.0, math.radians(30.0)))
            radius_m = truth.speed_m_s / truth.body_rates_frd_rad_s[2]
            assert radius_m == pytest.approx(2.0 / math.radians(30.0))
            roll, pitch, yaw = euler_from_attitude(truth.attitude_wxyz)
            assert (roll, pitch) == (0.0, 0.0)
            assert yaw > math.radians(45.0)
            on_circle = (-10.0 + radius_m * math.sin(yaw), -30.0 + radius_m * (1.0 - math.cos(yaw)), -5.0)
            assert truth.position_ned_m == pytest.approx(on_circle, abs=1e-6)

            client.offboard.set_attitude_rate(AttitudeRate(-20.0, 10.0, 15.0, 0.2))
            await bell.until(lambda: client.rates_deg_s == (-20, 10, 15), "the other rates")
            truth = vehicle.vehicle.truth()
            wanted = tuple(math.radians(rate) for rate in (-20.0, 10.0, 15.0))
            assert truth.body_rates_frd_rad_s == pytest.approx(wanted)
            assert truth.speed_m_s == pytest.approx(1.0)

            await asyncio.to_thread(client.offboard.stop)
            setpoints = vehicle.count(SETPOINT)
            await shows("flight_mode", FlightMode.HOLD)
            assert vehicle.count(SETPOINT) == setpoints
            assert vehicle.vehicle.truth().body_rates_frd_rad_s == (0.0, 0.0, 0.0)
            assert vehicle.vehicle.truth().speed_m_s == 0.0

            with pytest.raises(ActionError, match="COMMAND_DENIED"):
                await asyncio.to_thread(client.action.disarm)
            await asyncio.to_thread(client.action.land)
            await shows("flight_mode", FlightMode.LAND)
            await asyncio.to_thread(client.action.disarm)
            await shows("armed", False)
            assert vehicle.vehicle.armed is False
            await bell.until(lambda: len(client.texts) >= 4, "what the vehicle says")
            assert client.texts == [
                "Armed by external command",
                "Disarming denied: not landed",
                "Landing at current position",
                "Disarmed by external command",
            ]

    asyncio.run(main())


def test_mavsdk_sees_an_estimator_that_is_not_ready_and_may_not_arm() -> None:
    async def main() -> None:
        async with connected(estimator_ready_s=600.0) as (client, vehicle, bell):
            await bell.until(lambda: client.seen["health_all_ok"] is not None, "its health")
            assert not client.seen["health_all_ok"]
            await bell.until(lambda: client.seen["health"] is not None, "what ails it")
            assert not client.seen["health"].is_armable
            assert client.seen["position"] is client.seen["home"] is None
            with pytest.raises(ActionError, match="COMMAND_DENIED"):
                await asyncio.to_thread(client.action.arm)
            assert not vehicle.vehicle.armed

    asyncio.run(main())
