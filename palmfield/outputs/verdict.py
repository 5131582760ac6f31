"""Choose the sensation level of a skin that outputs show, with its observer and band, and the verdict of a run.

Tables, pictures, the live view and summary.json use this module. The arguments `skin` are elements of `skins` in
summary.json.
"""

import math
from collections.abc import Mapping
from typing import Any

from palmfield.outputs.budget_text import Part, combined, input_parts, parts_text
from palmfield.perception.force_threshold import FORCE_OBSERVER
from palmfield.perception.registry import READ_FIRST

RULE = "first observer that applies: mid-air, afferents, contact"
DB = 20.0 / math.log(10.0)
"""Decibels per unit of the natural logarithm of a factor."""


def shown_level(skin: Mapping[str, Any], name: str) -> tuple[float | None, str]:
    """Return the level of an observer [dB SL] that outputs show, and its frequency lines or its class of afferents.

    The level includes all lines. For observers that have no level of several lines, it is that of the main line. None
    if the observer is refused.
    """
    if (decides := skin.get(f"level_{name}_class")) is not None:
        return skin[f"level_{name}_dB_SL"], f"{str(decides).upper()} afferents"
    level, frequencies = skin.get(f"level_all_lines_{name}_dB_SL"), skin.get("line_frequencies_Hz", ())
    if level is not None and len(frequencies) > 1:
        return level, f"all {len(frequencies)} lines"
    main = skin.get("main_frequency_Hz")
    level = skin.get(f"level_{name}_dB_SL") if level is None else level
    return level, "" if main is None else f"line at {main:g} Hz"


def top_line(skin: Mapping[str, Any], name: str) -> str:
    """Describe the strongest line of the level of an observer; empty if there is only one line."""
    frequency = skin.get(f"strongest_line_{name}_Hz")
    if frequency is None:
        return ""
    return f"strongest {skin[f'level_strongest_line_{name}_dB_SL']:.0f} dB SL at {frequency:g} Hz"


def chosen_observer(skin: Mapping[str, Any]) -> str | None:
    """Return the observer that is shown for a skin, by RULE.

    None if all observers are refused or the run has no levels.
    """
    return next((name for name in READ_FIRST if shown_level(skin, name)[0] is not None), None)


def level_parts(skin: Mapping[str, Any], name: str) -> list[Part]:
    """Return the factors of the level of an observer by name: from the ranges of inputs, and from its own spread.

    An observer based on force depends only on p0.
    """
    parts = [one for one in input_parts(skin) if one[0] == "p0" or name != FORCE_OBSERVER.name]
    if spread := skin.get(f"level_{name}_spread_dB"):
        parts.append(("observer", math.exp(-spread / DB), math.exp(spread / DB)))
    return parts


def level_band_dB(skin: Mapping[str, Any], name: str) -> tuple[float, float]:
    """Return the lower and upper band of a level [dB], as a negative and a positive number, from all `level_parts`."""
    low, high = combined(level_parts(skin, name))
    return (DB * math.log(low) if low > 0.0 else -math.inf), DB * math.log(high)


def level_text(skin: Mapping[str, Any], name: str, level: float) -> str:
    """Format a level with its band, which determines the number of digits."""
    low, high = level_band_dB(skin, name)
    if low == high == 0.0:
        return f"{level:.1f} dB SL"
    return f"{level:.0f} dB SL ({level + low:.0f} to {level + high:.0f})"


def band_text(skin: Mapping[str, Any], name: str) -> str:
    """List the parts of the band of a level by name [dB]."""
    return parts_text(level_parts(skin, name), lambda low, high: f"{_dB(low)} to {_dB(high)} dB")


def _dB(factor: float) -> str:
    return f"{DB * math.log(factor):+.0f}" if factor > 0.0 else "-inf"


def verdict(skin: Mapping[str, Any]) -> dict[str, Any]:
    """Return whether the motion of a skin is felt: `felt` (yes, perhaps, no or not known) and `because`, a reason.

    yes: the whole band of the level of the chosen observer is above threshold; no: it is below; perhaps: the band
    contains the threshold, or the spread of the observer is unknown.
    """
    name = chosen_observer(skin)
    if name is None:
        reasons = [str(skin[f"level_{one}_why"]) for one in READ_FIRST if f"level_{one}_why" in skin]
        reason = reasons[-1].partition(": ")[2] if reasons else "the run was interrupted before levels were computed"
        return {"felt": "not known", "because": reason}
    level, lines = shown_level(skin, name)
    assert level is not None
    low, high = level_band_dB(skin, name)
    spread_known = skin.get(f"level_{name}_spread_dB") is not None
    answer = "perhaps"
    if spread_known and level + low > 0.0:
        answer = "yes"
    elif spread_known and level + high < 0.0:
        answer = "no"
    spread = "" if spread_known else ", its spread is unknown"
    because = f"{level_text(skin, name, level)} by {name}, {lines}{spread}"
    return {"felt": answer, "because": because, "observer": name, "level_dB_SL": level} | (
        {} if math.isinf(low) else {"low_dB_SL": level + low, "high_dB_SL": level + high}
    )


def first_line(summary: Mapping[str, Any]) -> str:
    """Return the first line of a run: target accuracies that were not reached, and the verdict of each skin."""
    texts = []
    for skin in summary["skins"]:
        answer = verdict(skin)
        missed = ""
        if skin.get("accuracy_reached") is False:
            error, target = (100.0 * skin[f"{key}_relative"] for key in ("displacement_error", "accuracy_wanted"))
            missed = f"target accuracy NOT reached: error {error:.2g} %, target {target:g} %; "
        of = f"{skin['name']}: " if len(summary["skins"]) > 1 else ""
        texts.append(f"{of}{missed}felt: {answer['felt']}, because {answer['because']}")
    return "; ".join(texts)
