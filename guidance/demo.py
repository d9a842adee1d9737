"""The demo: the built-in vehicle and the service as two processes, watched over zenoh, judged by the truth.

What flies is the very `guidance run`, configured by `demo.toml` and the overrides; it does not know that the
vehicle is not real. The vehicle's truth comes out of band, over its stdout, and is compared with the
reference at the same instants afterwards.
"""

from __future__ import annotations

import contextlib
import ctypes
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec

from guidance.config import Config, load
from guidance.demo_view import View, plain
from guidance.figures import StreamFigures, TrackingFigures, stream_figures, tracking_figures
from guidance.mavlink.profiles import PROFILES, profile_of
from guidance.records import Packet, Record, Status
from guidance.se3 import Vec3, add, norm, subtract
from guidance.telemetry.log import LogDamaged, read_records
from guidance.telemetry.subscriber import Subscriber
from guidance.trajectory import Trajectory, sample

CONFIG_FILE: Final = Path(__file__).with_name("demo.toml")

_ENGAGE_S: Final = 30.0
_STOP_S: Final = 5.0
_LOOK_S: Final = 0.1
_ENDED: Final = frozenset({"handed-over", "aborted", "finished", "withheld"})


class DemoError(Exception):
    """The flight did not come about or ended early; the text says what was seen."""


class Truth(NamedTuple):
    """The plant at `t_ns` of the monotonic clock, which processes on one machine share."""

    t_ns: int
    position_ned_m: Vec3


class Result(NamedTuple):
    """How well it tracked, and where the log is."""

    tracking: TrackingFigures
    stream: StreamFigures
    tracked_s: float
    log: str
    interrupted: bool

    @property
    def tracked(self) -> bool:
        """Below 0.1 m for good, and not cut short."""
        return self.tracking.converged_s is not None and not self.interrupted

    def as_json(self) -> dict[str, Any]:
        """The line for machines."""
        return {
            "tracked": self.tracked,
            "converged_s": self.tracking.converged_s,
            "rms_error_m": self.tracking.rms_error_m,
            "max_error_m": self.tracking.max_error_m,
            "setpoint_rate_hz": self.stream.rate_hz,
            "max_setpoint_gap_s": self.stream.max_gap_s,
            "tracked_s": self.tracked_s,
            "log": self.log,
        }


def fly(seconds: float, overrides: Sequence[str]) -> Result:
    """Fly for `seconds` of tracking and judge it; raises ConfigError, DemoError."""
    udp_port, zenoh_port = _free_port(socket.SOCK_DGRAM), _free_port(socket.SOCK_STREAM)
    settings = [
        f'link.connection="udpin://127.0.0.1:{udp_port}"',
        f'zenoh.listen=["tcp/127.0.0.1:{zenoh_port}"]',
        *overrides,
    ]
    config = load(CONFIG_FILE, settings)
    profile_of(config)
    if not (config.log.enabled and config.zenoh.enabled):
        raise DemoError("the demo watches over zenoh and is judged by its log: leave both enabled")
    directory = Path(config.log.directory)
    before = set(directory.glob("*.mcap"))
    truth: list[Truth] = []
    with contextlib.ExitStack() as stack:
        view = stack.enter_context(View(seconds))
        vehicle = stack.enter_context(_Child(_vehicle_command(config, udp_port), "vehicle", view.line))
        threading.Thread(target=_collect_truth, args=(vehicle, truth), daemon=True).start()
        service = stack.enter_context(_Child(_service_command(settings), "service", view.line))
        watch = stack.enter_context(Subscriber(config.vehicle.name, f"tcp/127.0.0.1:{zenoh_port}"))
        interrupted = False
        try:
            _watch(seconds, vehicle, service, watch.latest, view)
        except KeyboardInterrupt:
            interrupted = True
        service.stop(_STOP_S)
    made = sorted(set(directory.glob("*.mcap")) - before)
    if not made:
        raise DemoError(f"the service left no log in {directory.resolve()}")
    return _judge(made[-1], config.trajectory, _time_constant_s(config), truth, _planar(config), interrupted)


def show(result: Result) -> None:
    """Print the summary for people."""
    t, s = result.tracking, result.stream
    rows = [
        ("converged (below 0.1 m for good)", plain(t.converged_s, "s", 2)),
        ("RMS error after settling", plain(t.rms_error_m, "mm", 3, 1e3)),
        ("largest error after settling", plain(t.max_error_m, "mm", 3, 1e3)),
        ("setpoints", plain(s.rate_hz, "Hz", 1)),
        ("longest gap between setpoints", plain(s.max_gap_s, "ms", 1, 1e3)),
        ("log", result.log),
    ]
    View.summary("tracked" if result.tracked else "did NOT track", result.tracked, rows)


