#!/usr/bin/env python3
"""Which tests are not quick, from the times of a whole run.

python scripts/verification/slow_tests.py TIMES.xml [TIMES.xml ...]

TIMES.xml: of --junitxml; scripts/test.py writes out/tests-whole.xml. Writes tests/slow_tests.txt, with the seconds of
all cases of each function, by which files begin, and prints the thirty functions that take most.
"""

import sys
import xml.etree.ElementTree as ET
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
QUICK_S = 0.2
"""The longest of a function's cases, with fixtures, that is still quick [s]."""
SLOW_TESTS = ROOT / "tests" / "slow_tests.txt"


def functions(files: list[str]) -> dict[str, list[float]]:
    """Seconds of each case of each test function."""
    found = defaultdict[str, list[float]](list)
    for file in files:
        for case in ET.parse(file).iter("testcase"):
            name = case.get("name", "").partition("[")[0]
            found[f"{place(case.get('classname', ''))}::{name}"].append(float(case.get("time", "0")))
    return found


def place(module: str) -> str:
    """The file of a module's dotted name, followed by classes if the test is in one."""
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
    times = functions(sys.argv[1:])
    slow = sorted((name, sum(seconds)) for name, seconds in times.items() if max(seconds) > QUICK_S)
    SLOW_TESTS.write_text("".join(f"{seconds:6.1f} {name}\n" for name, seconds in slow))
    for name, seconds in sorted(times.items(), key=lambda one: -sum(one[1]))[:30]:
        print(f"{sum(seconds):7.1f} s {len(seconds):4} cases, longest {max(seconds):5.1f} s  {name}")


if __name__ == "__main__":
    main()
