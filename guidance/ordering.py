"""`guidance command`: one order to one vehicle over zenoh, and its answer."""

from __future__ import annotations

import os
import time
import tomllib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import msgspec
import zenoh

from guidance.checking import ConfigError, override
from guidance.telemetry.asking import AGAIN_NS, ANSWER_S, ASK_NS, order_payload, order_selector
from guidance.telemetry.zenoh_orders import Reply
from guidance.telemetry.zenoh_sink import brief, close_quietly, zenoh_config

#: Where a service listens as `deploy/*.toml` stand.
DEFAULT_CONNECT: Final = ("tcp/127.0.0.1:7447",)

_decode: Final = msgspec.json.Decoder(Reply).decode


class NoAnswerError(Exception):
    """Nobody answered; the text says where nobody did."""


def fields_of(verb: str, words: Sequence[str]) -> dict[str, Any]:
    """An order's fields from the words behind its verb; raises ValueError with what is expected.

    `allocate NAME`, `set KEY=VALUE`, `load FILE.toml` (its [trajectory]) or `load name=circle radius_m=5`.
    """
    if verb == "allocate" and len(words) == 1:
        return {"allocation": words[0]}
    if verb == "set" and len(words) == 1 and "=" in words[0]:
        data = _pairs(words, "set")
        return {"key": words[0].partition("=")[0].strip(), "value": _leaf(data)}
    if verb == "load" and words:
        is_file = len(words) == 1 and "=" not in words[0]
        return {"trajectory": _trajectory_of(Path(words[0])) if is_file else _pairs(words, "load")}
    if words or verb in ("allocate", "set", "load"):
        raise ValueError(
            f"{verb}: expected {_EXPECTED.get(verb, 'nothing behind it')}, got {' '.join(words) or 'nothing'}"
        )
    return {}


_EXPECTED: Final = {
    "allocate": "one of pitch-yaw, roll-pitch, roll-yaw",
    "set": "KEY=VALUE, such as law.k=0.8",
    "load": "a TOML file with a [trajectory], or its keys, such as name=circle radius_m=5",
}


def _pairs(words: Sequence[str], verb: str) -> dict[str, Any]:
    data: dict[str, Any] = {}
    try:
        for word in words:
            override(data, word)
    except ConfigError as error:
        raise ValueError(str(error).replace("--set", verb, 1)) from None
    return data


def _leaf(data: Any) -> Any:
    while isinstance(data, dict):
        (data,) = data.values()
    return data


def _trajectory_of(path: Path) -> dict[str, Any]:
    try:
        trajectory = tomllib.loads(path.read_text(encoding="utf-8")).get("trajectory")
    except OSError as error:
        raise ValueError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: not valid TOML: {error}") from None
    if not isinstance(trajectory, dict):
        raise ValueError(f"{path}: has no [trajectory]")
    return trajectory


def ask(
    vehicle: str,
    verb: str,
    fields: dict[str, Any],
    *,
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
    config_file: Path | None = None,
    multicast: bool = False,
    seconds: float = ASK_NS * 1e-9,
    open_session: Callable[[zenoh.Config], zenoh.Session] = zenoh.open,
) -> Reply:
    """Order once; it may take `seconds` to find the vehicle, and `ANSWER_S` more for the answer.

    It is asked again until it is answered: one id, so that it is obeyed once.

    Raises:
        ValueError: a wrong order or setting, in words.
        NoAnswerError: nobody answered.
    """
    _, payload = order_payload(vehicle, verb, fields, os.environ.get("USER", ""))
    nowhere = not (connect or listen or config_file or multicast)
    connect = DEFAULT_CONNECT if nowhere else connect
    config = zenoh_config(
        connect=connect, listen=listen, multicast_scouting=multicast, config_file=config_file
    )
    where = ", ".join((*connect, *listen)) or "the network"
    try:
        session = open_session(config)
    except zenoh.ZError as error:
        raise NoAnswerError(f"no zenoh session: {brief(error)}") from None
    try:
        start = time.monotonic()
        while True:
            selector = order_selector(vehicle, verb, time.monotonic() - start)
            replies = session.get(selector, payload=payload, timeout=ANSWER_S)
            for reply in replies:
                if reply.ok is not None:
                    return _decode(reply.ok.payload.to_bytes())
            if time.monotonic() - start >= seconds:
                raise NoAnswerError(f"no service of {vehicle} answers at {where}")
            time.sleep(AGAIN_NS * 1e-9)
    except zenoh.ZError as error:
        raise NoAnswerError(f"zenoh: {brief(error)}") from None
    except msgspec.MsgspecError as error:
        raise NoAnswerError(f"{vehicle} answers something else: {error}") from None
    finally:
        close_quietly(session)
