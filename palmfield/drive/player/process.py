"""Process of the player: `python -m palmfield.drive.player.process TALK ALARM`, numbers of two sockets of the caller.

It loads neither NumPy nor Warp nor MuJoCo. It plays the frames received over the first socket. The second socket
transmits numbers of signals of the caller, which the system writes even while the caller is busy. The board is silenced
at the request of the caller, if the caller ends or is stopped, and if a signal ends this process.
"""

import contextlib
import ctypes
import gc
import json
import os
import select
import signal
import socket
import sys
import time
from typing import Any

from palmfield.drive.player.board_end import BoardEnd, PortStuck
from palmfield.drive.player.budget import SoundBudget
from palmfield.drive.player.messages import END, FRAME, JOB, MUTE, SCHEDULE, Inbox, Job, LiveFrame, Schedule
from palmfield.drive.player.report import quantile
from palmfield.drive.player.sources import LiveSource, ScheduleSource, Source
from palmfield.drive.transport import PortLost
from palmfield.errors import PalmfieldError

now_s = time.monotonic
SPIN_S = 80e-6
"""Time before a moment at which a wait ends; then a busy loop reads the clock [s]."""
LOOK_S = 0.02
"""Longest wait between checks of the caller [s]."""
PARENT_S = 0.05
PROGRESS_S = 0.1
IDLE_S = 200e-6
"""Least free time in which a line of the log is written [s]."""
ENDS = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
STOPS, GOES_ON = int(getattr(signal, "SIGTSTP", 0)), int(getattr(signal, "SIGCONT", 0))


PRIORITY = 60
PR_SET_TIMERSLACK = 29
MCL_CURRENT, MCL_FUTURE = 1, 2


def collect_no_garbage() -> None:
    """Switch off garbage collection, which a player does not need, and let waits end on time, not 50 us later."""
    gc.collect()
    gc.freeze()
    gc.disable()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)


def request_priority() -> str:
    """Request SCHED_FIFO and locked memory; return the result in words, with reasons."""
    if not hasattr(os, "sched_setscheduler"):
        return "normal priority (this system has no SCHED_FIFO)"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError as error:
        return (
            f"normal priority ({(error.strerror or 'refused').lower()}: a line '@realtime - rtprio {PRIORITY}' in "
            "/etc/security/limits.conf permits SCHED_FIFO)"
        )
    result = f"SCHED_FIFO {PRIORITY}"
    if sys.platform == "linux" and ctypes.CDLL(None).mlockall(MCL_CURRENT | MCL_FUTURE) != 0:
        result += ", memory not locked"
    return result


class Caller:
    """Requests of the caller, by messages and signals, and whether the caller exists.

    ended: reason to end, or empty; signals: signals that requested the end; paused: whether the board must be silent"""

    def __init__(self, talk: socket.socket, alarm: socket.socket) -> None:
        self.talk, self.alarm = talk, alarm
        self.inbox = Inbox(talk)
        self.ended, self.signals = "", 0
        self._paused = self._stopped = False
        self._parent, self._looked_s = os.getppid(), now_s()
        self._closed: set[socket.socket] = set()

    @property
    def paused(self) -> bool:
        return self._paused or self._stopped

    def end(self, why: str, by_signal: bool = False) -> None:
        self.ended = self.ended or why
        self.signals += by_signal

    def listen(self) -> list[tuple[bytes, bytes]]:
        """Read signals, and return the received messages."""
        try:
            for number in self.alarm.recv(64):
                self._signal(number)
        except BlockingIOError:
            pass
        self.inbox.read()
        if self.inbox.closed:
            self.end("the parent process has ended")
        self._look()
        return list(self.inbox.messages())

    def _signal(self, number: int) -> None:
        if number in [getattr(signal, name, 0) for name in ENDS]:
            self.end(f"the parent process received {signal.Signals(number).name}", by_signal=True)
        elif number in (STOPS, GOES_ON):
            self._paused = number == STOPS

    def _look(self) -> None:
        """Detect a caller that has ended while its children hold the sockets, or that is stopped (SIGSTOP)."""
        now = now_s()
        if now - self._looked_s < PARENT_S:
            return
        self._looked_s = now
        if os.getppid() != self._parent:
            self.end("the parent process has ended")
            return
        with contextlib.suppress(OSError, IndexError), open(f"/proc/{self._parent}/stat", "rb") as file:
            self._stopped = file.read().rpartition(b")")[2].split()[0] in (b"T", b"t")

    def wait(self, until_s: float) -> bool:
        """Wait until a moment, a message, or at most LOOK_S; return whether the moment is reached."""
        rest = until_s - SPIN_S - now_s()
        if rest > 0.0:
            open_ones = [one for one in (self.talk, self.alarm) if one not in self._closed]
            for one in select.select(open_ones, [], [], min(rest, LOOK_S))[0]:
                # A closed socket is always ready
                with contextlib.suppress(OSError):
                    if not one.recv(1, socket.MSG_PEEK):
                        self._closed.add(one)
                return False
            if rest > LOOK_S:
                return False
        while now_s() < until_s:
            pass
        return True

    def send(self, **what: Any) -> None:
        """Send a line without waiting, because the caller may not read it."""
        with contextlib.suppress(OSError):
            self.talk.send(json.dumps(what).encode() + b"\n")


