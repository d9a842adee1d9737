"""A zenoh router as a process that may be killed: it says "heard" when a record comes through it."""

from __future__ import annotations

import json
import sys
import threading

import zenoh


def main(endpoint: str) -> None:
    """Route at `endpoint` until killed."""
    config = zenoh.Config()
    config.insert_json5("mode", '"router"')
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    heard = threading.Event()
    with zenoh.open(config) as session:
        session.declare_subscriber("guidance/*/*", lambda _: heard.set())
        heard.wait()
        sys.stdout.write("heard\n")
        sys.stdout.flush()
        threading.Event().wait()


if __name__ == "__main__":
    main(sys.argv[1])
