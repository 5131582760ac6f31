"""docs/boards.md: its example of foci that are sent live runs as it stands, on the virtual board that it has."""

import os
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "boards.md").read_text()
pytestmark = [pytest.mark.skipif(os.name != "posix", reason="the player needs POSIX"), pytest.mark.wall_clock]


def test_foci_are_sent_live(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    space = {}
    exec(code, space)
    report, virtual, board = space["player"].report, space["virtual"], space["board"]
    # At 90 a second or as fast as this machine lets it; the line takes 89
    assert 1 <= report.frames <= 46 + 2 and f"frames={report.frames}" in capsys.readouterr().out
    assert any(one.amplitudes.all() for one in virtual.emitted)
    assert virtual.received.startswith(board.start) and virtual.received.endswith(board.stop)
