"""What Foxglove and Lichtblick do on a WebSocket, for the tests of the bridge."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

DEADLINE_S: Final = 20.0
SUBPROTOCOL: Final = Subprotocol("foxglove.sdk.v1")
_MESSAGE: Final = struct.Struct("<BIQ")  # opcode, subscription, log time; the payload follows


class Viewer:
    """What a viewer does: learns what is advertised, subscribes, takes messages."""

    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self.channels: dict[str, dict[str, Any]] = {}
        self._messages: list[tuple[str, int, Any]] = []
        self._subscriptions: dict[int, str] = {}
        assert self._json()["op"] == "serverInfo"

    def _json(self) -> Any:
        while isinstance(frame := self._connection.recv(timeout=DEADLINE_S), bytes):
            self._keep(frame)
        return json.loads(frame)

    def _keep(self, frame: bytes) -> None:
        opcode, subscription, time_ns = _MESSAGE.unpack_from(frame)
        assert opcode == 1
        content = json.loads(frame[_MESSAGE.size :])
        self._messages.append((self._subscriptions[subscription], time_ns, content))

    def learn(self, topic: str) -> dict[str, Any]:
        """The channel of `topic`, as soon as it is advertised."""
        while topic not in self.channels:
            told = self._json()
            assert told["op"] == "advertise"
            self.channels |= {channel["topic"]: channel for channel in told["channels"]}
        return self.channels[topic]

    def subscribe(self, *topics: str) -> None:
        wanted = []
        for topic in topics:
            number = len(self._subscriptions) + 1
            self._subscriptions[number] = topic
            wanted.append({"id": number, "channelId": self.learn(topic)["id"]})
        self._connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))

    def message(self, topic: str) -> tuple[int, Any]:
        """Log time and content of the next message of `topic`."""
        while True:
            for index, (name, time_ns, content) in enumerate(self._messages):
                if name == topic:
                    del self._messages[index]
                    return time_ns, content
            frame = self._connection.recv(timeout=DEADLINE_S)
            if isinstance(frame, bytes):
                self._keep(frame)
            else:
                self.channels |= {channel["topic"]: channel for channel in json.loads(frame)["channels"]}


@contextmanager
def viewing(port: int) -> Iterator[Viewer]:
    with connect(f"ws://127.0.0.1:{port}", subprotocols=[SUBPROTOCOL]) as connection:
        assert connection.subprotocol == SUBPROTOCOL
        yield Viewer(connection)
