"""The checks of the port, of what comes over it, and of who speaks there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Final

from guidance.connection import SerialLine
from guidance.mavlink.budget import FULL
from guidance.mavlink.outbox import COMPONENT_ID
from guidance.mavlink.profiles import PROFILES, fitting
from guidance.mavlink.report import enum_name, is_garbage, version_text
from guidance.mavlink.signing import Refusal
from guidance.mavlink.streams import SATISFIED, Stream
from guidance.preflight.findings import Finding, Verdict, fail, ok, parted, skip, warn
from guidance.preflight.seen import Seen
from guidance.transport.processes import Process

#: Above these parts of it, a line is worth a look, and not to be flown over (the flights' own tests: 30 %).
LOSS_WARN: Final = 0.05
LOSS_FAIL: Final = 0.3
GARBAGE_WARN: Final = 0.01
#: A setpoint that acts later than this after its state is worth a look.
ROUND_TRIP_WARN_S: Final = 0.1

_FIRMWARE: Final = {row.autopilot: row.firmware for row in PROFILES.values()}
#: What it means that a message that helps does not come.
_WITHOUT: Final = {
    "CURRENT_MODE": "the mode is known from HEARTBEAT only, up to 1 s late",
    "WIND_COV": "PX4 tells the wind once it estimates it, in the air: the service finds it itself",
    "VFR_HUD": "it tells the airspeed, without which no airplane is flown",
}
#: Of what is wrong with the line, what is no mere warning.
_PROBLEMS: Final = {
    "two_autopilots": Verdict.FAIL,
    "two_addresses": Verdict.FAIL,
    "reboot": Verdict.FAIL,
    "lost": Verdict.FAIL,
}


def configuration(seen: Seen) -> Iterator[Finding]:
    """Read and valid, or there would be no check."""
    config = seen.config
    yield ok(
        "configuration",
        f"{seen.source}: {config.vehicle.name}, {config.vehicle.profile}, {config.link.rate_hz:g} Hz",
    )


def port(seen: Seen) -> Iterator[Finding]:
    """Opened, and ours alone."""
    for holder in seen.port.holders:
        yield _held(holder, seen)
    if seen.refused and not seen.port.holders:
        what, todo = parted(seen.refused)
        yield fail("port", f"{seen.observation.connection}: {what}", todo or "see link.connection")
    elif not seen.port.holders:
        yield ok("port", seen.opened)
    manager = seen.port.modem_manager
    if manager is not None and manager not in seen.port.holders:
        yield warn(
            "modem manager",
            f"{manager} writes modem commands to every new {seen.port.device}",
            "sudo systemctl disable --now ModemManager",
        )


def _held(holder: Process, seen: Seen) -> Finding:
    if is_service(holder):
        return fail(
            "port",
            f"the service itself runs on it: {holder}",
            "guidance watch shows what it sees; to check, stop it first: sudo systemctl stop guidance@NAME",
        )
    if "getty" in holder.name and isinstance(seen.observation.connection, SerialLine):
        unit = f"serial-getty@{os.path.basename(seen.port.device)}.service"
        return fail("port", f"a login console has it: {holder}", f"sudo systemctl disable --now {unit}")
    if holder.name == "ModemManager":
        return fail("port", f"{holder} has it", "sudo systemctl disable --now ModemManager")
    return fail("port", f"another program has it: {holder}", "end it, or give the port to this service only")


def is_service(process: Process) -> bool:
    """Whether it was started as `guidance run`, in whatever way."""
    names = [os.path.basename(word) for word in process.command]
    return "guidance" in names and "run" in names[names.index("guidance") :]


def bytes_seen(seen: Seen) -> Iterator[Finding]:
    """Something comes, and it is MAVLink."""
    link = seen.observation.link
    total, garbage = link.bytes_received, link.reader.counters["garbage_bytes"]
    frames = _frames(seen)
    if not total or not frames or (link.heartbeat is None and is_garbage(total, garbage)):
        yield fail("bytes", *_absence(seen))
    elif garbage > GARBAGE_WARN * total:
        yield warn(
            "bytes",
            f"{garbage} of {total} bytes are no MAVLink",
            "does another program read from this port too, or write to it? Is there noise on the line?",
        )
    else:
        yield ok("bytes", f"{total} came, {frames} MAVLink packets")


def _frames(seen: Seen) -> int:
    """MAVLink packets of whomever, those included that are refused for their signature."""
    link = seen.observation.link
    return link.received + link.company.frames + (0 if link.signing is None else link.signing.refused)


def _absence(seen: Seen) -> tuple[str, str]:
    """Why there is no autopilot, and what to look at: behind the last ": " of the link's words."""
    what, _, todo = seen.observation.absent_because.rpartition(": ")
    return (what, todo) if what else (todo, "look at what its port is set up for")


