"""Words that came from elsewhere, made fit for one line of a terminal, a journal or a service manager."""

from __future__ import annotations


def printable(text: str) -> str:
    """One line without control characters: what an autopilot or the network says steers no terminal."""
    return "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in " ".join(text.split()))
