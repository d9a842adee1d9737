"""The operator's orders, drawn and given: the one place here that knows their form."""

from __future__ import annotations

import msgspec

from guidance.changing import settings
from guidance.commands import VERBS, Engage, Order, OrderError, Shutdown, read_payload, verb_of
from guidance.core import Guide
from sitl.fuzzing.dice import Dice


def engage(guide: Guide, now_ns: int) -> None:
    """The operator wants it to fly."""
    guide.command(Engage(), now_ns)


def order(guide: Guide, now_ns: int, dice: Dice) -> str:
    """Some order, most often to engage; its name. One that is none does not reach the core."""
    given: Order = Engage()
    if dice.chance(0.5):
        verb = dice.choice([*VERBS])
        try:
            given = read_payload(verb, _payload(guide, dice))
        except OrderError as error:
            return f"refused at the door: {error}"
    if isinstance(given, Shutdown) and dice.chance(0.7):
        given = Engage()
    guide.command(given, now_ns)
    return verb_of(given)


def _payload(guide: Guide, dice: Dice) -> bytes:
    """The fields of every order, or of none."""
    if dice.chance(0.1):
        return dice.json()
    fields: dict[str, object] = {}
    if dice.chance(0.3):
        fields["id"] = dice.choice(("1", "2", dice.text()))
    kind = dice.random()
    if kind < 0.4:
        known = settings(guide.config)
        key = dice.choice([*known])
        ordinary = dice.choice((known[key], dice.uniform(0.0, 10.0)))
        fields |= {"key": key, "value": ordinary if dice.chance(0.7) else dice.scalar()}
    elif kind < 0.6:
        fields["allocation"] = dice.choice(("pitch-yaw", "roll-pitch", "roll-yaw", dice.text()))
    elif kind < 0.8:
        name = dice.choice(("circle", "line", "helix", "zigzag", dice.text()))
        fields["trajectory"] = {"name": name, dice.choice(("speed_m_s", "radius_m", "x")): dice.scalar()}
    payload = msgspec.json.encode(fields)
    return dice.mutated(payload) if dice.chance(0.1) else payload
