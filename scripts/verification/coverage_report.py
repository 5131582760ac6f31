"""Write the page of a coverage run: counts with binomial intervals, every case, and error against cost."""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from coverage_draw import BY_NAME, CONTRAST, CROSSINGS, FAMILIES, LONGEST_S, OTHER, ROUND
from coverage_judge import NAMES, SAME_MESH, relative_error, solver_of
from scipy.stats import binomtest

from palmfield.studies.bench.table import keep_rows

CONVERGED = 0.25
"""Largest ratio of a reference's own error to the error of an answer for which the answer is judged."""
AGREEING = 1.5
"""Two references contradict each other if they differ by more than this factor times the sum of their errors."""


@dataclass(frozen=True)
class Verdict:
    """Result for one solver's answer to one case.

    kind: "judged", "refused" (before the run), "refused late", "no answer", "no truth"
    estimate, true, truth_error: relative errors; by: solver of the reference; independent: whether it shares no code
    with palmfield
    """

    case: str
    family: str
    asked: str
    kind: str
    words: str = ""
    accuracy: float = math.nan
    estimate: float = math.nan
    true: float = math.nan
    truth_error: float = math.nan
    by: str = ""
    seconds: float = math.nan

    @property
    def independent(self) -> bool:
        return self.by == "scikit-fem"


def verdicts(drawn: dict[str, Any], truths: list[dict[str, Any]], answers: list[dict[str, Any]]) -> list[Verdict]:
    """Return one verdict for each expected answer of each case with any answer."""
    known: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for row in truths:
        if "displacement_m" in row:
            known[row["key"]].append(row)
    cases = {case["key"]: case for case in drawn["cases"]}
    return [_verdict(cases[row["key"]], row, known[row["key"]]) for row in answers if row["key"] in cases]


def _verdict(case: dict[str, Any], row: dict[str, Any], known: list[dict[str, Any]]) -> Verdict:
    base = {"case": case["key"], "family": case["family"], "asked": row["asked"], "accuracy": case["accuracy"]}
    for key, kind in (("refused", "refused"), ("refused_late", "refused late"), ("missing", "no answer")):
        if key in row:
            return Verdict(**base, kind=kind, words=row[key])
    own = solver_of(row)
    # A solver is no truth of its own answers, nor of those on the same mesh and matrices
    others = sorted((x for x in known if x["by"] not in (own, SAME_MESH.get(own))), key=lambda x: x["error"])
    estimate = float(row["displacement_error"])
    found = {"estimate": estimate, "seconds": row["seconds"], "words": row["solver"].split("(")[0].strip()}
    if not others:
        return Verdict(**base, kind="no truth", **found)
    best = others[0]
    true = relative_error(row["displacement_m"], best["displacement_m"])
    numbers = {"true": true, "truth_error": best["error"], "by": best["by"]}
    # An answer within its estimate of an unsure truth is no proof, and neither is one beyond it
    sure = best["error"] <= max(CONVERGED * max(true, estimate), 1e-12)
    return Verdict(**base, kind="judged" if sure else "no truth", **found, **numbers)


def band(hits: int, count: int) -> str:
    """Return the share of hits with its 95 % interval (Clopper and Pearson)."""
    if count == 0:
        return "-"
    low, high = binomtest(hits, count).proportion_ci(0.95, method="exact")
    return f"{100 * hits / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"


def contradictions(drawn: dict[str, Any], truths: list[dict[str, Any]]) -> list[str]:
    """Return the cases whose references differ by more than the sum of their errors."""
    lines = []
    for case in drawn["cases"]:
        rows = [row for row in truths if row["key"] == case["key"] and "displacement_m" in row]
        for one in range(len(rows)):
            for other in range(one):
                gap = relative_error(rows[one]["displacement_m"], rows[other]["displacement_m"])
                stated = rows[one]["error"] + rows[other]["error"]
                if gap > AGREEING * stated:
                    names = f"{rows[one]['by']} and {rows[other]['by']}"
                    lines.append(f"{case['key']} ({case['family']}): {names} differ by {gap:.2g}, stated {stated:.2g}")
    return lines


