#!/usr/bin/env python3
"""Compare committed predictions by populations with findings: docs/gallery/predictions_populations.md.

python scripts/verification/score_populations.py [--out docs/gallery]

It reads predictions_populations.json, predictions_direction.json and predictions.json (levels of one surface point).
Outcomes are those of `score_predictions`, for steady pressure those of Morisaki et al. 2022, and for direction and
frequency those in LATER.
"""

import argparse
import json
import math
from itertools import pairwise
from pathlib import Path

import predictions_direction as direction
from predictions_populations import FELT_N, HELD_N, NUMBERS, ROOT
from score_predictions import OUTCOMES, Outcome, predicted

PAGE = "predictions_populations.md"
TIE = "**The skin without waves predicts as many: these findings do not show that waves are needed.**"
LESS = "The skin without waves predicts fewer."
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
REARDON = (
    "Reardon et al. 2023, Sci. Adv. 9, eadf2037, behavioural experiment (row R19 of [its page](reardon2023/README.md))"
)
HASEGAWA = (
    "Hasegawa & Shinoda 2018, IEEE Trans. Haptics, figure 14 (rows H19-H21 of [its page](hasegawa2018/README.md))"
)
LATER = {
    "direction, slow": f"above chance by implication, no share is printed; {REARDON}",
    "direction, fast": "at chance at 4, 7 and 11 m/s",
    "direction, order": "the share falls as the wake gets longer; no share is printed",
    "best frequency": f"near 200 Hz; {HASEGAWA}",
    "threshold at 200 Hz": "0.4 mN; 0.2 mN if equation 8 lacks a factor 1/2, which makes our levels 6 dB lower",
    "rectangle": "about 20 dB lower threshold of a rectangle at 10 Hz",
}
"""What was published; the direction of each claim came out."""
SKINS = ("10 mm", "20 mm", "no waves")
REGISTERED = "8285ae9f"
"""Commit of the numbers of `predictions_direction`. Their field `commit` is that of the script before a rebase."""
MORE_HEAD = (
    "finding", "claim", "10 mm", "20 mm", "no waves", "one surface point", "duration and energy", "published",
    "populations", "populations, no waves", "one surface point", "duration and energy",
)  # fmt: skip
MORE = """\

## Direction, and level over frequency

Written from [predictions_direction.json](predictions_direction.json), whose numbers were committed in {registered},
before this comparison. Known before: the text of both papers. Nothing was fitted: the noise of the observer of
direction is that of judgements of the order of two touches (75 % right at 40 ms; Yamamoto and Kitazawa, Scholarpedia 10
(2015) 8249: 20 to 60 ms). It compares the mean spike times in the first and last quarter of the path. The focus moves
once along 16 cm.

**Directions right: {ours} of {of} by populations on skin with waves, {still} of {of} without waves, {point} of
{of_point} by one surface point, {energy} of {of_energy} by duration and energy.** {tie}

| {head} |
|{rule}|
{rows}

Share of right answers [%] at 0.5, 1, 2, 4, 7 and 11 m/s: {shares}. Waves change the time between both ends, and the
spread of the spike times, by little. So the share is that of the duration. With 20 or 60 ms in place of 40 the highest
share at 4 to 11 m/s is {other}. People are at chance there, which this observer does not explain.
"""
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
    tie = TIE if counts[1] >= counts[0] else LESS
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


def _shares(numbers: dict, skin: str) -> list[float]:
    """Return the shares of right answers by speed [%] at the first level; skin: or duration."""
    rows = numbers["direction"][skin]
    rows = rows if skin == "duration" else rows[f"{direction.LEVELS_Pa[0]:g} Pa"]
    found = [rows[f"{speed:g}"] for speed in direction.SPEEDS_M_S]
    return [100.0 * (one if skin == "duration" else one["share"]) for one in found]


def sizes_of(numbers: dict, skin: str) -> dict[str, tuple[str, bool]]:
    """Return size and truth of each claim on a skin, by one surface point, or by duration alone."""
    found: dict[str, tuple[str, bool]] = {}
    if skin != "one surface point":
        shares = dict(zip(direction.SPEEDS_M_S, _shares(numbers, skin), strict=True))
        slow, fast = min(shares[one] for one in direction.SLOW), max(shares[one] for one in direction.FAST)
        falls = all(one > other for one, other in pairwise(shares.values()))
        found["direction, slow"] = f"{slow:.0f} %", slow >= 75.0
        found["direction, fast"] = f"{fast:.0f} %", fast <= 100.0 * direction.CHANCE
        found["direction, order"] = "falls" if falls else "does not fall", falls
    if skin == "duration":
        # Energy: the same at all frequencies, and twice that of a sine for a rectangle
        return found | {"best frequency": ("none", False), "rectangle": ("3 dB", True)}
    levels = dict(numbers["frequency"][skin])
    gain = levels.pop("10 rectangle") - levels.pop("10")
    best = max(levels, key=lambda one: levels[one])
    found["best frequency"] = f"{best} Hz", 100.0 <= float(best) <= 300.0
    found["threshold at 200 Hz"] = f"{levels['200']:.1f} dB", abs(levels["200"]) <= 10.0
    found["rectangle"] = f"{gain:.0f} dB", gain > 0.0
    return found


def more(numbers: dict) -> str:
    """Return the section on direction and frequency."""
    sizes = {skin: sizes_of(numbers, skin) for skin in (*SKINS, "one surface point", "duration")}
    rows, counts = [], {name: [0, 0] for name in ("ours", "no waves", "one surface point", "duration")}
    for name, claim in numbers["claims"].items():
        shown = [sizes[skin].get(name, ("no answer", False))[0] for skin in sizes]
        verdicts = []
        for who, skins in (("ours", SKINS[:2]), *((one, (one,)) for one in list(counts)[1:])):
            answers = [sizes[skin][name][1] for skin in skins if name in sizes[skin]]
            verdicts.append(("right" if all(answers) else "wrong") if answers else "no answer")
            counts[who][0] += bool(answers) and all(answers)
            counts[who][1] += bool(answers)
        rows.append(" | ".join(["", name, claim, *shown, LATER[name], *verdicts, ""]).strip())
    (ours, of), (still, _), (point, of_point), (energy, of_energy) = counts.values()
    fastest = direction.FAST[0]
    own = numbers["direction"]["10 mm"][f"{direction.LEVELS_Pa[0]:g} Pa"][f"{fastest:g}"]["other_intervals"]
    return MORE.format(
        head=" | ".join(MORE_HEAD), rule="|".join(["---"] * len(MORE_HEAD)), registered=REGISTERED,
        ours=ours, of=of, still=still, point=point, of_point=of_point, energy=energy,
        of_energy=of_energy, rows="\n".join(rows), tie=TIE if still >= ours else LESS,
        shares="; ".join(
            f"{skin} {', '.join(f'{one:.0f}' for one in _shares(numbers, skin))}" for skin in (*SKINS, "duration")
        ),
        other=" or ".join(f"{100.0 * one:.0f} %" for one in own),
    )  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "gallery", help="folder of numbers and page")
    args = parser.parse_args()
    numbers, former, later = (
        json.loads((args.out / name).read_text(encoding="utf-8"))
        for name in (NUMBERS, "predictions.json", direction.NUMBERS)
    )
    (args.out / PAGE).write_text(page(numbers, former) + more(later), encoding="utf-8")


if __name__ == "__main__":
    main()
