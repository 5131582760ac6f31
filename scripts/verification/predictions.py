#!/usr/bin/env python3
"""Compute predictions for laboratories and of published findings: docs/gallery/predictions.json and .md.

python scripts/verification/predictions.py [--out docs/gallery]     # both halves, about 15 minutes of processor
python scripts/verification/predictions.py --page [--out ...]       # the page alone, from the numbers

The numbers are committed first; `score_predictions.py` then compares them with the published values on another page.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import predictions_felt as felt
import predictions_force as force

from palmfield.studies.bench.field import git_commit

ROOT = Path(__file__).resolve().parents[2]
NUMBERS, PAGE = "predictions.json", "predictions.md"
INTRODUCTION = Path(__file__).with_name("predictions_text.md")
OBSERVERS = ("bolanowski_1988", "morioka_griffin_2006", "afferent_human")


def compute() -> dict[str, Any]:
    """Return all numbers, rounded to four digits."""
    # A checkout that changes in the meantime is not what runs
    commit = git_commit()
    cases = []
    for name in force.LAYOUTS:
        for depth in force.DEPTHS_M:
            for plate in force.PLATES_M:
                case = force.case(name, depth, plate)
                print(name, depth, plate, f"{case.ratio:.3f}", flush=True)
                cases.append(_rounded(vars(case) | {
                    "ratio": case.ratio,
                    "as_measured": {f"{level:g}": case.as_measured(level) for level in force.LEVELS},
                }))  # fmt: skip
    findings = []
    for finding in felt.FINDINGS:
        sizes = felt.predicted(finding)
        print(finding.name, sizes, flush=True)
        right, of = felt.agreement(finding, sizes)
        findings.append(_rounded({
            "name": finding.name, "stimulus": finding.stimulus, "quantity": finding.quantity, "unit": finding.unit,
            "claim": finding.claim, "sizes": sizes, "with_the_claim": right, "of": of, "baseline": finding.baseline,
            "baseline_holds": finding.baseline_holds,
        }))  # fmt: skip
    return {"commit": commit, "force": cases, "findings": findings}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def page(numbers: dict[str, Any]) -> str:
    """Return the page of these numbers as Markdown."""
    text = INTRODUCTION.read_text(encoding="utf-8")
    parts = {
        "FORCE": _force_table(numbers["force"]),
        "FELT": _felt_table(numbers["findings"]),
    }
    for name, part in parts.items():
        text = text.replace(f"<!-- {name} -->", part)
    return text


def _force_table(cases: list[dict[str, Any]]) -> str:
    levels = [f"{level:g}" for level in force.LEVELS]
    head = ("array", "focus and plate at", "plate", "force over formula", "its error")
    titles = [*head, *(f"drive {one}" for one in levels), "sigma at full drive", "fringe", "mean with echoes"]
    lines = [f"| {' | '.join(titles)} |", "|---" * len(titles) + "|"]
    for case in cases:
        measured = [case["as_measured"][one] for one in levels]
        texts = " | ".join("beyond sigma 1" if value is None else f"{value:.2f}" for value in measured)
        plate = f"{1e3 * case['plate_m']:.0f} mm"
        lines.append(
            f"| `{case['layout']}` | {1e3 * case['depth_m']:.0f} mm | {plate} | {case['ratio']:.3f} | "
            f"{_error(case):.3f} | {texts} | "
            f"{case['sigma']:.2f} | up to {100 * case['fringe']:.0f} % | up to {case['fringe_mean']:.2f} |"
        )
    return "\n".join(lines)


def _error(case: dict[str, Any]) -> float:
    """Return half of the change for a doubled spacing; in the worst case half the spacing changed less."""
    return 0.5 * abs(case["coarser"] - case["ratio"])


def _felt_table(findings: list[dict[str, Any]]) -> str:
    lines = [
        "| finding | stimulus | what is predicted | " + " | ".join(f"`{name}`" for name in OBSERVERS)
        + " | with the claim | claim | duration and energy alone |",
        "|---" * (6 + len(OBSERVERS)) + "|",
    ]  # fmt: skip
    for one in findings:
        sizes = [", ".join(_text(row[name]) for row in one["sizes"].values()) for name in OBSERVERS]
        lines.append(
            f"| {one['name']} | {one['stimulus']} | {one['quantity']} [{one['unit']}] | {' | '.join(sizes)} | "
            f"{one['with_the_claim']} of {one['of']} | {one['claim']} | {one['baseline']} |"
        )
    return "\n".join(lines)


def _text(value: float | None) -> str:
    return "none" if value is None else f"{value:.3g}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "gallery")
    parser.add_argument("--page", action="store_true", help="write the page from the numbers that are there")
    arguments = parser.parse_args()
    target = arguments.out / NUMBERS
    if not arguments.page:
        target.write_text(json.dumps(compute(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    (arguments.out / PAGE).write_text(page(json.loads(target.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
