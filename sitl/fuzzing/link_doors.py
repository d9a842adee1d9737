"""The link's door: bytes of any kind, and well-formed messages that say impossible things."""

from __future__ import annotations

import math
from typing import Any, Final

from pymavlink.dialects.v20 import all as dialect

from guidance.mavlink.messages import DECODERS
from guidance.records import InputKind
from sitl.fuzzing.dice import Dice
from sitl.fuzzing.flight import KEY, FuzzedFlight
from sitl.fuzzing.frames import IDS, Signer, fitting, frame, payload

_COMMANDS: Final = (176, 400, 511, 512, 520, 31999)
#: Modes of both firmwares, and none.
_MODES: Final = (0, 4, 5, 15, 393216, 50593792, 84148224, 327680, 2**32 - 1)
_READ: Final = tuple(sorted(DECODERS))


class LinkDoor:
    """A flight, and one hostile input after the other. `newest` shows the input for a report."""

    inputs = 350

    def __init__(self, dice: Dice) -> None:
        self.newest = "the way to the first state"
        self._dice = dice
        self._fuzzed = FuzzedFlight(dice)

    @property
    def scene(self) -> str:
        """What is flown."""
        return self._fuzzed.name

    def feed(self) -> None:
        """One input."""
        fuzzed, dice = self._fuzzed, self._dice
        fuzzed.pass_time(dice)
        data = self._data()
        self.newest = f"bytes {data.hex()} at {fuzzed.flight.now_ns} ns"
        fuzzed.inject(data)

    def finish(self) -> bytes:
        """A second more of flight, and memory."""
        self.newest = "the end: a second of flight, then what is kept"
        self._fuzzed.flight.run(0.3)
        return self._fuzzed.oracle.finish()

    def _data(self) -> bytes:
        raise NotImplementedError

    def _signer(self, hostility: float) -> Signer | None:
        """The key's holder, or whoever pretends to be."""
        dice = self._dice
        if not self._fuzzed.signed and not dice.chance(0.05):
            return None
        if not dice.chance(hostility):
            return Signer(KEY, 0, self._fuzzed.signing_time + dice.randrange(1000))
        if dice.chance(0.3):
            return None
        key = KEY if dice.chance(0.6) else dice.randbytes(32)
        time = dice.choice((0, 2**48 - 1, self._fuzzed.signing_time + dice.randrange(-(10**8), 10**8)))
        return Signer(key, dice.whole(0, 255), time)


class BytesDoor(LinkDoor):
    """Raw bytes, and real frames that were damaged."""

    def _data(self) -> bytes:
        dice, heard = self._dice, self._fuzzed.heard
        kind = dice.random()
        if kind < 0.1 or not heard:
            start = dice.choice((b"", b"\xfd", b"\xfe", b"\xfd" * 9, b"\xfe\xff", b"\xfd\xff\x01"))
            return start + dice.randbytes(dice.choice((0, 1, 7, 12, 40, 300, 1400)))
        real = dice.choice(heard)
        if kind < 0.2:
            return real
        if kind < 0.7:
            return dice.mutated(real)
        if kind < 0.8:
            return dice.mutated(b"".join(dice.choices(heard, k=dice.randrange(2, 6))))
        return self._forged()

    def _forged(self) -> bytes:
        """A frame that is right but for its content, or but for one thing."""
        dice = self._dice
        message_id = dice.choice(IDS) if dice.chance(0.8) else dice.whole(0, 2**24 - 1)
        content = dice.randbytes(dice.choice((0, 1, 9, 28, 255)))
        if dice.chance(0.3):
            content = content[:1] + bytes(len(content))
        data = frame(
            message_id,
            content,
            dice.randrange(256),
            system=dice.choice((1, 1, 1, 0, 255, dice.randrange(256))),
            component=dice.choice((1, 1, 1, 0, 191, 190, dice.randrange(256))),
            version=dice.choice((1, 2)),
            signer=self._signer(0.5),
        )
        return dice.mutated(data, 1) if dice.chance(0.3) else data


