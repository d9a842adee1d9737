"""The command line `sitl`: the built-in vehicle as a process, the paper's figures, faults, and benchmarks."""

from __future__ import annotations

import asyncio
import json
import math
import time
from pathlib import Path
from typing import Annotated

import typer

from guidance.completion import one_of
from guidance.entry import enter, refused
from sitl import paper as section_4
from sitl.bench_cli import benchmarks
from sitl.campaign.command import campaign
from sitl.faults.command import faults
from sitl.fuzzing.command import fuzz
from sitl.models.files import NAMES
from sitl.plant import PlantParameters
from sitl.scenarios.command import scenarios
from sitl.shell import ShellOptions, run
from sitl.vehicle import USUAL, Firmware, Noise, Origin, VehicleOptions, fitting
from sitl.vehicle.estimator import SILENT
from sitl.vehicle.options import IDEAL

app = typer.Typer(
    name="sitl",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def sitl() -> None:
    """Software in the loop: the built-in vehicle and what flies against it.

    Examples:

    \b
    sitl vehicle --firmware px4-uuv --to 127.0.0.1:14540    a vehicle to fly
    sitl scenarios --profile px4-rover                      what a profile reaches
    sitl faults --only reboot                               what fails, and how it ends
    sitl campaign --flights 100000                          does the law converge?
    sitl fuzz --inputs 10000                                hostile input
    sitl paper --figure 1                                   the paper's figures
    sitl bench loop                                         how fast this machine is
    """


app.add_typer(benchmarks, name="bench")
app.command()(campaign)
app.command()(faults)
app.command()(fuzz)
app.command()(scenarios)


@app.command()
def vehicle(
    model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME|FILE.toml",
            help="The body: ideal, uuv, rover, boat, airplane (_12 or _20 m/s), copter, jsbsim:c172p (J3Cub, "
            "t6texan2), or parameters in a file; default, one that fits the firmware.",
            autocompletion=one_of(IDEAL, *NAMES),
        ),
    ] = None,
    firmware: Annotated[
        Firmware | None, typer.Option(help="Whose manners the vehicle has; default, one that fits the model.")
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HOST:PORT", help="Where to send, repeatable; without it, to whoever wrote last."
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one.")
    ] = 14580,
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    tcp: Annotated[bool, typer.Option("--tcp", help="Be a TCP server instead of using UDP.")] = False,
    pty: Annotated[
        str | None,
        typer.Option(metavar="PATH", help="Make a serial port (pseudo-terminal), named so, instead."),
    ] = None,
    position: Annotated[
        str | None,
        typer.Option(
            metavar="N,E,D",
            help="Start in metres NED; default -10,-30 on the ground, px4-uuv 5 m deep, jsbsim 60 m up.",
        ),
    ] = None,
    yaw_deg: Annotated[float, typer.Option(help="Heading at the start.")] = 0.0,
    speed: Annotated[
        float | None,
        typer.Option(help="airplane: airspeed at a start in the air, m/s; default 1.5 x stall."),
    ] = None,
    wind: Annotated[
        str | None, typer.Option(metavar="N,E", help="Velocity of the air, m/s: what flies, rover, boat.")
    ] = None,
    gusts: Annotated[float, typer.Option(help="airplane: sigma of level turbulence, m/s.")] = 0.0,
    home: Annotated[
        str | None,
        typer.Option(metavar="LAT,LON,ALT", help="Origin of the local frame: degrees, degrees, metres."),
    ] = None,
    max_rate: Annotated[float, typer.Option(help="ideal: bound on each body rate, rad/s.")] = 5.0,
    max_speed: Annotated[float, typer.Option(help="ideal: bound on the forward speed, m/s.")] = 5.0,
    rate_lag: Annotated[float, typer.Option(help="ideal: first-order lag of the body rates, s.")] = 0.0,
    speed_lag: Annotated[float, typer.Option(help="ideal: first-order lag of the speed, s.")] = 0.0,
    px4_version: Annotated[
        str,
        typer.Option(metavar="X.Y.Z", help="px4: its version; a UUV before 1.17 needs an attitude to move."),
    ] = "1.17.0",
    full_thrust_speed: Annotated[float, typer.Option(help="px4-uuv: speed at thrust 1, m/s.")] = 5.0,
    noise: Annotated[
        bool, typer.Option("--noise", help="An estimator with the usual noise, biases and heading error.")
    ] = False,
    position_noise: Annotated[
        float | None, typer.Option(help="Sigma of the reported position, m; default 0, --noise 0.05.")
    ] = None,
    attitude_noise: Annotated[
        float | None, typer.Option(help="Sigma of the reported attitude, rad; default 0, --noise 0.005.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the noise and of the gusts.")] = 0,
    mode: Annotated[str | None, typer.Option(help="Mode at the start, such as OFFBOARD or HOLD.")] = None,
    arm: Annotated[bool, typer.Option("--arm", help="Start armed.")] = False,
    airborne: Annotated[
        bool,
        typer.Option(
            "--airborne", help="What flies: start armed at 60 m, in the mode that circles or stands."
        ),
    ] = False,
    estimator_ready: Annotated[float, typer.Option(help="Seconds until there is a position.")] = 0.0,
    clock_drift_ppm: Annotated[float, typer.Option(help="How fast the vehicle's clock is.")] = 0.0,
    system_id: Annotated[int, typer.Option(help="MAVLink system id.")] = 1,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="PARAM=VALUE", help="Firmware parameter; repeatable.")
    ] = None,
    signing_key: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Sign, and take only what is signed, by this key (MAVLink 2)."),
    ] = None,
    truth: Annotated[
        str | None, typer.Option(metavar="FILE", help="Write the plant's truth as JSON lines; - is stdout.")
    ] = None,
    truth_period: Annotated[float, typer.Option(help="Seconds between lines of truth.")] = 0.02,
    exit_with_stdin: Annotated[
        bool, typer.Option("--exit-with-stdin", help="Exit when stdin closes (for a parent process).")
    ] = False,
) -> None:
    """Run a MAVLink vehicle around a body, in real time, until SIGTERM or Ctrl-C.

    Exit status 0 when it was ended, 2 for options that do not fit or a port in use.

    Examples:

    \b
    sitl vehicle --to 127.0.0.1:14540 --to 127.0.0.1:14550
    sitl vehicle --model rover --noise --wind 3,-2 --to 127.0.0.1:14540
    sitl vehicle --firmware ardupilot-plane --airborne --pty /tmp/autopilot
    """
    try:
        if not 1e-3 <= truth_period < math.inf:
            raise ValueError(f"--truth-period must be at least 0.001 s, not {truth_period}")
        if bool(to) + tcp + (pty is not None) > 1:
            raise ValueError("--to, --tcp and --pty exclude each other")
        shell_options = ShellOptions(
            host=host,
            port=port,
            to=tuple(map(_address, to or [])),
            tcp=tcp,
            pty=pty,
            truth=truth,
            truth_period_s=truth_period,
            exit_with_stdin=exit_with_stdin,
        )
        vehicle_options = VehicleOptions(
            firmware=_firmware(model or IDEAL) if firmware is None else firmware,
            model=model or "",
            system_id=system_id,
            plant=PlantParameters(max_rate, max_speed, rate_lag, speed_lag),
            initial_position_ned_m=None if position is None else _three("--position", position),
            initial_yaw_rad=math.radians(yaw_deg),
            initial_speed_m_s=speed,
            wind_ned_m_s=(0.0, 0.0, 0.0) if wind is None else _level("--wind", wind),
            gusts_m_s=gusts,
            initial_mode=mode,
            initially_armed=arm,
            airborne=airborne,
            origin=Origin() if home is None else Origin(*_three("--home", home)),
            px4_version=_version(px4_version),
            speed_at_full_thrust_m_s=full_thrust_speed,
            parameters=_parameters(set_ or []),
            clock_drift_ppm=clock_drift_ppm,
            unix_at_zero_ns=time.time_ns(),
            estimator_ready_s=estimator_ready,
            noise=_noise(USUAL if noise else SILENT, position_noise, attitude_noise),
            seed=seed,
            signing_key=b"" if signing_key is None else _key(signing_key),
        )
        asyncio.run(run(shell_options, vehicle_options))
    except (ValueError, OSError) as error:
        raise refused("sitl vehicle", error) from None


