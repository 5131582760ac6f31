#!/usr/bin/env python3
"""Compare the committed predictions with the published findings: docs/gallery/predictions_score.md.

python scripts/verification/score_predictions.py [--out docs/gallery]
python scripts/verification/score_predictions.py --no-waves     # computes the skin without waves first, 1 minute

Rules are those of predictions.md. It reads predictions.json and, of the baseline skin, predictions_no_waves.json.
"""

import argparse
import json
import statistics
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import predictions_felt as felt
from predictions import NUMBERS, ROOT

PAGE, STILL = "predictions_score.md", "predictions_no_waves.json"
TEXT = """\
# Predictions of findings, held against what was published

Written by `python scripts/verification/score_predictions.py` from [predictions.json](predictions.json). Rules are in
[predictions.md](predictions.md). The repository does not show which came first: predictions and scores entered its
history in one commit (2d3eff3).

**Directions: {ours} of {of} by the simulated skin, {still} of {of} by a skin without waves, {baseline} of {of} by
duration and energy alone. Sizes: {within} of {sizes} by the simulated skin, {still_within} without waves.**

**These findings do not show that waves are needed.** In the skin without waves each point moves as the pressure on it,
1 um/Pa at all frequencies, and nothing propagates; the observers are the same. It gives the verdict of the simulated
skin in {same} of {of} rows, the wrong one included. What decides these rows is the sound's pattern in time and the
observers' thresholds. The baseline was written after the outcomes were known.

| finding | claim | predicted | published | simulated skin | skin without waves | duration and energy | size |
|---|---|---|---|---|---|---|---|
{rows}

How much that says:

- The claims were written by someone who had read the abstracts, and what is published are effects that were found.
  Whoever guessed "yes" each time would have {of} of {of}. So a wrong row says more than a right one.
- The row of the best speed is right by its claim alone. The abstract says more: that the best speed is that of surface
  waves. Ours, {speed:.3g} m/s by the median, is twice that of the palm preset's own surface waves (4.5 to 5.5 m/s from
  50 to 400 Hz, deep skin), so that this part did not come out.
- Duration and energy can't tell most pairs apart, as they have the same energy. They are a low bar; the skin without
  waves is the one to beat.
- The outcomes are those of abstracts. Sizes of stimuli that these don't say are ours, so that a row compares
  directions under like stimuli, not the experiment.
- One observer's level at one place stands for perceived strength. Nothing here knows of touch by movement, of
  attention or of pressure that is steady.
"""
LIKELY, UNLIKELY = 5, 1
"""Numbers of answers, of six, with the direction of the claim: from the first on "yes", up to the second "no"."""
FACTOR, LEVEL_dB = 1.5, 3.0


@dataclass(frozen=True)
class Outcome:
    """A published finding.

    holds: whether it has the direction of the claim; size: in the unit of the prediction, or None
    """

    source: str
    text: str
    holds: bool
    size: float | None = None


OUTCOMES = {
    "STM speed": Outcome(
        "Frier et al. 2018, EuroHaptics (doi 10.1007/978-3-319-93445-7_24), abstract",
        "intensity is greatest where the focus moves as fast as surface waves of the skin; the abstract has no number",
        True,
    ),
    "gap": Outcome(
        "Howard et al. 2023, ACM Trans. Appl. Percept., abstract",
        "mean threshold 32.3 mm; one below 15 mm in over 95 %, two at 45 mm in 84 %",
        True, 32.3,
    ),
    "LM step": Outcome(
        "Morisaki et al. 2022 (doi 10.1109/TOH.2021.3125843), abstract",
        "vibration is suppressed at 5 to 15 Hz with steps below 1 mm; the step has a significant effect on it",
        True,
    ),
    "LM over AM": Outcome(
        "Takahashi et al. 2020, IEEE Trans. Haptics 13, 334, abstract",
        "circular LM is sensed stronger than AM of the same largest output, 10 to 200 Hz",
        True,
    ),
    "sampling": Outcome(
        "Frier et al. 2019, CHI, abstract",
        "the update rate changes the strength, most of all below 10 turns a second, and higher rates don't improve it; "
        "that fewer points are stronger is read from the 'optimal update rate' of the abstract",
        True,
    ),
    "rate of turns": Outcome(
        "Freeman & Wilson 2021, ICMI, abstract", "intensity rises linearly with speed up to 17 turns a second", True
    ),
    "more foci": Outcome(
        "Shen et al. 2023 (doi 10.1145/3544548.3580641), abstract", "more focal points are felt less intensely", True
    ),
    "tactile pointer": Outcome(
        "Hajas et al. 2020 (doi 10.1109/TOH.2020.2966445), abstract",
        "shapes drawn by a pointer are recognised more accurately than outlines; contrast was not measured",
        True,
    ),
}  # fmt: skip


