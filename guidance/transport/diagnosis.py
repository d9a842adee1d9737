"""Why a port cannot be opened, and what to do: missing, not allowed, busy, or no serial port at all."""

from __future__ import annotations

import errno
import glob
import grp
import os
import pwd
import stat
from typing import Final

from guidance.transport.processes import Processes

#: Where serial ports of autopilots are found, the lasting names first.
_PORTS: Final = ("/dev/serial/by-id/*", "/dev/ttyACM*", "/dev/ttyUSB*")
_SHOWN_MAX: Final = 4
#: What every group looks like that a user namespace does not know (kernel.overflowgid, nogroup).
UNMAPPED: Final = 65534
_READ_WRITE_GROUP: Final = stat.S_IRGRP | stat.S_IWGRP


def why_not_opened(path: str, error: Exception) -> str:
    """What an `error` at opening a serial port means."""
    number = _number(error)
    if number == errno.ENOENT:
        return f"there is no such device: is it plugged in and powered? {_present()}"
    if number == errno.ELOOP:
        return "its symbolic links lead in a circle"
    if number == errno.EPERM:  # of device nodes only the kernel's list of devices refuses with this one
        device = os.path.realpath(path)
        return (
            f"not allowed by the systemd unit or the container (DevicePolicy=): DeviceAllow= of the unit "
            f"must name it: sudo systemctl edit guidance@NAME, [Service] DeviceAllow={device} rw"
        )
    if number == errno.EACCES:
        return not_allowed(path)
    if number in (errno.EBUSY, errno.EAGAIN):
        users = users_of(os.path.realpath(path))
        who = ", ".join(users) or "another program (to see which: sudo fuser -v PORT)"
        return f"it is in use by {who}: end that program, or give the port to this one only"
    if number in (errno.ENOTTY, errno.EISDIR, errno.ENOTDIR):
        return "this is not a serial port"
    if number in (errno.EIO, errno.ENXIO, errno.ENODEV):
        return f"the device does not answer ({os.strerror(number)}): unplug it and plug it in again"
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error)


def not_allowed(path: str) -> str:
    """Which group has the port, or who else, and how to let this service in."""
    try:
        found = os.stat(path)
    except OSError as error:
        return f"not allowed, not even to look at it: {error.strerror}"
    if found.st_gid == UNMAPPED:
        return (
            "not allowed, and the unit hides which group may (PrivateUsers=): look outside the unit: "
            f"ls -l {path}, then sudo systemctl edit guidance@NAME, [Service] SupplementaryGroups=GROUP"
        )
    group = _name(found.st_gid, groups=True)
    owner = f"{_name(found.st_uid)}:{group}, mode {stat.S_IMODE(found.st_mode):04o}"
    if found.st_mode & _READ_WRITE_GROUP == _READ_WRITE_GROUP and found.st_gid != 0:
        return (
            f"not allowed ({owner}): sudo usermod -aG {group} {_name(os.geteuid())}, then log in anew "
            f"(for a systemd unit: SupplementaryGroups={group})"
        )
    port = os.path.basename(os.path.realpath(path))
    return (
        f"not allowed ({owner}): if a login console has it, sudo systemctl disable --now "
        f'serial-getty@{port}.service; else a udev rule: KERNEL=="{port}", GROUP="dialout", MODE="0660"'
    )


def users_of(device: str) -> list[str]:
    """The other programs that have `device` open, as far as this user may see: "name (pid N)"."""
    return [str(process) for process in Processes().holding(device)]


def users_of_udp_port(port: int) -> list[str]:
    """The programs that have a UDP port, as far as this user may see."""
    return [str(process) for process in Processes().on_udp_port(port)]


def _number(error: Exception) -> int | None:
    """The errno, which pyserial keeps for some errors only, and which termios gives as first argument."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    cause = error.__context__ if isinstance(error, OSError) else error
    first = cause.args[0] if cause is not None and cause.args else None
    return first if isinstance(first, int) else None


def _present() -> str:
    ports = [port for pattern in _PORTS for port in sorted(glob.glob(pattern))]
    return f"present: {', '.join(ports[:_SHOWN_MAX]) or 'no USB serial port'}"


def _name(number: int, *, groups: bool = False) -> str:
    try:
        return grp.getgrgid(number).gr_name if groups else pwd.getpwuid(number).pw_name
    except KeyError:
        return str(number)