def senders(seen: Seen) -> Iterator[Finding]:
    """Who else speaks."""
    link = seen.observation.link
    others = str(link.company) or "nobody else"
    if (link.system, COMPONENT_ID) in link.company.roles:
        yield warn(
            "others heard",
            f"{others}; one of them speaks as this service would ({link.system}/{COMPONENT_ID})",
            "does the service itself run already? Only one may send setpoints",
        )
    else:
        yield ok("others heard", others)


def autopilot(seen: Seen) -> Iterator[Finding]:
    """The wanted one is heard, and who it is."""
    observation = seen.observation
    link = observation.link
    if observation.absent_because or link.heartbeat is None:
        yield (
            fail("autopilot", *_absence(seen))
            if _frames(seen)
            else skip("autopilot", "no MAVLink packet came")
        )
        return
    beat, version = link.heartbeat, link.version
    firmware = _FIRMWARE.get(beat.autopilot) or enum_name("MAV_AUTOPILOT", beat.autopilot)
    who = f"{link.system}/{link.component}: {firmware} "
    if version is None:
        todo = "does the router forward AUTOPILOT_VERSION?"
        yield warn("autopilot", f"{who}of a version that it does not tell", todo)
    else:
        uid = f", uid {version.uid:x}" if version.uid else ""
        yield ok("autopilot", f"{who}{version_text(version.flight_sw_version)}{uid}")


def signing(seen: Seen) -> Iterator[Finding]:
    """Both ends sign, or neither does; who may order should have to."""
    link, config = seen.observation.link, seen.config.link
    commanders = config.commands_from
    if link.signing is None and commanders:
        who = " or ".join(map(str, commanders))
        yield warn(
            "orders by MAVLink",
            f"unsigned: whoever says that he is system {who} commands the vehicle",
            "set link.signing_key_file, or link.commands_from = []",
        )
    if link.signing is None and link.signs:
        yield warn(
            "signing",
            "the autopilot signs, and this service has no key: it may be ignored",
            "set link.signing_key_file to the autopilot's key, or take that out of the autopilot",
        )
    elif link.signing is None:
        yield ok("signing", "off: whoever reaches the line is believed")
    elif link.signing.refused:
        counts = ", ".join(f"{link.counters[why]} {why}" for why in Refusal if link.counters[why])
        yield warn(
            "signing",
            f"signed by our key, but also refused: {counts}",
            "who else sends on this line? Packets that come twice are refused too (signature_replayed)",
        )
    else:
        yield ok("signing", f"both ends sign, by one key ({config.signing_key_file})")
    if link.signing is not None:
        signers = ", ".join(f"{system}/{component}" for system, component in link.signing.signers)
        yield ok("signers", f"{signers or 'nobody yet'}; this service signs as link {config.signing_link_id}")


def profile(seen: Seen) -> Iterator[Finding]:
    """Firmware and vehicle type are those that the profile is for."""
    beat, row = seen.observation.link.heartbeat, seen.observation.profile
    assert beat is not None
    kind = f"{enum_name('MAV_AUTOPILOT', beat.autopilot)} {enum_name('MAV_TYPE', beat.type)}"
    fit = fitting(beat)
    if row.name in fit:
        yield ok(
            "profile",
            f"{row.name} is for {enum_name('MAV_TYPE', beat.type).removeprefix('MAV_TYPE_').lower()}",
        )
    else:
        known = f"set vehicle.profile = {fit[0]}" if fit else f"there is none yet; {_known()}"
        yield fail(
            "profile", f"{row.name} is not for {kind}", f"is it the vehicle that is meant? If so, {known}"
        )


def _known() -> str:
    return "known: " + ", ".join(sorted(PROFILES))


def one_autopilot(seen: Seen) -> Iterator[Finding]:
    """Nobody else uses its id, it did not reboot, no rate fell back, the line is fast enough."""
    for words, code in seen.observation.problems.items():
        what, todo = parted(words)
        yield Finding(code.replace("_", " "), _PROBLEMS.get(code, Verdict.WARN), what, todo)