class Session:
    """A board and its caller, until one of them is lost."""

    def __init__(self, board: BoardEnd, caller: Caller, priority: str) -> None:
        self.board, self.caller, self.priority = board, caller, priority
        self.source: Source | None = None
        self._reported_s = 0.0
        self._frames_before = 0
        self._reason = ""
        self._first_sound_s: float | None = None
        self._last_sound_s: float | None = None

    def run(self) -> None:
        """Play until the caller ends the play. Raises PortLost."""
        self.board.send_start()
        self.caller.send(ready=True, priority=self.priority, begin_s=self.board.begin_s)
        while not self.caller.ended:
            self._execute(self.caller.listen())
            if self.caller.ended:
                break
            if self.caller.paused:
                self._pause()
                continue
            if self.source is None:
                self.board.free_s(now_s())  # raises an error if the port is lost
                self.caller.wait(now_s() + LOOK_S)
                continue
            self._step(self.source)
        self._fade()

    def _fade(self) -> None:
        """Fade live sound out within the ramp, unless the caller requests the end again, or is stopped."""
        source, signals = self.source, self.caller.signals
        if not isinstance(source, LiveSource) or source.ramp_s <= 0.0:
            return
        source.fade()
        ends = now_s() + source.ramp_s
        while not source.silent and now_s() < ends and self.caller.signals == signals and not self.caller.paused:
            self.caller.listen()
            self._step(source)

    def _execute(self, messages: list[tuple[bytes, bytes]]) -> None:
        for kind, data in messages:
            if kind == END:
                self.caller.end("asked")
            elif kind == SCHEDULE:
                first_s = max(now_s(), self.board.free_s(now_s())) + 2e-3
                self._begin(ScheduleSource(Schedule.unpacked(data), self.board.line.byte_s, first_s))
            elif kind == FRAME:
                if not isinstance(self.source, LiveSource):
                    job = self.board.job
                    budget = SoundBudget(job.on_time_s, job.duty, job.duty_window_s)
                    live = LiveSource(
                        self.board.line.byte_s, self.board.stop, ramp_s=job.ramp_s, stale_s=job.stale_s,
                        refresh_s=job.refresh_s, budget=budget,
                    )  # fmt: skip
                    self._begin(live)
                assert isinstance(self.source, LiveSource)
                self.source.accept(LiveFrame.unpacked(data))
            elif kind == MUTE and isinstance(self.source, LiveSource):
                self.source.muted = True

    def _begin(self, source: Source) -> None:
        self.source = source
        self._frames_before = self.board.frames
        self._first_sound_s = self._last_sound_s = None

    def _step(self, source: Source) -> None:
        board = self.board
        now = now_s()
        choice = source.choose(now, board.free_s(now))
        if choice is None:
            board.send_stop()
            self.source = None
            self.caller.send(played=self.report(source), off=True)
            return
        at = max(choice.at_s, board.retry_s)
        if at > now:
            if at - now > IDLE_S:
                board.write_log()
            self._send_progress(source, now)
            if not self.caller.wait(at):
                return
        if choice.data and board.hand(choice.data, choice.due_s, max(at, now), choice.number):
            source.sent(now_s())
            self._last_sound_s = board.line.free_s(now_s())
            if self._first_sound_s is None:
                self._first_sound_s = self._last_sound_s
                self.caller.send(sounds_s=self._first_sound_s)

    def _pause(self) -> None:
        """Be silent while the caller is stopped, then continue."""
        began = now_s()
        if self.board.sounding:
            self.board.send_stop()
        while self.caller.paused and not self.caller.ended:
            self._execute(self.caller.listen())
            self.caller.wait(now_s() + LOOK_S)
        if self.source is not None:
            self.source.shift(now_s() - began)

    def _send_progress(self, source: Source, now: float) -> None:
        if now - self._reported_s < PROGRESS_S:
            return
        self._reported_s = now
        if isinstance(source, LiveSource) and source.reason != self._reason:
            self._reason = source.reason
            if self._reason:
                self.caller.send(silent=self._reason)
        self.caller.send(progress=[self.board.frames - self._frames_before, source.skipped])

    def report(self, source: Source | None) -> dict[str, Any]:
        """Return the report on all frames of a source, as fields of `PlayReport`."""
        late = self.board.late_s[self._frames_before :]
        delays = self.board.write_late_s[self._frames_before :]
        return {
            "frames": self.board.frames - self._frames_before,
            "skipped": 0 if source is None else source.skipped,
            "late_s": max(late, default=0.0),
            "late_p99_s": quantile(late, 0.99),
            "late_p50_s": quantile(late, 0.5),
            "write_p99_s": quantile(delays, 0.99),
            "write_worst_s": max(delays, default=0.0),
            "cut": self.board.cut,
            "seconds": now_s() - self.board.begin_s,
            "priority": self.priority,
            "first_s": self._first_sound_s,
            "last_s": self._last_sound_s,
            "on_line": self.board.on_line(),
        }


