"""Compare answers with tolerances, and combine the readings into a verdict."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from palmfield.errors import MeasurementError
from palmfield_papers.answer import Answer
from palmfield_papers.entries import Entry

Verdict = Literal["agrees", "disagrees", "depends", "not testable", "no answer"]
VERDICTS: tuple[Verdict, ...] = ("agrees", "disagrees", "depends", "not testable", "no answer")


ESTIMATORS_deg = 5.0
"""Tolerance between two estimators of an angle ([tolerance_rules.angle])."""


@dataclass(frozen=True)
class Comparison:
    """An answer compared with its entry.

    distance: distance from the limit, positive inside. For numbers in tolerances (1: equal, 0: limit), for inequalities
        in the unit of the compared quantity
    """

    within: bool
    distance: float


def distance_in_tolerances(ours: float, paper: float, kind: str, value: float) -> float:
    """Return 1 if both are equal, 0 at the limit of the tolerance, negative outside.

    kind, value: as in [tolerance_rules]. A factor requires the same sign.
    Raises MeasurementError for a kind that does not compare numbers.
    """
    if kind == "relative":
        off = abs(ours - paper) / abs(paper) if paper else math.inf
        return 1.0 - off / value
    if kind == "factor":
        if ours * paper <= 0.0:
            return -math.inf
        return 1.0 - abs(math.log(ours / paper)) / math.log(value)
    if kind in ("absolute_degrees", "dB"):
        return 1.0 - abs(ours - paper) / value
    raise MeasurementError(
        f"tolerance of kind '{kind}' does not compare two numbers; allowed: relative, factor, degrees, dB"
    )


def compared(entry: Entry, answer: Answer) -> Comparison | None:
    """Compare an answer with its entry. None if the answer has no value or the entry has no condition.

    Raises MeasurementError if the answer of an inequality has no margin, and if the value of the entry is not a number.
    """
    if answer.value is None or entry.tolerance.kind == "none":
        return None
    if entry.tolerance.kind == "inequality":
        if answer.margin is None:
            raise MeasurementError(f"entry {entry.id} is an inequality, and its answer has no margin")
        return Comparison(bool(answer.margin >= 0.0), float(answer.margin))
    paper = entry.value if answer.against is None else answer.against
    if isinstance(paper, list):
        # Inside a range the distance is 1; outside it is that to the nearer end
        paper = min(max(answer.value, min(paper)), max(paper))
    if not isinstance(paper, int | float):
        raise MeasurementError(f"entry {entry.id} has value {entry.value!r}, which cannot be compared with a number")
    distance = distance_in_tolerances(answer.value, float(paper), entry.tolerance.kind, entry.tolerance.value)
    return Comparison(bool(distance >= 0.0), float(distance))


def sure(entry: Entry, answer: Answer) -> bool:
    """Return whether the verdict is the same over the whole range of the numerical error."""
    own, error = compared(entry, answer), answer.error
    if own is None or answer.value is None or not error:
        return True

    def off(by: float, value: float) -> Comparison | None:
        margin = None if answer.margin is None else answer.margin + by
        return compared(entry, replace(answer, value=value + by, margin=margin))

    ends = [off(by, answer.value) for by in (-error, error)]
    return all(end is not None and end.within == own.within for end in ends)


def hangs_on_estimator(answer: Answer | None) -> bool:
    """Return whether two estimators of an angle differ by more than ESTIMATORS_deg."""
    if answer is None or answer.value is None or answer.other_estimate is None:
        return False
    return abs(answer.value - answer.other_estimate) > ESTIMATORS_deg


def verdict(entry: Entry, comparisons: Sequence[Comparison | None]) -> Verdict:
    """Return the verdict of all readings, base first.

    Readings without a value are ignored. If the base has no value, the verdict is "no answer".
    """
    if not entry.testable:
        return "not testable"
    within = [one.within for one in comparisons if one is not None]
    if not within or comparisons[0] is None:
        return "no answer"
    if all(within):
        return "agrees"
    return "depends" if any(within) else "disagrees"
