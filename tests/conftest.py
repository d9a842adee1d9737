"""One profile for every property test: the same examples each run, and no verdict by the clock."""

from hypothesis import settings

settings.register_profile("deterministic", derandomize=True, deadline=None)
settings.load_profile("deterministic")
