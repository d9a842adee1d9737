"""One profile for every property test: the same examples each run, and no verdict by the clock."""

import os
import signal

# Small matrices gain nothing by threads, and threads that spin starve the processes under test.
for library in ("OPENBLAS", "MKL", "OMP"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

# Who starts the tests in the background may leave Ctrl-C ignored, which every process they start inherits.
signal.signal(signal.SIGINT, signal.default_int_handler)

from hypothesis import settings  # noqa: E402 - the environment must stand before numpy is imported

settings.register_profile("deterministic", derandomize=True, deadline=None)
settings.load_profile("deterministic")
