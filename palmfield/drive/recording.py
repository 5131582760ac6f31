"""Write the bytes of frames to a file instead of a line."""

from collections.abc import Sequence
from contextlib import closing, nullcontext
from pathlib import Path

from palmfield.drive.board import Board
from palmfield.drive.frame_log import FrameLog
from palmfield.drive.playback import TimedFrame
from palmfield.drive.player.messages import Schedule
from palmfield.drive.player.report import PlayReport
from palmfield.drive.player.sources import on_the_line
from palmfield.drive.transport import FileTransport


def record(
    board: Board,
    frames: Sequence[tuple[float, bytes] | TimedFrame],
    path: str | Path,
    *,
    duration_s: float = 0.0,
    log: FrameLog | None = None,
) -> PlayReport:
    """Write the bytes for a board to a file. Frames for which the line has no time are omitted, as in the player.

    frames: (time of emission since the start [s], bytes), times ascending; duration_s: end of the last frame [s]
    log: receives each piece with its time on the line, and is closed at the end
    Raises OutputError if the file cannot be made or the disk is full. Then only its .part exists.
    """
    assert board.line is not None
    file = FileTransport(path)
    schedule = Schedule([one[0] for one in frames], [one[1] for one in frames], duration_s)
    sent, late_s = 0, 0.0
    free_s = board.line.time_s(len(board.start))
    begin_s = ends_s = free_s
    with closing(file), closing(log) if log is not None else nullcontext():

        def write(data: bytes, at_s: float) -> None:
            file.write(data)
            if log is not None:
                log.add(at_s, data)

        write(board.start, 0.0)
        try:
            for choice in on_the_line(schedule, board.line.time_s(1), free_s):
                write(choice.data, choice.at_s)
                ends_s = choice.at_s + board.line.time_s(len(choice.data))
                begin_s = choice.due_s - schedule.times_s[choice.number]
                sent, late_s = sent + 1, max(late_s, ends_s - choice.due_s)
        finally:
            write(board.stop, max(ends_s, begin_s + duration_s))
    return PlayReport(sent, len(frames) - sent, late_s)
