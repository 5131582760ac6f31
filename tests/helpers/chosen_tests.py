"""Which tests run: long checks only when wanted, and those that take little carry the marker `quick`."""

from collections import defaultdict
from pathlib import Path

import pytest

RARE = ("smoke", "numerics", "wall_clock", "slow", "nightly")
"""Markers that stand in few files: to ask for one alone is to read only the files that have its name in them."""
SLOW_TESTS = Path(__file__).parents[1] / "slow_tests.txt"
"""Functions of which a case took more than 0.2 s, after the seconds of all: scripts/verification/slow_tests.py."""
OTHERS_S = 0.02
"""What a case of another function takes [s], about."""


def name_of(node: str) -> str:
    """A test's function, without its parameters."""
    return node.partition("[")[0]


def slow_tests() -> dict[str, float]:
    """Seconds of all cases of each function that is not quick."""
    rows = (line.split() for line in SLOW_TESTS.read_text().splitlines())
    return {name: float(seconds) for seconds, name in rows}


def lacks_marker(config: pytest.Config, path: Path) -> bool:
    """Whether a file can't hold a test of the one marker that -m asks for: to collect all files takes half a minute."""
    marker = config.option.markexpr.strip()
    return marker in RARE and path.match("test_*.py") and marker not in path.read_text(encoding="utf-8")


def choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is quick, leave out what is `nightly` unless it is wanted or named, and sort for several processes."""
    slow = slow_tests()
    wanted = config.getoption("--nightly") or any("::" in argument for argument in config.args)
    kept, left = [], []
    for item in items:
        marked = any(item.get_closest_marker(name) for name in ("nightly", "wall_clock", "slow"))
        if not marked and name_of(item.nodeid) not in slow:
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
    for item in items:
        files[item.path] += OTHERS_S
    for name, path in {name_of(item.nodeid): item.path for item in items}.items():
        files[path] += slow.get(name, 0.0)
    items.sort(key=lambda item: -files[item.path])
