"""A preflight check on virtual time: the built-in vehicle, what else is on the line, what is concluded."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterable
from typing import Any

from pymavlink.dialects.v20 import all as mavlink

from guidance.mavlink.signing import Signing, SigningClock, wall_timestamp
from guidance.preflight.checks import findings
from guidance.preflight.findings import Finding, Verdict
from guidance.preflight.observation import Observation
from guidance.preflight.seen import Seen
from sitl.vehicle import Firmware, Vehicle, VehicleOptions
from tests.helpers import make_config

SECOND = 1_000_000_000
START_NS = 5 * SECOND
#: Around everything: none at all is a warning of its own.
FENCED = "guards.fence_ned_m=[[-9e4,-9e4],[9e4,-9e4],[9e4,9e4],[-9e4,9e4]]"
#: Everything else on the line speaks at this period.
OTHERS_NS = SECOND // 50

Others = Callable[[int], Iterable[bytes]]


class Bench:
    """A look of at most `seconds` at a vehicle (None: a dead line); `took_s` is how long it lasted.

    `others` gives what else comes at an instant, `orders` what others send to the vehicle then; `garbles`
    says what becomes of the vehicle's bytes on the way, `deaf_to` which of our messages do not arrive. A
    `lenient` vehicle that signs takes unsigned packets all the same.
    """

    def __init__(
        self,
        *overrides: str,
        vehicle: dict[str, Any] | None = None,
        seconds: float = 10.0,
        others: Others = lambda now_ns: (),
        orders: Others = lambda now_ns: (),
        garbles: Callable[[bytes], bytes] = lambda data: data,
        deaf_to: Callable[[Any], bool] = lambda message: False,
        dead: bool = False,
        signing_key: bytes | None = None,
        lenient: bool = False,
    ) -> None:
        config = make_config("supervisor.engage=auto", "supervisor.arm=true", FENCED, *overrides)
        options = {"firmware": Firmware(config.vehicle.profile), **(vehicle or {})}
        self.vehicle = Vehicle(VehicleOptions(**options), boot_ns=START_NS)
        if lenient:
            self.vehicle._pilot.link._mav.signing.allow_unsigned_callback = lambda mav, message_id: True
        signing = None if signing_key is None else Signing(signing_key, 0)
        if signing is not None:
            wall = wall_timestamp(self.vehicle.options.unix_at_zero_ns + START_NS)
            signing.set(SigningClock(wall), START_NS)
        self.observation = Observation(config, signing)
        self.sent: list[Any] = []
        self.now_ns = START_NS
        self._others, self._orders = others, orders
        self._garbles, self._deaf_to, self._dead = garbles, deaf_to, dead
        self._parser = mavlink.MAVLink(None)
        self._run(round(seconds * SECOND))
        self.took_s = (self.now_ns - START_NS) / SECOND

    def _run(self, most_ns: int) -> None:
        observation, vehicle = self.observation, self.vehicle
        observation.opened(self.now_ns)
        others_ns = self.now_ns
        while not observation.complete() and self.now_ns < START_NS + most_ns:
            for data in vehicle.advance(self.now_ns):
                if not self._dead:
                    observation.receive(self._garbles(data), self.now_ns)
            if self.now_ns >= others_ns:
                others_ns += OTHERS_NS
                for data in self._others(self.now_ns):
                    observation.receive(data, self.now_ns)
                for data in self._orders(self.now_ns):
                    vehicle.receive(data, self.now_ns)
            if self.now_ns >= observation.deadline():
                for packet in observation.tick(self.now_ns):
                    self._deliver(packet)
            due_ns = min(vehicle.deadline(), observation.deadline(), others_ns)
            self.now_ns = max(min(due_ns, START_NS + most_ns), self.now_ns)
        observation.tick(self.now_ns)

    def _deliver(self, packet: bytes) -> None:
        (message,) = self._parser.parse_buffer(packet)
        self.sent.append(message)
        if not self._deaf_to(message):
            self.vehicle.receive(packet, self.now_ns)

    def seen(self, **others: Any) -> Seen:
        """All of it; `others` beside the link."""
        return Seen("vehicle.toml", self.observation, **{"opened": "opened", **others})

    def findings(self, **others: Any) -> dict[str, Finding]:
        """By check."""
        return {finding.check: finding for _, finding in findings(self.seen(**others))}

    def bad(self, **others: Any) -> dict[str, Finding]:
        """What fails or is warned of."""
        wrong = (Verdict.FAIL, Verdict.WARN)
        return {name: f for name, f in self.findings(**others).items() if f.verdict in wrong}


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """One that nobody has."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def only(bench: Bench, check: str, verdict: Verdict, **others: Any) -> Finding:
    """The one thing that is wrong."""
    bad = bench.bad(**others)
    assert list(bad) == [check], bad
    assert bad[check].verdict is verdict, bad
    assert bad[check].todo, bad
    return bad[check]
