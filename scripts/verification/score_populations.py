#!/usr/bin/env python3
"""Compare committed predictions by populations with findings: docs/gallery/predictions_populations.md.

python scripts/verification/score_populations.py [--out docs/gallery]

It reads predictions_populations.json and predictions.json (levels of one surface point). Outcomes are those of
`score_predictions`, and for steady pressure those of Morisaki et al. 2022.
"""

import argparse
import json
import math
from pathlib import Path

from predictions_populations import FELT_N, HELD_N, NUMBERS, ROOT
from score_predictions import OUTCOMES, Outcome, predicted

PAGE = "predictions_populations.md"
HEAD = (
    "finding", "claim", "10 mm", "20 mm", "no waves", "published", "populations", "populations, no waves",
    "one surface point", "duration and energy",
)  # fmt: skip
STEADY = Outcome(
    "Morisaki et al. 2022 (doi 10.1109/TOH.2021.3125843), abstract",
    "LM at 5 to 15 Hz with steps below 1 mm: 0.027 N of sound felt like 0.21 N at rest",
    True,
    20.0 * math.log10(FELT_N / HELD_N),
)
TEXT = """\
# Predictions of findings by populations of afferents

For readers who judge the models. Written by `python scripts/verification/score_populations.py` from
[predictions_populations.json](predictions_populations.json). The numbers were committed (code at {commit}) and scored
in a later commit. The level is that of `population_all` ([afferents](../receptors.md)); its constants come from
thresholds under probes and one threshold under a contactor. The abstracts of all findings were known when the stimuli
were chosen.

**Directions right: {ours} of {of} by populations on skin with waves, {still} of {of} on a skin without waves, {point}
of {of_point} by one surface point and contact observers, {energy} of {of_point} by duration and energy.** {tie}

| {head} |
|---|---|---|---|---|---|---|---|---|---|
{rows}

A direction counts if both depths have it. In the skin without waves each point follows the pressure on it with the
static motion under a spot. Sizes: {sizes}
"""


def right(holds: bool, outcome: Outcome) -> str:
    return "right" if holds == outcome.holds else "wrong"


def page(numbers: dict, former: dict) -> str:
    points = {one["name"]: one for one in former["findings"]}
    outcomes, rows, counts = OUTCOMES | {"steady pressure": STEADY}, [], [0, 0, 0, 0]
    sizes = []
    for one in numbers["findings"]:
        outcome, holds = outcomes[one["name"]], one["holds"]
        shown = [
            "none" if one["sizes"][depth] is None else f"{one['sizes'][depth]:.3g} {one['unit']}"
            for depth in ("10 mm", "20 mm", "no waves")
        ]
        ours, still = holds["10 mm"] and holds["20 mm"], holds["no waves"]
        verdicts = [right(ours, outcome), right(still, outcome)]
        if one["name"] in points:
            point = points[one["name"]]
            verdicts += [right(predicted(point) == "yes", outcome), right(point["baseline_holds"], outcome)]
        else:
            verdicts += ["no answer", "no answer"]
        counts = [count + (verdict == "right") for count, verdict in zip(counts, verdicts, strict=True)]
        rows.append(" | ".join(["", one["name"], one["claim"], *shown, outcome.text, *verdicts, ""]).strip())
        if outcome.size is not None:
            sizes.append(f"{one['name']} {shown[0]} and {shown[1]} against {outcome.size:.3g} {one['unit']} published")
    tie = (
        "**The skin without waves predicts as many: these findings do not show that waves are needed.**"
        if counts[1] >= counts[0]
        else "The skin without waves predicts fewer."
    )
    return TEXT.format(
        commit=numbers["commit"],
        head=" | ".join(HEAD),
        ours=counts[0],
        still=counts[1],
        point=counts[2],
        energy=counts[3],
        of=len(rows),
        of_point=len(points),
        tie=tie,
        rows="\n".join(rows),
        sizes="; ".join(sizes) + ".",
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "gallery", help="folder of numbers and page")
    args = parser.parse_args()
    numbers, former = (
        json.loads((args.out / name).read_text(encoding="utf-8")) for name in (NUMBERS, "predictions.json")
    )
    (args.out / PAGE).write_text(page(numbers, former), encoding="utf-8")


if __name__ == "__main__":
    main()
