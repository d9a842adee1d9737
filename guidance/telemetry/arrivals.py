"""What comes in over zenoh, named for what it is: a record, something that is none, a presence, an answer.

The encoding of a payload says what it claims to be, `application/json;guidance.<Record>/<version>`. Only what
claims to be the record of its key in this version is decoded: another version may mean something else by the
same fields, and what claims nothing may be anybody's.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

import msgspec

from guidance.records import LOG_ONLY, NOT_A_RECORD, SCHEMA_VERSION, Record
from guidance.telemetry.schema import RECORDS, schema_name

#: One chunk of a key: what a service may be called.
VEHICLE: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")
#: So many of them are kept in mind; of more, those unheard for longest give way.
VEHICLES_MAX: Final = 200
#: No record comes near; a stranger's payload is not worth more memory.
LARGEST_BYTES: Final = 1 << 18

_ENCODING: Final = re.compile(r"application/json;(guidance\.[A-Za-z]{1,40})/(\d{1,6})")
_DECODERS: Final = {
    topic: msgspec.json.Decoder(record) for topic, record in RECORDS.items() if topic not in LOG_ONLY
}


class Heard(NamedTuple):
    """A record of `vehicle`; `answered` marks one that came in answer to a query and may be old."""

    arrived_ns: int
    vehicle: str
    topic: str
    record: Record
    answered: bool = False


class Ignored(NamedTuple):
    """Something on the keys that is no record of this version: `what` it is, and what is wrong with it.

    `version` is the schema version that it claims, if it claims another one.
    """

    arrived_ns: int
    vehicle: str
    what: str
    detail: str = ""
    version: int | None = None


class Presence(NamedTuple):
    """The liveliness token of `vehicle` appeared (`here`) or was withdrawn."""

    arrived_ns: int
    vehicle: str
    here: bool


class History(NamedTuple):
    """The last minutes of `vehicle`, as its service kept them: in the order of their instants, thinned out.

    It is empty if nobody answered.
    """

    arrived_ns: int
    vehicle: str
    records: tuple[Record, ...]


class Answered(NamedTuple):
    """What became of an order by its `id`; `accepted` is None if nobody answered, `reason` says where."""

    arrived_ns: int
    vehicle: str
    verb: str
    id: str
    accepted: bool | None
    reason: str


Arrival = Heard | Ignored | Presence | History | Answered


def vehicle_of(key: str) -> str:
    """The vehicle's chunk of `guidance/<vehicle>/...`."""
    return key.split("/", 2)[1]


def read(arrived_ns: int, key: str, encoding: str, payload: bytes, answered: bool = False) -> Heard | Ignored:
    """What a payload under `guidance/<vehicle>/<topic>` is, by its `encoding`; never raises."""
    _, vehicle, topic = key.split("/", 2)
    if VEHICLE.fullmatch(vehicle) is None:
        return Ignored(arrived_ns, vehicle, "no name of a vehicle")
    claim = _ENCODING.fullmatch(encoding)
    if claim is None:
        return Ignored(arrived_ns, vehicle, "no schema of ours", f"{topic}: {encoding[:80]}")
    name, version = claim[1], int(claim[2])
    if version != SCHEMA_VERSION:
        return Ignored(arrived_ns, vehicle, f"schema version {version}", f"{topic}: {name}", version)
    decoder = _DECODERS.get(topic)
    if decoder is None or name != schema_name(topic):
        return Ignored(arrived_ns, vehicle, "foreign key", f"{name} under {topic}")
    if len(payload) > LARGEST_BYTES:
        return Ignored(arrived_ns, vehicle, "garbage", f"{topic}: {len(payload)} bytes")
    try:
        return Heard(arrived_ns, vehicle, topic, decoder.decode(payload), answered)
    except NOT_A_RECORD as error:
        return Ignored(arrived_ns, vehicle, "garbage", f"{topic}: {error}")
