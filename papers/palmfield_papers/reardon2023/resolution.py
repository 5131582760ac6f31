"""Compute answers with numerical error from numbers at two levels of resolution."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

from palmfield_papers.answer import Answer, Setting
from palmfield_papers.entries import book
from palmfield_papers.reardon2023.runs import COARSE, FINER, FULL, QUICK

Number = Callable[[Setting, int], float]
"""Function that computes a number from a setting and a level of resolution (COARSE to FINER)."""
HOW = (
    "error: at the base readings, the difference from finer waves and samples and another period (quick: from coarser "
    "ones, same period, at least 3 %); at other readings, the larger of the same difference and the same ratio"
)
QUICK_LEAST = 0.03
"""Smallest relative error of numbers in quick runs.

Such numbers differed from full runs by up to 2.8 %, although the coarser run indicated 0.1 %. The coarser run has the
same period and the same modes in depth as the quick run.
"""


def level_of(setting: Setting) -> int:
    """Return the level at which the value of a setting is computed."""
    return QUICK if setting.quick else FULL


def base_of(setting: Setting) -> Setting:
    """Return the setting with base values of all axes and without a control."""
    axes = book().axes
    return replace(setting, readings=tuple((name, axes[name][0]) for name, _ in setting.readings), control="")


@cache
def _error(number: Number, base: Setting) -> tuple[float, float]:
    """Return the error at the base, in the unit of the number and relative."""
    level = level_of(base)
    value = number(base, level)
    error = abs(value - number(base, COARSE if level == QUICK else FINER))
    if level == QUICK:
        error = max(error, QUICK_LEAST * abs(value))
    return error, error / abs(value) if value else 0.0


def _carried(number: Number, setting: Setting, value: float) -> float:
    """Return the error at the base, scaled to a value under other readings."""
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
    """Return the number with its error.

    number: function of setting and level; pass the same function for all settings
    margin: margin of the number, for inequalities
    changes: changes of the slab, for a possible cause, whose error is not estimated
    resolution: error due to the grid of positions, which two runs do not show
    """
    value = number(setting, level_of(setting))
    error, how = (None, "") if changes else (max(_carried(number, setting, value), resolution), HOW)
    if error is not None and resolution:
        how += "; at least that of the grid"
    return Answer(
        value, error, margin=None if margin is None else margin(value), note="; ".join(filter(None, (note, how))),
        shown=shown or {},
    )  # fmt: skip
