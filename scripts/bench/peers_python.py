"""Common parts of both comparisons with other programs: their options, and the interpreter with those programs."""

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from palmfield.errors import PalmfieldError

ABOUT_PYTHON = "interpreter that has other programs, made by scripts/peers/setup.py [default: this one]"


def parser(about: str | None, runs: int) -> argparse.ArgumentParser:
    """Return a parser of the options of `palmfield bench` and --peers-python."""
    result = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    result.add_argument("--peers-python", type=Path, help=ABOUT_PYTHON)
    result.add_argument("--out", type=Path, help="markdown file to write the table to")
    result.add_argument("--picture", type=Path, help="PNG to draw")
    result.add_argument("--device", default="cpu", help="where palmfield's own methods run: cpu or cuda:0")
    result.add_argument("--runs", type=int, default=runs, help="how often each method runs; medians are printed")
    result.add_argument("--only", default="", help="leave out methods whose names lack this text")
    result.add_argument("--commit", default="", help="for the head, where no git is [default: git's]")
    return result


def interpreter(python: Path) -> Path:
    """Return the program that `python` names, in a folder of PATH if it is a bare name.

    Raises PalmfieldError if it does not run or lacks NumPy, which every method needs.
    """
    program = shutil.which(python)
    if program is None:
        raise PalmfieldError(f"--peers-python {python} is no program: make one with scripts/peers/setup.py")
    try:
        alone = {**os.environ, "PYTHONPATH": ""}
        done = subprocess.run([program, "-c", "import numpy"], capture_output=True, text=True, env=alone)
    except OSError as error:
        raise PalmfieldError(f"--peers-python {python} does not run: {error.strerror}; give an interpreter") from error
    if done.returncode != 0:
        words = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise PalmfieldError(
            f"--peers-python {python} can't import NumPy ({words}): make one with scripts/peers/setup.py"
        )
    return Path(program)


def print_report(make: Callable[[], str]) -> None:
    """Print the result of `make`; user errors become one line and exit code 2."""
    try:
        print(make(), end="")
    except PalmfieldError as error:
        print(f"palmfield: {error}", file=sys.stderr)
        sys.exit(2)
