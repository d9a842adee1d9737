"""Processes that share work, and end with the command that started them."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import BaseContext


@contextmanager
def workers(count: int | None = None, context: BaseContext | None = None) -> Iterator[ProcessPoolExecutor]:
    """As many as there are cores, unless `count` says how many.

    Ctrl-C, which a terminal tells all processes of a command, ends each at once: Python would hand it to the
    work in them as an exception, and they would go on with the next. What waits is given up on the way out.
    """
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_end_by_ctrl_c)
    try:
        yield pool
    finally:
        pool.shutdown(cancel_futures=True)


def _end_by_ctrl_c() -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)
