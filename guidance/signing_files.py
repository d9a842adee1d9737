"""The two files of a signed link: the key, which only we may read, and the clock, which outlives the process.

The clock is written once a second (`kept_file`): what a kill -9 loses of it is a second.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec

from guidance.checking import shown
from guidance.config import Config, ConfigError
from guidance.kept_file import KeptFile, said
from guidance.mavlink.signing import KEY_BYTES, TICK_NS, TIMESTAMP_MAX, Signing, SigningClock, wall_timestamp

#: Where the wall clock does not say more, this much is added to the kept timestamp: what may not have been
#: written any more. Less than the minute that a peer allows.
RESERVE: Final = 10 * 1_000_000_000 // TICK_NS
#: A wall clock that is so far ahead of ours was set meanwhile.
SET_ANEW: Final = 5 * 1_000_000_000 // TICK_NS

_HEX: Final = 2 * KEY_BYTES


def read_key(path: Path, environ: Mapping[str, str] = os.environ) -> bytes:
    """The 32 bytes of a key file; raises ConfigError if it is none, or is not kept to ourselves.

    A file below systemd's credentials directory is guarded by systemd, by an access control list that shows
    as permissions of the group.
    """
    where = f"link.signing_key_file = {shown(str(path))}"
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        said = error.strerror if isinstance(error, OSError) else str(error)
        raise ConfigError(f"{where}: cannot be read: {said}") from None
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise ConfigError(f"{where}: must be a regular file")
        if status.st_uid not in (os.geteuid(), 0):
            raise ConfigError(
                f"{where}: belongs to user {status.st_uid}: must belong to the service's user or to root: "
                f"chown {os.geteuid()} {path}"
            )
        others = stat.S_IRWXO if _is_credential(path, environ) else stat.S_IRWXG | stat.S_IRWXO
        if status.st_mode & others:
            mode = stat.S_IMODE(status.st_mode)
            raise ConfigError(
                f"{where}: others may read or write it (mode {mode:o}): chmod 600 {path}, and if others may "
                "have read it, make another key"
            )
        content = os.read(descriptor, 4 * KEY_BYTES)
    finally:
        os.close(descriptor)
    key = content if len(content) == KEY_BYTES else _unhex(content)
    if key is None:
        raise ConfigError(
            f"{where}: must hold {KEY_BYTES} bytes or {_HEX} hex digits, and holds neither: "
            f"openssl rand -hex {KEY_BYTES}"
        )
    if not any(key):
        raise ConfigError(f"{where}: a key of zeros means no signing: openssl rand -hex {KEY_BYTES}")
    return key


def _unhex(content: bytes) -> bytes | None:
    text = content.strip()
    if len(text) != _HEX:
        return None
    try:
        return bytes.fromhex(text.decode("ascii"))
    except ValueError:
        return None


def _is_credential(path: Path, environ: Mapping[str, str]) -> bool:
    directory = environ.get("CREDENTIALS_DIRECTORY")
    return bool(directory) and path.resolve().is_relative_to(Path(str(directory)).resolve())


def clock_path(vehicle: str, environ: Mapping[str, str] = os.environ) -> Path:
    """Where the clock is kept: in systemd's state directory, or in the user's."""
    state = environ.get("STATE_DIRECTORY", "").partition(":")[0]
    if state:
        return Path(state) / f"signing-{vehicle}.json"
    user = environ.get("XDG_STATE_HOME", "")
    base = Path(user) if os.path.isabs(user) else Path("~/.local/state").expanduser()
    return base / "guidance" / f"signing-{vehicle}.json"


class ClockKeeper:
    """Keeps a link's signing clock in a file. `problem` says what is wrong with that, empty if nothing is."""

    def __init__(self, signing: Signing, path: Path) -> None:
        self.signing = signing
        self._file = KeptFile(path)
        self._unread = ""

    @property
    def problem(self) -> str:
        """As the class says."""
        if self._file.problem:
            return f"{self._file.problem}; older packets may be believed after a restart"
        return "" if self._file.kept is not None else self._unread

    def begin(self, unix_ns: int) -> SigningClock:
        """The clock to start with, by the wall clock and the file; later than all that was ever signed."""
        wall = wall_timestamp(unix_ns)
        try:
            content = self._file.read()
            if content is None:
                return SigningClock(wall)
            kept = msgspec.json.decode(content, type=SigningClock)
            if not all(0 <= t <= TIMESTAMP_MAX for t in (kept.timestamp, *(s[3] for s in kept.streams))):
                raise ValueError("a timestamp is out of range")
        except (OSError, ValueError) as error:
            self._unread = f"{self._file.path} cannot be used: {said(error)}; older packets may be believed"
            return SigningClock(wall)
        if kept.timestamp < wall:
            return SigningClock(wall, kept.streams)
        return SigningClock(min(kept.timestamp + RESERVE, TIMESTAMP_MAX), kept.streams)

    def set_anew(self, unix_ns: int) -> SigningClock | None:
        """The clock to go on with if the wall clock was set forward, as by GPS or NTP after the start."""
        wall = wall_timestamp(unix_ns)
        return SigningClock(wall) if wall > self.signing.clock.timestamp + SET_ANEW else None

    def keep(self) -> None:
        """Have the clock written, unless the last time is not over yet; returns at once."""
        self._file.keep(msgspec.json.encode(self.signing.clock))

    def close(self, timeout_s: float) -> None:
        """Keep the last of it, if that is possible within so long."""
        self._file.close(msgspec.json.encode(self.signing.clock), timeout_s)


def open_signing(config: Config, environ: Mapping[str, str] = os.environ) -> ClockKeeper | None:
    """The key and the kept clock of a configuration, None if it has no key; raises ConfigError."""
    if not config.link.signing_key_file:
        return None
    key = read_key(Path(config.link.signing_key_file), environ)
    return ClockKeeper(Signing(key, config.link.signing_link_id), clock_path(config.vehicle.name, environ))
