"""An echo: sends every datagram back. The floor of `sitl bench latency`, which starts it with a port."""

from __future__ import annotations

import socket
import sys


def main(port: int) -> None:
    """Until it is ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as echo:
        echo.bind(("127.0.0.1", port))
        while True:
            data, sender = echo.recvfrom(2048)
            echo.sendto(data, sender)


if __name__ == "__main__":
    main(int(sys.argv[1]))
