"""docs/tutorials/drive_your_array.md, followed as a new user would: every command, in order, on the virtual board."""

from pathlib import Path

import pytest
from page_code import blocks, run_page

from palmfield.drive.boards import BOARDS
from palmfield.drive.virtual import VirtualBoard

pytestmark = pytest.mark.wall_clock

PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "drive_your_array.md"


@pytest.mark.slow
def test_the_page_can_be_followed(tmp_path, monkeypatch):
    with VirtualBoard(BOARDS["sonicsurface"], realtime=True) as board:
        # 4: played, with frames left out, as happens where something else keeps this machine
        done = run_page(
            blocks(PAGE.read_text(encoding="utf-8")), tmp_path, monkeypatch,
            instead={"/dev/ttyUSB0": board.port, "--duration 2": "--duration 0.3"}, allowed=(0, 4),
        )  # fmt: skip
    assert len(done.said) >= 12 and len(done.not_run) == 2
    assert "the board is off" in next(said for line, said in done.said.items() if "--log first.jsonl" in line)
    assert any(change.amplitudes.any() for change in board.emitted)
    assert not board.emitted[-1].amplitudes.any() and not board.flags
    for name in ("first.png", "sounding.csv", "board.json", "board.png", "loop/trial.png"):
        assert (tmp_path / name).stat().st_size > 0
