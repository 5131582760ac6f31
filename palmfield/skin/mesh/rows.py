"""Rows of elements through the sheets of a layer."""

from collections.abc import Sequence

import numpy as np

from palmfield.skin.materials.material import Material
from palmfield.skin.materials.sheet import Sheet
from palmfield.types import Float


def element_rows(sheets: Sequence[Sheet], fractions: Float) -> tuple[Float, list[Material]]:
    """Return depth fractions of rows of elements, each in one sheet, (L+1,), and the material of each row.

    sheets: from the surface down; thicknesses are shares of their sum
    fractions: depth fractions for a layer of one sheet, 0 first, 1 last; they determine the number of rows in each
        sheet, at least one.
    """
    index = np.arange(len(fractions), dtype=float)
    total = sum(sheet.thickness_m for sheet in sheets)
    result, materials = [0.0], []
    for sheet in sheets:
        top, bottom = result[-1], result[-1] + sheet.thickness_m / total
        first, last = np.interp([top, bottom], fractions, index)
        count = max(1, round(last - first))
        inner = np.interp(np.linspace(first, last, count + 1)[1:-1], index, fractions)
        result += [*inner.tolist(), bottom]
        materials += [sheet.material] * count
    result[-1] = 1.0
    return np.array(result), materials
