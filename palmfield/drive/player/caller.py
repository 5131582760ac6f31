"""The player in the process of the caller: it starts the process of the player, sends frames, and receives results."""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any, Self

from palmfield.drive.board import Board
from palmfield.drive.playback import TimedFrame
from palmfield.drive.player.messages import END, FRAME, JOB, MUTE, SCHEDULE, Inbox, Job, LiveFrame, Schedule, packed
from palmfield.drive.player.report import PlayReport
from palmfield.drive.ports import open_port
from palmfield.errors import DeviceError
from palmfield.interrupts import handling, in_main_thread, leave

STARTS_WITHIN_S = 30.0
POSIX = os.name == "posix"
PACKAGES = str(Path(__file__).parents[3])
"""Path on which Python finds palmfield."""


ENDS = ("SIGTERM", "SIGHUP", "SIGQUIT")
"""Signals that are converted to SystemExit, so that `finally` runs. SIGINT is KeyboardInterrupt already."""


@contextlib.contextmanager
def signals_to(alarm: socket.socket, silent_within_s: float) -> Iterator[None]:
    """In the block, write the numbers of signals to a socket without delay, also while Python is busy.

    alarm: socket that never blocks; silent_within_s: time to silence the board before Ctrl-Z stops this process
    Signals are caught only in the main thread. Signals that the process ignores are not caught (as SIGHUP under nohup).
    """
    if not in_main_thread():
        yield
        return

    def stop(number: int, _frame: FrameType | None) -> None:
        time.sleep(silent_within_s)
        signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
        # The process continues here after SIGCONT
        signal.signal(number, stop)
        with contextlib.suppress(OSError):
            alarm.send(bytes([signal.SIGCONT]))

    with handling({**dict.fromkeys(ENDS, leave), "SIGTSTP": stop}):
        wakeup = signal.set_wakeup_fd(alarm.fileno(), warn_on_full_buffer=False)
        try:
            yield
        finally:
            signal.set_wakeup_fd(wakeup)


