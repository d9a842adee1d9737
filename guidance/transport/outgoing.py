"""Packets into a stream of bytes: each whole and at once, or not at all.

A stream that does not keep up would deliver setpoints later than they are meant for. So nothing is kept for
later here, and what our system keeps (a serial port's buffer holds 0.7 s at 57600 baud) is bounded: while
more than that waits, packets are dropped. What the other system keeps cannot be seen from here: over TCP it
acknowledges what a program there does not read, and hands it over later. That is bounded by the core, which
sends no setpoint while its questions are not answered (`guidance.view.STALLED_S`): what it sent until then
does arrive late.

Where our system takes a part of a packet, the rest must follow, or the receiver would lose the next packet
too; but it is late, so it follows with its last byte changed, which is part of the checksum, and the receiver
drops the packet and stays in step.
"""

from __future__ import annotations

from collections.abc import Callable


class Outgoing:
    """Decides what is written. `write` takes bytes and returns how many the system took, 0 for none now.

    `waiting` returns how many bytes the system has not sent yet, at most `waiting_max_bytes` of them may be
    there for another packet to follow.
    """

    def __init__(
        self, write: Callable[[bytes], int], waiting: Callable[[], int], waiting_max_bytes: float
    ) -> None:
        self.dropped = 0
        self._write = write
        self._waiting = waiting
        self._waiting_max_bytes = waiting_max_bytes
        self._rest = b""

    def send(self, packet: bytes) -> None:
        """Write the packet, or drop it and count it."""
        if self._rest:
            self._rest = self._rest[self._write(self._rest) :]
        if self._rest or self._waiting() > self._waiting_max_bytes:
            self.dropped += 1
            return
        taken = self._write(packet)
        if taken < len(packet):
            self.dropped += 1
            if taken:
                self._rest = packet[taken:-1] + bytes([packet[-1] ^ 0xFF])
