"""Are the skin solvers' error estimates true? Random cases, every solver's answers, and truths; writes a page.

    python scripts/verification/coverage.py draw CASES.json --seed 1 --count 126
    python scripts/verification/coverage.py truths CASES.json [--limit 300]
    PEERS/bin/python scripts/peers/skin_truths.py CASES.json CASES.peers.jsonl
    python scripts/verification/coverage.py answers CASES.json [--limit 300] [--longest 120]
    python scripts/verification/coverage.py report CASES.json [--out docs/bench/skin_coverage.md]

Each step appends to a file beside the cases, and goes on where it ended. Set OMP_NUM_THREADS=1 and
OPENBLAS_NUM_THREADS=1.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coverage_draw import Case, draw
from coverage_judge import answers, truths
from coverage_report import write_report


def rows_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def go_on(cases: list[Case], path: Path, work: Callable[[Case], list[dict[str, Any]]]) -> None:
    """Append the rows of all cases that the file has none of; a case's rows are written together."""
    done = {row["key"] for row in rows_of(path)}
    left = [case for case in cases if case["key"] not in done]
    for number, case in enumerate(left, 1):
        rows = work(case)
        with path.open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)
        seconds = sum(row.get("seconds", 0.0) for row in rows)
        print(f"{number} of {len(left)}: {case['key']}, {case['family']}, {seconds:.1f} s", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("draw", "truths", "answers", "report"))
    parser.add_argument("cases", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=126)
    parser.add_argument("--limit", type=float, default=300.0, help="longest run [s]")
    parser.add_argument("--longest", type=float, default=120.0, help="longest prediction of a solver by name [s]")
    parser.add_argument("--out", type=Path, default=Path("docs/bench/skin_coverage.md"))
    settings = parser.parse_args()
    path = settings.cases
    if settings.step == "draw":
        path.write_text(json.dumps({"seed": settings.seed, "cases": draw(settings.seed, settings.count)}))
        return
    drawn = json.loads(path.read_text())
    if settings.step == "truths":
        go_on(drawn["cases"], path.with_suffix(".truths.jsonl"), lambda case: truths(case, settings.limit))
    elif settings.step == "answers":
        work = path.with_suffix(".answers.jsonl")
        go_on(drawn["cases"], work, lambda case: answers(case, settings.limit, settings.longest))
    else:
        known = rows_of(path.with_suffix(".truths.jsonl")) + rows_of(path.with_suffix(".peers.jsonl"))
        write_report(drawn, known, rows_of(path.with_suffix(".answers.jsonl")), settings.out)


if __name__ == "__main__":
    main()