class MessagesDoor(LinkDoor):
    """Messages of the autopilot, each field of which may say anything; and what an operator does meanwhile.

    Every episode leaves out some kinds of messages and is more or less hostile in the others, so that not
    all of them end in the same second with the mode being lost.
    """

    def __init__(self, dice: Dice) -> None:
        super().__init__(dice)
        self._ids = dice.sample(_READ, dice.randrange(1, len(_READ) + 1))
        self._hostility = dice.choice((0.02, 0.1, 0.3, 1.0))
        self._operated = dice.chance(0.3)
        self._sequence = dice.randrange(256)

    def feed(self) -> None:
        """A message; sometimes, in some episodes, a command or a word of the shell."""
        dice, fuzzed = self._dice, self._fuzzed
        if not (self._operated and dice.chance(0.03)):
            super().feed()
            return
        fuzzed.pass_time(dice)
        if dice.chance(0.5):
            self.newest = f"an order at {fuzzed.flight.now_ns} ns"
            self.newest += f": {fuzzed.order(dice)}"
        else:
            kind = dice.choice((InputKind.LINK_UP, InputKind.LINK_DOWN, InputKind.NOTE))
            self.newest = f"{kind} at {fuzzed.flight.now_ns} ns"
            fuzzed.flight.guide.note(kind, dice.text(), fuzzed.flight.now_ns)
            fuzzed.flight.tick()

    def _data(self) -> bytes:
        return b"".join(self._message() for _ in range(self._dice.choice((1, 1, 1, 1, 3, 20))))

    def _message(self) -> bytes:
        dice = self._dice
        message_id = dice.choice(self._ids) if dice.chance(0.9) else dice.choice(IDS)
        content = payload(message_id, dice, fitting(message_id, self._known(message_id)), self._hostility)
        if dice.chance(0.1):
            content = content[: dice.randrange(len(content) + 1)]
        elif dice.chance(0.3):
            content = content.rstrip(b"\0") or b"\0"
        elif dice.chance(0.03):
            content += dice.randbytes(dice.randrange(40))
        # Most go on where the vehicle's own count would be; the others are late, repeated or jump.
        self._sequence += 1 if dice.chance(0.9) else dice.randrange(256)
        stranger = dice.chance(0.1)
        return frame(
            message_id,
            content,
            self._sequence,
            system=dice.whole(0, 255) if stranger else 1,
            component=dice.whole(0, 255) if stranger else 1,
            version=dice.choice((1, 2, 2, 2)),
            signer=self._signer(0.1),
        )

    def _known(self, message_id: int) -> dict[str, Any]:
        """What a healthy autopilot might say in the fields that decide whether it is listened to."""
        dice, flight = self._dice, self._fuzzed.flight
        truth = flight.truth()
        boot_ms = max(int(truth.boot_ms) + dice.choice((0, 0, 1, 5, -3, 60, -400, 3000)), 0) % 2**32
        name = dialect.mavlink_map[message_id].msgname
        known: dict[str, Any] = {"time_boot_ms": boot_ms, "time_usec": boot_ms * 1000}
        link = flight.guide.link
        mode = (link.custom_mode or 0) if dice.chance(0.9) else dice.choice(_MODES)
        if name == "HEARTBEAT":
            armed = 0x81 if link.armed is not dice.chance(0.05) else 0x01
            known |= {"type": 12, "autopilot": dice.choice((12, 3)), "base_mode": armed}
            known |= {"custom_mode": mode, "system_status": 4, "mavlink_version": 3}
        elif name == "CURRENT_MODE":
            known |= {"custom_mode": mode, "intended_custom_mode": dice.choice((mode, 0, *_MODES))}
        elif name == "TIMESYNC":
            asked = dice.choice(self._fuzzed.oracle.questions or [0])
            vehicle_ns = round(truth.boot_ms * 1e6)
            skew_ns = dice.choice((0, 10**6, -(10**9), 10**10, 2**62))
            known |= {"ts1": asked, "tc1": dice.choice((0, vehicle_ns, vehicle_ns + skew_ns))}
        elif name == "COMMAND_ACK":
            known |= {"command": dice.choice(_COMMANDS), "result": dice.choice((0, 0, 1, 2, 3, 4, 5))}
            known |= {"target_system": dice.choice((0, 1)), "target_component": dice.choice((0, 191))}
        elif name == "NAMED_VALUE_FLOAT":
            known |= {"name": b"ALLOC", "value": float(dice.choice((0, 1, 2)))}
        elif name in ("GPS_GLOBAL_ORIGIN", "HOME_POSITION", "GLOBAL_POSITION_INT"):
            place = {"latitude": 473977420, "longitude": 85455940, "lat": 473977420, "lon": 85455940}
            known |= place | {"altitude": 489000, "alt": 489000, "vx": 0, "vy": 0, "vz": 0}
        else:
            known |= self._state(name, truth.position_ned_m)
        return known

    def _state(self, name: str, position_ned_m: tuple[float, float, float]) -> dict[str, Any]:
        """A pose near the true one, or anywhere, and a quaternion that is nearly one."""
        dice = self._dice
        away_m = dice.choice((0.0, 0.01, 0.4, 30.0))
        x, y, z = (value + dice.uniform(-away_m, away_m) for value in position_ned_m)
        q = [dice.gauss(0.0, 1.0) for _ in range(4)]
        norm = math.sqrt(sum(part * part for part in q)) or 1.0
        q = [part / norm * dice.choice((1.0, 1.0, 1.0, 1.0001, 0.98, -1.0)) for part in q]
        known: dict[str, Any] = {"x": x, "y": y, "z": z, "vx": 0.1, "vy": 0.0, "vz": 0.0}
        known |= {"rollspeed": 0.0, "pitchspeed": 0.0, "yawspeed": 0.1, "q": tuple(q)}
        known |= dict(zip(("q1", "q2", "q3", "q4"), q, strict=True))
        known |= {"roll": 0.1, "pitch": -0.1, "yaw": 3.1}
        if name == "ODOMETRY":
            known |= {
                "frame_id": 1,
                "child_frame_id": dice.choice((8, 12)),
                "estimator_type": 3,
                "quality": 100,
            }
            known |= {"reset_counter": dice.choice((0, 0, 0, 1))}
        return known