def silence(board: BoardEnd, caller: Caller, lost: str) -> str:
    """Silence the board, with retries as long as its port exists; return the reason of a failure, or "".

    lost: reason why the port was lost, or ""
    """
    began, reported, signals = now_s(), False, caller.signals
    gone_since: float | None = None
    while True:
        if board.exists() and board.try_stop():
            return ""
        caller.listen()
        now = now_s()
        if caller.signals > signals:
            return "given up"
        patience = board.job.patience_s
        if board.exists():
            gone_since = None
            if patience and now - began > patience:
                return f"the port has accepted no bytes for {patience:g} s"
        else:
            gone_since = gone_since or now
            # A URL has no file to wait for, so it is reopened
            if board.is_url and board.try_stop():
                return ""
            if board.job.port.startswith("/dev/pts/"):
                return "the port has disappeared"
            if now - gone_since > board.job.replug_s:
                return f"the port has disappeared and did not return within {board.job.replug_s:g} s"
        if not reported:
            reported = True
            caller.send(lost=lost or "the port accepts no bytes", trying=True)
        caller.wait(now + LOOK_S)


def main() -> int:
    talk, alarm = (socket.socket(fileno=int(number)) for number in sys.argv[1:3])
    for name in ("SIGTSTP", "SIGTTIN", "SIGTTOU", "SIGPIPE"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    talk.setblocking(True)
    caller = Caller(talk, alarm)
    for name in ENDS:
        if hasattr(signal, name):
            number = getattr(signal, name)
            signal.signal(number, lambda sent, _: caller.end(f"the player received {signal.Signals(sent).name}", True))
    alarm.setblocking(False)
    job = first_job(talk)
    talk.setblocking(False)
    collect_no_garbage()
    priority = request_priority() if job.realtime else "normal priority (requested)"
    try:
        board = BoardEnd(job)
    except PalmfieldError as error:
        caller.send(failed=str(error))
        return 1
    session = Session(board, caller, priority)
    lost, broken = "", ""
    try:
        session.run()
    except PortLost as error:
        lost = str(error)
        if not isinstance(error, PortStuck):
            board.close_port()
    except PalmfieldError as error:
        # Units that are opened by the first bytes are missing
        board.close()
        caller.send(failed=str(error))
        return 1
    except BaseException as error:
        broken = f"{type(error).__name__}: {error}"
    why = silence(board, caller, lost) if board.sounding or lost or broken else ""
    board.close()
    talk.setblocking(True)
    caller.send(
        ended=caller.ended, lost=lost, broken=broken, off=not why, why_on=why, played=session.report(session.source),
        log_error=board.log_error,
    )  # fmt: skip
    return 0


def first_job(talk: socket.socket) -> Job:
    """Return the first message. Raises EOFError if the caller ends without it."""
    inbox = Inbox(talk)
    talk.setblocking(False)
    while True:
        select.select([talk], [], [])
        inbox.read()
        for kind, data in inbox.messages():
            if kind == JOB:
                return Job.unpacked(data)
        if inbox.closed:
            raise EOFError("the parent process has ended")


if __name__ == "__main__":
    sys.exit(main())
