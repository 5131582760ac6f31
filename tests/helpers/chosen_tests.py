"""Which tests run: long checks only when wanted, and those that take little carry the marker `quick`."""

from pathlib import Path

import pytest

SLOW_TESTS = Path(__file__).parents[1] / "slow_tests.txt"
"""Tests by function that took more than 0.2 s; scripts/verification/slow_tests.py writes it."""


def name_of(node: str) -> str:
    """A test's function, without its parameters."""
    return node.partition("[")[0]


def choose(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what is quick, and leave out what is `nightly` unless it is wanted or named."""
    slow = set(SLOW_TESTS.read_text().split())
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
