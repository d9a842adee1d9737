"""The demo: the built-in vehicle and the service as two processes, watched over zenoh, judged by the truth.

What flies is the very `guidance run`, configured by `demo.toml` and the overrides; it does not know that the
vehicle is not real. The vehicle's truth comes out of band, over its stdout, and is compared with the
reference at the same instants afterwards.
"""

from __future__ import annotations

import contextlib
import socket
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import msgspec

from guidance.child import Child
from guidance.config import Config, ConfigError, from_json, load, parse_connection
from guidance.connection import Network
from guidance.demo_view import Result as Result  # what `fly` returns, so found here
from guidance.demo_view import View
from guidance.figures import Goals, StreamFigures, TrackingFigures, stream_figures, tracking_figures
from guidance.fleet import Fleet
from guidance.mavlink.profiles import PROFILES
from guidance.noted_signals import noted_signals
from guidance.records import Packet, Record, Session, Status
from guidance.se3 import Vec3, add, norm, subtract
from guidance.telemetry.log import LogDamaged, NotALog, read_records
from guidance.telemetry.schema import RECORDS
from guidance.telemetry.subscriber import Subscriber
from guidance.telemetry.zenoh_sink import zenoh_config
from guidance.trajectory import sample

CONFIG_FILE: Final = Path(__file__).with_name("demo.toml")

#: Until the service is heard of over zenoh.
_START_S: Final = 15.0
#: A state before engaging that lasts longer than this will not pass; the steps of engaging have a time-out.
_NO_PROGRESS_S: Final = 3.0
_STEPS: Final = frozenset({"streaming", "switching", "arming"})
_LOOK_S: Final = 0.1
_ENDED: Final = frozenset({"handed-over", "aborted", "finished", "withheld"})
_SET_ATTITUDE_TARGET: Final = (82).to_bytes(3, "little")


class DemoError(Exception):
    """The flight did not come about or ended early; the text says what was seen."""


class Truth(NamedTuple):
    """The plant at `t_ns` of the monotonic clock, which processes on one machine share."""

    t_ns: int
    position_ned_m: Vec3


class Plan(NamedTuple):
    """What is flown: the service's settings, the configuration that they make, and where zenoh has it."""

    settings: list[str]
    config: Config
    watch_at: str


def fly(seconds: float, overrides: Sequence[str]) -> Result:
    """Fly for `seconds` of tracking (or until SIGINT, SIGTERM, SIGHUP) and judge it.

    Raises:
        ConfigError: the overrides do not make a configuration, or none that the demo can watch.
        DemoError: it did not come to a flight, or that ended early.
    """
    plan = plan_flight(overrides)
    directory = Path(plan.config.log.directory)
    before = set(directory.glob("*.mcap"))
    truth: list[Truth] = []
    with noted_signals() as noted, View(seconds) as view:
        view.head(plan.config, plan.watch_at)
        with (
            Child(vehicle_command(plan.config), "vehicle", view.line) as vehicle,
            Child(service_command(plan.settings), "service", view.line) as service,
        ):
            vehicle.listen(lambda line: _take_truth(line, truth))
            service.listen(None)
            name, fleet = plan.config.vehicle.name, Fleet()
            with Subscriber(zenoh_config(connect=[plan.watch_at]), name) as watch:

                def latest(topic: str) -> Record | None:
                    fleet.take(watch.take())
                    return fleet.newest(name, RECORDS[topic])

                step_s = plan.config.supervisor.step_timeout_s + 1.0  # the service's own word comes first
                try:
                    _watch(seconds, step_s, (vehicle, service), latest, view, noted)
                except DemoError as error:
                    service.stop()
                    log = log_of(plan.config, set(directory.glob("*.mcap")) - before)
                    raise DemoError(f"{error}{'' if log is None else f'; log: {log}'}") from None
            service.stop()
            if service.process.returncode != 0:
                raise DemoError(service.obituary())
    log = log_of(plan.config, set(directory.glob("*.mcap")) - before)
    if log is None:
        raise DemoError(f"the service left no log in {directory.resolve()}")
    return _judge(log, plan.config, truth, seconds, noted[0] if noted else 0)


