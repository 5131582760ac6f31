"""When a line is free, by hand."""

import pytest

from palmfield.drive.player.line_clock import READING_AGE_S, LineClock


def test_bytes_follow_one_another_at_the_lines_rate():
    line = LineClock(1e-3)
    assert line.hand(10, 5.0) == pytest.approx(5.010)
    assert line.hand(10, 5.002) == pytest.approx(5.020)
    assert line.free_s(5.015) == pytest.approx(5.020)
    assert line.free_s(6.0) == 6.0


def test_what_is_told_to_wait_counts_and_what_is_told_to_be_gone_does_not():
    line = LineClock(1e-3)
    line.hand(30, 0.0)
    # 0.1 s later the own clock says that all is out, the system that 30 bytes wait
    assert line.note_waiting(30, 0.1, refused=False) == 0
    assert line.free_s(0.1) == pytest.approx(0.1 + 0.030 - READING_AGE_S)
    line = LineClock(1e-3)
    line.hand(30, 0.0)
    # Told too early: a real port's buffer may be behind what tells
    assert line.note_waiting(0, 0.001, refused=False) == 30
    assert line.free_s(0.001) == pytest.approx(0.030)


def test_a_line_that_takes_nothing_is_stuck_since_its_last_byte():
    line = LineClock(1e-3)
    line.hand(30, 1.0)
    line.note_waiting(10, 1.02, refused=False)
    line.note_waiting(10, 2.02, refused=False)
    assert line.stuck_s(2.02) == pytest.approx(1.0)
    line.note_waiting(9, 2.03, refused=False)
    assert line.stuck_s(2.04) == pytest.approx(0.01)
    line.note_waiting(0, 9.0, refused=True)
    line.note_waiting(0, 9.5, refused=True)
    assert line.stuck_s(9.6) == pytest.approx(0.6)


def test_a_little_that_is_always_behind_is_found_and_old_news_are_not():
    line = LineClock(1e-3)
    behind, heard = 4e-3, 0.0
    for n in range(200):
        now = 1.0 + n * 1e-3
        if n % 10 == 0:
            line.hand(10, now)
        out = min(line.written, max(0.0, now - 1.0 - behind) * 1e3)
        line.note_waiting(line.written - int(out), now, refused=False)
        heard = line.free_s(now)
    assert heard == pytest.approx(1.2 + behind, abs=1.5e-3)
    line = LineClock(1e-3)
    out = 0.0
    for n in range(200):
        now = 1.0 + n * 1e-3
        if n % 10 == 0:
            line.hand(10, now)
        if n % 4 == 0:
            out = min(line.written, (now - 1.0) * 1e3)
        line.note_waiting(line.written - round(out), now, refused=False)
        heard = line.free_s(now)
    assert heard == pytest.approx(1.2, abs=1.5e-3)