@app.command()
def paper(
    figure: Annotated[
        int | None, typer.Option(metavar="N", help="1, 2, 3 or 4; without it, all of them.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where figure-N.png and .svg go; default ., with --json nowhere."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="The numbers on stdout: an object, or a list of four.")
    ] = False,
    step: Annotated[float, typer.Option(help="Longest step of the integration, s.")] = section_4.STEP_S,
    sample: Annotated[float, typer.Option(help="Time between the points given, s.")] = section_4.SAMPLE_S,
) -> None:
    """Reproduce figures 1 to 4 of the paper: the law in continuous time, as plots and as numbers.

    Exit status 0 when they are made, 2 for a wrong option or a file that cannot be.

    Examples:

    \b
    sitl paper --output figures
    sitl paper --figure 3 --json
    """
    numbers = list(section_4.FIGURES) if figure is None else [figure]
    try:
        for number in numbers:
            section_4.check(number, step, sample)
        reports = [section_4.report(number, step, sample) for number in numbers]
        if output is not None or not as_json:
            # Not needed for the numbers, and slow to import.
            from sitl.paper_plots import write

            for report in reports:
                for path in write(report, Path() if output is None else output):
                    typer.echo(path, err=as_json)
    except ModuleNotFoundError as error:
        raise refused("sitl paper", f"plots need {error.name}, of the extra se3-guidance[sitl]") from None
    except (ValueError, OSError) as error:
        raise refused("sitl paper", error) from None
    if as_json:
        typer.echo(json.dumps(reports if figure is None else reports[0]))


