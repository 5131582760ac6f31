"""Lines that come in over a socket, by UDP or TCP, heard by a thread of its own."""

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from typing import Literal, Self

from palmfield.errors import DeviceError
from palmfield.realtime import follower

By = Literal["udp", "tcp"]
LONGEST_LINE = 65536
LOOK_S = 0.1
"""So often it is looked whether to stop."""


class LineListener:
    """Hears lines, each with the time at which it came, on the monotonic clock of this machine. A context manager.

    host, port: where it listens; by TCP one connection at a time
    """

    def __init__(self, on_line: Callable[[bytes, float], None], host: str, port: int, by: By) -> None:
        """on_line: called in the listening thread with each line that isn't blank; port: 0 for any that is free

        Raises DeviceError for an address that can't be listened at.
        """
        if by not in ("udp", "tcp"):
            raise DeviceError(f"lines are listened to by '{by}'; allowed: udp, tcp")
        self.by, self._on_line = by, on_line
        self._ended = threading.Event()
        try:
            if by == "udp":
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.bind((host, port))
            else:
                self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            raise DeviceError(f"{host}:{port} can't be listened at: {error}; give an address of this machine") from None
        self._socket.settimeout(LOOK_S)
        self.host, self.port = self._socket.getsockname()[:2]
        self._thread = follower(self._listen)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def _listen(self) -> None:
        while not self._ended.is_set():
            with contextlib.suppress(TimeoutError):
                if self.by == "udp":
                    data = self._socket.recv(LONGEST_LINE)
                    now = time.monotonic()
                    for line in data.splitlines():
                        self._take(line, now)
                else:
                    peer, _ = self._socket.accept()
                    with peer:
                        self._serve(peer)

    def _serve(self, peer: socket.socket) -> None:
        """Lines of one connection, until it ends; what was cut off at its end is a line too."""
        peer.settimeout(LOOK_S)
        rest = b""
        while not self._ended.is_set():
            try:
                data = peer.recv(LONGEST_LINE)
            except TimeoutError:
                continue
            except OSError:
                data = b""
            now = time.monotonic()
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                self._take(line, now)
            if not data or len(rest) > LONGEST_LINE:
                self._take(rest, now)
                return

    def _take(self, line: bytes, now: float) -> None:
        if line.strip():
            self._on_line(line, now)
