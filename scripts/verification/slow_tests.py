#!/usr/bin/env python3
"""List the tests that are not quick, from the times of a whole run.

python scripts/verification/slow_tests.py TIMES.xml [TIMES.xml ...]

TIMES.xml is a file of --junitxml; scripts/test.py writes out/tests-whole.xml. The script writes tests/slow_tests.txt,
with the seconds of all cases of each function, which determine the order of files, and of each shared fixture. It
prints the thirty slowest.
"""

import sys
import xml.etree.ElementTree as ET
from collections import defaultdict
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "helpers"))

from chosen_tests import FIXTURE, SLOW_TESTS

ROOT = SLOW_TESTS.parents[1]
QUICK_S = 0.2
"""Longest time of the longest case of a function, or of a shared fixture, that counts as quick [s]."""


def parts(files: list[str]) -> dict[str, list[float]]:
    """Return the seconds of each case of each function without shared fixtures, and of each fixture call."""
    found = defaultdict[str, list[float]](list)
    for file in files:
        for case in ET.parse(file).iter("testcase"):
            name = case.get("name", "").partition("[")[0]
            seconds = float(case.get("time", "0"))
            for prop in case.iterfind(f"properties/property[@name='{FIXTURE}']"):
                fixture, _, took = prop.get("value", "").rpartition(" ")
                found[fixture].append(float(took))
                seconds -= float(took)
            found[f"{place(case.get('classname', ''))}::{name}"].append(max(seconds, 0.0))
    return found


def place(module: str) -> str:
    """Return the file of a dotted module name, which classes may follow."""
    parts = module.split(".")
    for count in range(len(parts), 0, -1):
        file = "/".join(parts[:count]) + ".py"
        if (ROOT / file).exists():
            return "::".join([file, *parts[count:]])
    raise SystemExit(f"no file of this clone is {module}: give the times of its own tests")


def main() -> None:
    """See the module's docstring."""
    if not sys.argv[1:]:
        raise SystemExit(__doc__)
    times = parts(sys.argv[1:])
    slow = sorted((name, sum(seconds)) for name, seconds in times.items() if max(seconds) > QUICK_S)
    SLOW_TESTS.write_text("".join(f"{seconds:6.1f} {name}\n" for name, seconds in slow))
    for name, seconds in sorted(times.items(), key=lambda one: -sum(one[1]))[:30]:
        print(f"{sum(seconds):7.1f} s {len(seconds):4} times, longest {max(seconds):5.1f} s  {name}")


if __name__ == "__main__":
    main()
