"""Numbers, colours and text of palmfield's MJCF files."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence

import numpy as np

from palmfield.types import Float

SKIN_RGBA = "0.87 0.68 0.58 1"


def numbers_text(numbers: Float | Sequence[float], digits: int) -> str:
    """Return numbers as MJCF text, rounded to `digits` decimals."""
    return " ".join(f"{number + 0.0:.{digits}g}" for number in np.round(numbers, digits))


def file_text(root: ET.Element, note: str) -> str:
    """Return the indented text of a file with a note in the first line."""
    ET.indent(root)
    return f"<!-- {note} -->\n{ET.tostring(root, encoding='unicode')}\n"