def _watch(
    seconds: float, vehicle: _Child, service: _Child, latest: Callable[[str], Record | None], view: View
) -> None:
    """Until it has tracked for `seconds`; raises DemoError if it does not come to that."""
    deadline = time.monotonic() + _ENGAGE_S
    while True:
        for child in (vehicle, service):
            if child.ended:
                raise DemoError(f"the {child.name} ended by itself: {child.last_line}")
        status = latest("status")
        if isinstance(status, Status) and status.trajectory_start_ns is not None:
            elapsed_s = (time.monotonic_ns() - status.trajectory_start_ns) * 1e-9
            if elapsed_s >= seconds:
                return
        elif isinstance(status, Status) and status.state in _ENDED:
            raise DemoError(f"{status.state}: {status.reason}")
        elif time.monotonic() > deadline:
            why = status.reason if isinstance(status, Status) else "no telemetry over zenoh"
            raise DemoError(f"not tracking after {_ENGAGE_S:.0f} s: {why}")
        view.update(latest)
        time.sleep(_LOOK_S)


def _judge(
    log: Path,
    trajectory: Trajectory,
    time_constant_s: float,
    truth: Sequence[Truth],
    planar: bool,
    interrupted: bool,
) -> Result:
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
    except LogDamaged as damage:
        raise DemoError(str(damage)) from None
    if start_ns is None:
        return Result(
            TrackingFigures(None, None, None), StreamFigures(None, None), 0.0, str(log), interrupted
        )
    errors: list[tuple[float, float]] = []
    for t_ns, position in truth:
        if start_ns <= t_ns <= end_ns:
            time_s = (t_ns - start_ns) * 1e-9
            e = subtract(position, add(origin, sample(trajectory, time_s).position))
            errors.append((time_s, norm(Vec3(e.x, e.y, 0.0) if planar else e)))
    return Result(
        tracking_figures(errors, time_constant_s),
        stream_figures([t_ns for t_ns in sent_ns if start_ns <= t_ns <= end_ns]),
        (end_ns - start_ns) * 1e-9,
        str(log),
        interrupted,
    )


_SET_ATTITUDE_TARGET: Final = (82).to_bytes(3, "little")


def _time_constant_s(config: Config) -> float:
    return config.law.beta / config.law.k


def _planar(config: Config) -> bool:
    return PROFILES[config.vehicle.profile].planar


def _vehicle_command(config: Config, port: int) -> list[str]:
    full = config.vehicle.speed_at_full_thrust_m_s
    command = [sys.executable, "-m", "sitl", "vehicle", "--firmware", config.vehicle.profile]
    command += ["--to", f"127.0.0.1:{port}", "--port", "0", "--truth", "-", "--exit-with-stdin"]
    command += ["--system-id", str(config.vehicle.system_id)]
    if config.vehicle.profile == "ardupilot-rover":
        return [*command, "--set", f"WP_SPEED={full}"]
    return [*command, "--full-thrust-speed", str(full)]


def _service_command(settings: Sequence[str]) -> list[str]:
    command = [sys.executable, "-m", "guidance", "run", "--config", str(CONFIG_FILE)]
    for setting in settings:
        command += ["--set", setting]
    return command


class _Child:
    """A process of its own session: Ctrl-C reaches only the demo, which ends its children in order."""

    def __init__(self, command: Sequence[str], name: str, line: Callable[[str, str], None]) -> None:
        self.name = name
        self.last_line = "it said nothing"
        self._line = line
        self.process = subprocess.Popen(  # noqa: S603 - our own interpreter and modules
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            preexec_fn=_end_with_parent if sys.platform == "linux" else None,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def __enter__(self) -> _Child:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(_STOP_S)
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    @property
    def ended(self) -> bool:
        """Whether the process is gone."""
        return self.process.poll() is not None

    def stop(self, timeout_s: float) -> None:
        """SIGTERM, and SIGKILL if that is not enough."""
        if not self.ended:
            self.process.terminate()
            try:
                self.process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait()
        self._reader.join(1.0)

    def _read(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as pipe:
            for line in pipe:
                self.last_line = line.rstrip()
                self._line(self.name, self.last_line)


def _end_with_parent() -> None:
    """Linux: a demo that is killed leaves no process behind (PR_SET_PDEATHSIG)."""
    ctypes.CDLL(None).prctl(1, signal.SIGTERM)


def _collect_truth(vehicle: _Child, truth: list[Truth]) -> None:
    assert vehicle.process.stdout is not None
    decode = msgspec.json.Decoder().decode
    with contextlib.suppress(ValueError):  # the pipe is closed under us at the end
        for line in vehicle.process.stdout:
            with contextlib.suppress(msgspec.DecodeError):  # the last line may be cut
                row = decode(line)
                truth.append(Truth(row["t_ns"], Vec3(*row["position_ned_m"])))


def _free_port(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
