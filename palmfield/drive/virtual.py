"""Virtual board: reads bytes from a pseudo-terminal or a TCP socket at the rate of the line, and plays them.

It has the buffers of the real board and records the emission. Faults can be added to the line.
"""

import contextlib
import os
import socket
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from typing import Literal, Self

from palmfield.drive.board import Board, Emitted, Flag
from palmfield.drive.transport import COUNT_MARK, REPORT_LIMIT_S
from palmfield.errors import DeviceError
from palmfield.realtime import realtime

TICK_S = 0.5e-3
REPORT_S = 4e-3
"""Interval of reports of the number of bytes read [s]; ten times longer while the number is unchanged."""
assert 10 * REPORT_S < REPORT_LIMIT_S
BURST_S = 20e-3
"""Largest delay of the reading thread that one read makes up [s]."""


@dataclass
class Faults:
    """Faults of the line, as shares of bytes. drop: lost bytes; flip: bytes with one wrong bit; seed: random seed"""

    drop: float = 0.0
    flip: float = 0.0
    seed: int = 0
    draws: Random = field(init=False, repr=False)

    def __post_init__(self) -> None:
        for name, share in (("drop", self.drop), ("flip", self.flip)):
            if not 0.0 <= share <= 1.0:
                raise DeviceError(f"{name} has value {share:g}; allowed: a share of bytes, 0 to 1")
        self.draws = Random(self.seed)

    def through(self, data: bytes) -> bytes:
        """Return the bytes that arrive, after the faults."""
        if self.drop == self.flip == 0.0:
            return data
        draw = self.draws.random
        passed = [byte for byte in data if draw() >= self.drop]
        return bytes(byte ^ (1 << self.draws.randrange(8)) if draw() < self.flip else byte for byte in passed)


THREAD_PRIORITY = 70


