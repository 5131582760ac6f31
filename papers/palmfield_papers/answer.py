"""What a paper's own module gives to the gallery: an answer for each number, under given readings and controls."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from matplotlib.figure import Figure


@dataclass(frozen=True)
class Setting:
    """Under what a number is computed. Hashable, so that what several numbers share can be kept by it.

    readings: pairs of axis and value, of all axes on which the number depends ([reading_axes] of tolerances.toml)
    control: name of a negative control, which changes one thing on purpose; empty for none
    quick: coarser, for an answer in minutes; device: Warp's name of where kernels run
    """

    readings: tuple[tuple[str, str], ...] = ()
    control: str = ""
    quick: bool = False
    device: str = "cpu"

    def reading(self, axis: str) -> str:
        """The value of an axis. Raises KeyError where the number doesn't depend on it."""
        return dict(self.readings)[axis]


@dataclass(frozen=True)
class Answer:
    """One number as computed, in the unit of its entry.

    value: the number, or what is compared; None where there is none, which `note` explains
    error: numerical error of the value in its unit, from a finer run or an exact solution; 0 for closed forms
    band: least and largest value as far as p0 and material are known, None where neither enters
    margin: of an inequality, how far inside (positive) or outside (negative) of what it asks; None for numbers
    shown: other numbers that are printed beside it and not counted, by what they are
    other_estimate: the same quantity by another estimator, as good a reading of the paper's words; None for none
    against: what the paper prints under this reading, where it prints two numbers for one thing; else the entry's value
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
            raise ValueError("an answer without a value needs a note that says why")
        for number in (self.value, self.error, self.margin, self.against):
            if number is not None and not math.isfinite(number):
                raise ValueError(f"an answer has {number}: give None and a note where there is no number")


Compute = Callable[[Setting], Answer]


@dataclass(frozen=True)
class Cause:
    """A possible reason for a claim that disagrees, tested by changing it: what is changed, and the answer then."""

    what: str
    compute: Compute


@dataclass(frozen=True)
class Picture:
    """A figure of a paper, drawn again from our data. name: of its file, without suffix; draw: called with the base."""

    name: str
    caption: str
    draw: Callable[[Setting], Figure]


@dataclass(frozen=True)
class Paper:
    """All that one paper has in the gallery.

    name: as on the command line; paper: as in the entries of tolerances.toml; about: two or three sentences
    answers: by id of the entry; causes: of claims that disagree, by id
    later: of claims that agree and that no listed control turns, by id: what the entry says it could fail by, done on
        purpose. They were written when answers were known, and stand apart from the controls
    found_later: readings that were found by looking at answers, by id of the claims that they bear on; no verdict
        counts them
    notes: Markdown that stands below the tables (hypotheses, chains, what was printed and what is right)
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
