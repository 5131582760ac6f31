"""Count the verdicts of a paper, and find which negative controls changed a verdict."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from palmfield_papers.entries import Control
from palmfield_papers.rows import Row
from palmfield_papers.verdicts import VERDICTS, sure, verdict

SHARE = 3
"""Divisor: at least one in this number of the claims that a control lists beforehand must change."""


WEIGHTLESS = {
    "C14c": "the order of the filter, which the paper does not name, changes it by the tolerance, a factor of 2",
    "C19f": "the high-pass removes almost all motion of a held focus; without it the ratio is 0.45",
    "C21a": "the focus moves on the circle on which the largest motion is sought",
    "C21b": "it compares the motion far from the focus with half of that under it",
    "C21c": "it compares the motion far from the circle with that under the focus",
    "C21d": "the focus itself moves over a larger area",
    "R11f": "the focus turns at the corners and rests there longer",
    "R12l": "for any slab, half the rate differs more from the highest rate",
    "R16-R18l": "a longer path in the same time leaves a longer wake",
    "R20d": "a spot that passes faster is a shorter pulse",
    "R20e": "a spot that passes faster is a shorter pulse",
    "H6d": "sounds in phase have the largest possible sum",
    "H12a": "the sound does not depend on the modulation frequency without the transducers' response",
    "H17a": "delays rounded to 1/50 of a period move a focus by far less than 1 mm",
    "H22a": "both sides differ by 34 dB",
}
"""Ids of agreements that no answer of a run could have changed, with the reason.

They were found after the first runs, from the derivation of each number. Verdicts are unchanged; these agreements are
counted separately.
"""


@dataclass(frozen=True)
class Noticed:
    """A control, with the ids of the listed claims that it changed, that it did not change, and that have no answer.

    wanted: smallest required number of changed claims
    """

    control: Control
    turned: tuple[str, ...]
    kept: tuple[str, ...]
    silent: tuple[str, ...]
    wanted: int

    @property
    def works(self) -> bool:
        return len(self.turned) >= max(1, self.wanted)


def counts(rows: Sequence[Row]) -> dict[str, int]:
    """Return the number of claims for each verdict."""
    found = Counter(row.verdict for row in rows if row.verdict is not None)
    return {name: found[name] for name in VERDICTS}


def weightless(rows: Sequence[Row]) -> list[str]:
    """Return the claims that agree and that no answer could have changed."""
    return [row.entry.id for row in rows if row.verdict == "agrees" and row.entry.id in WEIGHTLESS]


def noticed(controls: Sequence[Control], rows: Sequence[Row]) -> list[Noticed]:
    """Return the controls that list a claim of these rows."""
    by_id = {row.entry.id: row for row in rows}
    out = []
    for control in controls:
        listed = [by_id[name] for name in control.sensitive if name in by_id]
        if not listed:
            continue
        changed = {row.entry.id: row.turned(control.name) if control.name in row.controls else None for row in listed}
        out.append(
            Noticed(
                control,
                tuple(name for name, one in changed.items() if one),
                tuple(name for name, one in changed.items() if one is False),
                tuple(name for name, one in changed.items() if one is None),
                math.ceil(len(control.sensitive) / SHARE),
            )
        )
    return out


def unsure(rows: Sequence[Row]) -> list[str]:
    """Return claims whose verdict would change if an answer changed by its numerical error."""
    return [row.entry.id for row in rows if row.entry.counts and any(_hangs_on(row, n) for n in range(len(row.tried)))]


def _hangs_on(row: Row, number: int) -> bool:
    one = row.tried[number]
    if one.answer is None or one.comparison is None or sure(row.entry, one.answer):
        return False
    comparisons = [other.comparison for other in row.tried]
    comparisons[number] = replace(one.comparison, within=not one.comparison.within)
    return verdict(row.entry, comparisons) != row.verdict


def turned_later(rows: Sequence[Row]) -> list[str]:
    """Return the claims of `untested` that change in a test that was written when answers were known."""
    by_id = {row.entry.id: row for row in rows}
    return [name for name in untested(rows) if any(by_id[name].differs(one) for _, one in by_id[name].later)]


def untested(rows: Sequence[Row]) -> list[str]:
    """Return claims that agree and that no control changes."""
    return [
        row.entry.id for row in rows if row.verdict == "agrees" and not any(row.turned(name) for name in row.controls)
    ]
