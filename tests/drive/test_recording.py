"""What is written instead of sent, by the line's rate and by what a line of that rate has time for."""

from itertools import pairwise

import numpy as np
import pytest

from palmfield.drive import record
from palmfield.drive.boards.sonicsurface import BOARD, FRAME_RATE_HZ, OFF_SEQUENCE
from palmfield.drive.frame_log import FrameLog, LogHead, read_log
from palmfield.errors import OutputError

FRAME_S = 258 / 23040


def schedule(count: int, interval_s: float) -> list[tuple[float, bytes]]:
    """Frames whose first 32 transducers tell their number in turn."""
    return [(n * interval_s, BOARD.encode(np.full(256, np.exp(2j * np.pi * n / 32)))) for n in range(count)]


def test_a_record_holds_what_the_line_would_have_carried(tmp_path):
    path = tmp_path / "run.bin"
    report = record(BOARD, schedule(2000, 0.001), path, duration_s=2.0)
    data = path.read_bytes()
    assert len(data) == report.frames * 258 + 2 * len(OFF_SEQUENCE)
    assert data.startswith(OFF_SEQUENCE) and data.endswith(OFF_SEQUENCE)
    assert report.frames == pytest.approx(2.0 * FRAME_RATE_HZ, abs=2) and report.frames + report.skipped == 2000
    assert report.late_s <= FRAME_S
    assert not path.with_name("run.bin.part").exists()
    again = tmp_path / "again.bin"
    record(BOARD, schedule(2000, 0.001), again, duration_s=2.0)
    assert again.read_bytes() == data


def test_its_log_has_the_lines_times_and_the_last_frame_lasts(tmp_path):
    path = tmp_path / "run.jsonl"
    log = FrameLog(path, LogHead("sonicsurface", 256, "sonicsurface"))
    record(BOARD, schedule(20, 0.02), tmp_path / "run.bin", duration_s=1.0, log=log)
    times = [piece.time_s for piece in read_log(path)[1]]
    start_s = len(OFF_SEQUENCE) / 23040
    assert times[0] == 0.0
    # The first frame goes out at once, and the start is when its last byte is out
    np.testing.assert_allclose(times[1:-1], start_s + 0.02 * np.arange(20), atol=1e-6)
    assert times[-1] == pytest.approx(start_s + FRAME_S + 1.0, abs=1e-6)
    fast = tmp_path / "fast.jsonl"
    log = FrameLog(fast, LogHead("sonicsurface", 256, "sonicsurface"))
    record(BOARD, schedule(500, 0.003), tmp_path / "fast.bin", log=log)
    begun = [piece.time_s for piece in read_log(fast)[1]]
    assert min(b - a for a, b in pairwise(begun[1:])) >= FRAME_S - 1e-6


def test_no_frames_only_silence(tmp_path):
    report = record(BOARD, [], tmp_path / "run.bin")
    assert report.frames == report.skipped == 0
    assert (tmp_path / "run.bin").read_bytes() == 2 * OFF_SEQUENCE


def test_where_nothing_can_be_written(tmp_path):
    with pytest.raises(OutputError, match=r"cannot write .*No such file"):
        record(BOARD, schedule(3, 0.0), tmp_path / "missing" / "run.bin")
    (tmp_path / "run.bin.part").symlink_to("/dev/full")
    with pytest.raises(OutputError, match="cannot write"):
        record(BOARD, schedule(3, 0.0), tmp_path / "run.bin")
    assert not (tmp_path / "run.bin").exists()
