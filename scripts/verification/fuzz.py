"""Test palmfield with thousands of malformed inputs; writes docs/bench/fuzzing.md.

python scripts/verification/fuzz.py --cases 1000 --seed 1 --write docs/bench/fuzzing.md
"""

import argparse
import json
import pickle
import re
import select
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from fuzz_cases import Case, drawn

HERE = Path(__file__).resolve().parent
SHARES = {"keys": 0.3, "rules": 0.15, "scene": 0.35, "mesh": 0.2}
LONGEST_S = 120.0
RAW = re.compile(r"XML Error|XML_ERROR|ErrorID|Schema violation|mjMINVAL|Traceback|pydantic|No module named|\n")
"""Text that messages of palmfield must not contain: words of MuJoCo and of parsers, and more than one line."""
BAD = ("traceback", "crash", "too long", "accepted against a rule", "refused in raw words")


class Outcome(NamedTuple):
    """Result of a case: refused, accepted or one of BAD. message: the text, or information on a crash"""

    case: Case
    outcome: str
    message: str
    seconds: float


def run_cases(cases: list[Case], longest_s: float = LONGEST_S) -> list[Outcome]:
    """Return the result of each case, computed in processes that may crash."""
    results: dict[int, tuple[str, str, float]] = {}
    with tempfile.TemporaryDirectory() as folder:
        listed = Path(folder) / "cases.pickle"
        listed.write_bytes(pickle.dumps(cases))
        starts = 0
        while len(results) < len(cases):
            first = len(results)
            _one_process(listed, first, Path(folder) / f"process_{starts}", longest_s, results)
            starts += 1
    found = []
    for number, case in enumerate(cases):
        outcome, message, seconds = results[number]
        if outcome == "accepted" and case.forbidden:
            outcome = "accepted against a rule"
        if outcome == "refused" and RAW.search(message):
            outcome = "refused in raw words"
        found.append(Outcome(case, outcome, message, seconds))
    return found


def _one_process(
    listed: Path, first: int, folder: Path, longest_s: float, results: dict[int, tuple[str, str, float]]
) -> None:
    """Run cases from a number on until the process ends; the case at its end is a crash or takes too long."""
    command = [sys.executable, str(HERE / "fuzz_worker.py"), str(listed), str(first), str(folder)]
    worker = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert worker.stdout is not None
    began, last = first, time.monotonic()
    ended = "crash"
    while True:
        ready, _, _ = select.select([worker.stdout], [], [], longest_s)
        line = worker.stdout.readline() if ready else b""
        if not line:
            ended = "crash" if ready else "too long"
            break
        line_facts = json.loads(line)
        if line_facts["outcome"] == "began":
            began, last = line_facts["number"], time.monotonic()
        else:
            results[line_facts["number"]] = line_facts["outcome"], line_facts["said"], line_facts["seconds"]
    worker.kill()
    code = worker.wait()
    if began not in results:
        results[began] = ended, f"the process ended with {code}", time.monotonic() - last


def table(outcomes: list[Outcome]) -> str:
    """Return counts by kind as Markdown."""
    lines = ["| kind | inputs | forbidden by a rule | refused | accepted | bad |", "|---|---|---|---|---|---|"]
    for kind in [*SHARES, "all"]:
        own = [one for one in outcomes if kind in (one.case.kind, "all")]
        counts = Counter(one.outcome for one in own)
        bad, forbidden = sum(counts[name] for name in BAD), sum(one.case.forbidden for one in own)
        lines.append(f"| {kind} | {len(own)} | {forbidden} | {counts['refused']} | {counts['accepted']} | {bad} |")
    return "\n".join(lines)


def kinds_of(count: int) -> dict[str, int]:
    """Return the number of cases of each kind in a total."""
    kinds = {kind: round(share * count) for kind, share in SHARES.items()}
    kinds["keys"] += count - sum(kinds.values())
    return kinds


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--write", type=Path, help="markdown page to write")
    arguments = parser.parse_args()
    start = time.monotonic()
    cases = drawn(kinds_of(arguments.cases), arguments.seed)
    outcomes = run_cases(cases)
    faults = len({(one.case.kind, one.case.fault) for one in outcomes})
    spent = time.monotonic() - start
    command = f"python scripts/verification/fuzz.py --cases {arguments.cases} --seed {arguments.seed}"
    page = [
        "# Malformed inputs",
        "",
        "For developers. Random and forbidden inputs must give an error message of one line, and never a crash.",
        "",
        f"    {command} --write docs/bench/fuzzing.md",
        "",
        "The library hypothesis draws the inputs (`scripts/verification/fuzz_cases.py`). They are forbidden values and "
        "combinations of keys, small scenes, and meshes of a ball. Scenes and meshes have a known fault or random "
        "changes. Nothing is simulated. A randomly changed input may still be valid. These outcomes count as bad: "
        f"tracebacks, crashes, more than {LONGEST_S:g} s, and forbidden inputs that are accepted. Messages of several "
        "lines, and messages that come from MuJoCo, its XML parser, pydantic or Python's imports, also count as bad.",
        "",
        f"{len(outcomes)} different inputs with {faults} kinds of faults, seed {arguments.seed}, {spent:.0f} s.",
        "",
        table(outcomes),
        "",
    ]
    bad = [one for one in outcomes if one.outcome in BAD]
    for one in bad:
        print(f"{one.outcome}: {one.case.kind}, {one.case.fault}: {one.case.values}\n  {one.message}", file=sys.stderr)
    print("\n".join(page))
    if arguments.write is not None:
        # The parts of fuzz_lines.py and fuzz_trees.py stay
        _, heading, others = arguments.write.read_text().partition("\n## ") if arguments.write.exists() else ("",) * 3
        arguments.write.write_text("\n".join(page) + heading + others)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
