"""A serial port: opened and set up by pyserial, read and written here.

pyserial 3.5, its last release, is made for blocking reads with time-outs; what that leaves to do here:

- it sets VMIN = 0, with which a read of nothing and a device that is gone look alike (both give no bytes);
- its lock is `flock`, which only programs respect that ask for it; TIOCEXCL keeps out all others that come
  later (except root's), and who was there before is looked up and named;
- closing a port waits up to 30 s for bytes that flow control holds back, unless they are thrown away first;
- closing lowers DTR, and opening raises it, which resets some boards: once is enough, so HUPCL is cleared.

The path is resolved at each opening: a name in /dev/serial/by-id finds the device whatever its number is.
"""

from __future__ import annotations

import errno
import fcntl
import os
import termios
from contextlib import suppress
from typing import Final

import serial

from guidance.connection import SerialLine
from guidance.transport.base import Lost, said
from guidance.transport.diagnosis import users_of, why_not_opened
from guidance.transport.hanging import in_a_thread
from guidance.transport.stream import ByteStream

#: So much of what was sent may wait in the system: it is as late as that.
WAITING_MAX_S: Final = 0.05
#: But always one packet of the largest size.
WAITING_MIN_BYTES: Final = 280
_CFLAG, _CC = 2, 6  # in what tcgetattr returns


async def open_serial(line: SerialLine) -> ByteStream:
    """Open the port, in a thread: a USB adapter that hangs answers no request for 5 s.

    Raises:
        Lost: it cannot be opened; says what to do.
    """
    return await in_a_thread(lambda: _open(line))


def _open(line: SerialLine) -> ByteStream:
    device = os.path.realpath(line.path)
    try:
        port = serial.Serial(line.path, line.baud, rtscts=line.rtscts, timeout=0, exclusive=True)
    except (OSError, ValueError, termios.error) as error:
        raise Lost(why_not_opened(line.path, error)) from None
    try:
        descriptor = port.fileno()
        attributes = termios.tcgetattr(descriptor)
        attributes[_CC][termios.VMIN] = 1
        attributes[_CFLAG] &= ~termios.HUPCL
        termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
        with suppress(OSError):
            fcntl.ioctl(descriptor, termios.TIOCEXCL)
    except (OSError, termios.error) as error:
        port.close()
        raise Lost(why_not_opened(line.path, error)) from None

    def close() -> None:
        with suppress(OSError, termios.error):
            termios.tcflush(descriptor, termios.TCOFLUSH)
        port.close()

    shown = line.path if device == line.path else f"{line.path} ({device})"
    words = f"opened {shown} at {line.baud} baud (serial)"
    others = users_of(device)
    if others:
        words += f"; {', '.join(others)} has it open too and takes bytes away: end it"
    # The driver of an autopilot's own USB reports whole buffers, not bytes, but it has only 16 of them.
    waiting_max = max(WAITING_MAX_S * line.baud / 10, WAITING_MIN_BYTES)
    if os.path.basename(device).startswith("ttyACM"):
        waiting_max = float("inf")
    return ByteStream(descriptor, words, close=close, lost=_lost, waiting_max_bytes=waiting_max)


def _lost(error: OSError | None) -> str:
    if error is None or error.errno in (errno.EIO, errno.ENXIO, errno.ENODEV):
        return "the device is gone: unplugged, or without power?"
    return said(error)