class VirtualBoard:
    """The virtual twin of a board behind a port. Use as a context manager, or `unplug` it at the end.

    port: port to open, a device or a pyserial URL; received: all bytes so far, as they arrived
    emitted: emission over time, on `clock`; flags: errors that the board detected
    Unlike a real board it reports the number of bytes read, because real ports report the number of waiting bytes.
    """

    def __init__(
        self,
        board: Board,
        *,
        by: Literal["pty", "tcp"] = "pty",
        tcp_port: int = 0,
        faults: Faults | None = None,
        link: str | Path | None = None,
        tells: bool = True,
        realtime: bool = False,
        decodes: bool = True,
    ) -> None:
        """tcp_port: 0: any free port; link: fixed name of the pseudo-terminal, also after it is plugged in again;
        tells: whether the board reports the number of bytes read; realtime: whether its thread requests priority,
        because a real board reads bytes at any load of the host; decodes: True: bytes are decoded on arrival; False:
        when `decode` is called, to avoid delays. Raises DeviceError for a system without pseudo-terminals, and for a
        port that is in use.
        """
        assert board.line is not None
        self.board, self.line, self.faults = board, board.line, faults or Faults()
        self.twin = board.wired_twin()
        self.received = bytearray()
        self.emitted: list[Emitted] = []
        self._began = time.monotonic()
        self._stalled, self._ended = threading.Event(), threading.Event()
        self._by, self._tcp_port, self._link = by, tcp_port, None if link is None else Path(link)
        self._read_count, self._reports = 0, tells
        self._free_s = 0.0
        self._losing = 0
        self._realtime = realtime
        self._decodes = decodes
        self._undecoded: list[tuple[bytes, float]] = []
        self._ended.set()
        self.plug()

    @property
    def clock(self) -> float:
        """Seconds since the board was switched on."""
        return time.monotonic() - self._began

    @property
    def flags(self) -> list[Flag]:
        return self.twin.flags

    def stall(self, stalled: bool = True) -> None:
        """Stop or resume reading; meanwhile bytes wait in the buffers of the system."""
        if stalled:
            self._stalled.set()
        else:
            self._stalled.clear()

    def lose(self, count: int) -> None:
        """Drop this number of the next bytes on the line."""
        self._losing = count

    def settle(self, quiet_s: float = 0.1) -> None:
        """Wait until no bytes have come for quiet_s [s]."""
        before = -1
        while before != len(self.received):
            before = len(self.received)
            time.sleep(quiet_s)

    def decode(self) -> None:
        """Compute the emission over time and the detected errors, if bytes are not decoded on arrival."""
        for data, begin in self._undecoded:
            self.emitted += [*self.twin.until(begin), *self.twin.feed(data, begin)]
        self._undecoded.clear()
        self.emitted += self.twin.until(self.clock)

    def unplug(self) -> None:
        """Remove the port; the emission of the board continues."""
        if self._ended.is_set():
            return
        self._ended.set()
        self._thread.join()
        self._close()

    def plug(self) -> None:
        """Restore the port after `unplug`; the emission of the board has continued during this time."""
        if not self._ended.is_set():
            return
        if self._by == "pty":
            self._open_pty()
        else:
            self._open_socket(self._tcp_port)
        self._ended.clear()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.unplug()

    # -- end of the line at the board --------------------------------------------------------------------------------

    def _open_pty(self) -> None:
        try:
            import tty
        except ImportError:
            raise DeviceError("this system has no pseudo-terminals; use by='tcp'") from None
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        if self._link is not None:
            self._link.symlink_to(self.port)
            self.port = str(self._link)

    def _open_socket(self, tcp_port: int) -> None:
        self._slave = -1
        try:
            self._server = socket.create_server(("127.0.0.1", tcp_port))
        except OSError as error:
            raise DeviceError(f"TCP port {tcp_port} cannot be opened: {error}; give a free port, or 0") from None
        self._server.setblocking(False)
        self._peer: socket.socket | None = None
        self._tcp_port = self._server.getsockname()[1]
        self.port = f"socket://127.0.0.1:{self._tcp_port}"

    def _close(self) -> None:
        if self._slave >= 0:
            if self._link is not None:
                self._link.unlink(missing_ok=True)
            os.close(self._slave)
            os.close(self._master)
            return
        if self._peer is not None:
            self._peer.close()
        self._server.close()

    def _available(self, most: int) -> bytes:
        """Return the available bytes, up to this number."""
        if self._slave >= 0:
            with contextlib.suppress(BlockingIOError, OSError):
                return os.read(self._master, most)
            return b""
        if self._peer is None:
            with contextlib.suppress(BlockingIOError):
                self._peer, _ = self._server.accept()
                self._peer.setblocking(False)
        if self._peer is not None:
            try:
                data = self._peer.recv(most)
            except BlockingIOError:
                return b""
            except OSError:
                data = b""
            if not data:
                self._peer.close()
                self._peer = None
            return data
        return b""

    def _run(self) -> None:
        with realtime(THREAD_PRIORITY) if self._realtime else contextlib.nullcontext():
            self._read()

    def _read(self) -> None:
        before = self.clock
        reported, reported_s = -1, 0.0
        while not self._ended.is_set():
            time.sleep(TICK_S)
            now = self.clock
            # Received bytes came after the last check. So an idle line accumulates no time, and a full line keeps the
            # time of the byte in transit
            begin = max(self._free_s, before - self.line.time_s(1), now - BURST_S)
            before = now
            allowed = (now - begin) * self.line.bytes_per_s
            if not self._stalled.is_set() and allowed >= 1.0:
                data = self._available(int(allowed))
                if data:
                    self._receive(data, begin)
                    self._free_s = begin + self.line.time_s(len(data))
            if self._decodes:
                self.emitted += self.twin.until(now)
            if self._reports and now - reported_s >= (REPORT_S if self._read_count != reported else 10.0 * REPORT_S):
                reported, reported_s = self._read_count, now
                self._report()

    def _report(self) -> None:
        """Report how many bytes were read; unread reports are dropped."""
        number = COUNT_MARK + self._read_count.to_bytes(8, "little")
        with contextlib.suppress(OSError):
            if self._slave >= 0:
                os.write(self._master, number)
            elif self._peer is not None:
                self._peer.send(number)

    def _receive(self, data: bytes, begin: float) -> None:
        """Process bytes that are consecutive on the line from time `begin` [s] on."""
        self._read_count += len(data)
        self.received += data
        through = self.faults.through(data[self._losing :])
        self._losing = max(0, self._losing - len(data))
        if self._decodes:
            self.emitted += self.twin.feed(through, begin)
        else:
            self._undecoded.append((through, begin))
