"""What travels between the layers and out: inputs of the core, and the records it emits.

Every record is immutable, carries `t_ns`, the companion's monotonic clock in ns at the instant that it
holds for, and is published unchanged as JSON: to zenoh under `guidance/<vehicle>/<topic>` and to the MCAP
log under `/<topic>`. World frame NED, body frame FRD. `SCHEMA_VERSION` is raised whenever a field changes
its meaning or leaves; a reader of version N may meet new fields, never other ones.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

import msgspec

from guidance.handling_records import AirplaneHandling as AirplaneHandling
from guidance.handling_records import GroundHandling as GroundHandling
from guidance.handling_records import Stepping as Stepping
from guidance.handling_records import VelocityHandling as VelocityHandling
from guidance.record import Int64 as Int64
from guidance.record import Record as Record
from guidance.record import Triple as Triple
from guidance.record import Wxyz as Wxyz

SCHEMA_VERSION: Final = 1


class InputKind(StrEnum):
    """What can enter the core; nothing else can change what it does."""

    DATAGRAM = "datagram"
    TICK = "tick"
    COMMAND = "command"
    LINK_UP = "link_up"
    LINK_DOWN = "link_down"
    NOTE = "note"
    SIGNING_CLOCK = "signing_clock"
    LEARNED = "learned"


class Input(Record, frozen=True, kw_only=True, gc=False):
    """One event that entered the core, in order; `seq` counts them without gaps, so that a loss shows.

    The `text` of a command is JSON (`guidance.commands.Order`), and so is that of the signing clock
    (`guidance.mavlink.signing.SigningClock`) and of what was learned before
    (`guidance.flying.Handler.learned`). That of a datagram numbers those of its frames whose signature was
    not made with our key, so that a replay needs no key.
    """

    seq: Int64
    kind: InputKind
    data: bytes = b""
    text: str = ""


class Packet(Record, frozen=True, kw_only=True, gc=False):
    """One MAVLink packet handed to the link, and the input after which it was."""

    input_seq: Int64
    data: bytes


class Session(Record, frozen=True, kw_only=True):
    """The first record of a run: who wrote it, and all that a replay needs beside the inputs.

    `unix_offset_ns` added to any `t_ns` of this run gives Unix time. `config_json` is the effective
    configuration.
    """

    schema_version: Int64
    session_id: str
    guidance_version: str
    vehicle: str
    profile: str
    unix_offset_ns: Int64
    config_json: str


class State(Record, frozen=True, kw_only=True, gc=False, omit_defaults=True):
    """The vehicle at `t_ns`, predicted from the newest attitude and position by `predicted_s`.

    The sources are the MAVLink messages in use. `resets` counts those found of the autopilot's estimator.
    `source_offset_m` is how far the position still is from what its source says, since a switch of sources.
    `body_rates_frd_rad_s` are predicted, too, behind a delay by what was sent; the measured ones are the
    vehicle's own.
    """

    position_ned_m: Triple
    velocity_ned_m_s: Triple
    attitude_wxyz: Wxyz
    body_rates_frd_rad_s: Triple
    attitude_age_s: float
    position_age_s: float
    predicted_s: float
    attitude_source: str
    position_source: str
    vehicle_time_ms: Int64
    resets: Int64 = 0
    source_offset_m: float = 0.0
    measured_body_rates_frd_rad_s: Triple = (0.0, 0.0, 0.0)


class Reference(Record, frozen=True, kw_only=True, gc=False):
    """What is tracked at `t_ns`, `trajectory_s` after the trajectory's start: r, r' and r'' of the paper.

    `offset_ned_m` of r, with its derivatives in r' and r'', is what is left of the jumps of the autopilot's
    estimator (`guidance.blending`): r without it is the trajectory.
    """

    trajectory_s: float
    position_ned_m: Triple
    velocity_ned_m_s: Triple
    acceleration_ned_m_s2: Triple
    offset_ned_m: Triple = (0.0, 0.0, 0.0)


class Setpoint(Record, frozen=True, kw_only=True, gc=False, omit_defaults=True):
    """What was sent, and what the law asked for before limits; `t_ns` is the instant it is meant to act.

    `demanded_*` are (11) and (14) before, `body_rates_frd_rad_s` and `speed_m_s` after all limits.
    `neutral` marks a setpoint that asks for nothing (proof of life before tracking). `thrust` is the
    part of full thrust, -1 to 1. `attitude_wxyz` is that of an airplane, whose thrust is its throttle (0 to
    1), or stands beside an underwater vehicle's rates; `velocity_ned_m_s` is what vehicles are told that take
    one. `type_mask` is the message's: which of its fields count; logs from before it was kept have none.
    """

    seq: Int64
    neutral: bool
    body_rates_frd_rad_s: Triple
    speed_m_s: float
    demanded_body_rates_frd_rad_s: Triple
    demanded_speed_m_s: float
    thrust: float
    saturated: bool
    singular: bool
    attitude_wxyz: Wxyz = (1.0, 0.0, 0.0, 0.0)
    velocity_ned_m_s: Triple = (0.0, 0.0, 0.0)
    type_mask: Int64 | None = None


class TrackingError(Record, frozen=True, kw_only=True, gc=False):
    """e = x - r at `t_ns`, the Lyapunov functions V1 and V2, and the field in body axes (y4, y5, y6).

    V1 is phi, 1/2 k |e|^2 in the paper; V2 is 1/2 (y5^2 + y6^2).
    """

    error_ned_m: Triple
    norm_m: float
    v1: float
    v2: float
    field_body: Triple


class Status(Record, frozen=True, kw_only=True, omit_defaults=True):
    """The supervisor: its state, since when, why, and what it knows of the vehicle's mode.

    `state` is one of `disconnected`, `connected`, `withheld`, `ready`, `streaming`, `switching`, `arming`,
    `tracking`, `pausing`, `holding`, `aborting`, `cancelling`, `backing-out`, `leaving`, `handed-over`,
    `aborted`, `finished` (`guidance.supervisor.State`). `mode` and `intended_mode` are the profile's names.

    `allocation` names the rates that turn the vehicle; it is left out while it is the paper's, as in logs
    from before it could be another.

    `cautions` forbid no flight and are to be known before one; in a flight they are those of before it.

    `trajectory_json` is the one that was loaded by an order, as the table of a configuration; it is left out
    while it is that of the session.

    `trajectory_start_ns` is the instant of t = 0 and `origin_ned_m` the trajectory's origin in the
    vehicle's local frame; both are set at the first tracking tick.
    """

    state: str
    reason: str
    since_ns: Int64
    armed: bool | None
    mode: str
    intended_mode: str
    trajectory_start_ns: Int64 | None
    origin_ned_m: Triple | None
    setpoints_sent: Int64
    allocation: str = "pitch-yaw"
    cautions: tuple[str, ...] = ()
    trajectory_json: str = ""


class StreamStatus(msgspec.Struct, frozen=True, kw_only=True):
    """One message stream: is it alive, does it keep its rate, and are its values usable?

    `insisted` says whether that matters: not of one whose rate does not, and not while a better or a lesser
    one does its work.
    """

    message: str
    wanted_hz: float
    rate_hz: float
    age_s: float | None
    alive: bool
    at_rate: bool
    valid: bool
    rejected: Int64
    insisted: bool = True


class Link(Record, frozen=True, kw_only=True):
    """The link to the autopilot: who is heard, what is lost or refused, and the clock between the two.

    `uplink_age_s` is the age of the newest packet of ours that the autopilot answered (TIMESYNC).
    `transport` is the connection's kind; `needed_bytes_per_s` is at most needed in the busier direction,
    `capacity_bytes_per_s` what the line carries each way, null where that is not known.
    `origin_geodetic` is that of the local frame (GPS_GLOBAL_ORIGIN): latitude and longitude, deg, and m AMSL.
    `counters` names every kind of input that was not used (bad checksums, garbage bytes, other systems,
    non-finite values, duplicates, ...) with its count since the start.
    """

    connected: bool
    heartbeat_age_s: float | None
    autopilot: str
    vehicle_type: str
    autopilot_version: str
    autopilot_uid: str
    received: Int64
    lost: Int64
    reboots: Int64
    round_trip_s: float | None
    uplink_age_s: float | None
    clock_offset_ns: Int64 | None
    clock_drift_ppm: float | None
    streams: tuple[StreamStatus, ...]
    counters: dict[str, Int64]
    transport: str = ""
    received_bytes_per_s: float = 0.0
    sent_bytes_per_s: float = 0.0
    needed_bytes_per_s: float = 0.0
    capacity_bytes_per_s: float | None = None
    origin_geodetic: Triple | None = None


class Parameters(Record, frozen=True, kw_only=True):
    """What the autopilot's parameters are, by the names and in the units of its own, once they were read and
    whenever one has changed.

    Those `used` shape the setpoints, the others are only looked at; `absent` ones it does not have. `unmet`
    is why the vehicle is not flown with them.
    """

    values: dict[str, float]
    used: tuple[str, ...]
    absent: tuple[str, ...]
    unmet: str


class Timing(Record, frozen=True, kw_only=True):
    """Lateness of the control loop: from the instant that a setpoint became due to the tick that sent it.

    `lateness_counts[i]` counts ticks later than `lateness_edges_s[i - 1]` and at most `lateness_edges_s[i]`;
    the last count has no upper edge. All figures are since the start of the run.
    """

    ticks: Int64
    lateness_edges_s: tuple[float, ...]
    lateness_counts: tuple[Int64, ...]
    lateness_max_s: float
    setpoint_gap_max_s: float
    setpoint_rate_hz: float
    dropped_records: Int64
    dropped_packets: Int64 = 0


class Level(StrEnum):
    """How much an event matters, in the words of MAV_SEVERITY."""

    INFO = "info"
    NOTICE = "notice"
    WARNING = "warning"
    ERROR = "error"
    CRITICAL = "critical"


class Event(Record, frozen=True, kw_only=True):
    """Something happened that an operator or a log reader should know; `code` is for machines."""

    level: Level
    code: str
    text: str


class Answer(Record, frozen=True, kw_only=True):
    """What became of an order: obeyed (`accepted`), or not and why.

    `order`, `id` and `source` are those of the order. `reason` of an accepted one says what was changed, or
    that it was so already. `repeated` marks an id that was answered before: nothing was done again.
    """

    order: str
    id: str
    source: str
    accepted: bool
    reason: str
    repeated: bool = False


class Lost(Record, frozen=True, kw_only=True):
    """The recorder had to drop `count` records since the last mark, because the disk did not keep up."""

    count: Int64


#: Topic of each record; the key expression is `guidance/<vehicle>/<topic>`, the MCAP topic `/<topic>`.
TOPICS: Final[dict[type[Record], str]] = {
    Session: "session",
    Input: "input",
    Packet: "packet",
    State: "state",
    Reference: "reference",
    Setpoint: "setpoint",
    TrackingError: "error",
    GroundHandling: "ground",
    AirplaneHandling: "airplane",
    VelocityHandling: "copter",
    Stepping: "stepping",
    Status: "status",
    Link: "link",
    Parameters: "parameters",
    Timing: "timing",
    Event: "event",
    Answer: "answers",
    Lost: "lost",
}

#: When each is told. A rate in Hz is that of `guidance.reporting.PERIODS_NS`, by time alone.
RATES: Final[dict[type[Record], str]] = {
    Session: "once, at the start",
    Input: "everything that enters the core",
    Packet: "everything that is sent to the autopilot",
    State: "with each setpoint; 10 Hz without",
    Reference: "with each setpoint that tracks",
    Setpoint: "with each new attitude that may be flown by; 50 Hz (link.rate_hz) are asked for",
    TrackingError: "with each setpoint that tracks",
    GroundHandling: "with each setpoint of a rover or boat",
    AirplaneHandling: "with each setpoint of an airplane",
    VelocityHandling: "with each setpoint of a copter",
    Stepping: "with each setpoint of a tuning flight",
    Status: "5 Hz, and when it changes",
    Link: "2 Hz",
    Parameters: "when they have been read, and when one changes",
    Timing: "1 Hz",
    Event: "as it happens",
    Answer: "one for each order",
    Lost: "when the recorder had to drop some",
}

#: What decoding a payload raises that is not the JSON of its record: not JSON, not UTF-8, nested too deeply.
NOT_A_RECORD: Final = (msgspec.MsgspecError, UnicodeDecodeError, RecursionError)

#: Topics that only the log gets: the raw traffic, and the marks of the recorder itself.
LOG_ONLY: Final = frozenset({"input", "packet", "lost"})
