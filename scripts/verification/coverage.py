"""Are the skin solvers' error estimates true? Random cases, solvers' answers, whole scenes, and truths; writes a page.

    python scripts/verification/coverage.py draw CASES.json --seed 1 --count 130
    python scripts/verification/coverage.py answers CASES.json [--limit 30] [--longest 10]
    python scripts/verification/coverage.py truths CASES.json [--limit 45]
    PEERS/bin/python scripts/peers/skin_truths.py CASES.json CASES.peers.jsonl
    python scripts/verification/coverage.py report CASES.json [--out docs/bench/skin_coverage.md]

`answers` gives each case to `auto` and to the solvers by name that were drawn for it, `truths`, of boxes and layers, to
another solver than `auto` took, at a tenth of the accuracy; cases without an answer wait for its next call. All but the
first and the last step append to files beside the cases, and go on where they ended. Limits are of processor time. Set
OMP_NUM_THREADS=1, MKL_NUM_THREADS=1, OPENBLAS_NUM_THREADS=1 and PALMFIELD_CACHE=off.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coverage_draw import Case, draw
from coverage_judge import answers, truths
from coverage_report import write_report
from coverage_scenes import with_load


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
    parser.add_argument("step", choices=("draw", "answers", "truths", "report"))
    parser.add_argument("cases", type=Path)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=130)
    parser.add_argument("--limit", type=float, default=30.0, help="longest run [s]")
    parser.add_argument("--longest", type=float, default=10.0, help="longest prediction of a solver by name [s]")
    parser.add_argument("--out", type=Path, default=Path("docs/bench/skin_coverage.md"))
    parser.add_argument("--frozen", help="commit of the code that the seed was drawn after, for the page")
    settings = parser.parse_args()
    path = settings.cases
    if settings.step == "draw":
        cases = [with_load(case) if "scene" in case else case for case in draw(settings.seed, settings.count)]
        path.write_text(json.dumps({"seed": settings.seed, "cases": cases}))
        return
    drawn = json.loads(path.read_text())
    known, given = path.with_suffix(".truths.jsonl"), path.with_suffix(".answers.jsonl")
    if settings.step == "answers":
        go_on(drawn["cases"], given, lambda case: answers(case, settings.limit, settings.longest))
    elif settings.step == "truths":
        answered = {row["key"]: row for row in rows_of(given) if row["asked"] == "auto"}
        asked = [case for case in drawn["cases"] if case["by_others"] and case["key"] in answered]
        go_on(asked, known, lambda case: truths(case, answered[case["key"]], settings.limit))
    else:
        truths_known = rows_of(known) + rows_of(path.with_suffix(".peers.jsonl"))
        write_report(drawn, truths_known, rows_of(given), settings.out, settings.frozen)


if __name__ == "__main__":
    main()