def streams(seen: Seen) -> Iterator[Finding]:
    """Each message at the rate that was asked for."""
    observation = seen.observation
    wanted = observation.link.streams
    for stream in wanted.all():
        instead = observation.stands_in(stream)
        if not wanted.needed(stream, observation.now_ns):
            continue
        if instead is not None:
            yield ok(stream.message, f"does not come, {instead.message} stands in")
        else:
            yield _stream(stream, observation.now_ns)


def _stream(stream: Stream, now_ns: int) -> Finding:
    status = stream.status(now_ns)
    name, rate = stream.message, f"{status.rate_hz:.0f} of {status.wanted_hz:.0f} Hz"
    if not status.alive:
        if not stream.insistent:
            return warn(name, "does not come", _WITHOUT.get(name, "the autopilot does not tell it"))
        return fail(name, "does not come", "is the estimator ready, does the router forward it?")
    if stream.absent(now_ns):
        return fail(name, f"{rate}, but not usable", "is the estimator ready, are the clocks synchronised?")
    if not stream.insistent:
        return ok(name, f"comes, {status.rate_hz:.1f} Hz")
    if stream.asked_hz < stream.wanted_hz:
        rate += f"; {stream.wanted_hz:.0f} Hz was denied"
        todo = f"set link.rate_hz = {stream.asked_hz:.0f}, or let the autopilot's loop run faster"
    else:
        todo = "does another program on the link ask for rates of its own? Is the line too slow?"
    if status.rate_hz >= SATISFIED * status.wanted_hz:
        return ok(name, rate)
    verdict = Verdict.WARN if status.at_rate else Verdict.FAIL
    return Finding(name, verdict, rate, todo)


def setpoints(seen: Seen) -> Iterator[Finding]:
    """What they ask for, of this version of the firmware."""
    link, row = seen.observation.link, seen.observation.profile
    sent = row.for_version(link.version)
    found = f"{sent.asked} (type_mask {sent.type_mask:#04x})"
    if sent is not row:
        which = "that does not tell its version" if link.version is None else "of this version"
        found += f": a {row.firmware} {which} may not move by less"
    yield ok("setpoints", found)


def clock(seen: Seen) -> Iterator[Finding]:
    """The autopilot's clock is known, and how long an answer takes."""
    observation = seen.observation
    watch = observation.link.clock
    if not watch.synced(observation.now_ns) or watch.round_trip_s is None:
        yield fail("clock", "no answers to TIMESYNC", "does the router forward it, both ways?")
        return
    offset_s = watch.offset_ns(observation.now_ns) * 1e-9
    found = (
        f"round trip {watch.round_trip_s * 1e3:.1f} ms, offset {offset_s:.3f} s, "
        f"drift {watch.drift_ppm:.0f} ppm"
    )
    if watch.round_trip_s > ROUND_TRIP_WARN_S:
        yield warn("clock", found, "that is slow: keep rho times (delay + lag of the vehicle) below 0.5")
    else:
        yield ok("clock", found)


def loss(seen: Seen) -> Iterator[Finding]:
    """Little is lost on the way."""
    link = seen.observation.link
    lost, total = link.sequence.lost, link.sequence.lost + link.received
    found = f"{lost} of {total} packets lost"
    if lost <= LOSS_WARN * total:
        yield ok("loss", found)
    else:
        verdict = Verdict.WARN if lost <= LOSS_FAIL * total else Verdict.FAIL
        yield Finding("loss", verdict, found, "is the line too slow, the radio too weak, the cable too long?")


def throughput(seen: Seen) -> Iterator[Finding]:
    """What the line carries."""
    record = seen.observation.record
    assert record is not None
    received, capacity = record.received_bytes_per_s, record.capacity_bytes_per_s
    found = f"{received:.0f} bytes/s come, flying needs up to {record.needed_bytes_per_s:.0f} each way"
    if capacity is None:
        yield ok("throughput", found)
    elif received >= FULL * capacity:
        todo = "raise the baud rate at both ends, or let the autopilot send less on this port"
        yield warn("throughput", f"the line is full: {found}, of {capacity:.0f}", todo)
    else:
        yield ok("throughput", f"{found}, of {capacity:.0f}")
