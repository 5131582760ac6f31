#!/usr/bin/env python3
"""Run the checks of CI from a bare Python: ruff, mypy, the contract of imports, then pytest four times.

The last line is that of pytest.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import _setup

RUFF = (("ruff", "check", "."), ("ruff", "format", "--check", "."))
CHECKS = (("mypy",), ("lint-imports",))
"""These checks use one core for a minute; meanwhile the lowest versions are installed and tested."""
PYTEST = ("pytest", "-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder")
IN_REAL_TIME = ("pytest", "-m", "wall_clock", "-n", "2", "--dist", "loadfile", "--reruns", "2")
"""These tests run two at a time, since they mostly wait, and again after a failure.

A pause of the machine delays boards.
"""
TIMES = ("--durations", "30", "--junitxml", "out/tests-whole.xml")
"""Times of tests: the slowest are printed, and all are stored for scripts/verification/slow_tests.py."""
CORES = {"SkylakeX": "Haswell", "Cooperlake": "Haswell", "SapphireRapids": "Haswell", "Nehalem": "Prescott"}
"""OpenBLAS kernel names: other kernels for a test, by the kernel in use; on other x86 processors "Nehalem"."""
TELL_CORES = (
    "import json, numpy, scipy.linalg, threadpoolctl; "
    "print(json.dumps([p.get('architecture') for p in threadpoolctl.threadpool_info() if p['user_api'] == 'blas']))"
)


def main() -> int:
    parser = argparse.ArgumentParser(
        description="Make .venv, install palmfield, palmfield-papers and test tools in it, and run ruff check, ruff "
        "format --check, mypy, import-linter and pytest. Before that, pytest's smoke tests run in .venv-lowest, with "
        "the lowest versions of dependencies that pyproject.toml allows (made and run on Python 3.11 alone); after it, "
        "the tests that play in real time (wall_clock) run by themselves, two at a time, and "
        "its numerics tests once more with OpenBLAS's kernels for another processor. Stops at the first that fails.",
        epilog="Tests run on all cores, those of a file one after the other. Anything else is passed "
        "on to pytest, for instance -k NAME, -m 'not slow', or a path from the "
        "repository's root; then it runs once, in .venv.",
        allow_abbrev=False,
    )
    parser.add_argument(
        "--quick", action="store_true", help="ruff and the tests that take less than 0.2 s, in two minutes"
    )
    parser.add_argument("--nightly", action="store_true", help="also the long checks that the usual run leaves out")
    args, passed_on = parser.parse_known_args()
    # Hundreds of processes would compile all that they import, each for itself
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    python = _setup.environment("test")
    if args.quick:
        return run(python, *RUFF[0]) or run(python, *PYTEST, "-m", "quick", *passed_on)
    nightly = ("--nightly",) if args.nightly else ()
    if status := first_failure(python, RUFF):
        return status
    if passed_on:
        return first_failure(python, CHECKS) or run(python, *PYTEST, *nightly, *passed_on)
    core = another_core(python)
    whole = (*PYTEST, "-m", "not wall_clock", *TIMES, *nightly)
    with ThreadPoolExecutor() as pool:
        checked = pool.submit(first_failure, python, CHECKS)
        smoked = smoke_on_lowest()
    if status := checked.result() or smoked or run(python, *whole) or run(python, *IN_REAL_TIME):
        return status
    return run(python, *PYTEST, "-m", "numerics", OPENBLAS_CORETYPE=core) if core else 0


def first_failure(python: Path, commands: tuple[tuple[str, ...], ...]) -> int:
    """Run commands until one fails; return its exit status, or 0."""
    return next((status for command in commands if (status := run(python, *command))), 0)


def smoke_on_lowest() -> int:
    """Run the smoke tests with the lowest allowed versions, which have wheels only for the oldest Python."""
    if sys.version_info[:2] != _setup.OLDEST:
        _setup.say(f"lowest versions are tested on Python {'.'.join(map(str, _setup.OLDEST))}: left out")
        return 0
    return run(_setup.environment("test", _setup.LOWEST_VENV), *PYTEST, "-m", "smoke")


def another_core(python: Path) -> str | None:
    """Return OpenBLAS kernels that run here and sum in another order than those of numpy and scipy here."""
    own = cores(python)
    if own and platform.machine().lower() in ("x86_64", "amd64"):
        other = CORES.get(own[0], "Nehalem")
        if cores(python, OPENBLAS_CORETYPE=other) == [other]:
            return other
    _setup.say(f"no second set of OpenBLAS kernels here (BLAS: {', '.join(own) or 'none'}): numerics run once only")
    return None


def cores(python: Path, **variables: str) -> list[str]:
    """Return the kernel names of the BLAS of numpy and scipy; empty if unknown, as for Accelerate."""
    result = subprocess.run(
        [python, "-c", TELL_CORES], env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    return sorted({name for name in json.loads(result.stdout) if name}) if result.returncode == 0 else []


def run(python: Path, tool: str, *options: str, **variables: str) -> int:
    """Return the exit status of a tool in the environment of `python`, with additional environment variables."""
    where = [] if python == _setup.python_of(_setup.VENV) else [f"{_setup.LOWEST_VENV.name}:"]
    _setup.say(" ".join([*where, *(f"{name}={value}" for name, value in variables.items()), tool, *options]))
    # import-linter has a command only, and no module to run.
    command = [python.parent / tool, *options] if tool == "lint-imports" else [python, "-m", tool, *options]
    return subprocess.run(command, cwd=_setup.ROOT, env={**os.environ, **variables}, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
