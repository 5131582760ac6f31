"""Transducer arrays of known boards by name; `palmfield.acoustics.placement` makes others."""

from dataclasses import replace

import numpy as np

from palmfield.acoustics.layouts import LAYOUTS, grid, sonicsurface_order
from palmfield.acoustics.placement import combined, from_poses, placed, with_faults
from palmfield.errors import SceneError
from palmfield.types import Array

__all__ = [
    "LAYOUTS",
    "combined",
    "from_poses",
    "grid",
    "layout",
    "layout_of_version",
    "placed",
    "sonicsurface_order",
    "with_faults",
]


def layout(name: str, p0_Pa_m: float | None = None) -> Array:
    """Return the array of a known board.

    name: a key of LAYOUTS.
    p0_Pa_m: peak pressure of one transducer at 1 m on its axis at full drive [Pa m]; None for the value of the layout.
    Raises SceneError for another name, and for a p0 that is not positive.
    """
    if name not in LAYOUTS:
        raise SceneError(f"array layout '{name}' is unknown: use one of {', '.join(LAYOUTS)}")
    p0 = LAYOUTS[name].p0.value if p0_Pa_m is None else p0_Pa_m
    if not 0.0 < p0 < np.inf:
        raise SceneError(f"p0_Pa_m = {p0} is not positive and finite: give the peak pressure at 1 m, about 1 to 8")
    return replace(LAYOUTS[name].build(), name=name, p0_Pa_m=p0)


def layout_of_version(name: str, version: int) -> str:
    """Return the present name of a layout that is recorded in a file.

    name, version: as in the file; version is 1 in files that record none
    A name that is not in LAYOUTS is returned unchanged. Raises SceneError for a version that does not exist.
    """
    if name not in LAYOUTS or version == LAYOUTS[name].version:
        return name
    if not 1 <= version < LAYOUTS[name].version:
        raise SceneError(f"layout '{name}' has version {version}; allowed: 1 to {LAYOUTS[name].version}")
    return LAYOUTS[name].earlier[version - 1]
