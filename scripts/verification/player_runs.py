"""Runs of the player during a busy solver: AUTD packets, also by a plain writer thread, and SonicSurface frames.

check_player.py makes a page of them; tests/drive/player/test_lateness.py asserts a short one.
"""

import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from faults import machine_pauses
from player_line import LineBytes, listened

from palmfield.drive.boards import BOARDS
from palmfield.drive.boards.autd2018 import PERIOD_S, Autd2018
from palmfield.drive.player import Player
from palmfield.drive.player.line_clock import LineClock
from palmfield.drive.player.report import PlayReport

AUTD = BOARDS["autd2018"]
SONIC = BOARDS["sonicsurface"]
FULL_WIDTH = 320
COUNTED = 30_000
"""Limit of numbers that fit a coordinate."""


@dataclass(frozen=True)
class Late:
    """Delays of packets [s]: 99th percentile and maximum."""

    p99_s: float
    worst_s: float

    @classmethod
    def of(cls, delays: Sequence[float]) -> "Late":
        return cls(float(np.percentile(delays, 99)), float(np.max(delays)))


@dataclass(frozen=True)
class Stream:
    """Result for packets.

    line: delay of the last byte on the line, from the times of hand-over and the rate of the line
    handed: delay of the hand-over; lost: number of packets handed over but not received
    """

    sent: int
    skipped: int
    lost: int
    line: Late
    handed: Late


@dataclass(frozen=True)
class AutdRun:
    """A run with AUTD packets. pauses: packets due while the machine was paused for more than half of one"""

    player: Stream
    thread: Stream
    report: PlayReport
    pauses: int


@dataclass(frozen=True)
class SonicRun:
    """A run with SonicSurface frames. whole: number of complete received frames"""

    report: PlayReport
    whole: int


def svds(ended: threading.Event) -> None:
    """Compute singular values of small matrices; half of it blocks the interpreter (GIL), half does not."""
    matrix = np.random.default_rng(0).standard_normal((120, 120))
    while not ended.is_set():
        np.linalg.svd(matrix)


@contextmanager
def busy(works: Sequence[Callable[[threading.Event], None]]) -> Iterator[None]:
    """Start a thread of this process for each function, which runs until its event is set."""
    ended = threading.Event()
    threads = [threading.Thread(target=work, args=(ended,), daemon=True) for work in works]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        for thread in threads:
            thread.join()


def numbered(count: int) -> list[bytes]:
    """Return AUTD packets whose focus encodes their number."""
    board = AUTD
    assert isinstance(board, Autd2018)
    return [board.packet((number % COUNTED, number // COUNTED, 0, FULL_WIDTH)) for number in range(count)]


def lost(line_bytes: LineBytes, sent: int) -> int:
    """Return how many of some numbered packets, sent once each, were not received."""
    board = AUTD
    assert isinstance(board, Autd2018)
    numbers, at, size = set(), 0, board.frame_bytes
    while at + size <= len(line_bytes.data):
        told = board.numbers(line_bytes.data[at : at + size])
        # After a packet of which the system took a part only the next one begins elsewhere
        at += size if told is not None else 1
        if told is not None and told[3] == FULL_WIDTH:
            numbers.add(told[:2])
    return sent - len(numbers)


def write_plainly(port: str, packets: Sequence[bytes], began: list[float], ended: list[float]) -> None:
    """Sleep until the time of each packet and write it.

    began, ended: lists that receive the delays of each write [s]
    """
    end = os.open(port, os.O_WRONLY | os.O_NOCTTY)
    start = time.monotonic() + 0.1
    for number, packet in enumerate(packets):
        due = start + number * PERIOD_S
        if (rest := due - time.monotonic()) > 0.0:
            time.sleep(rest)
        began.append(time.monotonic() - due)
        os.write(end, packet)
        ended.append(time.monotonic() - due)
    os.close(end)


def on_the_line(late: Sequence[float]) -> list[float]:
    """Return delays of the last bytes of packets on a line, from their hand-over delays at the due times [s]."""
    line = LineClock(AUTD.frame_time_s / AUTD.frame_bytes)
    due = [1.0 + number * PERIOD_S for number in range(len(late))]
    return [line.hand(AUTD.frame_bytes, at + by) - at - AUTD.frame_time_s for at, by in zip(due, late, strict=True)]


def stream_autd(seconds: float, works: Sequence[Callable[[threading.Event], None]], priority: bool) -> AutdRun:
    """Send packets at 2 kHz by the player and, at the same time, by a thread, each to its own line."""
    packets = numbered(round(seconds / PERIOD_S))
    began: list[float] = []
    ended: list[float] = []
    with listened() as line, listened() as other_line, machine_pauses() as pauses:
        writer = threading.Thread(target=write_plainly, args=(other_line.port, packets, began, ended))
        with Player(AUTD, line.port, realtime=priority) as player, busy(works):
            writer.start()
            report = player.play([(number * PERIOD_S, packet) for number, packet in enumerate(packets)])
            writer.join()
        stood = sum(math.ceil(pause / PERIOD_S - 0.5) for _, pause in pauses())
    played = Stream(
        report.frames, report.skipped, lost(line, report.frames), Late(report.late_p99_s, report.late_s),
        Late(report.write_p99_s, report.write_worst_s),
    )  # fmt: skip
    plain = Stream(len(packets), 0, lost(other_line, len(packets)), Late.of(on_the_line(began)), Late.of(ended))
    return AutdRun(played, plain, report, stood)


def play_sonic(seconds: float, works: Sequence[Callable[[threading.Event], None]], priority: bool) -> SonicRun:
    """Send frames of a SonicSurface at the full rate of its line."""
    drives = [np.full(SONIC.transducers, np.exp(2j * np.pi * step / 32)) for step in range(32)]
    frames = [SONIC.encode(drive) for drive in drives]
    times = [number * SONIC.frame_time_s for number in range(round(seconds / SONIC.frame_time_s))]
    with listened() as line, Player(SONIC, line.port, realtime=priority) as player, busy(works):
        report = player.play([(at, frames[number % 32]) for number, at in enumerate(times)])
    line_bytes = line.frames(len(frames[0]), len(SONIC.start))
    return SonicRun(report, sum(data in frames for data in line_bytes))
