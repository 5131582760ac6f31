"""Describe the error budget of a skin (`palmfield.estimate.error_budget.error_budget`) in words."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

TextRow = tuple[str, str]
"""Row of a table: quantity and size."""
Part = tuple[str, float, float]
"""Part of a band: an input, and the displacement factors at the low and high ends of its range."""
PARTS = {"mesh": "mesh", "step": "time step", "reduction": "reduction", "edge": "cut edge", "field": "field in float32"}
"""Parts of the numerical error, by the first word of their keys in the numbers of a skin."""
COARSE = 0.05
"""Relative band above which a number has two digits."""
SHOWN = 5e-4
"""Relative bias below which ignored effects are not reported."""


def budget_rows(skin: Mapping[str, Any]) -> list[TextRow]:
    """Return the uncertainty of the response of a skin under the focus. Its three kinds are separate and not added."""
    of_motion, of_velocity = (
        ", ".join(
            f"{name} {figures(100 * skin[f'{key}_{kind}'], 1.0)} %"
            for key, name in PARTS.items()
            if f"{key}_{kind}" in skin
        )
        for kind in ("error_relative", "velocity_error_relative")
    )
    velocity = f"; of its velocity: {of_velocity}" if of_velocity else ""
    rows = [("error, numerical", f"of the response under the focus: {of_motion}{velocity}")]
    budget = skin.get("error_budget")
    if budget is None:
        return rows
    silent = [one["what"] for one in budget["left_out"] if one["low"] is None]
    texts = [f"{one['what']} {bias_text(one['low'], one['high'])}" for one in _significant(budget)]
    rows.append(("error, not modelled", "; ".join([*texts, f"not estimated: {', '.join(silent)}"])))
    ranges = [f"{one['what']} x {one['low']:.2g} to x {one['high']:.2g}" for one in _ranges(budget)]
    unknown = [one["what"] for one in budget["inputs"] if one["low"] is None]
    rest = [f"not propagated: {', '.join(unknown)}"] if unknown else []
    rows.append(("error, inputs", "; ".join([*ranges, *rest])))
    return rows


def figures(value: float, band: float) -> str:
    """Format a number with as many digits as its relative band allows: 2 above 5 %, 3 above 0.5 %, else 4."""
    digits = 2 if band > COARSE else 3 if band > COARSE / 10 else 4
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e" in text and 1.0 <= abs(value) < 1e6 else text


def widest(budget: Mapping[str, Any] | None) -> float:
    """Return the largest magnitude of the relative biases in a budget; 0 if none is estimated."""
    return max((_largest(one) for one in (budget or {}).get("left_out", ()) if one["low"] is not None), default=0.0)


def input_parts(skin: Mapping[str, Any], without: Sequence[str] = ()) -> list[Part]:
    """Return the inputs with a known range, each with its displacement factors. without: inputs to exclude"""
    parts = {one["what"]: (one["low"], one["high"]) for one in _ranges(skin.get("error_budget") or {"inputs": ()})}
    if "p0_band_low" in skin:
        parts = {"p0": (skin["p0_band_low"], skin["p0_band_high"])} | parts
    return [(what, low, high) for what, (low, high) in parts.items() if what not in without]


def combined(parts: Sequence[Part]) -> tuple[float, float]:
    """Combine inputs into one band, as factors: root sum of squares of their logarithms, separately for each side.

    This is valid for independent inputs with multiplicative effects.
    """
    lows, highs = [low for _, low, _ in parts], [high for _, _, high in parts]
    low = 0.0 if min(lows, default=1.0) <= 0.0 else math.exp(-math.hypot(*(math.log(min(one, 1.0)) for one in lows)))
    return low, math.exp(math.hypot(*(math.log(max(one, 1.0)) for one in highs)))


def parts_text(parts: Sequence[Part], ends: Callable[[float, float], str] | None = None) -> str:
    """List the parts of a band by name. ends: function that describes the two factors"""
    describe = ends or (lambda low, high: f"x {low:.2g} to {high:.2g}")
    return ", ".join(f"{what} {describe(low, high)}" for what, low, high in parts)


def _largest(bias: Mapping[str, Any]) -> float:
    return float(max(-bias["low"], bias["high"]))


def largest_omitted(budget: Mapping[str, Any] | None) -> str:
    """Return the largest bias due to ignored effects, as text after a semicolon; empty if no bias is significant."""
    significant = _significant(budget) if budget else []
    if not significant:
        return ""
    one = max(significant, key=_largest)
    return f"; largest effect not modelled: {one['what']} {bias_text(one['low'], one['high'])}"


def _significant(budget: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the ignored effects that are significant."""
    return [one for one in budget["left_out"] if one["low"] is not None and _largest(one) > SHOWN]


def _ranges(budget: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """Return the inputs with a known range."""
    return [one for one in budget["inputs"] if one["low"] is not None and one["low"] < one["high"]]


def bias_text(low: float, high: float) -> str:
    """Describe a relative bias (true minus computed)."""
    if low == high == 0.0:
        return "0 %"
    if low == -high:
        return f"+- {100 * high:.2g} %"
    ends = [("+" if end > 0.0 else "") + figures(100 * end, 1.0) if end else "0" for end in (low, high)]
    return f"{ends[0]} to {ends[1]} %"


def in_a_line(budget: Mapping[str, Any] | str | None) -> str:
    """Return the largest parts of a budget in one line, for pictures. The line is empty without a budget."""
    if not isinstance(budget, Mapping):
        return ""
    parts = [f"numerical {figures(100 * budget['numerical']['displacement_error_relative'], 1.0)} %"]
    largest = sorted(_significant(budget), key=_largest, reverse=True)[:2]
    parts += [f"{one['what']} (not modelled): {bias_text(one['low'], one['high'])}" for one in largest]
    parts += [f"{one['what']} x {one['low']:.2g} to {one['high']:.2g}" for one in _ranges(budget)]
    return "Error of the skin response under the focus: " + "; ".join(parts)


def of_full(level: float) -> str:
    """Describe a drive level as a part of full drive."""
    return f"{level:.3f} of full" if level == 0.0 or level >= 1e-3 else f"{level:.2g} of full"
