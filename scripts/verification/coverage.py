"""Test the error estimates of the skin solvers: random cases, answers, whole scenes and references.

    python scripts/verification/coverage.py begin --seed 1 --count 130
    python scripts/verification/coverage.py cases CASES.json [--left]
    PEERS/bin/python scripts/peers/skin_truths.py CASES.json docs/bench/coverage/peers.jsonl
    python scripts/verification/coverage.py answers [--limit 30] [--longest 10]
    python scripts/verification/coverage.py truths [--limit 45]
    python scripts/verification/coverage.py report [--out docs/bench/skin_coverage.md]

A "truth" is a more accurate reference solution. `begin` writes the seed and the present commit, at which the code is
frozen; `answers` and `truths` refuse other code. `answers` solves each case with `auto` and with the named solvers that
were drawn for it. `truths` solves boxes, layers and scenes of hands and meshes with a solver that `auto` did not
choose, at a tenth of the accuracy (scenes: SCENE_FINER); cases without an answer wait for its next call. These commands
append small lines to files in docs/bench/coverage, those of a case together, and continue from there, also in a later
checkout: commit the folder. `cases --left` are the cases without a usable truth, except scenes, for scikit-fem.
`report` writes the page. Limits are of processor time. Set OMP_NUM_THREADS=1, MKL_NUM_THREADS=1, OPENBLAS_NUM_THREADS=1
and PALMFIELD_CACHE=off.
"""

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coverage_coupled import section
from coverage_draw import Case, draw
from coverage_judge import answers, truths
from coverage_report import verdicts, write_report
from coverage_scenes import with_load
from coverage_store import CODE, DRAWN, FOLDER, ChangedCodeError, begin, known_head, line


def rows_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def go_on(cases: list[Case], path: Path, work: Callable[[Case], list[dict[str, Any]]]) -> None:
    """Append the rows of all cases that are missing in the file; the rows of a case are written together."""
    done = {row["key"] for row in rows_of(path)}
    left = [case for case in cases if case["key"] not in done]
    for number, case in enumerate(left, 1):
        rows = work(case)
        with path.open("a") as file:
            file.writelines(line(row) for row in rows)
        seconds = sum(row.get("seconds", 0.0) for row in rows)
        print(f"{number} of {len(left)}: {case['key']}, {case['family']}, {seconds:.1f} s", flush=True)


def drawn_cases(seed: int, count: int) -> list[Case]:
    """Return all cases of a run; those of discs in scenes include their load."""
    return [with_load(case) if "scene" in case and case["by_scikit_fem"] else case for case in draw(seed, count)]


def left(cases: list[Case], known: list[dict[str, Any]], given: list[dict[str, Any]]) -> list[Case]:
    """Return the cases that scikit-fem can solve and whose answer of `auto` has no usable truth."""
    found = verdicts({"cases": cases}, known, given)
    keys = {one.case for one in found if one.asked == "auto" and one.kind == "no truth"}
    able = [case for case in cases if case["key"] in keys and case["body"]["shape"] != "scene"]
    return [case | {"by_scikit_fem": True} for case in able]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("step", choices=("begin", "cases", "answers", "truths", "report"))
    parser.add_argument("cases", type=Path, nargs="?", help="of step cases: the file that scikit-fem's script reads")
    parser.add_argument("--left", action="store_true", help="of step cases: only those without a truth that counts")
    parser.add_argument("--folder", type=Path, default=FOLDER, help="where the run is kept")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=130)
    parser.add_argument("--limit", type=float, default=30.0, help="longest run [s]")
    parser.add_argument("--longest", type=float, default=10.0, help="longest prediction of a solver by name [s]")
    parser.add_argument("--out", type=Path, default=Path("docs/bench/skin_coverage.md"))
    settings = parser.parse_args()
    folder = settings.folder
    try:
        if settings.step == "begin":
            begin(folder, settings.seed, settings.count)
            return
        head = known_head(folder, code=CODE if settings.step in ("answers", "truths") else DRAWN)
    except ChangedCodeError as error:
        parser.error(str(error))
    known, given = folder / "truths.jsonl", folder / "answers.jsonl"
    all_known = rows_of(known) + rows_of(folder / "peers.jsonl")
    if settings.step == "cases":
        if settings.cases is None:
            parser.error("step cases needs the file to write")
        cases = drawn_cases(head["seed"], head["count"])
        if settings.left:
            cases = left(cases, all_known, rows_of(given))
        settings.cases.write_text(json.dumps({"seed": head["seed"], "cases": cases}))
        return
    cases = draw(head["seed"], head["count"])
    if settings.step == "answers":
        go_on(cases, given, lambda case: answers(case, settings.limit, settings.longest))
    elif settings.step == "truths":
        answered = {row["key"]: row for row in rows_of(given) if row["asked"] == "auto"}
        asked = [case for case in cases if case["by_others"] and case["key"] in answered]
        go_on(asked, known, lambda case: truths(case, answered[case["key"]], settings.limit))
    else:
        drawn = {"seed": head["seed"], "cases": cases}
        coupled = section(folder / "coupled", settings.out)
        write_report(drawn, all_known, rows_of(given), settings.out, head["frozen"], coupled)


if __name__ == "__main__":
    main()
