#!/usr/bin/env python3
"""Runs what CI runs, from a bare Python: ruff, mypy, then pytest, whose closing line is the last line."""

import argparse
import os
import subprocess
import sys

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import _setup

CHECKS = (("ruff", "check", "."), ("ruff", "format", "--check", "."), ("mypy",))


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Make .venv, install palmfield and its test tools in it, and run ruff check, ruff format --check, "
        "mypy and pytest. Stops at the first that fails.",
        epilog="Tests run on all cores, those of a file one after the other. Anything else is passed "
        "on to pytest, for instance -k NAME, -m 'not slow', or a path from the "
        "repository's root.",
        allow_abbrev=False,
    )
    _, passed_on = parser.parse_known_args()
    python = _setup.environment("test")
    for tool, *options in (*CHECKS, ("pytest", "-n", "auto", "--dist", "loadfile", *passed_on)):
        _setup.say(" ".join([tool, *options]))
        status = subprocess.run([python, "-m", tool, *options], cwd=_setup.ROOT, check=False).returncode
        if status != 0:
            break
    return status


if __name__ == "__main__":
    sys.exit(main())
