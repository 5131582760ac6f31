"""What is given on the command line: near names, home folders, paths and ports of Windows, lists of pictures."""

import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from palmfield.cli.app import app
from palmfield.errors import did_you_mean

RUN = CliRunner()
FOCUS = ["drive", "--focus", "0", "0", "0.15", "--duration", "0.05"]
posix = pytest.mark.skipif(os.name != "posix", reason="paths of Windows are its own there")


@pytest.mark.parametrize(
    ("word", "near"),
    [("sonic", "sonicsurface"), ("SonicSurface", "sonicsurface"), ("autd", "autd3"), ("open", "openmpd"), ("so", "")],
)
def test_a_boards_name_that_comes_near(word, near, tmp_path):
    told = str(RUN.invoke(app, [*FOCUS, "--board", word, "--record", str(tmp_path / "x.bin")]).exception)
    assert f"(did you mean '{near}'?)" in told if near else "did you mean" not in told
    assert did_you_mean("focus_z", ["focus_m", "frame"], 0.9) == ""


@posix
@pytest.mark.parametrize("line", [["--record", "~/x.bin"], ["--record=~/x.bin"]])
def test_home_is_found_where_the_shell_left_it(line, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    done = RUN.invoke(app, [*FOCUS, "--board", "sonicsurface", *line])
    assert done.exit_code == 0 and (tmp_path / "x.bin").exists() and not Path("~").exists()


@posix
@pytest.mark.parametrize(
    ("line", "words"),
    [
        (["plan", r"C:\Users\me\x.xml"], "/mnt/c/Users/me/x.xml"),
        ([*FOCUS, "--record=D:/x.bin"], "/mnt/d/x.bin"),
        ([*FOCUS, "--port", "COM3"], "/dev/ttyUSB0; in WSL attach"),
        (["calibrate", "show", r"C:\b.json"], "is a Windows path"),
    ],
)
def test_what_is_of_windows_gets_its_mend(line, words):
    assert words in str(RUN.invoke(app, line).exception)


def test_pictures_are_taken_as_a_list(tmp_path):
    told = str(RUN.invoke(app, ["plot", str(tmp_path), "motion,wavefronts,nose"]).exception)
    assert "'nose'" in told and "motion,wave" not in told
