"""How the autopilot is reached: a `connection` of the configuration taken apart, or what is wrong with it.

| connection | what it does |
| --- | --- |
| `udpin://HOST:PORT` | listens, answers the autopilot |
| `udpout://HOST:PORT` | writes first |
| `udpbcast://ADDRESS:PORT` | broadcasts its heartbeat until the autopilot answers, then writes to it alone |
| `tcp://HOST:PORT` | connects |
| `serial:///dev/NAME?baud=57600&flow=none` | opens the port; `flow` is `none` or `rtscts` |
"""

from __future__ import annotations

import ipaddress
import re
from typing import Final, Literal, cast
from urllib.parse import urlsplit

import msgspec

from guidance.checking import one_of

#: What both autopilots give their first telemetry port (PX4 SER_TEL1_BAUD, ArduPilot SERIAL1_BAUD).
DEFAULT_BAUD: Final = 57600
#: Baud rates that ports and autopilots commonly have.
BAUD_RATES: Final = (57600, 115200, 230400, 460800, 500000, 921600, 1500000, 2000000, 3000000)
BAUD_MIN: Final = 1200
BAUD_MAX: Final = 4_000_000
#: Start bit, eight of data, stop bit.
BITS_PER_BYTE: Final = 10

Scheme = Literal["udpin", "udpout", "udpbcast", "tcp"]
_FORMS: Final = {
    "udpin": "udpin://HOST:PORT (listen)",
    "udpout": "udpout://HOST:PORT (write first)",
    "udpbcast": "udpbcast://ADDRESS:PORT (broadcast until the autopilot answers)",
    "tcp": "tcp://HOST:PORT (connect)",
    "serial": f"serial:///dev/NAME?baud={DEFAULT_BAUD}&flow=none",
}
_CONTROL: Final = re.compile(r"[\x00-\x20\x7f]")


class Network(msgspec.Struct, frozen=True):
    """An address on the network."""

    scheme: Scheme
    host: str
    port: int

    @property
    def byte_stream(self) -> bool:
        """Whether a frame may span two reads."""
        return self.scheme == "tcp"

    @property
    def reliable(self) -> bool:
        """Whether nothing is lost on the way: what is not answered waits to be read, and will be."""
        return self.scheme == "tcp"

    @property
    def capacity_bytes_per_s(self) -> None:
        """What it can carry is not known."""
        return None

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.scheme}://{host}:{self.port}"


class SerialLine(msgspec.Struct, frozen=True):
    """A serial port. `rtscts` is flow control by the lines RTS and CTS."""

    path: str
    baud: int = DEFAULT_BAUD
    rtscts: bool = False

    @property
    def scheme(self) -> Literal["serial"]:
        """As in the string."""
        return "serial"

    @property
    def byte_stream(self) -> bool:
        """Whether a frame may span two reads."""
        return True

    @property
    def reliable(self) -> bool:
        """Bytes may be lost."""
        return False

    @property
    def capacity_bytes_per_s(self) -> float | None:
        """What it carries each way; None for /dev/ttyACM*, the autopilot's own USB: no baud rate slows it."""
        return None if self.path.startswith("/dev/ttyACM") else self.baud / BITS_PER_BYTE

    def __str__(self) -> str:
        flow = "&flow=rtscts" if self.rtscts else ""
        return f"serial://{self.path}?baud={self.baud}{flow}"


Connection = Network | SerialLine


def parse_connection(text: str) -> Connection:
    """The connection that `text` means; ValueError says what is wrong and what is expected."""
    scheme, separator, rest = text.partition("://")
    form = _FORMS.get(scheme.lower())
    if form is None or not separator:
        raise ValueError("expected " + ", ".join(_FORMS.values()))
    if _CONTROL.search(text):
        raise ValueError(f"spaces and control characters are not allowed; expected {form}")
    if scheme.lower() == "serial":
        return _serial(rest, form)
    return _network(text, cast(Scheme, scheme.lower()), form)


def _network(text: str, scheme: Scheme, form: str) -> Network:
    try:
        parts = urlsplit(text)
    except ValueError:  # half an IPv6 address
        raise ValueError(f"expected {form}") from None
    if not parts.hostname:
        raise ValueError(f"expected {form}")
    if parts.path or parts.query or parts.fragment or "@" in parts.netloc:
        raise ValueError(f"nothing may follow the port; expected {form}")
    try:
        port = parts.port
    except ValueError:
        raise ValueError(f"the port must be a number from 0 to 65535; expected {form}") from None
    if port is None:
        raise ValueError(f"the port is missing; expected {form}")
    if port == 0 and scheme != "udpin":
        raise ValueError(f"port 0 is only for listening; expected {form}")
    if scheme == "udpbcast":
        try:
            ipaddress.IPv4Address(parts.hostname)
        except ValueError:
            raise ValueError(
                f"ADDRESS must be the network's IPv4 broadcast address (192.168.1.255); expected {form}"
            ) from None
    return Network(scheme, parts.hostname, port)


def _serial(rest: str, form: str) -> SerialLine:
    path, question, query = rest.partition("?")
    if not path.startswith("/"):
        raise ValueError(f"the device must be an absolute path, with three slashes; expected {form}")
    if not path.strip("/"):
        raise ValueError(f"the device is missing; expected {form}")
    settings: dict[str, str] = {}
    for setting in query.split("&") if question else ():
        key, equals, value = setting.partition("=")
        if key not in ("baud", "flow"):
            raise ValueError(f'"{key}" must be {one_of(["baud", "flow"], key)}; expected {form}')
        if not equals or not value:
            raise ValueError(f"{key} has no value; expected {form}")
        if key in settings:
            raise ValueError(f"{key} is given twice; expected {form}")
        settings[key] = value
    baud = settings.get("baud", str(DEFAULT_BAUD))
    if not re.fullmatch("[0-9]{1,9}", baud) or not BAUD_MIN <= int(baud) <= BAUD_MAX:
        raise ValueError(
            f"baud = {baud} must be a whole number from {BAUD_MIN} to {BAUD_MAX}; expected {form}"
        )
    flow = settings.get("flow", "none")
    if flow not in ("none", "rtscts"):
        raise ValueError(f"flow = {flow} must be {one_of(['none', 'rtscts'], flow)}; expected {form}")
    return SerialLine(path, int(baud), flow == "rtscts")
