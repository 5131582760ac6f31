"""One transducer after the other: what a board emits in the times that the table says."""

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.drive.boards import BOARDS
from palmfield.drive.frame_log import read_log
from palmfield.tables import read_table

RUN = CliRunner()


@pytest.mark.parametrize("board", ["sonicsurface", "ultraino", "openmpd"])
def test_each_sounds_alone_in_its_time(board, tmp_path):
    some = [3, 60, 7]
    line = ["calibrate", "sound", board, "--dwell", "0.3", "--pause", "0.1", "--record", str(tmp_path / "b.bin")]
    line += ["--times", str(tmp_path / "t.csv"), "--log", str(tmp_path / "b.jsonl")]
    said = RUN.invoke(app, line + [word for number in some for word in ("--element", str(number))])
    assert said.exit_code == 0, said.output
    head, pieces = read_log(tmp_path / "b.jsonl")
    assert head.array == BOARDS[board].layouts[0]
    twin = head.playable.wired_twin()
    changes = [change for piece in pieces for change in twin.feed(piece.data, piece.time_s)]
    changes += twin.until(twin.time_s + 0.1)
    first = next(change.time_s for change in changes if change.amplitudes.any())
    table, _ = read_table(tmp_path / "t.csv")
    start = first - table["from_s"][0]
    np.testing.assert_array_equal(table["element"], some)
    for number, begin, end in zip(some, table["from_s"], table["to_s"], strict=True):
        for time_s, on in ((begin + 0.05, True), (end - 0.02, True), (end + 0.08, False)):
            now = [change.amplitudes for change in changes if change.time_s <= start + time_s][-1]
            assert np.flatnonzero(now).tolist() == ([number] if on else [])


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["autd2018"], "takes a focus"),
        (["sonicsurface", "--element", "256"], "allowed: 0 to 255"),
        (["sonicsurface", "--element", "3", "--element", "3"], "element 3 is given twice"),
        (["sonicsurface", "--dwell", "0.001"], "dwell of 0.001 s; allowed: 11.2 ms"),
        (["sonicsurface", "--pause", "nan"], "pause of nan s"),
    ],
)
def test_what_cannot_be_played(more, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said = RUN.invoke(app, ["calibrate", "sound", *more, "--record", "b.bin"])
    assert words in str(said.exception) and not (tmp_path / "sounding.csv").exists()
