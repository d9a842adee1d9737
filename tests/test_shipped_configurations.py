"""The shipped configurations: each key is documented in the code's own words, and each of them flies."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final, NamedTuple, get_args, get_type_hints

import msgspec
import pytest

from guidance.checking import allowed, one_of
from guidance.config import Config, LawConfig, load, parse
from guidance.mavlink.profiles import PROFILES, Handling
from guidance.records import TrackingError
from guidance.supervisor import State
from guidance.trajectory import TRAJECTORIES
from guidance.tuning import ErrorFunction
from sitl.lockstep import Lockstep
from tests.helpers import DEMO, fly_until, fly_until_tracking, make_flight, records_of
from tests.pilot import Pilot

DEPLOY: Final = Path(__file__).parents[1] / "deploy"
EXAMPLES: Final = sorted(DEPLOY.glob("*.toml"))
EACH: Final = pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
#: How a unit at the end of a key is written in its comment.
UNITS: Final = {
    "_m": "m",
    "_s": "s",
    "_hz": "Hz",
    "_m_s": "m/s",
    "_rad_s": "rad/s",
    "_m_s2": "m/s^2",
    "_rad_s2": "rad/s^2",
    "_per_s": "1/s",
    "_deg": "degrees",
    "_mb": "MB",
    "_min": "min",
}


#: The tables whose `name` says which keys the others are.
CHOICES: Final[dict[str, dict[str, type[msgspec.Struct]]]] = {
    "trajectory": dict(TRAJECTORIES),
    "law.error_function": {str(kind.__struct_config__.tag): kind for kind in get_args(ErrorFunction)},
}
ABSENT: Final = re.compile(r"Absent: .+\.$")
#: The table of a class of vehicles is in the examples of that class only.
CLASS_OF: Final = {
    "ground": Handling.GROUND,
    "airplane": Handling.AIRPLANE,
    "copter": Handling.VELOCITY,
    "excitation": None,  # what no file may say
}


class Key(NamedTuple):
    """A key as an example shows it: its comment, whether it is set, and the value shown."""

    comment: str
    active: bool
    literal: str

    @property
    def value(self) -> Any:
        """The value shown."""
        return value_of(self.literal)


def keys_in(path: Path) -> dict[str, Key]:
    """Dotted key -> how the file shows it; the keys of a choice are `trajectory.NAME.KEY`.

    A header may be a comment too, and then everything in its table must be.
    """
    shown: dict[str, Key] = {}
    table = header_of_part = ""
    commented = False
    comment: list[str] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        key = re.fullmatch(r"(# )?([a-z_0-9]+) = (.+)", line)
        if header := re.fullmatch(r"(# )?\[([a-z_.]+)\]", line):
            table = header_of_part = header[2]
            commented, comment = bool(header[1]), []
        elif part := re.fullmatch(r"# --- ([a-z-]+) ---", line):
            table, comment = f"{header_of_part}.{part[1]}", []
        elif key:
            assert f"{table}.{key[2]}" not in shown
            assert key[1] or not commented, f"{key[2]} stands in another table than [{table}]"
            shown[f"{table}.{key[2]}"] = Key(" ".join(comment), not key[1], key[3])
            comment = []
        elif line.startswith("#"):
            comment.append(line[1:].strip())
        else:
            assert not line, line
            comment = []
    return shown


def value_of(literal: str) -> Any:
    """What TOML makes of a literal."""
    return tomllib.loads(f"value = {literal}")["value"]


def unit_of(dotted: str) -> str:
    """The unit at the end of a key's name."""
    return next((UNITS[end] for end in sorted(UNITS, key=len, reverse=True) if dotted.endswith(end)), "")


def fields(kind: type[msgspec.Struct], above: str) -> Iterator[tuple[str, Any, Any]]:
    """Dotted key, field and type of each value in a table."""
    hints = get_type_hints(kind, include_extras=True)
    for field in msgspec.structs.fields(kind):
        yield f"{above}.{field.name}", field, hints[field.name]


def every_key(path: Path) -> list[tuple[str, Any, Any]]:
    """Of the whole configuration for a class of vehicles, with all trajectories and error functions."""
    found = []
    handling = PROFILES[path.stem].handling
    for table in msgspec.structs.fields(Config):
        if table.name != "trajectory" and CLASS_OF.get(table.name, handling) is handling:
            found += [row for row in fields(table.type, table.name) if row[0] != "law.error_function"]
    for choice, kinds in CHOICES.items():
        for name, kind in kinds.items():
            found += list(fields(kind, f"{choice}.{name}"))
    return found


