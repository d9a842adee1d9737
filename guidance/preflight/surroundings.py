"""What is looked at beside the link: who else has the port, the disk of the log, and zenoh."""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Final, NamedTuple

import zenoh

from guidance.config import Config, Log
from guidance.connection import Connection, SerialLine
from guidance.telemetry.zenoh_sink import brief, close_quietly, zenoh_config
from guidance.transport.processes import Process, Processes

#: Looks at every new /dev/ttyACM* by writing modem commands to it.
_MODEM_MANAGER: Final = "ModemManager"
#: By which keys of its configuration zenoh lets not everybody in.
_RESTRICTING: Final = ("access_control/enabled", "transport/link/tls/enable_mtls")
_ALIVE_S: Final = 0.5
_LOOK_S: Final = 0.05


class PortLook(NamedTuple):
    """Who has the port, and who may take it."""

    holders: tuple[Process, ...] = ()
    modem_manager: Process | None = None
    device: str = ""


def look_at_port(connection: Connection, processes: Processes, root: Path = Path("/")) -> PortLook:
    """Who has the serial device or the UDP port, as far as this user may see."""
    if isinstance(connection, SerialLine):
        path = root / connection.path.lstrip("/")
        device = "/" + os.path.relpath(os.path.realpath(path), root)
        managers = processes.named(_MODEM_MANAGER) if device.startswith("/dev/ttyACM") else []
        return PortLook(tuple(processes.holding(device)), next(iter(managers), None), device)
    if connection.scheme == "udpin" and connection.port:
        return PortLook(tuple(processes.on_udp_port(connection.port)))
    return PortLook()


class DiskLook(NamedTuple):
    """The log's directory: why nothing can be written there, or how much can."""

    directory: Path
    problem: str
    free_bytes: int


def look_at_disk(log: Log) -> DiskLook:
    """Try to write; a directory that the service would create is not created."""
    directory = Path(log.directory).absolute()
    there = directory
    try:
        there = next(folder for folder in (directory, *directory.parents) if folder.exists())
        if not there.is_dir():
            return DiskLook(directory, f"{there} is not a directory", 0)
        if there != directory and not os.access(there, os.W_OK | os.X_OK):
            return DiskLook(directory, f"{there} may not be written to", 0)
        if there == directory:
            with tempfile.TemporaryFile(dir=there) as file:
                file.write(b"\0")
        return DiskLook(directory, "", shutil.disk_usage(there).free)
    except OSError as error:
        return DiskLook(directory, f"{there}: {error.strerror}", 0)


class ZenohLook(NamedTuple):
    """`neighbours` are the routers and peers that were reached; `service`: a service of this name answers.

    `restricted`: zenoh's own configuration has access control, or asks for certificates.
    """

    problem: str = ""
    neighbours: int = 0
    service: bool = False
    restricted: bool = False


class ZenohProbe:
    """Opens a session as the service would, in a thread of its own: zenoh may take as long as it likes.

    It looks for neighbours for at most `seconds`.

    Raises:
        ValueError: settings that zenoh does not take.
    """

    def __init__(self, config: Config, seconds: float) -> None:
        self._seconds = seconds
        settings = config.zenoh
        self._config = zenoh_config(
            mode=settings.mode,
            connect=settings.connect,
            listen=settings.listen,
            multicast_scouting=settings.multicast_scouting,
            config_file=Path(settings.config_file) if settings.config_file else None,
        )
        self._expected = bool(settings.connect or settings.multicast_scouting or settings.config_file)
        self._restricted = any(self._config.get_json(key) == "true" for key in _RESTRICTING)
        self._token = f"guidance/{config.vehicle.name}/alive"
        self._look = ZenohLook("no session was opened in time")
        self._enough = threading.Event()
        self.done = threading.Event()
        self._thread = threading.Thread(target=self._run, name="zenoh-probe", daemon=True)

    @property
    def look(self) -> ZenohLook:
        """What is known by now."""
        return self._look._replace(restricted=self._restricted)

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def end(self, timeout_s: float) -> bool:
        """Enough; False if a call of zenoh's does not come back in time."""
        self._enough.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            session = zenoh.open(self._config)
        except zenoh.ZError as error:
            self._look = ZenohLook(f"no session can be opened: {brief(error)}".splitlines()[0])
            self.done.set()
            return
        try:
            self._wait_for_neighbours(session)
        except zenoh.ZError as error:
            self._look = ZenohLook(f"the session failed: {brief(error)}".splitlines()[0])
        self.done.set()
        close_quietly(session)

    def _wait_for_neighbours(self, session: zenoh.Session) -> None:
        self._look = ZenohLook()
        end = time.monotonic() + self._seconds
        while self._expected and not self._enough.is_set() and time.monotonic() < end:
            neighbours = len(session.info.routers_zid()) + len(session.info.peers_zid())
            if neighbours:
                answers = list(session.liveliness().get(self._token, timeout=_ALIVE_S))
                service = any(answer.ok is not None for answer in answers)
                self._look = ZenohLook("", neighbours, service)
                return
            time.sleep(_LOOK_S)