class Player:
    """A board on a port, played by a separate process. Use as a context manager: at its end the board is silent.

    In the block, in the main thread, SIGTERM, SIGHUP and SIGQUIT become SystemExit, and Ctrl-Z silences the board
    before it stops the program.

    priority: priority of the process, in words; silent: reason why live frames are silent, or empty
    begin_s: beginning of the log, on time.monotonic() [s]; report: report of the last play, after `close`
    log_error: reason why the log ended early, after `close`; else empty
    """

    def __init__(
        self,
        board: Board,
        port: str,
        *,
        log: str | Path | None = None,
        on_trouble: Callable[[str], None] | None = None,
        **settings: Any,
    ) -> None:
        """port: device or pyserial URL; log: file to which lines of a log are added
        on_trouble: called with a sentence when the port is lost and the player tries to silence the board
        settings: other fields of `palmfield.drive.player.messages.Job`
        Raises DeviceError for a board without bytes, for a port that cannot be opened, and on a system without POSIX.
        """
        if not POSIX:
            raise DeviceError(
                "playing a board needs a separate process, which needs Linux or macOS; on this system write the "
                "bytes to a file (--record)"
            )
        if board.line is None:
            raise DeviceError(f"board '{board.name}' takes no bytes, so it has no port; use another board")
        self.board, self.port = board, port
        self.priority = self.silent = self.log_error = ""
        self.begin_s = 0.0
        self.report: PlayReport | None = None
        self._on_trouble = on_trouble
        self._ended: dict[str, Any] | None = None
        self._closed = self._lost = False
        job = Job(
            port, board.line.baud, board.line.bytes_per_s, board.start.hex(), board.stop.hex(),
            log="" if log is None else str(log), **settings,
        )  # fmt: skip
        self._talk, talk = socket.socketpair()
        self._alarm, alarm = socket.socketpair()
        for end in (self._talk, self._alarm):
            end.setblocking(False)
        # A packet is sent immediately, and a long schedule in few pieces
        self._talk.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        paths = [PACKAGES, *filter(None, [os.environ.get("PYTHONPATH")])]
        # In a separate session, so that signals of the terminal reach only the caller, which handles them
        self._process = subprocess.Popen(
            [sys.executable, "-m", "palmfield.drive.player.process", str(talk.fileno()), str(alarm.fileno())],
            pass_fds=(talk.fileno(), alarm.fileno()), stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            start_new_session=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        )  # fmt: skip
        talk.close()
        alarm.close()
        self._inbox = Inbox(self._talk)
        silent_within_s = 0.05 + 2.0 * board.frame_time_s + board.line.time_s(len(board.stop))
        self._signals = signals_to(self._alarm, silent_within_s)
        self._signals.__enter__()
        try:
            self._send(JOB, job.packed())
            ready = self._until("ready", time.monotonic() + STARTS_WITHIN_S)
        except BaseException:
            self.close()
            raise
        self.priority, self.begin_s = str(ready["priority"]), float(ready["begin_s"])

    # -- frames --------------------------------------------------------------------------------------------------------

    def play(
        self,
        frames: Iterable[tuple[float, bytes] | TimedFrame],
        *,
        duration_s: float = 0.0,
        on_progress: Callable[[int, int], None] | None = None,
        on_sound: Callable[[float], None] | None = None,
    ) -> PlayReport:
        """Send frames so that they are emitted at their times; return when all are played and the board is silent.

        frames: (time of emission since the start [s], bytes), times ascending; duration_s: least end of the last frame,
            since the start [s]
        on_progress: called with the numbers of frames sent and skipped, a few times per second
        on_sound: called with the time of emission of the first frame, on time.monotonic() [s], when the frame is in
            transit, usually before it is emitted
        Of several due frames the newest is sent. Raises DeviceError if the board is lost or the player has ended.
        """
        listed = list(frames)
        schedule = Schedule([one[0] for one in listed], [one[1] for one in listed], duration_s)
        self._send(SCHEDULE, schedule.packed())
        return PlayReport(**self._until("played", None, on_progress, on_sound)["played"])

    def send(self, steps: Sequence[bytes], level: float = 1.0, made_s: float | None = None, due_s: float = 0.0) -> None:
        """Send a live frame. It sounds until a newer frame comes, or fades out after `stale_s`.

        steps: the same frame at rising levels up to its own, of equal length, for the ramp; one frame if the board has
            no levels
        level: level of the sound, 0 for silence; made_s: time of the input data, on time.monotonic() [s], None: now
        due_s: target time of the last byte on the line, on the same clock, later than those of all earlier frames; 0:
            as soon as possible. Of several due frames the newest is sent
        Raises DeviceError if the board is lost or the player has ended.
        """
        made = time.monotonic() if made_s is None else made_s
        self._send(FRAME, LiveFrame(made, level, steps, due_s).packed())
        self._read_lines()

    def mute(self) -> None:
        """Fade out live frames, until the next one."""
        self._send(MUTE)
        self._read_lines()

    @property
    def played(self) -> PlayReport:
        """Return `report`, after `close`. Raises DeviceError if the process of the player ended without a report."""
        if self.report is None:
            raise DeviceError(f"the player process ended unexpectedly, so the output on {self.port} is unknown")
        return self.report

    def check(self) -> None:
        """Raise DeviceError if the board is lost or the player has ended since its last message."""
        self._read_lines()

    # -- messages of the player ----------------------------------------------------------------------------------------

    def _send(self, kind: bytes, data: bytes = b"") -> None:
        view = memoryview(packed(kind, data))
        while view:
            try:
                view = view[self._talk.send(view) :]
            except BlockingIOError:
                select.select([], [self._talk], [], 0.1)
            except OSError:
                self._inbox.read()
                self._died()

    def _until(
        self,
        key: str,
        ends_s: float | None,
        on_progress: Callable[[int, int], None] | None = None,
        on_sound: Callable[[float], None] | None = None,
    ) -> dict[str, Any]:
        """Return the first line with this key. Raises DeviceError if the player fails or ends earlier."""
        while ends_s is None or time.monotonic() < ends_s:
            select.select([self._talk], [], [], 0.1)
            for line in self._read_lines():
                if key in line:
                    return line
                if "progress" in line and on_progress is not None:
                    on_progress(*line["progress"])
                if "sounds_s" in line and on_sound is not None:
                    on_sound(float(line["sounds_s"]))
            if self._ended is not None:
                raise DeviceError(f"the player has ended: {self._ended['ended']}; the board is off")
        raise DeviceError(
            f"the player process did not respond for {STARTS_WITHIN_S:g} s; check whether the machine is overloaded"
        )

    def _read_lines(self) -> list[dict[str, Any]]:
        self._inbox.read()
        lines = []
        for line in self._inbox.lines():
            if "failed" in line:
                raise DeviceError(line["failed"])
            if "silent" in line:
                self.silent = line["silent"]
            if "trying" in line and self._on_trouble is not None:
                self._on_trouble(f"{line['lost']}; trying to silence the board (press Ctrl-C to stop trying)")
            if "ended" in line:
                self._ended, self.report = line, PlayReport(**line["played"])
                self.log_error = line["log_error"]
            lines.append(line)
        if self._ended is not None and not self._closed:
            self._raise_end(self._ended)
        if self._inbox.closed and self._ended is None:
            self._died()
        return lines

    def _raise_end(self, end: dict[str, Any]) -> None:
        """Raise DeviceError with the reason why the player has ended; no error if the caller requested the end."""
        if self._lost or not (end["lost"] or end["broken"] or end["why_on"] or end["ended"].startswith("the player")):
            return
        self._lost = True
        sounds = self.board.when_host_dies if end["why_on"] else "the board is off"
        why = f" ({end['why_on']})" if end["why_on"] else ""
        if end["lost"]:
            what = f"lost the board on {self.port} after {end['played']['frames']} frames: {end['lost']}"
        else:
            what = f"the player has ended: {end['broken'] or end['ended']}"
        raise DeviceError(f"{what}; {sounds}{why}")

    def _died(self) -> None:
        """Silence the board from this process, after the player has ended without a message. Raise DeviceError."""
        if self._lost:
            return
        self._lost = True
        code = self._process.wait(5.0)
        how = f"by signal {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        try:
            _silence(self.board, self.port)
        except DeviceError as error:
            raise DeviceError(
                f"the player process on {self.port} was ended {how}, and the board could not be silenced "
                f"({error}); {self.board.when_host_dies}"
            ) from None
        raise DeviceError(f"the player process on {self.port} was ended {how}; the board is off")

    def close(self) -> None:
        """Silence the board and free the port; return when this is done.

        Raises DeviceError if the board could not be silenced, unless this error was raised before.
        """
        if self._closed:
            return
        error: DeviceError | None = None
        try:
            try:
                if self._ended is None and not self._inbox.closed:
                    self._send(END)
            except DeviceError as lost:
                error = lost
            while self._ended is None and not self._inbox.closed:
                select.select([self._talk], [], [], 0.1)
                try:
                    self._read_lines()
                except DeviceError as lost:
                    error = error or lost
            self._process.wait(5.0)
        finally:
            self._closed = True
            self._signals.__exit__(None, None, None)
            self._talk.close()
            self._alarm.close()
        if error is not None:
            raise error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if exception[0] is None:
            self.close()
            return
        with contextlib.suppress(DeviceError):
            self.close()


def _silence(board: Board, port: str) -> None:
    """Silence the board from this process. Raises DeviceError if this fails."""
    transport = open_port(port, None if board.line is None else board.line.baud)
    try:
        while board.stop and not transport.write(board.stop):
            pass
        transport.flush()
    finally:
        transport.close()
