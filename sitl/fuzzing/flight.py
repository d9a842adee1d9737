"""A flight to be disturbed: the guide and the built-in vehicle on virtual time, brought to some state."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, Final

import guidance
from guidance.config import Config, load
from guidance.supervisor import State
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.oracle import Oracle
from sitl.fuzzing.orders import order
from sitl.lockstep import SECOND, Channel, Lockstep
from sitl.vehicle import Firmware, Vehicle, VehicleOptions

DEMO: Final = Path(guidance.__file__).with_name("demo.toml")
KEY: Final = bytes(range(32))
_WALL_NS: Final = 1_700_000_000_000_000_000
SIGNED: Final = "link.signing_key_file=key"
_ROVER: Final = ("vehicle.profile=ardupilot-rover", "flight.origin=engage", "limits.yaw_rate_max_rad_s=2.0")
_LINES: Final = ("udpin://127.0.0.1:14540", "serial:///dev/ttyS0?baud=921600", "tcp://127.0.0.1:5760")
#: Below what the vehicle does by itself, so that it is these limits which hold.
_NARROW: Final = (
    "limits.speed_min_m_s=-1",
    "limits.speed_max_m_s=3",
    "limits.roll_rate_max_rad_s=0.5",
    "limits.pitch_rate_max_rad_s=1",
    "limits.yaw_rate_max_rad_s=1.5",
)
_TRAJECTORIES: Final = ("helix", "circle", "lemniscate")


class Stage:
    """Where an episode begins: settings, the vehicle, the ways of the link, and what to wait for."""

    def __init__(
        self,
        *settings: str,
        seconds: float = 0.0,
        until: State | None = None,
        to_guide: Channel = Channel(),  # noqa: B008  # immutable
        to_vehicle: Channel = Channel(),  # noqa: B008
        **vehicle: Any,
    ) -> None:
        self.settings = settings
        self.seconds = seconds
        self.until = until
        self.to_guide = to_guide
        self.to_vehicle = to_vehicle
        self.vehicle = vehicle


STAGES: Final = {
    "tracking": Stage(seconds=8.0, until=State.TRACKING),
    "rough": Stage(
        seconds=8.0,
        until=State.TRACKING,
        to_guide=Channel(0.01, 0.05, 0.1, 0.05),
        to_vehicle=Channel(0.01, 0.05, 0.1, 0.05),
    ),
    "engaging": Stage(seconds=0.6),
    "ready": Stage("supervisor.engage=pilot", seconds=5.0, until=State.READY),
    "waiting": Stage(seconds=1.0, estimator_ready_s=1e6),
    "withheld": Stage(seconds=3.0, until=State.WITHHELD, initially_armed=True),
    "unheard": Stage("supervisor.step_timeout_s=1", seconds=3.0, to_vehicle=Channel(loss=1.0)),
    "alone": Stage(to_guide=Channel(loss=1.0), to_vehicle=Channel(loss=1.0)),
}


@cache
def configuration(*settings: str) -> Config:
    """The demo's with these settings."""
    return load(DEMO, settings)


class FuzzedFlight:
    """One flight, its oracle, and what the vehicle sent lately (`heard`), of which frames are forged."""

    def __init__(self, dice: Dice) -> None:
        name = dice.choice(("tracking", "tracking", "tracking", *STAGES))
        stage = STAGES[name]
        rover = dice.chance(0.3)
        self.signed = dice.chance(0.25)
        settings = [*stage.settings, f"link.connection={dice.choice(_LINES)}"]
        settings += _ROVER if rover else ("supervisor.arm=true",)
        settings += (SIGNED,) * self.signed
        settings += ("link.commands_from=[1, 255]",) * dice.chance(0.3)
        if not rover and dice.chance(0.4):
            settings += [*_NARROW, f"trajectory={{name={dice.choice(_TRAJECTORIES)!r}, speed_m_s=1.0}}"]
        config = configuration(*settings)
        options = dict(stage.vehicle)
        if name == "withheld":
            options["initial_mode"] = "GUIDED" if rover else "OFFBOARD"
        key = KEY if self.signed else None
        self.name = f"{name}, {config.vehicle.profile}, {config.link.connection}" + ", signed" * self.signed
        self.heard: list[bytes] = []
        self.flight = _Heard(
            config,
            Vehicle(
                VehicleOptions(
                    firmware=Firmware(config.vehicle.profile),
                    unix_at_zero_ns=_WALL_NS,
                    signing_key=key or b"",
                    **options,
                ),
                boot_ns=SECOND,
            ),
            to_guide=stage.to_guide,
            to_vehicle=stage.to_vehicle,
            seed=dice.randrange(1 << 30),
            signing_key=key,
        )
        self.flight.heard = self.heard
        self.oracle = Oracle(self.flight.guide, key)
        self.flight.on_record = self.oracle.take
        guide, until = self.flight.guide, stage.until
        reached: Callable[[], bool] | None = (
            None if until is None else (lambda: guide.engagement.state is until)
        )
        if until is State.READY:
            self.flight.run(0.5)
        self.flight.run(stage.seconds * (1.0 if until else dice.random()), until=reached)

    def inject(self, data: bytes) -> None:
        """Bytes come in; now."""
        self.flight.inject(data)

    def pass_time(self, dice: Dice) -> None:
        """None, a little, or rarely a lot of it; a tick that nobody asked for, or a late one."""
        kind = dice.random()
        if kind < 0.5:
            return
        flight = self.flight
        if kind < 0.93:
            flight.run(dice.choice((0.0005, 0.002, 0.01)))
        elif kind < 0.96:
            flight.tick()
        elif kind < 0.998:
            flight.run(dice.choice((0.02, 0.05)))
        else:  # the process was stopped, or the machine slept
            flight.now_ns += round(dice.choice((0.3, 1.5, 12.0)) * SECOND)
            flight.tick()

    def order(self, dice: Dice) -> str:
        """The operator orders something, now; its name."""
        self.flight.inject(b"")  # what was sent before it is judged by what held before it
        name = order(self.flight.guide, self.flight.now_ns, dice)
        self.flight.inject(b"")
        self.flight.tick()
        return name

    @property
    def signing_time(self) -> int:
        """Now, as signatures have it: 10 us since 2015."""
        return (_WALL_NS + self.flight.now_ns) // 10_000 - 142_007_040_000_000


class _Heard(Lockstep):
    """Keeps what the vehicle sent last, and can be ticked at any time."""

    heard: list[bytes]

    def tick(self) -> None:
        """Time passed, says somebody, whether or not it is due."""
        self.guide.tick(self.now_ns)
        self._drain()

    def _send(self, data: bytes, channel: Channel, *, to_guide: bool) -> None:
        if to_guide:
            self.heard.append(data)
            if len(self.heard) > 64:
                del self.heard[:32]
        super()._send(data, channel, to_guide=to_guide)
