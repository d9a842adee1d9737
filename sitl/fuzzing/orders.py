"""The operator's orders, drawn and given: the one place here that knows their form."""

from __future__ import annotations

from guidance.core import Guide
from guidance.records import Command
from sitl.fuzzing.dice import Dice


def engage(guide: Guide, now_ns: int) -> None:
    """The operator wants it to fly."""
    guide.command(Command.ENGAGE, now_ns)


def order(guide: Guide, now_ns: int, dice: Dice) -> str:
    """Some order, most often to engage; its name."""
    command = Command.ENGAGE if dice.chance(0.7) else dice.choice([*Command])
    guide.command(command, now_ns)
    return command
