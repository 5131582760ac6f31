"""Receive lines of JSON over a UDP or TCP socket, the only input of a run from other programs."""

import json
import logging
import selectors
import socket
import threading
import time
from abc import abstractmethod
from collections import Counter
from typing import Any, Literal

from palmfield.closing import Closing
from palmfield.errors import DeviceError, refuse_unknown
from palmfield.realtime import follower

LOG = logging.getLogger(__name__)
By = Literal["udp", "tcp"]
LONGEST_LINE = 65536
LOOK_S = 0.02
"""Largest time between two checks of the sockets while this process is running."""
STALE_S = 0.1
"""Largest age of received data; older data are not used."""
QUEUED_BYTES, LINE_COSTS = 49152, 512
"""Size of a full queue [bytes], and system memory used by one line [bytes].

At this size, the sender's system may queue further old bytes. Linux blocks a sender whose data are not read at 94 kB,
or at 142 lines of 50 bytes.
"""
NEXT_SENDER_S = 1.0
"""Duration of silence of a UDP sender [s] after which another sender may replace it."""
WAITING = 8
"""Largest number of open TCP connections that have not sent a valid line. One more connection closes the oldest one."""
FOREIGN = "garbled", "keys", "convention"
"""Errors in a first line that close its connection, because they show that the sender uses another protocol."""
REPORTED, REPORTED_LENGTH = 5, 300
"""Number of invalid lines of each kind that are reported with their text, and number of characters of each text."""


class BadLine(ValueError):
    """An invalid line. kind: kind of the error, under which the line is counted"""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(f"{kind}: {text}")
        self.kind = kind


def read_object(line: str | bytes) -> dict[str, Any]:
    """Return the JSON object in a line. Numbers are floats, and inf if too large. Raises BadLine of kind garbled."""
    try:
        value = json.loads(line.decode() if isinstance(line, bytes) else line, parse_int=float)
    except (ValueError, RecursionError, MemoryError) as error:
        raise BadLine("garbled", f"{line[:60]!r} is not a JSON object: {error}") from None
    if not isinstance(value, dict):
        raise BadLine("garbled", f"{line[:60]!r} is not a JSON object, but a JSON {type(value).__name__}")
    return value


