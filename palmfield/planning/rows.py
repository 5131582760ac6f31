"""The rows of a plan: one decision each."""

from collections.abc import Sequence
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Row:
    """One decision.

    size: what it amounts to (resolution, error bound or cost); why: the reason, in words
    instance: of which skin, stimulus or array it is, several with commas between; empty for the whole scene
    """

    what: str
    size: str
    why: str
    instance: str = ""


def merged(rows: Sequence[Row]) -> tuple[Row, ...]:
    """Rows that say the same of several instances as one."""
    result: dict[tuple[str, str, str], Row] = {}
    for row in rows:
        key = row.what, row.size, row.why
        known = result.get(key)
        if known is None:
            result[key] = row
        elif row.instance not in known.instance.split(", "):
            result[key] = replace(known, instance=f"{known.instance}, {row.instance}")
    return tuple(result.values())
