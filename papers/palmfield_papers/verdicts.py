"""Whether an answer is within its tolerance, by how much, and what the readings say together."""

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
"""The tolerance of angles ([tolerance_rules.angle])."""


@dataclass(frozen=True)
class Held:
    """An answer held against its entry. distance: from the limit, positive inside; for numbers in tolerances (1 is a
    hit, 0 the limit), for inequalities in the unit of what is compared."""

    within: bool
    distance: float


def distance_in_tolerances(ours: float, paper: float, kind: str, value: float) -> float:
    """1 where both are equal, 0 at the limit of the tolerance, negative outside.

    kind, value: as in [tolerance_rules]. A factor asks for the same sign.
    Raises MeasurementError for a kind that holds no numbers against each other.
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
    raise MeasurementError(f"tolerance of kind '{kind}' holds no two numbers; allowed: relative, factor, degrees, dB")


def hold(entry: Entry, answer: Answer) -> Held | None:
    """The answer against the entry; None where the answer has no value or the entry asks for nothing.

    Raises MeasurementError where an inequality's answer has no margin, and where the entry's value is no number.
    """
    if answer.value is None or entry.tolerance.kind == "none":
        return None
    if entry.tolerance.kind == "inequality":
        if answer.margin is None:
            raise MeasurementError(f"entry {entry.id} is an inequality, and its answer has no margin")
        return Held(bool(answer.margin >= 0.0), float(answer.margin))
    paper = entry.value if answer.against is None else answer.against
    if isinstance(paper, list):
        # A range is met all over, and missed by what lies beyond its nearer end
        paper = min(max(answer.value, min(paper)), max(paper))
    if not isinstance(paper, int | float):
        raise MeasurementError(f"entry {entry.id} has value {entry.value!r}, which no number can be held against")
    distance = distance_in_tolerances(answer.value, float(paper), entry.tolerance.kind, entry.tolerance.value)
    return Held(bool(distance >= 0.0), float(distance))


def sure(entry: Entry, answer: Answer) -> bool:
    """Whether the yes or no is the same all over the answer's numerical error."""
    held, error = hold(entry, answer), answer.error
    if held is None or answer.value is None or not error:
        return True

    def off(by: float, value: float) -> Held | None:
        margin = None if answer.margin is None else answer.margin + by
        return hold(entry, replace(answer, value=value + by, margin=margin))

    ends = [off(by, answer.value) for by in (-error, error)]
    return all(end is not None and end.within == held.within for end in ends)


def hangs_on_estimator(answer: Answer | None) -> bool:
    """Whether two estimators of an angle differ by more than ESTIMATORS_deg."""
    if answer is None or answer.value is None or answer.other_estimate is None:
        return False
    return abs(answer.value - answer.other_estimate) > ESTIMATORS_deg


def verdict(entry: Entry, held: Sequence[Held | None]) -> Verdict:
    """What the readings say together, the base first. A reading without a value says nothing; a base without one
    leaves no answer."""
    if not entry.testable:
        return "not testable"
    said = [one.within for one in held if one is not None]
    if not said or held[0] is None:
        return "no answer"
    if all(said):
        return "agrees"
    return "depends" if any(said) else "disagrees"
