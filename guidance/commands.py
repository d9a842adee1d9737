"""What an operator can order, as JSON: one tagged union for signals, zenoh and MAVLink alike.

An order enters the core as the text of an input (`InputKind.COMMAND`), so that a replay obeys it again. It is
checked for its form here; whether it is obeyed is decided by `guidance.orders` alone.

`id` is chosen by who orders: the same id twice is answered the same and does nothing twice. `source` says who
it was.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal, get_args

import msgspec
from msgspec import Meta

#: What a TOML key can hold and JSON can say; lists are for no key that can be set.
Scalar = bool | int | float | str | None
Allocation = Literal["pitch-yaw", "roll-pitch", "roll-yaw"]
Short = Annotated[str, Meta(max_length=100)]

#: An order is a line, not a file.
PAYLOAD_BYTES_MAX: Final = 4096


class _Order(
    msgspec.Struct,
    frozen=True,
    kw_only=True,
    forbid_unknown_fields=True,
    omit_defaults=True,
    tag_field="order",
):
    id: Short = ""
    source: Short = ""


class Engage(_Order, frozen=True, kw_only=True, tag="engage"):
    """Take control, or take it anew after a hand-over."""


class Hold(_Order, frozen=True, kw_only=True, tag="hold"):
    """Stop on the way and stay there, by the autopilot's own mode (`supervisor.hold_mode`)."""


class Resume(_Order, frozen=True, kw_only=True, tag="resume"):
    """Go on after a hold."""


class Abort(_Order, frozen=True, kw_only=True, tag="abort"):
    """Give control back by the configured action."""


class Shutdown(_Order, frozen=True, kw_only=True, tag="shutdown"):
    """End the service; a vehicle under control is put into the exit mode first."""


class Allocate(_Order, frozen=True, kw_only=True, tag="allocate"):
    """An actuator failed, or works again: turn by these rates from now on."""

    allocation: Allocation


class LoadTrajectory(_Order, frozen=True, kw_only=True, tag="load"):
    """Fly this one next: the keys of [trajectory] in the configuration."""

    trajectory: dict[str, Scalar]


class Set(_Order, frozen=True, kw_only=True, tag="set"):
    """Give a gain or a limit, by its dotted key in the configuration, another value."""

    key: Short
    value: Scalar


Order = Engage | Hold | Resume | Abort | Shutdown | Allocate | LoadTrajectory | Set

#: Order by order, as its tag and the last part of its zenoh key.
VERBS: Final[dict[str, type[Order]]] = {str(kind.__struct_config__.tag): kind for kind in get_args(Order)}

_encode: Final = msgspec.json.Encoder().encode
_decoder: Final[msgspec.json.Decoder[Order]] = msgspec.json.Decoder(Order)
_table: Final = msgspec.json.Decoder(dict[str, msgspec.Raw])


class OrderError(ValueError):
    """This is no order; the text says why."""


def verb_of(order: Order) -> str:
    """Its tag, such as `engage`."""
    return str(order.__struct_config__.tag)


def text_of(order: Order) -> str:
    """As the core takes it."""
    return _encode(order).decode()


def read(text: str | bytes) -> Order:
    """An order from its text; raises OrderError."""
    try:
        return _decoder.decode(text)
    except (ValueError, RecursionError) as error:  # msgspec's own are ValueErrors
        raise OrderError(f"not an order: {error}") from None


def read_payload(verb: str, payload: bytes) -> Order:
    """An order from its verb and the JSON of its fields, which may be empty; raises OrderError."""
    if verb not in VERBS:
        raise OrderError(f"there is no order {verb[:40]!r}; there are {', '.join(VERBS)}")
    if len(payload) > PAYLOAD_BYTES_MAX:
        raise OrderError(f"{len(payload)} bytes: an order has at most {PAYLOAD_BYTES_MAX}")
    try:
        fields = _table.decode(payload or b"{}")
    except (ValueError, RecursionError) as error:
        raise OrderError(f"the payload must be a JSON object: {error}") from None
    if "order" in fields:
        raise OrderError("the payload must not name the order; the key does")
    return read(_encode({"order": verb, **fields}))
