"""Sinks: where records leave the service, to zenoh and to an MCAP log; and the log read back.

Nothing here is ever on the control path. The control thread encodes a record once, wraps the bytes in a
`Sample` and offers it to each sink; from there on every sink has a bounded queue and a thread of its own.
Import `ZenohSink`, `Recorder` and `read_log` from their modules: zenoh alone takes a while to import.
"""

from __future__ import annotations

from guidance.telemetry.queue import DropOldestQueue, Sample
from guidance.telemetry.worker import Sink

__all__ = ["DropOldestQueue", "Sample", "Sink"]
