"""From a number at a level of fineness to an answer with its numerical error."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from palmfield_papers.answer import Answer, Setting
from palmfield_papers.entries import book
from palmfield_papers.reardon2023.runs import COARSE, FINER, FULL, QUICK

Number = Callable[[Setting, int], float]
"""A number under a setting at a level of fineness (COARSE to FINER)."""
HOW = (
    "error: at the base readings, to finer waves, samples and another period (quick: to coarser ones, same period, and "
    "at least 3 %), under other ones the larger of the same and the same share"
)
QUICK_LEAST = 0.03
"""Of a quick run's numbers: they differed from the full run's by up to 2.8 %, where the coarser run, which has the
period and the modes in depth of the quick one, said 0.1 %."""


def level_of(setting: Setting) -> int:
    """The level at which a setting's value is computed."""
    return QUICK if setting.quick else FULL


def base_of(setting: Setting) -> Setting:
    """The same axes at their base values, without a control."""
    axes = book().axes
    return replace(setting, readings=tuple((name, axes[name][0]) for name, _ in setting.readings), control="")


@cache
def _error(number: Number, base: Setting) -> tuple[float, float]:
    """At the base: in the number's unit, and as a share of it."""
    level = level_of(base)
    value = number(base, level)
    error = abs(value - number(base, COARSE if level == QUICK else FINER))
    if level == QUICK:
        error = max(error, QUICK_LEAST * abs(value))
    return error, error / abs(value) if value else 0.0


def _carried(number: Number, setting: Setting, value: float) -> float:
    """The base's error, carried to a value under other readings."""
    error, share = _error(number, base_of(setting))
    return max(error, share * abs(value))


def answered(
    number: Number,
    setting: Setting,
    *,
    margin: Callable[[float], float] | None = None,
    note: str = "",
    shown: Mapping[str, float] | None = None,
    changes: Mapping[str, Any] | None = None,
    resolution: float = 0.0,
) -> Answer:
    """The number with its error; margin: of the number, for inequalities. number: one function for all settings.

    changes: to the slab, of a possible cause, whose error is not estimated
    resolution: by how much the grid on which a place is read may move the number, which two runs don't show
    """
    value = number(setting, level_of(setting))
    error, how = (None, "") if changes else (max(_carried(number, setting, value), resolution), HOW)
    if error is not None and resolution:
        how += "; at least that of the grid"
    return Answer(
        value, error, margin=None if margin is None else margin(value), note="; ".join(filter(None, (note, how))),
        shown=shown or {},
    )  # fmt: skip
