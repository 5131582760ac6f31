"""Compute each number of a paper under its readings and controls, and compare it within its tolerance."""

import logging
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from palmfield.errors import PalmfieldError
from palmfield_papers.answer import Answer, Compute, Paper, Setting
from palmfield_papers.entries import Book, Control, Entry
from palmfield_papers.verdicts import Comparison, Verdict, compared, hangs_on_estimator, verdict

logger = logging.getLogger("palmfield.papers")


@dataclass(frozen=True)
class Tried:
    """One answer of a row. readings: all axes and their values; failed: reason if there is no answer"""

    readings: Mapping[str, str]
    answer: Answer | None
    comparison: Comparison | None
    failed: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Return the answer for JSON."""
        answer, comparison = self.answer, self.comparison
        return {
            "readings": dict(self.readings),
            "ours": None if answer is None else answer.value,
            "error": None if answer is None else answer.error,
            "band": None if answer is None or answer.band is None else list(answer.band),
            "margin": None if answer is None else answer.margin,
            "against": None if answer is None else answer.against,
            "other_estimate": None if answer is None else answer.other_estimate,
            "note": self.failed or ("" if answer is None else answer.note),
            "shown": {} if answer is None else dict(answer.shown),
            "within": None if comparison is None else comparison.within,
            "distance": None if comparison is None or comparison.distance == float("-inf") else comparison.distance,
            "failed": bool(self.failed),
        }


@dataclass(frozen=True)
class Row:
    """One entry and all its answers, base readings first.

    controls: answers by name of the control, only for claims
    causes, later: changes and their answers
    found_later: readings that were found from answers, which verdicts ignore
    seconds: processor time
    """

    entry: Entry
    tried: tuple[Tried, ...]
    verdict: Verdict | None
    controls: Mapping[str, Tried] = field(default_factory=dict)
    causes: tuple[tuple[str, Tried], ...] = ()
    later: tuple[tuple[str, Tried], ...] = ()
    found_later: tuple[tuple[str, Tried], ...] = ()
    seconds: float = 0.0

    @property
    def base(self) -> Tried | None:
        return self.tried[0] if self.tried else None

    def turned(self, control: str) -> bool | None:
        """Return whether the verdict changes under a control. None if one of the two verdicts is missing."""
        return self.differs(self.controls[control])

    def differs(self, other: Tried) -> bool | None:
        """Return whether the verdict differs from that of the base. None if one of the two verdicts is missing."""
        if self.base is None or self.base.comparison is None or other.comparison is None:
            return None
        return self.base.comparison.within != other.comparison.within

    def as_dict(self) -> dict[str, Any]:
        """Return the row for JSON."""
        entry = self.entry
        return {
            "id": entry.id,
            "row": entry.row,
            "kind": entry.kind,
            "quantity": entry.quantity,
            "unit": entry.unit,
            "paper": entry.value,
            "corrected": entry.corrected,
            "column": entry.column,
            "configuration": entry.configuration,
            "condition": entry.condition,
            "tolerance": {"rule": entry.tolerance.rule, "kind": entry.tolerance.kind, "value": entry.tolerance.value},
            "verdict": self.verdict,
            "tried": [one.as_dict() for one in self.tried],
            "controls": {name: one.as_dict() | {"turned": self.turned(name)} for name, one in self.controls.items()},
            "causes": [{"what": what, **one.as_dict()} for what, one in self.causes],
            "later": [{"what": what, **one.as_dict(), "turned": self.differs(one)} for what, one in self.later],
            "found_later": [{"what": what, **one.as_dict()} for what, one in self.found_later],
            "seconds": round(self.seconds, 3),
        }


def _tried(entry: Entry, compute: Compute, setting: Setting) -> Tried:
    readings = dict(setting.readings)
    try:
        answer = compute(setting)
        return Tried(readings, answer, compared(entry, answer))
    except PalmfieldError as error:
        return Tried(readings, None, None, str(error))
    except Exception as error:  # a failed row must not stop the page
        logger.exception("entry %s failed", entry.id)
        return Tried(readings, None, None, f"{type(error).__name__}: {error}")


def _acts_on(control: Control, entry: Entry, outcome: Verdict | None, quick: bool) -> bool:
    """Return whether a control applies to a claim.

    It applies if it lists the claim or, in full runs, if it affects the configuration of a claim that agrees.
    """
    if control.name in entry.sensitive_to:
        return True
    return not quick and outcome == "agrees" and entry.configuration in control.configurations


def row(entry: Entry, paper: Paper, book: Book, setting: Setting) -> Row:
    """Answer an entry under its readings and, for claims, under controls. If it disagrees, test causes.

    setting: quick and device are used. INPUT, ERRATUM and CALC are answered only under the base.
    """
    started = time.process_time()
    compute = paper.answers.get(entry.id)
    if compute is None:
        outcome: Verdict | None = None
        if entry.kind == "CLAIM":
            outcome = "no answer" if entry.testable else "not testable"
        return Row(entry, (), outcome)
    readings = book.varied(entry) if entry.counts else [book.base(entry)]
    tried = tuple(_tried(entry, compute, replace(setting, readings=one)) for one in readings)
    if entry.kind != "CLAIM":
        return Row(entry, tried, None, seconds=time.process_time() - started)
    outcome, split = verdict(entry, [one.comparison for one in tried]), hangs_on_estimator(tried[0].answer)
    base = replace(setting, readings=readings[0])
    controls = {
        control.name: _tried(entry, compute, replace(base, control=control.name))
        for control in book.controls
        if entry.counts and _acts_on(control, entry, outcome, setting.quick)
    }
    causes = tuple(
        (cause.what, _tried(entry, cause.compute, base))
        for cause in (paper.causes.get(entry.id, ()) if outcome == "disagrees" else ())
    )
    outcome = "depends" if split and outcome in ("agrees", "disagrees") else outcome
    found = Row(entry, tried, outcome, controls, causes)
    later: tuple[tuple[str, Tried], ...] = ()
    if outcome == "agrees" and not any(found.turned(name) for name in controls):
        later = tuple((one.what, _tried(entry, one.compute, base)) for one in paper.later.get(entry.id, ()))
    readings_later = tuple(
        (one.what, _tried(entry, one.compute, base)) for one in paper.found_later.get(entry.id, ()) if entry.counts
    )
    return replace(found, later=later, found_later=readings_later, seconds=time.process_time() - started)


def rows(paper: Paper, book: Book, setting: Setting) -> Iterator[Row]:
    """Yield the rows of a paper in the order of the file."""
    for entry in book.of_paper(paper.paper):
        yield row(entry, paper, book, setting)