def plan_flight(overrides: Sequence[str]) -> Plan:
    """The demo's configuration with overrides, on ports that are free.

    Raises:
        ConfigError: the overrides do not make a configuration, or none that the demo can watch.
    """
    settings = [f'link.connection="udpin://127.0.0.1:{free_port(socket.SOCK_DGRAM)}"', *overrides]
    config = load(CONFIG_FILE, settings)
    zenoh = config.zenoh
    if not (config.log.enabled and zenoh.enabled):
        raise ConfigError(
            "log.enabled, zenoh.enabled: must be true here: the demo watches over zenoh, judges by the log"
        )
    if zenoh.config_file:
        raise ConfigError(
            "zenoh.config_file: the demo watches at zenoh.listen or zenoh.connect; set one of them"
        )
    connection = parse_connection(config.link.connection)
    if not isinstance(connection, Network) or connection.scheme in ("tcp", "udpbcast") or not connection.port:
        raise ConfigError("link.connection: the demo needs udpin or udpout, and a port of 1 to 65535")
    if not zenoh.listen and zenoh.mode == "peer":
        settings.append(f'zenoh.listen=["tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"]')
        config = load(CONFIG_FILE, settings)
    endpoints = (*config.zenoh.listen, *config.zenoh.connect)
    if not endpoints:
        raise ConfigError("zenoh.connect: is empty, and zenoh.mode is client: name a router")
    return Plan(settings, config, endpoints[0].replace("/0.0.0.0:", "/127.0.0.1:"))


def _watch(
    seconds: float,
    step_s: float,
    children: Sequence[Child],
    latest: Callable[[str], Record | None],
    view: View,
    noted: Sequence[int],
) -> None:
    """Until it has tracked for `seconds` or a signal came; raises DemoError if it does not come to that."""
    state, since = "", time.monotonic()
    while not noted:
        for child in children:
            if child.ended:
                raise DemoError(child.obituary())
        status = latest("status")
        now = time.monotonic()
        if not isinstance(status, Status):
            if now - since > _START_S:
                raise DemoError(f"no telemetry over zenoh after {_START_S:.0f} s")
        elif status.trajectory_start_ns is not None:
            if (time.monotonic_ns() - status.trajectory_start_ns) * 1e-9 >= seconds:
                return
        elif status.state in _ENDED:
            raise DemoError(f"not tracking: {status.state}: {status.reason}")
        elif status.state != state:
            state, since = status.state, now
        elif now - since > (step_s if state in _STEPS else _NO_PROGRESS_S):
            raise DemoError(f"not tracking, {state} for {now - since:.0f} s: {status.reason}")
        view.update(latest)
        time.sleep(_LOOK_S)


