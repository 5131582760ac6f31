"""Types for the modules of papers: an answer for each number, under each reading and each negative control."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Setting:
    """Conditions under which a number is computed. Hashable, so that numbers can share cached results.

    readings: pairs of axis and value, for all axes on which the number depends ([reading_axes] of tolerances.toml). A
        reading is one interpretation of the text of the paper
    control: name of a negative control, which changes one thing deliberately; empty for none
    quick: whether to compute coarser, for an answer in minutes
    device: Warp device of kernels
    """

    readings: tuple[tuple[str, str], ...] = ()
    control: str = ""
    quick: bool = False
    device: str = "cpu"

    def reading(self, axis: str) -> str:
        """Return the value of an axis. Raises KeyError if the number does not depend on it."""
        return dict(self.readings)[axis]


@dataclass(frozen=True)
class Answer:
    """One computed number, in the unit of its entry.

    value: the number to compare; None if there is none, with the reason in `note`
    error: numerical error of the value in its unit, from a finer run or an exact solution; 0 for closed forms
    band: least and largest value within the ranges of p0 and material, None if it depends on neither
    margin: for an inequality, the distance from its limit, positive if it is satisfied; None for numbers
    shown: other numbers by description, which are printed but have no verdict
    other_estimate: the same quantity by another estimator that the text of the paper equally allows; None for none
    against: value of the paper under this reading, if the paper prints two values; otherwise that of the entry
    """

    value: float | None
    error: float | None = None
    band: tuple[float, float] | None = None
    margin: float | None = None
    note: str = ""
    shown: Mapping[str, float] = field(default_factory=dict)
    against: float | None = None
    other_estimate: float | None = None

    def __post_init__(self) -> None:
        if self.value is None and not self.note:
            raise ValueError("an answer without a value needs a note with the reason")
        for number in (self.value, self.error, self.margin, self.against):
            if number is not None and not math.isfinite(number):
                raise ValueError(f"an answer has {number}: give None and a note where there is no number")


Compute = Callable[[Setting], Answer]


@dataclass(frozen=True)
class Cause:
    """A possible reason for a disagreement: the description of a change, and the answer with this change."""

    what: str
    compute: Compute


@dataclass(frozen=True)
class Picture:
    """A figure of a paper from our data. name: of its file, without suffix; draw: function of the base readings"""

    name: str
    caption: str
    draw: Callable[[Setting], Figure]


@dataclass(frozen=True)
class Paper:
    """Contents of the gallery for one paper.

    name: as on the command line; paper: as in the entries of tolerances.toml; about: two or three sentences
    answers: answers by id of the entry
    causes: possible reasons by id, for claims that disagree
    later: tests by id, for claims that agree and whose verdict no listed control changes. Each test makes the failure
        that the entry names. They were written when answers were known, and are separate from the controls
    found_later: readings that were found from the answers, by id of the claims that they concern; verdicts ignore them
    notes: Markdown below the tables (hypotheses, chains, printed and corrected values)
    """

    name: str
    paper: str
    title: str
    about: str
    answers: Mapping[str, Compute]
    causes: Mapping[str, tuple[Cause, ...]] = field(default_factory=dict)
    later: Mapping[str, tuple[Cause, ...]] = field(default_factory=dict)
    found_later: Mapping[str, tuple[Cause, ...]] = field(default_factory=dict)
    pictures: tuple[Picture, ...] = ()
    notes: Callable[[Setting], str] | None = None
