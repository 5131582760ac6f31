"""The rows of a plan: one decision each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Row:
    """One decision.

    size: resolution, error bound or cost; why: the reason, in words
    instance: of the skin, stimulus or array, several with commas between; empty for the whole scene
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
        known = result.get(key)
        if known is None:
            result[key] = row
        elif row.instance not in known.instance.split(", "):
            result[key] = replace(known, instance=f"{known.instance}, {row.instance}")
    return tuple(result.values())