def counts(rows: list[Verdict]) -> list[str]:
    """Return the cells of a table, see HEAD."""
    judged = [row for row in rows if row.kind == "judged"]
    covered = sum(row.estimate >= row.true for row in judged)
    half = sum(row.estimate < 0.5 * row.true for row in judged)
    ratios = [row.estimate / row.true for row in judged if row.true > 0.0]
    median = f"{float(np.median(ratios)):.2g}" if ratios else "-"
    kinds = Counter(row.kind for row in rows)
    silent = ", ".join(str(kinds[kind]) for kind in ("refused", "refused late", "no answer"))
    cells = (len(rows), len(judged), band(covered, len(judged)), half, median, silent, kinds["no truth"])
    return [*map(str, cells), band(covered, len(rows))]


HEAD = (
    "cases", "judged", "estimate >= true", "below half", "median estimate / true", "refused, refused late, no answer",
    "no reference", "covered, of all",
)  # fmt: skip


def table(title: str, groups: dict[str, list[Verdict]]) -> list[str]:
    lines = [f"| {title} | " + " | ".join(HEAD) + " |", "|" + "---|" * (1 + len(HEAD))]
    return lines + [f"| {name} | " + " | ".join(counts(rows)) + " |" for name, rows in groups.items()]


def draw_costs(rows: list[Verdict], path: Path) -> None:
    """Draw the true error over the time of every judged answer, by solver."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.subplots()
    for name in NAMES[1:]:
        mine = [row for row in rows if row.asked == name and row.kind == "judged" and row.true > 0.0]
        if mine:
            axes.loglog([row.seconds for row in mine], [100.0 * row.true for row in mine], "o", ms=4, label=name)
    axes.set_xlabel("time of the answer [s]")
    axes.set_ylabel("true error of the displacement [%]")
    if axes.get_legend_handles_labels()[0]:
        axes.legend()
    axes.grid(True, which="both", alpha=0.2)
    figure.savefig(path, dpi=140)


def goals(rows: list[Verdict], peers: dict[str, int]) -> list[str]:
    """Return a table of the goals for the estimates, and the results of `auto` for each.

    peers: references by scikit-fem of each family
    """
    judged = [row for row in rows if row.kind == "judged"]
    covered = sum(row.estimate >= row.true for row in judged)
    half = sum(row.estimate < 0.5 * row.true for row in judged)
    ratios = [row.estimate / row.true for row in judged if row.true > 0.0]
    refused = sum(row.kind == "refused" for row in rows)
    late = sum(row.kind == "refused late" for row in rows)
    families = {name: [row for row in rows if row.family == name] for name in FAMILIES}
    worst = max(
        (sum(row.kind == "refused" for row in each) / len(each) for each in families.values() if each), default=0
    )
    cells = [
        ("estimate >= true error, of the judged cases", "97 %", band(covered, len(judged))),
        ("estimate >= true error, of all cases", "85 %", band(covered, len(rows))),
        ("estimates below half of the true error", "none", str(half)),
        ("median of estimate / true error", "<= 3", f"{np.median(ratios):.2g}" if ratios else "-"),
        ("refused before the run, of all cases", "<= 10 %", band(refused, len(rows))),
        ("refused before the run, in the family with most refusals", "<= 33 %", f"{100 * worst:.0f} %"),
        ("refused during the run", "none", str(late)),
        ("references by scikit-fem", ">= 30", str(sum(peers.values()))),
        ("references by scikit-fem in the family with the fewest", ">= 2", str(min(peers.values()))),
    ]
    return ["| solver `auto` | goal | result |", "|---|---|---|", *(f"| {' | '.join(row)} |" for row in cells)]


def write_report(
    drawn: dict[str, Any],
    truths: list[dict[str, Any]],
    answers: list[dict[str, Any]],
    out: Path,
    frozen: str | None = None,
    coupled: Sequence[str] = (),
) -> None:
    """Write the page, and the picture next to it (the name of the page, .png).

    frozen: commit of the code before the seed was drawn, if it was frozen; coupled: lines on coupled scenes
    """
    rows = verdicts(drawn, truths, answers)
    auto = [row for row in rows if row.asked == "auto"]
    seen = {row.case for row in rows}
    peers = {row["key"] for row in truths if row["by"] == "scikit-fem" and "displacement_m" in row}
    finer = {row["key"] for row in truths if row.get("finer", 1.0) > 1.0}
    tried = {row["key"] for row in truths if row["by"] != "scikit-fem"}
    family_of = {case["key"]: case["family"] for case in drawn["cases"]}
    by_family = {name: sum(family_of.get(key) == name for key in peers) for name in FAMILIES}
    picture = out.with_suffix(".png")
    out.parent.mkdir(parents=True, exist_ok=True)
    families = keep_rows(out, table("family", {name: [row for row in auto if row.family == name] for name in FAMILIES}))
    lines = [
        "# Are the error estimates of the skin solvers true?",
        "",
        "This page compares the error estimates of the solvers "
        f"with the true error in {len(drawn['cases'])} random cases, {len(seen)} of which the solvers were given.",
        "",
        f"    python scripts/verification/coverage.py begin --seed {drawn['seed']} --count {len(drawn['cases'])}",
        "",
        "Then `cases`, `answers`, `truths` and `report` follow, and `scripts/peers/skin_truths.py` in the "
        "environment of the other programs. "
        + ("" if frozen is None else f"The code was frozen at commit {frozen}; the seed is the time after that. ")
        + "[coverage](coverage/) has all cases.",
        "",
        "**Cases.** Bodies, materials and loads are random, in ten families. Spots are 1 to 300 mm wide, depths 1 to "
        f"50 mm, target accuracies {100 * ROUND[0]:g} to {100 * ROUND[1]:g} % ({100 * OTHER[0]:g} to "
        f"{100 * OTHER[1]:g} % for boxes, layers and scenes). A case lasts {CROSSINGS[0]:g} to {CROSSINGS[1]:g} times "
        "as long as a shear wave needs to cross the spot or twice the depth, and at most "
        f'{1e3 * LONGEST_S:g} ms. In family "rims" the spot reaches over the rim, in "contrast" the stiffness of '
        f'sheets differs {CONTRAST:g}-fold, "scenes" are discs, palms and ellipsoids in `palmfield.run`. Each case is '
        f"solved by `auto` and by {BY_NAME} other solvers (scenes: by one). Predicted times above 5 s count as "
        '"no answer".',
        "",
        "**True error.** The error is the relative L2 error over the times, at the worst point. The reference is "
        f"another solver with a tenth of the target accuracy ({len(tried)} cases; palms and ellipsoids: a quarter), or "
        f"scikit-fem with its own mesh, elements and steps ({len(peers)} cases, {len(finer)} also with finer ones). A "
        f"case is judged only if the error of its reference is at most {CONVERGED:g} of the estimate or of the true "
        "error, whichever is larger. Intervals are 95 % intervals.",
        "",
        "## Goals",
        "",
        *goals(auto, by_family),
        "",
        "## By solver",
        "",
        *table(
            "solver",
            {"auto": auto, "auto against scikit-fem": [row for row in auto if row.independent]}
            | {name: [row for row in rows if row.asked == name] for name in NAMES[1:]}
            | {"all": rows},
        ),
        "",
        f"{families} has `auto` by family.",
        "",
        f"![True error against time of each solver]({picture.name})",
        "",
        *coupled,
        "## References that contradict one another",
        "",
        *([f"- {line}" for line in contradictions(drawn, truths)] or ["None."]),
        "",
        "## Cases of `auto` with an estimate below the true error",
        "",
        *(_below(auto) or ["None."]),
    ]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text("\n".join(lines) + "\n")
    draw_costs(rows, picture)


def _below(rows: list[Verdict]) -> list[str]:
    low = [_line(row) for row in rows if row.kind == "judged" and row.estimate < row.true]
    head = [
        "| case | family | target % | estimate % | true % | truth, its error % | s | solver |",
        "|---|---|---|---|---|---|---|---|",
    ]
    return [*head, *low] if low else []


def _line(row: Verdict) -> str:
    def percent(value: float) -> str:
        return "" if math.isnan(value) else f"{100 * value:.2g}"

    seconds = "" if math.isnan(row.seconds) else f"{row.seconds:.2g}"
    truth = f"{row.by}, {percent(row.truth_error)}" if row.by else ""
    words = row.words.replace("|", "/").replace("\n", " ")[:90]
    return (
        f"| {row.case.rpartition('-')[2]} | {row.family} | {percent(row.accuracy)} "
        f"| {percent(row.estimate)} "
        f"| {percent(row.true)} | {truth} | {seconds} | {words} |"
    )
