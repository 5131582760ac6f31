"""docs/drive_your_array.md, followed as a new user would: every command, in order, on the virtual board."""

import re
import shlex
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.drive.boards import BOARDS
from palmfield.drive.virtual import VirtualBoard

pytestmark = pytest.mark.wall_clock

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "drive_your_array.md").read_text()
NOT_HERE = ("pip install .", "palmfield board sonicsurface --virtual")
"""The first is how this test came to run, the second goes on for ever: the test has the board itself."""


@pytest.mark.slow
def test_the_page_can_be_followed(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mjcf").symlink_to(ROOT / "mjcf")
    blocks = re.findall(r"```sh\n(.*?)```", PAGE, flags=re.DOTALL)
    commands = [line for block in blocks for line in block.splitlines() if line not in NOT_HERE]
    assert len(commands) >= 12
    said = {}
    with VirtualBoard(BOARDS["sonicsurface"], realtime=True) as board:
        for line in commands:
            here = line.replace("/dev/ttyUSB0", board.port).replace("$PWD", str(tmp_path))
            words = shlex.split(here.replace("--duration 2", "--duration 0.3"))
            assert words[0] == "palmfield"
            done = CliRunner().invoke(app, words[1:])
            # 4: played, with frames left out, as happens where something else keeps this machine
            allowed = (0, 4) if "--port" in line else (0,)
            assert done.exit_code in allowed, (line, done.output, done.exception)
            said[line] = done.output
    assert "the board is off" in said[next(line for line in commands if "--log first.jsonl" in line)]
    assert any(change.amplitudes.any() for change in board.emitted)
    assert not board.emitted[-1].amplitudes.any() and not board.flags
    for name in ("first.png", "sounding.csv", "board.json", "board.png", "loop/trial.png"):
        assert (tmp_path / name).stat().st_size > 0
