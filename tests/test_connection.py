"""Connection strings: what each means, and what is said of a wrong one."""

from __future__ import annotations

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from guidance.config import ConfigError, parse_connection
from guidance.connection import Network, SerialLine
from tests.helpers import make_config

MEANINGS = {
    "udpin://0.0.0.0:0": Network("udpin", "0.0.0.0", 0),
    "udpin://[::1]:14540": Network("udpin", "::1", 14540),
    "udpout://autopilot.local:14580": Network("udpout", "autopilot.local", 14580),
    "udpbcast://192.168.1.255:14550": Network("udpbcast", "192.168.1.255", 14550),
    "tcp://10.0.0.1:5760": Network("tcp", "10.0.0.1", 5760),
    "serial:///dev/ttyS0": SerialLine("/dev/ttyS0", 57600),
    "serial:///dev/ttyS0?baud=921600&flow=rtscts": SerialLine("/dev/ttyS0", 921600, rtscts=True),
    "serial:///dev/ttyS0?flow=none": SerialLine("/dev/ttyS0"),
    "serial:///dev/serial/by-path/pci-0:0:1.0-port0": SerialLine("/dev/serial/by-path/pci-0:0:1.0-port0"),
}
REFUSED = {
    "": "expected udpin://HOST:PORT (listen), udpout://HOST:PORT (write first)",
    "udp://1.2.3.4:5": "expected udpin://HOST:PORT (listen)",
    "udpin:1.2.3.4:5": "expected udpin",
    "udpin://": "expected udpin",
    "udpin://:14540": "expected udpin",
    "udpin://[::1": "expected udpin",
    "udpin://host": "the port is missing",
    "udpin://host:port": "the port must be a number from 0 to 65535",
    "udpin://host:65536": "the port must be a number from 0 to 65535",
    "udpin://host:1/path": "nothing may follow the port",
    "udpin://host:1?x": "nothing may follow the port",
    "udpin://me@host:1": "nothing may follow the port",
    "udpin://ho st:1": "spaces and control characters are not allowed",
    "udpout://host:0": "port 0 is only for listening",
    "udpbcast://everybody:14550": "must be the network's IPv4 broadcast address",
    "udpbcast://[ff02::1]:14550": "must be the network's IPv4 broadcast address",
    "tcp://host": "the port is missing",
    "tcp://host:0": "port 0 is only for listening",
    "serial://": "the device must be an absolute path, with three slashes",
    "serial:///": "the device is missing",
    "serial://dev/ttyACM0": "the device must be an absolute path, with three slashes",
    "serial:ttyACM0": "expected udpin",
    "serial:///dev/x?baud": "baud has no value",
    "serial:///dev/x?baud=": "baud has no value",
    "serial:///dev/x?baud=fast": "baud = fast must be a whole number from 1200 to 4000000",
    "serial:///dev/x?baud=1199": "baud = 1199 must be",
    "serial:///dev/x?baud=-57600": "baud = -57600 must be",
    "serial:///dev/x?baud=57600.0": "baud = 57600.0 must be",
    "serial:///dev/x?baud=57600&baud=115200": "baud is given twice",
    "serial:///dev/x?buad=57600": '"buad" must be "baud" or "flow" (did you mean baud?)',
    "serial:///dev/x?": '"" must be "baud" or "flow"',
    "serial:///dev/x?flow=xonxoff": 'flow = xonxoff must be "none" or "rtscts"',
}


@pytest.mark.parametrize("text", MEANINGS)
def test_what_a_connection_means(text: str) -> None:
    assert parse_connection(text) == MEANINGS[text]
    assert parse_connection(str(MEANINGS[text])) == MEANINGS[text]


@pytest.mark.parametrize("text", REFUSED)
def test_a_wrong_connection_is_refused_with_what_is_expected(text: str) -> None:
    with pytest.raises(ConfigError) as refusal:
        make_config(f"link.connection='{text}'")
    assert REFUSED[text] in str(refusal.value)
    assert "expected " in str(refusal.value)


@given(st.text(max_size=40) | st.builds("serial:///{}?{}".format, st.text(max_size=9), st.text(max_size=20)))
def test_any_text_is_a_connection_or_refused(text: str) -> None:
    with suppress(ValueError):
        parse_connection(text)


def test_only_a_real_serial_line_has_a_known_capacity() -> None:
    assert parse_connection("serial:///dev/ttyUSB0?baud=57600").capacity_bytes_per_s == 5760
    assert parse_connection("serial:///dev/ttyACM0?baud=57600").capacity_bytes_per_s is None
    assert parse_connection("tcp://host:1").capacity_bytes_per_s is None
    streams = ["serial:///dev/ttyACM0", "tcp://host:1"]
    assert all(parse_connection(text).byte_stream for text in streams)
    assert not parse_connection("udpin://host:1").byte_stream