def predicted(finding: dict[str, Any]) -> str:
    """Return yes, no or split: whether the answers have the direction of the claim."""
    count = finding["with_the_claim"] * 6 / finding["of"]
    return "yes" if count >= LIKELY else "no" if count <= UNLIKELY else "split"


def median(finding: dict[str, Any]) -> float:
    """Return the median of all available answers."""
    return statistics.median(value for row in finding["sizes"].values() for value in row.values() if value is not None)


def size_text(finding: dict[str, Any], outcome: Outcome) -> str:
    if outcome.size is None:
        return "none published"
    ours = median(finding)
    if finding["unit"] == "dB":
        within = abs(ours - outcome.size) <= LEVEL_dB
    else:
        within = 1.0 / FACTOR <= ours / outcome.size <= FACTOR
    return f"{ours:.3g} against {outcome.size:g} {finding['unit']}: {'within' if within else 'outside'}"


def no_waves() -> list[dict[str, Any]]:
    """Return the predictions by a skin without waves, in the form of predictions.json."""
    found = []
    for finding in felt.FINDINGS:
        sizes = felt.predicted(finding, (felt.NO_WAVES,))
        count, of = felt.agreement(finding, sizes)
        found.append({"name": finding.name, "unit": finding.unit, "sizes": sizes, "with_the_claim": count, "of": of})
    return found


def page(numbers: dict[str, Any], without_waves: list[dict[str, Any]]) -> str:
    findings = {one["name"]: one for one in numbers["findings"]}
    still = {one["name"]: one for one in without_waves}
    lines, ours_right, baseline_right, still_right, same = [], 0, 0, 0, 0
    for name, outcome in OUTCOMES.items():
        one = findings[name]
        ours = predicted(one) == ("yes" if outcome.holds else "no")
        baseline = one["baseline_holds"] == outcome.holds
        unmoved = predicted(still[name]) == ("yes" if outcome.holds else "no")
        ours_right, baseline_right = ours_right + ours, baseline_right + baseline
        still_right, same = still_right + unmoved, same + (predicted(still[name]) == predicted(one))
        lines.append(
            f"| {name} | {one['claim']} | {predicted(one)} ({one['with_the_claim']} of {one['of']}) | {outcome.text} "
            f"({outcome.source}) | {'right' if ours else 'wrong'} | {'right' if unmoved else 'wrong'} | "
            f"{'right' if baseline else 'wrong'} | "
            f"{size_text(one, outcome)} |"
        )
    sized = {name: outcome for name, outcome in OUTCOMES.items() if outcome.size is not None}
    within, still_within = (
        sum("within" in size_text(rows[name], outcome) for name, outcome in sized.items()) for rows in (findings, still)
    )
    return TEXT.format(
        ours=ours_right, baseline=baseline_right, still=still_right, same=same, of=len(OUTCOMES), within=within,
        still_within=still_within, sizes=len(sized), rows="\n".join(lines), speed=median(findings["STM speed"]),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "gallery")
    parser.add_argument("--no-waves", action="store_true", help="compute the skin without waves anew")
    arguments = parser.parse_args()
    still = arguments.out / STILL
    if arguments.no_waves:
        still.write_text(json.dumps(no_waves(), indent=1, allow_nan=False) + "\n", encoding="utf-8")
    numbers = json.loads((arguments.out / NUMBERS).read_text(encoding="utf-8"))
    (arguments.out / PAGE).write_text(page(numbers, json.loads(still.read_text(encoding="utf-8"))), encoding="utf-8")


if __name__ == "__main__":
    main()