def _judge(log: Path, config: Config, truth: Sequence[Truth], asked_s: float, number: int) -> Result:
    """Compare truth and reference at the same instants; the log says when tracking began and ended."""
    start_ns: int | None = None
    origin = Vec3(0.0, 0.0, 0.0)
    end_ns = 0
    sent_ns: list[int] = []
    try:
        for record in read_records(log, "status", "packet"):
            if isinstance(record, Status) and record.trajectory_start_ns is not None:
                start_ns = record.trajectory_start_ns
                origin = Vec3(*(record.origin_ned_m or origin))
                end_ns = record.since_ns if record.state == "leaving" else record.t_ns
            elif isinstance(record, Packet) and record.data[7:10] == _SET_ATTITUDE_TARGET:
                sent_ns.append(record.t_ns)
    except (LogDamaged, NotALog) as damage:
        raise DemoError(str(damage)) from None
    tracking, stream = TrackingFigures(None, None, None), StreamFigures(None, None)
    errors: list[tuple[float, float]] = []
    time_constant_s = config.law.beta / config.law.k
    if start_ns is not None:
        planar = PROFILES[config.vehicle.profile].planar
        for t_ns, position in truth:
            if start_ns <= t_ns <= end_ns:
                time_s = (t_ns - start_ns) * 1e-9
                e = subtract(position, add(origin, sample(config.trajectory, time_s).position))
                errors.append((time_s, norm(Vec3(e.x, e.y, 0.0) if planar else e)))
        if not truth or end_ns - truth[-1].t_ns > 500_000_000:
            raise DemoError(f"the vehicle's truth did not come to the end of the flight; log: {log}")
        tracking = tracking_figures(errors, time_constant_s)
        stream = stream_figures([t_ns for t_ns in sent_ns if start_ns <= t_ns <= end_ns])
    return Result(
        tracking=tracking,
        stream=stream,
        goals=goals(config),
        asked_s=asked_s,
        tracked_s=0.0 if start_ns is None else (end_ns - start_ns) * 1e-9,
        last_error_m=errors[-1][1] if errors else None,
        time_constant_s=time_constant_s,
        log=str(log),
        interrupted_by=number,
    )


def goals(config: Config) -> Goals:
    """What is asked of this flight: more is known of the paper's own than of any other."""
    paper = load(CONFIG_FILE)
    same = config.law == paper.law and config.limits == paper.limits and config.vehicle == paper.vehicle
    bounded = same and config.trajectory == paper.trajectory
    fast = load(CONFIG_FILE, ("trajectory.radius_m=20", "trajectory.speed_m_s=4")).trajectory
    return Goals(
        converged_s=12.0 if bounded else None,
        rms_error_m=0.003 if bounded else 0.02 if same and config.trajectory == fast else None,
        max_error_m=0.01 if bounded else None,
        rate_hz=config.link.rate_hz,
        max_gap_s=2.5 / config.link.rate_hz,
    )


def log_of(config: Config, made: set[Path]) -> Path | None:
    """The one of the new logs that this flight's service wrote: no other listens on its port."""
    for path in sorted(made):
        with contextlib.suppress(LogDamaged, NotALog, ConfigError):
            session = next(iter(read_records(path, "session")), None)
            if isinstance(session, Session) and from_json(session.config_json).link == config.link:
                return path
    return None


def vehicle_command(config: Config) -> list[str]:
    """The built-in vehicle that the service finds; it writes its truth to stdout."""
    connection = parse_connection(config.link.connection)
    assert isinstance(connection, Network)  # the plan has seen to it
    full = config.vehicle.speed_at_full_thrust_m_s
    command = [sys.executable, "-m", "sitl", "vehicle", "--firmware", config.vehicle.profile]
    if connection.scheme == "udpin":
        host = "127.0.0.1" if connection.host == "0.0.0.0" else connection.host  # noqa: S104 - not bound here
        command += ["--to", f"{host}:{connection.port}", "--port", "0"]
    else:
        command += ["--host", connection.host, "--port", str(connection.port)]
    command += ["--truth", "-", "--exit-with-stdin", "--system-id", str(config.vehicle.system_id)]
    if config.vehicle.profile == "ardupilot-rover":
        return [*command, "--set", f"WP_SPEED={full}"]
    return [*command, "--full-thrust-speed", str(full)]


def service_command(settings: Sequence[str]) -> list[str]:
    """The service."""
    command = [sys.executable, "-m", "guidance", "run", "--config", str(CONFIG_FILE)]
    return command + [part for setting in settings for part in ("--set", setting)]


def _take_truth(line: str, truth: list[Truth]) -> None:
    with contextlib.suppress(msgspec.DecodeError, KeyError):  # the last line may be cut
        row = msgspec.json.decode(line)
        truth.append(Truth(row["t_ns"], Vec3(*row["position_ned_m"])))


def free_port(kind: socket.SocketKind) -> int:
    """A port of the loopback that nobody has now."""
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