def chosen_in(shown: dict[str, Key], dotted: str) -> bool:
    """Whether a key belongs to what is chosen: always, but for the keys of the other choices."""
    choice = next((choice for choice in CHOICES if dotted.startswith(f"{choice}.")), None)
    return choice is None or dotted.split(".")[-2] in (choice.split(".")[-1], shown[f"{choice}.name"].value)


def test_there_is_an_example_for_every_profile() -> None:
    assert [path.stem for path in EXAMPLES] == sorted(PROFILES)


@EACH
def test_every_key_is_shown_with_unit_range_and_default(path: Path) -> None:
    shown = keys_in(path)
    expected = every_key(path)
    assert set(shown) == {key for key, _, _ in expected} | {f"{choice}.name" for choice in CHOICES}
    for dotted, field, hint in expected:
        key = shown[dotted]
        words = allowed(hint)
        assert allowed_value(key.value, hint), dotted
        assert f"{words[0].upper()}{words[1:]}. " in key.comment, f"{dotted}: the comment lacks: {words}"
        unit = unit_of(dotted)
        assert re.search(rf"(?<!\w){re.escape(unit)}(?!\w)", key.comment), f"{dotted}: the unit {unit}?"
        if field.required:
            assert key.active or not chosen_in(shown, dotted), f"{dotted} is required"
            assert key.comment.endswith("Required."), dotted
        elif field.default is None:
            assert ABSENT.search(key.comment), dotted
        else:
            default = msgspec.to_builtins(field.default)
            literal = re.search(r"Default (.+)\.$", key.comment)
            assert literal, f"{dotted}: the comment lacks its default"
            assert value_of(literal[1]) == _toml(default), dotted
            assert key.active or key.value == _toml(default), dotted


def allowed_value(value: Any, hint: Any) -> bool:
    """Whether the configuration takes it."""
    try:
        msgspec.convert(value, hint)
    except msgspec.ValidationError:
        return False
    return True


