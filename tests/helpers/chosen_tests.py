"""Which tests run: long checks only when wanted, and those that take little carry the marker `quick`."""

import math
from collections import defaultdict
from pathlib import Path

import pytest

FIXTURE = "shared fixture"
"""Name of a property of a test that first asked for a fixture which serves several: the fixture, and its seconds."""
RARE = ("smoke", "numerics", "wall_clock", "slow", "nightly")
"""Markers that stand in few files: to ask for one alone is to read only the files that have its name in them."""
SLOW_TESTS = Path(__file__).parents[1] / "slow_tests.txt"
"""Functions of which a case took more than 0.2 s, and shared fixtures that did, after the seconds of all:
scripts/verification/slow_tests.py."""
OTHERS_S = 0.02
"""What a case of another function takes [s], about."""


def name_of(node: str) -> str:
    """A test's function, without its parameters."""
    return node.partition("[")[0]


def slow_tests() -> dict[str, float]:
    """Seconds of all cases of each function that is not quick, and of shared fixtures that are not."""
    rows = (line.split() for line in SLOW_TESTS.read_text().splitlines())
    return {name: float(seconds) for seconds, name in rows}


def lacks_marker(config: pytest.Config, path: Path) -> bool:
    """Whether a file can't hold a test of the one marker that -m asks for: to collect all files takes half a minute."""
    marker = config.option.markexpr.strip()
    return marker in RARE and path.match("test_*.py") and marker not in path.read_text(encoding="utf-8")


def name_of_fixture(base: str, name: str) -> str:
    """A fixture by the file or folder that defines it, as in `SLOW_TESTS`."""
    return f"{base}::{name}"


def slow_parts(item: pytest.Item, slow: dict[str, float]) -> set[str]:
    """What of a test isn't quick: its function and the shared fixtures that it needs, with or without others."""
    file = item.nodeid.partition("::")[0]
    bases = [file, *(str(folder) for folder in Path(file).parents)]
    fixtures = {name_of_fixture(base, name) for base in bases for name in getattr(item, "fixturenames", ())}
    return ({name_of(item.nodeid)} | fixtures) & slow.keys()


def choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is quick, leave out what is `nightly` unless it is wanted or named, and sort for several processes."""
    slow = slow_tests()
    wanted = config.getoption("--nightly") or any("::" in argument for argument in config.args)
    kept, left = [], []
    for item in items:
        marked = any(item.get_closest_marker(name) for name in ("nightly", "wall_clock", "slow"))
        if not marked and not slow_parts(item, slow):
            item.add_marker(pytest.mark.quick)
        (left if item.get_closest_marker("nightly") and not wanted else kept).append(item)
    if left:
        config.hook.pytest_deselected(items=left)
        items[:] = kept
    if hasattr(config, "workerinput"):
        longest_file_first(items, slow)


def longest_file_first(items: list[pytest.Item], slow: dict[str, float]) -> None:
    """Sort tests by files: a long one at the end would keep one of several processes busy alone."""
    files: dict[Path, float] = defaultdict(float)
    parts: dict[Path, set[str]] = defaultdict(set)
    for item in items:
        files[item.path] += OTHERS_S
        parts[item.path] |= slow_parts(item, slow)
    for path, names in parts.items():
        # Exact, as each process goes through a set in an order of its own, and all must agree
        files[path] += math.fsum(slow[name] for name in names)
    items.sort(key=lambda item: (-files[item.path], item.path))