def main() -> None:
    """Entry point of the console script."""
    enter(app, "sitl")


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 1 <= int(port) <= 65535:
        raise ValueError(f"--to must be HOST:PORT with a port of 1 to 65535, not {text!r}")
    return host, int(port)


def _version(text: str) -> tuple[int, int, int]:
    parts = text.split(".")
    if len(parts) != 3 or not all(part.isdecimal() for part in parts):
        raise ValueError(f"--px4-version must be three numbers such as 1.16.0, not {text!r}")
    major, minor, patch = map(int, parts)
    return (major, minor, patch)


def _key(path: Path) -> bytes:
    content = path.read_bytes()
    key = content if len(content) == 32 else bytes.fromhex(content.decode("ascii", "replace"))
    if len(key) != 32:
        raise ValueError(f"--signing-key must name a file of 32 bytes or 64 hex digits, not {len(key)} bytes")
    return key


def _firmware(model: str) -> Firmware:
    fit = fitting(model)
    if not fit:
        raise ValueError(f"no firmware fits the model {model} yet")
    return fit[0]


def _noise(noise: Noise, position_m: float | None, attitude_rad: float | None) -> Noise:
    """With what is said of its own."""
    if position_m is not None:
        noise = noise._replace(position_m=position_m)
    return noise if attitude_rad is None else noise._replace(attitude_rad=attitude_rad)


def _three(option: str, text: str) -> tuple[float, float, float]:
    x, y, z = _numbers(option, text, 3)
    return x, y, z


def _level(option: str, text: str) -> tuple[float, float, float]:
    north, east = _numbers(option, text, 2)
    return north, east, 0.0


def _numbers(option: str, text: str, count: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        words = {2: "two", 3: "three"}[count]
        raise ValueError(f"{option} must be {words} numbers with commas between, not {text!r}")
    return numbers


def _parameters(assignments: list[str]) -> dict[str, float]:
    parameters: dict[str, float] = {}
    for assignment in assignments:
        name, equals, value = assignment.partition("=")
        try:
            parameters[name] = float(value)
        except ValueError:
            equals = ""
        if not name or not equals:
            raise ValueError(f"--set must be PARAM=NUMBER, not {assignment!r}")
    return parameters
