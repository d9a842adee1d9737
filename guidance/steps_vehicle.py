"""What the autopilot tells of its vehicle before a tuning flight is planned; it moves nothing."""

from __future__ import annotations

from guidance.config import Config, ConfigError
from guidance.mavlink.requirements import values_of
from guidance.preflight.run import observed


def told_by_autopilot(config: Config, wait_s: float) -> dict[str, float]:
    """The autopilot's parameters by their newest names, in its units, those that came within `wait_s`.

    Raises:
        ConfigError: the line is not open, no autopilot was heard on it, or the key of a signed link cannot be
            used.
    """
    observation, refused = observed(config, wait_s, lambda seen: seen.parameters.complete)
    if refused:
        raise ConfigError(f"link.connection = {config.link.connection}: {refused}")
    if observation.absent_because:
        raise ConfigError(f"{observation.absent_because}; the steps are planned by what it tells of itself")
    return values_of(observation.profile.requirements, observation.parameters.values)
