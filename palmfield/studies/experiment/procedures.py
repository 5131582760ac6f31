"""Choose the next level of an experiment: staircases, limits, constant stimuli, adjustment.

The next level depends only on the answers so far. A procedure has no state: each call passes the trials of the run so
far. So an interrupted experiment can continue.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from pydantic import ConfigDict, with_config

from palmfield.errors import OutputError
from palmfield.types import Float

Scale = Literal["linear", "log"]
STRICT = ConfigDict(extra="forbid", strict=False)


class Answered(NamedTuple):
    """A trial of one run. right: whether the answer was correct, or was "yes"; word: the answer in an adjustment"""

    level: float
    right: bool
    word: str = ""


def _mean(levels: Sequence[float], scale: Scale) -> float:
    """Return the mean in a scale, which is geometric for ratios. NaN without levels."""
    if not levels:
        return math.nan
    return float(np.exp(np.mean(np.log(levels)))) if scale == "log" else float(np.mean(levels))


def _moved(level: float, step: float, scale: Scale, low: float, high: float) -> float:
    """Return a level moved by a step (in dB for ratios), and clipped to the limits."""
    moved = level + step if scale == "linear" else level * 10.0 ** (step / 20.0)
    return round(min(max(moved, low), high), 12)


@with_config(STRICT)
@dataclass(frozen=True)
class Staircase:
    """A transformed up-down staircase (Levitt 1971).

    After `down` right answers in a row the next level is harder; after `up` wrong answers in a row it is easier. One of
    the two numbers is 1.

    start: first level
    steps: step sizes; each is used until the next reversal, and the last one to the end
    up_ratio: size of steps to easier levels, divided by that of steps to harder levels
    scale: steps are added (linear) or are in dB (log: 20 lg)
    low, high: limits of presented levels
    reversals, trials: numbers after which the staircase ends; whichever is reached first
    skipped: number of first reversals that the estimate excludes
    harder: whether harder levels are lower or higher
    """

    start: float
    steps: tuple[float, ...]
    up: int = 1
    down: int = 2
    up_ratio: float = 1.0
    scale: Scale = "log"
    low: float = -math.inf
    high: float = math.inf
    reversals: int = 10
    trials: int = 100
    skipped: int = 4
    harder: Literal["lower", "higher"] = "lower"

    def __post_init__(self) -> None:
        if min(self.up, self.down) != 1 or max(self.up, self.down) > 8:
            raise OutputError(f"up {self.up}, down {self.down}; allowed: 1 to 8, one of them 1")
        if not self.steps or min(self.steps) <= 0.0 or not self.up_ratio > 0.0:
            raise OutputError(f"steps {self.steps}, up_ratio {self.up_ratio:g}; allowed: one step or more, above 0")
        if not self.low <= self.start <= self.high or (self.scale == "log" and not max(self.low, 0.0) < self.start):
            raise OutputError(f"start {self.start:g}; allowed: {self.low:g} to {self.high:g}, of scale 'log' above 0")
        if not 0 <= self.skipped < self.reversals or self.trials < 1:
            raise OutputError(f"reversals {self.reversals}, skipped {self.skipped}, trials {self.trials}; allowed: "
                              "fewer skipped than reversals, and one trial or more")  # fmt: skip

    @property
    def convergence(self) -> float:
        """Fraction of right answers at which steps to harder and to easier levels balance.

        A move to a harder level needs `down` right answers in a row. With a fraction p of right answers, a fraction
        p^down of the moves is to harder levels. An up_ratio q gives p^down = q/(1 + q). So p is 0.707 for 1 up 2 down,
        0.794 for 1 up 3 down, and 0.293 for 2 up 1 down (Levitt 1971, table I).
        """
        to_harder = self.up_ratio / (1.0 + self.up_ratio)
        if self.up == 1:
            return float(to_harder ** (1.0 / self.down))
        return 1.0 - float((1.0 - to_harder) ** (1.0 / self.up))

    def next_level(self, run: Sequence[Answered]) -> float | None:
        """Return the level of the next trial, None at the end."""
        course = self._course(run)
        return None if len(run) >= self.trials or len(course.turns) >= self.reversals else course.level

    def turns(self, run: Sequence[Answered]) -> list[int]:
        """Return the numbers of the trials, from 0, at which the staircase reversed."""
        return self._course(run).turns

    def estimate(self, run: Sequence[Answered]) -> float:
        """Return the mean level of an even number of reversals, in the scale; NaN with fewer than two.

        The mean estimates the level of `convergence`.
        """
        levels = [run[turn].level for turn in self.turns(run)[self.skipped :]]
        return _mean(levels[len(levels) % 2 :], self.scale)

    def _course(self, run: Sequence[Answered]) -> "_Course":
        level, heading, rights, wrongs = self.start, 0, 0, 0
        turns: list[int] = []
        for number, trial in enumerate(run):
            rights, wrongs = (rights + 1, 0) if trial.right else (0, wrongs + 1)
            # A right answer ends a row of wrong ones, and vice versa
            move = 1 if rights >= self.down else -1 if wrongs >= self.up else 0
            if move == 0:
                continue
            rights = wrongs = 0
            if heading and move != heading:
                turns.append(number)
            heading = move
            size = self.steps[min(len(turns), len(self.steps) - 1)] * (1.0 if move > 0 else self.up_ratio)
            sign = -move if self.harder == "lower" else move
            level = _moved(trial.level, sign * size, self.scale, self.low, self.high)
        return _Course(level, turns)


class _Course(NamedTuple):
    level: float
    turns: list[int]


@with_config(STRICT)
@dataclass(frozen=True)
class ConstantStimuli:
    """Present each level equally often.

    levels: the levels
    repeats: number of repetitions; each has its own random order
    seed: seed of the order
    """

    levels: tuple[float, ...]
    repeats: int
    seed: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if len(set(self.levels)) < 2 or len(set(self.levels)) < len(self.levels) or self.repeats < 1:
            raise OutputError(f"levels {list(self.levels)}, repeats {self.repeats}; allowed: two different levels or "
                              "more, each once, and one repeat or more")  # fmt: skip

    def order(self) -> Float:
        """Return the levels of all trials, shape (repeats * levels,)."""
        rng = np.random.default_rng(self.seed)
        return np.concatenate([rng.permutation(np.array(self.levels)) for _ in range(self.repeats)])

    def next_level(self, run: Sequence[Answered]) -> float | None:
        """Return the level of the next trial, None at the end."""
        order = self.order()
        return float(order[len(run)]) if len(run) < len(order) else None


@with_config(STRICT)
@dataclass(frozen=True)
class Adjustment:
    """A participant makes a level stronger and weaker until it is just perceptible, from several random start levels.

    low, high: limits of the levels; step, scale: as for a staircase; settings: number of settings
    presses: largest number of answers in one setting. Answers are `stronger`, `weaker`, and `done`.
    """

    low: float
    high: float
    step: float
    settings: int = 4
    presses: int = 60
    scale: Scale = "log"
    seed: tuple[int, ...] = (0,)

    def __post_init__(self) -> None:
        if not (self.low < self.high and self.step > 0.0) or (self.scale == "log" and self.low <= 0.0):
            raise OutputError(f"low {self.low:g}, high {self.high:g}, step {self.step:g}; allowed: low below high, of "
                              "scale 'log' above 0, and a step above 0")  # fmt: skip
        if self.settings < 1 or self.presses < 1:
            raise OutputError(f"settings {self.settings}, presses {self.presses}; allowed: 1 or more")

    def next_level(self, run: Sequence[Answered]) -> float | None:
        """Return the level of the next presentation, None at the end."""
        ends = self._ends(run)
        begun, setting = ends[-1] + 1 if ends else 0, len(ends)
        if setting >= self.settings:
            return None
        if begun == len(run):
            rng = np.random.default_rng((*self.seed, setting))
            share = float(rng.random())
            if self.scale == "linear":
                return round(self.low + share * (self.high - self.low), 12)
            return round(self.low * (self.high / self.low) ** share, 12)
        sign = {"stronger": 1.0, "weaker": -1.0}.get(run[-1].word, 0.0)
        return _moved(run[-1].level, sign * self.step, self.scale, self.low, self.high)

    def settings_of(self, run: Sequence[Answered]) -> list[float]:
        """Return the levels at which the answer was `done`."""
        return [run[end].level for end in self._ends(run) if run[end].word == "done"]

    def estimate(self, run: Sequence[Answered]) -> float:
        """Return the mean of the settings in the scale, NaN without one."""
        return _mean(self.settings_of(run), self.scale)

    def _ends(self, run: Sequence[Answered]) -> list[int]:
        """Return the numbers of the trials with which settings ended."""
        ends, begin = [], 0
        for number, trial in enumerate(run):
            if trial.word == "done" or number - begin + 1 >= self.presses:
                ends.append(number)
                begin = number + 1
        return ends


@with_config(STRICT)
@dataclass(frozen=True)
class Limits:
    """The method of limits: rising and falling series of levels in turn. Each ends when the answer changes.

    levels: rising; series: number of series; rising and falling alternate, the first is rising
    scale: scale of the mean. A rising series ends at the first yes and a falling one at the first no, at the latest
    after the last level. Hasegawa & Shinoda 2018 (section 6.1) used six series.
    """

    levels: tuple[float, ...]
    series: int = 6
    scale: Scale = "log"

    def __post_init__(self) -> None:
        if len(self.levels) < 2 or any(high <= low for low, high in pairwise(self.levels)):
            raise OutputError(f"levels {list(self.levels)}; allowed: two or more, each above the one before")
        if self.scale == "log" and self.levels[0] <= 0.0:
            raise OutputError(f"levels {list(self.levels)}; allowed with scale 'log': above 0")
        if self.series < 1:
            raise OutputError(f"series {self.series}; allowed: 1 or more")

    def next_level(self, run: Sequence[Answered]) -> float | None:
        """Return the level of the next trial, None at the end."""
        number, place = 0, 0
        for trial in run:
            number, place = self._after(number, place, trial)
        return None if number >= self.series else self._order(number)[place]

    def estimate(self, run: Sequence[Answered]) -> float:
        """Return the mean, in the scale, of the ends of the series; NaN without an end.

        The end of a series is midway between the level that changed the answer and the previous level. A series whose
        answer never changed, or changed at its first level, is excluded.
        """
        ends = []
        number, place = 0, 0
        for trial in run:
            order = self._order(number)
            turned = trial.right == (number % 2 == 0)
            if turned and place:
                pair = order[place - 1], order[place]
                ends.append(math.sqrt(pair[0] * pair[1]) if self.scale == "log" else 0.5 * sum(pair))
            number, place = self._after(number, place, trial)
        return _mean(ends, self.scale)

    def _order(self, number: int) -> tuple[float, ...]:
        return self.levels if number % 2 == 0 else self.levels[::-1]

    def _after(self, number: int, place: int, trial: Answered) -> tuple[int, int]:
        """Return the number of the series, and the position in it, after a trial."""
        turned = trial.right == (number % 2 == 0)
        return (number + 1, 0) if turned or place + 1 == len(self.levels) else (number, place + 1)


Procedure = Staircase | Limits | ConstantStimuli | Adjustment
