"""The configuration, changed while the service runs: a gain, a limit, or the trajectory.

What is refused here is what the file would be refused for, in the same words. Only numbers and switches that
the next setpoint can obey may be set: not what chooses a law, and nothing outside [law] and [limits].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any, Final

import msgspec
from msgspec.structs import replace

from guidance.checking import ConfigError, Problem, problems
from guidance.commands import Scalar
from guidance.config import Config, checked

_GAINS: Final = ("k", "rho2_per_s", "rho3_per_s", "beta")


def settings(config: Config) -> dict[str, Scalar]:
    """Every key that can be set, and its value; which there are depends on the error function alone."""
    law, limits = config.law, config.limits
    found: dict[str, Scalar] = {f"law.{name}": getattr(law, name) for name in _GAINS}
    for name in law.error_function.__struct_fields__:
        found[f"law.error_function.{name}"] = getattr(law.error_function, name)
    for name in limits.__struct_fields__:
        found[f"limits.{name}"] = getattr(limits, name)
    return found


def with_setting(config: Config, key: str, value: Scalar) -> Config:
    """With another value of one key; raises ConfigError."""
    known = settings(config)
    if key not in known:
        close = get_close_matches(key, known, n=1)
        meant = f" (did you mean {close[0]}?)" if close else ""
        raise ConfigError(f"{key[:60]}: cannot be set{meant}; {', '.join(known)} can")
    table, _, name = key.rpartition(".")
    if table == "limits":
        return checked(replace(config, limits=_section(config.limits, table, name, value)))
    if table == "law.error_function":
        chosen = _section(config.law.error_function, table, name, value)
        return checked(replace(config, law=replace(config.law, error_function=chosen)))
    return checked(replace(config, law=_section(config.law, table, name, value)))


def with_trajectory(config: Config, trajectory: Mapping[str, Scalar]) -> Config:
    """With another trajectory, given as the keys of [trajectory]; raises ConfigError."""
    data = msgspec.to_builtins(config) | {"trajectory": dict(trajectory)}
    _refuse(problems(data, Config))
    return checked(msgspec.convert(data, Config))


def _section(section: Any, table: str, name: str, value: Scalar) -> Any:
    data = msgspec.to_builtins(section) | {name: value}
    _refuse(problems(data, type(section), table))
    return msgspec.convert(data, type(section))


def _refuse(found: Iterable[Problem]) -> None:
    text = "\n".join(f"{problem.key}{problem.text}" for problem in found)
    if text:
        raise ConfigError(text)
