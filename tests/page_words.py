"""What may stand in backticks on a page: each kind of word, and how it is known to exist."""

from __future__ import annotations

import importlib
import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any, Final, Literal, get_args, get_type_hints

import msgspec
import typer.main
from pymavlink.dialects.v20 import all as dialect
from typer.core import TyperGroup

from guidance import cli as guidance_cli
from guidance.component import PARAMETERS
from guidance.config import Config
from guidance.connection import parse_connection
from guidance.guards import GUARDS
from guidance.mavlink.profiles import PROFILES
from guidance.records import TOPICS, StreamStatus
from guidance.telemetry.schema import encoding_schema
from guidance.trajectory import TRAJECTORIES
from guidance.tuning import ErrorFunction
from sitl import cli as sitl_cli
from tests.code_texts import is_said, is_word_of_the_code
from tests.pages import ROOT

PROGRAMS: Final[dict[str, Any]] = {
    "guidance": typer.main.get_command(guidance_cli.app),
    "sitl": typer.main.get_command(sitl_cli.app),
}
SOURCES: Final = "\n".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "guidance").rglob("*.py"))
)
DEPLOYED: Final = "\n".join(
    path.read_text(encoding="utf-8") for path in sorted((ROOT / "deploy").glob("*.toml"))
)
#: What a formula in backticks is made of: the paper's symbols.
SYMBOLS: Final = frozenset(
    re.findall(
        r"\w+", "x r e R k u1 u2 u3 u4 y4 y5 y6 b1 Xr phi lambda beta hat H max rho2 rho3 v v_min v_max"
    )
)
#: Parameters of autopilots that no code here reads, by where they are defined.
ELSEWHERE: Final[dict[str, tuple[str, ...]]] = {
    "PX4 commander_params.c": (
        *("COM_RC_OVERRIDE", "COM_LOW_BAT_ACT", "COM_KILL_DISARM", "COM_DISARM_LAND"),
    ),
    "PX4 geofence_params.c, rc_update/params.c": (
        *("GF_ACTION", "GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "RC_MAP_KILL_SW"),
    ),
    "PX4 mavlink/module.yaml, mavlink_params.c": (
        *(
            "MAV_0_FORWARD",
            "MAV_1_FORWARD",
            "MAV_n_FORWARD",
            "MAV_1_CONFIG",
            "MAV_x_CONFIG",
            "MAV_1_MODE",
            "MAV_n_MODE",
        ),
        *("MAV_1_RATE", "MAV_HB_FORW_EN", "SER_TEL2_BAUD", "SER_TEL2_PROTO"),
    ),
    "ArduPilot GCS_MAVLink_Parameters.cpp, 4.7": ("MAVn_OPTIONS",),
    "ArduPilot AP_SerialManager.cpp": ("SERIALn_PROTOCOL", "SERIALn_BAUD", "SERIALn_OPTIONS", "SERIALn"),
    "ArduPilot RC_Channel.cpp, AC_Fence.cpp, AP_BattMonitor_Params.cpp": (
        *("RCx_OPTION", "BATT_FS_LOW_ACT", "BATT_LOW_VOLT"),
        *("FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_ALT_MAX"),
    ),
    "ArduPilot Parameters.cpp of each vehicle": (
        *("FS_THR_ENABLE", "FS_TIMEOUT", "FS_OPTIONS", "THR_FAILSAFE", "FS_SHORT_ACTN"),
    ),
}
#: Words of other programs, files that are made, and what a user types in a shell.
OTHERS: Final = frozenset(
    [
        *(
            "venv",
            "NO_COLOR",
            "python3 -m venv .venv && .venv/bin/pip install .",
            "tmux",
            "screen",
            "apt install python3-venv",
            "pip install '.[sitl]'",
            "pip install '.[foxglove]'",
        ),
        *(
            "kill -9",
            "kill -USR1",
            "rover-1.toml",
            "systemctl edit",
            "systemctl stop",
            "systemctl status",
            "journalctl -u guidance@uuv-1",
        ),
        *("sudo systemctl kill -s USR1 guidance@uuv-1", "sudo systemctl restart guidance@uuv-1"),
        *("sudo systemctl stop guidance@uuv-1", "systemctl edit guidance@uuv-1", "systemd-analyze security"),
        *("systemctl edit guidance-dashboard", "systemctl restart guidance-dashboard", "[Service]"),
        *("DASHBOARD_OPTIONS", "?age=2.5"),
        'Environment="DASHBOARD_OPTIONS=--host 0.0.0.0 --port 8000"',
        *("DeviceAllow=", "time-sync.target", "systemd-timesyncd", "fake-hwclock", "gpsd", "chrony"),
        *("$STATE_DIRECTORY", "~/.local/state/guidance", "signing-NAME.json", "/var/lib", "SIGUSR1"),
        *("/etc/guidance/uuv-1.toml", "/var/log/guidance/uuv-1/logs", "/etc/mavlink-router/main.conf"),
        *("/dev/serial/by-id", "/dev/ttyUSB0", "/dev/ttyACM*", "00042_19700101T000012Z_uuv-1_1a2b3c4d.mcap"),
        "printf %s PASSPHRASE | sha256sum | cut -c-64",
        *("Mode = Server", "Address = 0.0.0.0", "--streamrate=-1", "MAV_GCS_SYSID", "crazyflow"),
        *("jsbsim:J3Cub", "jsbsim:c172p", "jsbsim:t6texan2", "ws://127.0.0.1:8765"),
        *("apt install chromium",),
        *("rotorpy:hummingbird", "rotorpy:crazyflie", "rotorpy:px4_sihsim_quadx"),
        *("guard_NAME", "map_ned", "base_link_frd"),
    ]
)


def keys_of(kind: type[msgspec.Struct], above: str) -> Iterator[tuple[str, Any]]:
    """Dotted key and type of each value in a table of the configuration, and of the tables in it."""
    hints = get_type_hints(kind, include_extras=True)
    for field in msgspec.structs.fields(kind):
        yield f"{above}{field.name}", hints[field.name]


def every_key() -> dict[str, list[Any]]:
    """Dotted key -> the types it may have: those of a choice differ by its name."""
    found: dict[str, list[Any]] = {}
    tables: list[tuple[str, type[msgspec.Struct]]] = [
        (f"{table.name}.", table.type)
        for table in msgspec.structs.fields(Config)
        if table.name != "trajectory"
    ]
    tables += [("trajectory.", kind) for kind in TRAJECTORIES.values()]
    tables += [("law.error_function.", kind) for kind in get_args(ErrorFunction)]
    for above, kind in tables:
        for key, hint in keys_of(kind, above):
            found.setdefault(key, []).append(hint)
    errors = tuple(str(kind.__struct_config__.tag) for kind in get_args(ErrorFunction))
    found["law.error_function.name"] = [Literal[errors]]
    found["trajectory.name"] = [Literal[tuple(TRAJECTORIES)]]
    return found


KEYS: Final = every_key()
SECTIONS: Final = {key.rpartition(".")[0] for key in KEYS}
FIELDS: Final = {
    f"{topic}.{field.name}" for kind, topic in TOPICS.items() for field in msgspec.structs.fields(kind)
}
#: What the encoding of a payload may say behind `application/json;`, or nothing.
ENCODINGS: Final = {"application/json", *map(encoding_schema, TOPICS.values())}
COMMON_FIELDS: Final = {"t_ns", *(field.name for field in msgspec.structs.fields(StreamStatus))}


def is_key(text: str) -> bool:
    """`table.key`, or with a value that it takes."""
    key, equals, value = text.partition(" = ")
    if key not in KEYS:
        return False
    return not equals or any(takes(hint, value) for hint in KEYS[key])


def takes(hint: Any, literal: str) -> bool:
    """Whether a type takes a TOML literal."""
    try:
        msgspec.convert(msgspec.toml.decode(f"value = {literal}")["value"], hint)
    except (msgspec.MsgspecError, ValueError):
        return False
    return True


def is_field(text: str) -> bool:
    return text in FIELDS


def is_topic_or_field_name(text: str) -> bool:
    """A whole record, or a field spoken of after its record."""
    return text in TOPICS.values() or text in COMMON_FIELDS or any(f.endswith(f".{text}") for f in FIELDS)


def is_section(text: str) -> bool:
    return bool(re.fullmatch(r"\[[a-z_.]+\]", text)) and text[1:-1] in SECTIONS


def is_path(text: str) -> bool:
    """From the root of the repository, perhaps a pattern."""
    if not re.fullmatch(r"[\w.@-]+(/[\w.@*-]*)+|[\w-]+\.\w+", text):
        return False
    return any(ROOT.glob(text)) if "*" in text else (ROOT / text).exists()


def is_program(text: str) -> bool:
    """`guidance VERB ...` or `sitl VERB ...`, as far as it is written."""
    words = text.split()
    name = words[0].removeprefix(".venv/bin/") if words else ""
    if name not in PROGRAMS or len(words) < 2:
        return False
    command = PROGRAMS[name]
    assert isinstance(command, TyperGroup)
    verb = command.commands.get(words[1])
    if verb is None:
        return False
    options = {option for parameter in verb.params for option in parameter.opts}
    return all(word.split("=")[0] in options for word in words[2:] if word.startswith("--"))


def is_object(text: str) -> bool:
    """`guidance.module.name`, a constant perhaps with its value."""
    path, equals, value = text.partition(" = ")
    if not re.fullmatch(r"(guidance|sitl)(\.\w+)+", path):
        return False
    names = path.split(".")
    for cut in range(len(names), 0, -1):
        try:
            found = importlib.import_module(".".join(names[:cut]))
        except ModuleNotFoundError:
            continue
        for name in names[cut:]:
            if not hasattr(found, name):
                return False
            found = getattr(found, name)
        return not equals or repr(found) == value
    return False


def is_value(text: str) -> bool:
    """`"name"`, one that some key takes; a profile."""
    return text in PROFILES or (bool(re.fullmatch(r'"[a-z-]+"', text)) and text in DEPLOYED)


def is_autopilot_word(text: str) -> bool:
    """A parameter that the code knows, or a message."""
    if not re.fullmatch(r"[A-Z][A-Z0-9]*(_[A-Z0-9]+)*", text):
        return False
    return bool(re.search(rf"\b{text}\b", SOURCES)) or f"MAVLINK_MSG_ID_{text}" in vars(dialect)


def is_guard(text: str) -> bool:
    return text in {guard.name for guard in GUARDS}


def is_profile_column(text: str) -> bool:
    return text in next(iter(PROFILES.values()))._fields


def is_formula(text: str) -> bool:
    """Of the paper's symbols and numbers alone."""
    words = re.findall(r"[A-Za-z]\w*", text)
    return bool(words) and all(word in SYMBOLS for word in words)


def is_short_key(text: str) -> bool:
    """A key spoken of after its table, perhaps with a value; some are patterns."""
    name, equals, value = text.partition(" = ")
    pattern = re.compile(r"(.+\.)?" + re.escape(name).replace(r"\*", r"\w+"))
    found = [key for key in KEYS if pattern.fullmatch(key)] if re.fullmatch(r"[a-z_*.]+", name) else []
    return bool(found) and (not equals or any(takes(hint, value) for key in found for hint in KEYS[key]))


def is_option(text: str) -> bool:
    """`--option`, perhaps with a value, of some command."""
    option, _, _ = text.partition(" ")
    if option in ("-h", "--help", "--install-completion", "--show-completion"):
        return True
    return any(
        option in parameter.opts
        for program in PROGRAMS.values()
        for verb in program.commands.values()
        for parameter in [
            *verb.params,
            *(p for sub in getattr(verb, "commands", {}).values() for p in sub.params),
        ]
    )


def is_connection(text: str) -> bool:
    """As in the configuration."""
    if "://" not in text:
        return False
    try:
        parse_connection(text.strip('"'))
    except ValueError:
        return False
    return True


def is_zenoh_key(text: str) -> bool:
    """Below `guidance/<vehicle>/`, or a topic in a log; the parameter of a query, what an encoding says."""
    topic = re.sub(r"^(guidance/(<vehicle>|\*))?/", "", text)
    if text.removeprefix("application/json;") in ENCODINGS or text in ("<vehicle>", "?history=180", "_raw"):
        return True
    known = {
        *TOPICS.values(),
        "",
        "*",
        "<topic>",
        "alive",
        "tf",
        "log",
        "NAME/...",
        "vehicle/...",
        "reference/...",
    }
    return topic != text and (topic in known or bool(re.fullmatch(r"command/(\.\.\.|[a-z]+)", topic)))


@cache
def message_fields() -> frozenset[str]:
    """Of every message of MAVLink."""
    messages = (getattr(dialect, name) for name in dir(dialect) if name.startswith("MAVLink_"))
    return frozenset(name for message in messages for name in getattr(message, "ordered_fieldnames", ()))


def is_message_field(text: str) -> bool:
    return text in message_fields()


def is_component_parameter(text: str) -> bool:
    """`LAW_K`, or a pattern."""
    pattern = re.compile(re.escape(text).replace(r"\*", ".*"))
    return any(pattern.fullmatch(name) for name in PARAMETERS)


def is_known_elsewhere(text: str) -> bool:
    """A parameter that is in a firmware alone, a word of another program, an extra; what is still to come."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    listed = any(text in names for names in ELSEWHERE.values())
    return listed or text in OTHERS or text in project["optional-dependencies"]


def is_pattern_of_fields(text: str) -> bool:
    """`demanded_*`, or an element of a list: `counts[i - 1]`."""
    ends = {field.partition(".")[2] for field in FIELDS}
    if text.endswith("*"):
        return any(end.startswith(text[:-1]) for end in ends)
    return text.endswith("]") and re.sub(r"\[i( - 1)?\]$", "", text) in ends


def is_json(text: str) -> bool:
    """Its names are those of the code."""
    names = re.findall(r'"(\w+)"', text)
    return text.startswith("{") and bool(names) and all(re.search(rf"\b{name}\b", SOURCES) for name in names)


KINDS: Final[tuple[Callable[[str], bool], ...]] = (
    is_key,
    is_field,
    is_section,
    is_path,
    is_program,
    is_object,
    is_value,
    is_autopilot_word,
    is_guard,
    is_profile_column,
    is_topic_or_field_name,
    is_formula,
    is_short_key,
    is_option,
    is_word_of_the_code,
    is_connection,
    is_zenoh_key,
    is_component_parameter,
    is_message_field,
    is_known_elsewhere,
    is_json,
    is_pattern_of_fields,
    is_said,
)


def is_known(text: str) -> bool:
    """Whether some kind of word knows it."""
    return any(kind(text) for kind in KINDS)