class LineListener(Closing):
    """Context manager that reads the lines of one sender in a separate thread. A subclass processes the lines.

    One sender is accepted, from its first valid line on. A TCP sender is accepted until its connection ends, a UDP
    sender until it has been silent for NEXT_SENDER_S. Other senders are refused. A connection with another protocol in
    its first line (for example an HTTP request) is closed. If this process was stopped, lines that were queued for more
    than STALE_S are skipped.

    host, port, by: address; received: number of valid lines so far
    bad: number of skipped lines of each kind; reported: text of the first errors of each kind
    """

    def __init__(self, host: str, port: int, by: By) -> None:
        """port: 0 for any free port. Raises DeviceError for an address at which it cannot listen."""
        refuse_unknown(DeviceError, "the protocol is {}", by, ("udp", "tcp"))
        self.by, self.received = by, 0
        self.bad: Counter[str] = Counter()
        self.reported: list[str] = []
        self._ended, self._news = threading.Event(), threading.Condition()
        self._failed: BaseException | None = None
        self._sender, self._sent_s = "", 0.0
        try:
            if by == "udp":
                self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
                self._socket.bind((host, port))
            else:
                self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            raise DeviceError(f"cannot listen at {host}:{port}: {error}; give an address of this machine") from None
        self._socket.setblocking(False)
        self.host, self.port = self._socket.getsockname()[:2]
        self._open = selectors.DefaultSelector()
        self._open.register(self._socket, selectors.EVENT_READ)
        self._thread = follower(self._run)
        self._thread.start()

    @abstractmethod
    def read_line(self, line: bytes, came_s: float) -> None:
        """Process a line. came_s: its arrival, as time.monotonic() [s]. The listening thread calls this method.

        Raises BadLine; any other exception counts as a garbled line.
        """

    def check(self) -> None:
        """Raise DeviceError if the listening thread has failed, so that lines are no longer read."""
        if self._failed is not None:
            raise DeviceError(
                f"receiving at {self.by} {self.host}:{self.port} has stopped: {type(self._failed).__name__}: "
                f"{self._failed}; start again"
            )

    def wait(self, after: int, timeout_s: float) -> bool:
        """Wait until more than `after` valid lines have arrived; return whether they have.

        Raises DeviceError like `check`.
        """
        with self._news:
            self._news.wait_for(lambda: self.received > after or self._failed is not None, timeout_s)
        self.check()
        return self.received > after

    def skip(self, kind: str, text: str) -> None:
        """Count a skipped line."""
        self.bad[kind] += 1
        if self.bad[kind] <= REPORTED:
            # The text may contain control characters of a terminal, or characters that the terminal cannot show
            self.reported.append("".join(c if c.isprintable() else repr(c)[1:-1] for c in text[:REPORTED_LENGTH]))

    def skipped(self) -> str:
        """Return the number of skipped lines of each kind, as text in brackets; "" if no line was skipped."""
        kinds = ", ".join(f"{count} {kind}" for kind, count in sorted(self.bad.items()))
        return f" ({kinds})" if kinds else ""

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        for key in list(self._open.get_map().values()):
            self._socket_of(key).close()
        self._open.close()

    # -- the listening thread ------------------------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._listen()
        except BaseException as error:
            self._failed = error
        with self._news:
            self._news.notify_all()

    def _listen(self) -> None:
        """Check all sockets repeatedly, and empty each of them."""
        begun_s = time.monotonic()
        while not self._ended.is_set():
            # All sockets were empty at some time after this, which limits the age of data received now
            since_s, begun_s = begun_s, time.monotonic()
            for key, _ in self._open.select(LOOK_S):
                one = self._socket_of(key)
                if one.fileno() < 0:
                    continue
                if one is not self._socket:
                    self._read(one, key.data, since_s)
                elif self.by == "udp":
                    self._read_datagrams(since_s)
                else:
                    self._accept(since_s)

    @staticmethod
    def _socket_of(key: selectors.SelectorKey) -> socket.socket:
        assert isinstance(key.fileobj, socket.socket)
        return key.fileobj

    def _read_datagrams(self, since_s: float) -> None:
        while not self._ended.is_set():
            try:
                data, sender = self._socket.recvfrom(LONGEST_LINE)
            except BlockingIOError:
                return
            except ConnectionError:
                continue
            for line in data.splitlines():
                self._line(_name(sender), line, since_s)

    def _accept(self, since_s: float) -> None:
        while True:
            try:
                peer, address = self._socket.accept()
            except BlockingIOError:
                return
            except ConnectionError:
                continue
            if self._sender:
                self._refuse(_name(address))
                peer.close()
                continue
            others = [self._socket_of(key) for key in self._open.get_map().values() if key.data is not None]
            for other in others[: len(others) + 1 - WAITING]:
                self._hang_up(other)
            peer.setblocking(False)
            # A sender with a broken connection must not block others for ever
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
            for option, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3)):
                if hasattr(socket, option):
                    peer.setsockopt(socket.IPPROTO_TCP, getattr(socket, option), value)
            name = _name(address)
            self._open.register(peer, selectors.EVENT_READ, (name, rest := bytearray()))
            self._read(peer, (name, rest), since_s)

    def _read(self, peer: socket.socket, of: tuple[str, bytearray], since_s: float) -> None:
        """Read all data of a connection. An incomplete line at its end counts as a line."""
        name, rest = of
        waited = 0
        while not self._ended.is_set():
            try:
                data = peer.recv(LONGEST_LINE)
            except BlockingIOError:
                return
            except OSError:
                data = b""
            if time.monotonic() - since_s > STALE_S:
                waited += len(data) + LINE_COSTS * data.count(b"\n")
            rest += data
            *lines, last = bytes(rest).split(b"\n")
            rest[:] = last
            whole = lines if data and len(last) <= LONGEST_LINE else [*lines, last]
            good = all(self._line(name, line, since_s) for line in whole)
            if waited > QUEUED_BYTES:
                self.skip("stale", f"{name} sent more than the queue holds, so its connection is closed")
                good = False
            if not good or not data:
                self._hang_up(peer, name)
                return

    def _hang_up(self, peer: socket.socket, name: str = "") -> None:
        self._open.unregister(peer)
        peer.close()
        if name == self._sender:
            self._sender = ""

    def _line(self, name: str, line: bytes, since_s: float) -> bool:
        """Process a line if its sender is accepted; return whether the sender may continue."""
        if not line.strip():
            return True
        now = time.monotonic()
        has_door = name == self._sender
        if not has_door and self._sender and (self.by == "tcp" or now - self._sent_s <= NEXT_SENDER_S):
            self._refuse(name)
            return False
        # With frequent checks the arrival time is exact; else a line may be as old as the last check
        came_s = now if now - since_s <= 3.0 * LOOK_S else since_s
        if now - came_s > STALE_S:
            self.skip(
                "stale", f"{line[:60]!r} waited in the queue for up to {now - came_s:.2g} s; allowed: {STALE_S:g} s"
            )
            return has_door
        if len(line) > LONGEST_LINE:
            self.skip("garbled", f"garbled: {line[:60]!r} has more than {LONGEST_LINE} bytes; give one object per line")
            return False
        try:
            self.read_line(line, came_s)
        except BadLine as error:
            self.skip(error.kind, str(error))
            return has_door or error.kind not in FOREIGN
        except Exception as error:
            self.skip("garbled", f"garbled: {line[:60]!r}: {type(error).__name__}: {error}")
            return has_door
        self._sender, self._sent_s = name, now
        with self._news:
            self._news.notify_all()
        return True

    def _refuse(self, name: str) -> None:
        text = f"{name} is refused, because {self._sender} is already sending; allowed: one sender at a time"
        if self.bad["second sender"] < REPORTED:
            LOG.warning(text)
        self.skip("second sender", text)


def _name(address: tuple[str, int]) -> str:
    return f"{address[0]}:{address[1]}"