def _toml(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


@EACH
def test_names_that_only_the_profile_knows_are_listed(path: Path) -> None:
    shown = keys_in(path)
    profile = PROFILES[shown["vehicle.profile"].value]
    assert profile.name == path.stem
    for name in PROFILES:
        assert f'"{name}"' in shown["vehicle.profile"].comment
    for mode in profile.modes:
        listed = f'"{mode.name}"' in shown["supervisor.exit_mode"].comment
        assert listed is (mode != profile.control_mode), mode.name
    for choice, kinds in CHOICES.items():
        assert one_of(kinds) in shown[f"{choice}.name"].comment
    assert shown["trajectory.name"].comment.endswith("Required.")
    paper = next(f.default for f in msgspec.structs.fields(LawConfig) if f.name == "error_function")
    assert shown["law.error_function.name"].comment.endswith(f'Default "{paper.__struct_config__.tag}".')


@EACH
def test_uncommenting_every_default_changes_nothing(path: Path) -> None:
    config = load(path)
    shown = keys_in(path)
    chosen = str(config.trajectory.__struct_config__.tag)
    settings = [
        f"{dotted.replace(f'.{chosen}.', '.')}={key.literal}"
        for dotted, key in shown.items()
        if not key.active and chosen_in(shown, dotted) and not ABSENT.search(key.comment)
    ]
    assert ('law.error_function.name="quadratic"' in settings) is not shown["law.error_function.name"].active
    assert len(settings) > 10
    assert load(path, settings) == config


@EACH
def test_what_has_no_default_can_be_uncommented_as_it_stands(path: Path) -> None:
    absent = {dotted: key for dotted, key in keys_in(path).items() if ABSENT.search(key.comment)}
    assert len(absent) >= 11
    config = load(path, [f"{dotted}={key.literal}" for dotted, key in absent.items()])
    for dotted, key in absent.items():
        table, name = dotted.split(".")
        assert getattr(getattr(config, table), name) == key.value


def uncommented(part: str) -> str:
    """With its keys taken out of comments."""
    return re.sub(r"(?m)^# (?=[a-z_]+ = )", "", part)


@EACH
@pytest.mark.parametrize("name", CHOICES["law.error_function"])
def test_each_error_function_can_be_uncommented_as_it_stands(path: Path, name: str) -> None:
    text = path.read_text(encoding="utf-8")
    section = re.search(r"(?ms)^(# )?\[law\.error_function\]\n.+?(?=^# What may be asked)", text)
    assert section
    before, after = text[: section.start()], text[section.end() :]
    head, *parts = re.split(r"(?m)^# --- ([a-z-]+) ---\n", section[0])
    head = re.sub(r"(?m)^(# )?name = .+$", f'name = "{name}"', head).replace("# [law", "[law")
    keys = [
        part if title == name else re.sub(r"(?m)^(?=[a-z_]+ = )", "# ", part)
        for title, part in zip(parts[::2], (uncommented(part) for part in parts[1::2]), strict=True)
    ]
    config = parse("".join((before, head, *keys, after)), str(path))
    assert type(config.law.error_function) is CHOICES["law.error_function"][name]
    assert config == msgspec.structs.replace(
        load(path), law=msgspec.structs.replace(load(path).law, error_function=config.law.error_function)
    )


#: The vehicle that a configuration is for, and how well it is flown without noise: below the first for good,
#: within the second at the end (m).
FLOWN: Final = {
    "px4-uuv": ("ideal", 0.1, 0.01),
    "ardupilot-rover": ("rover", 0.1, 0.02),
    "px4-plane": ("airplane_12", 3.0, 0.3),
    "ardupilot-plane": ("airplane_20", 3.0, 0.3),
    "px4-copter": ("copter_px4", 0.5, 0.05),
    "ardupilot-copter": ("copter_ardupilot", 0.5, 0.05),
    "px4-rover": ("rover_px4", 0.1, 0.02),
}

#: How the firmware calls the mode in which its vehicle waits in the air.
LOITERING: Final = {
    "px4-plane": "AUTO.LOITER",
    "ardupilot-plane": "LOITER",
    "px4-copter": "AUTO.LOITER",
    "ardupilot-copter": "LOITER",
}


def vehicle_flight(path: Path, config: Config, **options: Any) -> Lockstep:
    if path.stem in LOITERING:  # it is taken over in the air; what is not armed there falls
        options["initial_position_ned_m"] = (0.0, 0.0, -200.0)
        options |= {"initially_armed": True, "initial_mode": LOITERING[path.stem]}
    return make_flight(config=config, model=FLOWN[path.stem][0], **options)


def converges(path: Path, flight: Lockstep, seconds: float) -> None:
    """As `FLOWN` says."""
    _, arrived_m, within_m = FLOWN[path.stem]
    flight.run(seconds)
    errors = records_of(flight, TrackingError)
    outside = [error.t_ns for error in errors if error.norm_m >= arrived_m]
    assert outside[-1] < flight.now_ns - 10e9
    assert max(error.norm_m for error in errors[-200:]) < within_m


@EACH
def test_it_flies_as_it_is_shipped(path: Path) -> None:
    config = load(path)
    assert (config.supervisor.engage, config.supervisor.arm) == ("pilot", False)
    airborne = path.stem in LOITERING
    flight = vehicle_flight(path, config)
    pilot = Pilot(flight)
    fly_until(flight, State.READY, 3.0)
    flight.run(5.0)
    assert flight.vehicle.armed is airborne
    pilot.switch("control")
    if not airborne:
        fly_until(flight, State.ARMING, 1.0)
        pilot.arm()
    fly_until_tracking(flight, 1.1)
    converges(path, flight, 30.0)


def unattended(path: Path, **options: Any) -> Lockstep:
    """In control, without a pilot; but nobody takes over what flies, unless the pilot says so."""
    airborne = path.stem in LOITERING
    config = load(path, [] if airborne else ["supervisor.engage=auto", "supervisor.arm=true"])
    flight = vehicle_flight(path, config, **options)
    if airborne:
        fly_until(flight, State.READY, 3.0)
        flight.run(1.0)  # PX4 wants the stream first
        Pilot(flight).switch("control")
    fly_until_tracking(flight)
    return flight


@EACH
def test_it_flies_unattended(path: Path) -> None:
    converges(path, unattended(path), 30.0)


@EACH
@pytest.mark.parametrize("yaw_deg", [-90.0, 90.0, 180.0])
def test_it_arrives_whichever_way_it_faces(path: Path, yaw_deg: float) -> None:
    converges(path, unattended(path, initial_yaw_rad=math.radians(yaw_deg)), 40.0)


def test_the_demo_flies() -> None:
    flight = make_flight(config=load(DEMO))
    fly_until_tracking(flight)
    flight.run(25.0)
    errors = [error.norm_m for error in records_of(flight, TrackingError)]
    assert max(errors[-500:]) < 0.1
    assert max(errors[-200:]) < 0.01
