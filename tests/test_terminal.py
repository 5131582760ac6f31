"""Tables are as wide as the terminal that they are printed in."""

import os
import pty
import struct
import subprocess
import sys
from fcntl import ioctl
from termios import TIOCSWINSZ

import pytest

from palmfield.cli.keys import as_text
from palmfield.terminal import columns

PRINTS = "from palmfield.terminal import columns; print(columns(130))"


@pytest.mark.parametrize(("told", "wide"), [("80", 80), ("30", 60), ("300", 130), ("wide", 130), ("0", 130)])
def test_the_variable_columns_counts_between_what_can_be_read_and_what_is_needed(told, wide, monkeypatch):
    for stream in ("__stdout__", "__stderr__"):
        monkeypatch.setattr(sys, stream, None)
    monkeypatch.setenv("COLUMNS", told)
    assert columns(130) == wide


def test_what_is_piped_is_as_wide_as_the_terminal_behind():
    own, its = pty.openpty()
    ioctl(its, TIOCSWINSZ, struct.pack("HHHH", 24, 93, 0, 0))
    env = {name: value for name, value in os.environ.items() if name != "COLUMNS"}
    try:
        said = subprocess.run([sys.executable, "-c", PRINTS], stdout=subprocess.PIPE, stderr=its, env=env, check=True)
    finally:
        os.close(its)
        os.close(own)
    assert said.stdout.split() == [b"93"]


def test_no_word_of_a_narrow_table_is_cut_off(monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    printed = as_text("driver")
    assert max(map(len, printed.splitlines())) <= 60 and "\u2026" not in printed
