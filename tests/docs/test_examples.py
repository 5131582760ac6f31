"""examples/: at most 40 lines each, and each runs as it stands and prints something with a number in it."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.usefixtures("kept_operators")

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))
NIGHTLY = ("03_a_circle_on_silicone", "10_draw_a_run")
"""docs/skin.md, whose code runs as a test, has the same circle; tests of their own draw each kind of picture."""


def test_there_are_ten_short_ones_and_the_page_names_each():
    assert len(EXAMPLES) >= 10
    page = (ROOT / "examples" / "README.md").read_text()
    for path in EXAMPLES:
        text = path.read_text()
        assert text.count("\n") <= 40, path.name
        assert text.startswith('"""'), path.name
        assert path.name in page


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "mjcf").symlink_to(ROOT / "mjcf")
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=[pytest.mark.nightly] if path.stem in NIGHTLY else [])
        for path in EXAMPLES
    ],
)
def test_each_runs(path, folder, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(path)])
    runpy.run_path(str(path), run_name="__main__")
    assert re.search(r"\d", capsys.readouterr().out)


def test_one_runs_as_a_program_of_its_own(folder):
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    command = [sys.executable, str(EXAMPLES[0])]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-3000:]
    assert re.search(r"\d", done.stdout)
