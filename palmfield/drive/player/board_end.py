"""Port of a board in the process of the player: sends whole frames, counts bytes in transit, silences the board."""

import os
import time
from array import array
from collections import deque
from typing import NamedTuple

from palmfield.drive.log_lines import log_line
from palmfield.drive.player.line_clock import READING_AGE_S, LineClock
from palmfield.drive.player.messages import Job
from palmfield.drive.ports import AUTD3, open_port
from palmfield.drive.transport import PortLost, SerialTransport, Transport, may_be_virtual
from palmfield.errors import DeviceError

now_s = time.monotonic
RETRY_S = 20e-3
"""Delay before the next frame after the system accepted only a part of a frame, or nothing [s]."""
MOST_RECORDED = 1_000_000
"""Largest number of frames whose delays are stored."""


class PortStuck(PortLost):
    """A port that exists but accepts no bytes."""


class _OnItsWay(NamedTuple):
    """A frame in transit. end: total bytes written up to its end; number: index of its delay"""

    end: int
    due_s: float
    number: int


class BoardEnd:
    """An open port and the frames sent through it.

    frames: number of frames written whole; cut: number of frames that the system accepted only in part
    late_s: delay of the last byte of each frame on the line [s]; write_late_s: delay of its writing [s]
    numbered: number, due time and index in late_s of each numbered frame
    """

    def __init__(self, job: Job) -> None:
        """Raises DeviceError if the port cannot be opened."""
        self.job = job
        self.start, self.stop = bytes.fromhex(job.start), bytes.fromhex(job.stop)
        self.line = LineClock(1.0 / job.bytes_per_s)
        self.frames = self.cut = 0
        self.late_s, self.write_late_s = array("d"), array("d")
        self.numbered: list[tuple[int, float, int]] = []
        self._on_its_way: deque[_OnItsWay] = deque()
        self._refused_s: float | None = None
        self.sounding = True  # a board may emit sound from power-up on
        self._log = os.open(job.log, os.O_WRONLY | os.O_APPEND) if job.log else -1
        self._unwritten: deque[str] = deque()
        self._port: Transport | None = self._open()
        self.begin_s = now_s()

    def _open(self) -> Transport:
        port = open_port(self.job.port, self.job.baud)
        if isinstance(port, SerialTransport) and may_be_virtual(self.job.port):
            port.await_report()
        return port

    def free_s(self, now: float) -> float:
        """Return the time at which the line is free [s]. Raises PortLost if the port is lost or accepts no bytes."""
        self._poll(now)
        if self.line.stuck_s(now) > self.job.lost_s and (self._refused_s is not None or self._on_its_way):
            raise self._stuck()
        return self.line.free_s(now)

    @property
    def retry_s(self) -> float:
        """Time before which the next frame must not be written [s]."""
        return 0.0 if self._refused_s is None else self._refused_s + RETRY_S

    def _stuck(self) -> PortStuck:
        return PortStuck(f"{self.job.port} has accepted no bytes for {self.job.lost_s:g} s")

    def _poll(self, now: float) -> None:
        port = self._open_port()
        out = self.line.note_waiting(port.waiting(), now, self._refused_s is not None)
        while self._on_its_way and self._on_its_way[0].end <= out:
            frame = self._on_its_way.popleft()
            # The clock of this process is finer, unless the line was blocked
            self.late_s[frame.number] = max(self.late_s[frame.number], now - READING_AGE_S - frame.due_s)

    def hand(self, data: bytes, due_s: float, planned_s: float, number: int = -1) -> bool:
        """Write a frame; return False if the system did not accept all of it. Then the next write is a whole frame.

        due_s: target time of its last byte on the line; planned_s: planned time of writing, both on `now_s`
        number: number of a frame whose time on the line `on_line` reports later
        Raises PortLost if the port is lost.
        """
        began = now_s()
        if not self._offer(data, began):
            return False
        self.frames += 1
        if len(self.late_s) < MOST_RECORDED:
            self.write_late_s.append(now_s() - planned_s)
            self.late_s.append(self.line.free_s(began) - due_s)
            if number >= 0 and self.job.tells_frames:
                self.numbered.append((number, due_s, len(self.late_s) - 1))
        self._on_its_way.append(_OnItsWay(self.line.written, due_s, len(self.late_s) - 1))
        return True

    def on_line(self) -> list[tuple[int, float]]:
        """Return the number of each numbered frame, and the time when its last byte was on the line, on `now_s` [s]."""
        return [(number, due_s + self.late_s[row]) for number, due_s, row in self.numbered]

    def _offer(self, data: bytes, now: float) -> bool:
        self.sounding = True
        port = self._open_port()
        written = port.offer(data) if isinstance(port, SerialTransport) else len(data) * port.write(data)
        if written:
            self.line.hand(written, now)
            if self._log >= 0:
                self._unwritten.append(log_line(now - self.begin_s, data, whole=written == len(data)))
        whole = written == len(data)
        self._refused_s = None if whole else now
        self.cut += 0 < written < len(data)
        return whole

    def _open_port(self) -> Transport:
        if self._port is None:
            raise PortLost(f"{self.job.port} is closed")
        return self._port

    def send_start(self) -> None:
        """Put the board into a defined, silent state. Raises PortLost."""
        self._send_whole(self.start)
        self.sounding = False

    def send_stop(self) -> None:
        """Silence the board, and return when the bytes are sent. Raises PortLost."""
        self._send_whole(self.stop)
        self.sounding = False

    def _send_whole(self, data: bytes) -> None:
        if not data:
            return
        began = now_s()
        while not self._offer(data, now_s()):
            self._wait_for_line(began, RETRY_S)
        while (rest := self.free_s(now_s()) - now_s()) > 0.0 or self._open_port().waiting():
            self._wait_for_line(began, max(rest, 1e-3))
        self._on_its_way.clear()

    def _wait_for_line(self, began: float, rest: float) -> None:
        now = now_s()
        self._poll(now)
        if self.line.stuck_s(now) > self.job.lost_s and now - began > self.job.lost_s:
            raise self._stuck()
        time.sleep(min(rest, RETRY_S))

    # -- after the port was lost ---------------------------------------------------------------------------------------

    def exists(self) -> bool:
        """Return whether the port exists: as a file, or, for ports without a file, as an open connection."""
        port = self.job.port
        return self._port is not None or (not (self.is_url or port.startswith("/dev/pts/")) and os.path.exists(port))

    @property
    def is_url(self) -> bool:
        return "://" in self.job.port or self.job.port.startswith(AUTD3)

    def try_stop(self) -> bool:
        """Reopen a lost port to silence the board; return whether this succeeded."""
        try:
            if self._port is None:
                self._port = self._open()
                self.line = LineClock(self.line.byte_s)
                self._on_its_way.clear()
            self.send_stop()
        except PortStuck:
            return False
        except PortLost:
            self.close_port()
            return False
        except DeviceError:
            return False
        return True

    def close_port(self) -> None:
        if self._port is not None:
            self._port.close()
            self._port = None

    # -- the log -------------------------------------------------------------------------------------------------------

    def write_log(self, most: int = 1) -> None:
        """Write this number of waiting lines. A full disk ends the log, not the sound."""
        while self._unwritten and most > 0:
            try:
                os.write(self._log, self._unwritten.popleft().encode())
            except OSError as error:
                self.log_error = error.strerror or "the disk is full"
                self._unwritten.clear()
                os.close(self._log)
                self._log = -1
            most -= 1

    log_error = ""

    def close(self) -> None:
        self.close_port()
        if self._log >= 0:
            self.write_log(len(self._unwritten))
        if self._log >= 0:
            os.close(self._log)
            self._log = -1
