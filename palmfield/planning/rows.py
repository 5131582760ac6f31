"""The rows of a plan. Each row is one decision."""

from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Row:
    """One decision.

    size: resolution, error bound or cost
    why: the reason, in words
    instance: name of the skin, stimulus or array, several separated by commas; empty for the whole scene
    """

    what: str
    size: str
    why: str
    instance: str = ""


def merged(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Merge rows with equal text of several instances."""
    result: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        key = row.what, row.size, row.why
        present = result.get(key)
        if present is None:
            result[key] = row
        elif row.instance not in present.instance.split(", "):
            result[key] = replace(present, instance=f"{present.instance}, {row.instance}")
    return tuple(result.values())
