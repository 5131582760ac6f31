"""Transducer layouts of known boards, in palmfield's array frame (centroid at the origin, x right, y up, z out)."""

import numpy as np

from palmfield.errors import SceneError
from palmfield.types import Array, Float, Int

DEFAULT_P0_PA_M = 2.53
"""Peak pressure of one transducer at 1 m [Pa m].

Published values for 40 kHz transducers of this kind run from 1.27 to 8.02 Pa at 1 m, a factor 40 in radiation pressure,
and depend on the supply voltage. It is a calibration of a given board: measure it, or treat results as relative.
"""

LAYOUTS = {
    "uhev1": "Ultrahaptics UHEV1: 16 x 16 elements, 10.3 mm pitch (Chilles et al. 2019 do not print the pitch; 10.3 to "
    "10.5 mm is the usual figure)",
    "sonicsurface": "SonicSurface: 16 x 16 elements, 10.5 mm pitch, in the order of the board's data bytes",
}

SONICSURFACE_BLOCK = ((0, 7, 1, 2), (4, 3, 6, 5))
"""Addresses within one block of 2 rows and 4 columns, rows in the direction of +y.

Blocks follow one another up the board, 8 addresses each; 8 blocks make a strip of 64 addresses, and strips follow one
another to the right.
"""


def grid(pitch_m: float) -> Float:
    """Positions of a flat 16 x 16 board in z = 0 [m], shape (256, 3): row by row from low y, x running fastest."""
    steps = (np.arange(16) - 7.5) * pitch_m
    y, x = np.meshgrid(steps, steps, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(256)])


def sonicsurface_order() -> Int:
    """Address of each site of `grid` on a SonicSurface board, shape (256,)."""
    row, column = np.divmod(np.arange(256), 16)
    block = np.array(SONICSURFACE_BLOCK)
    return (64 * (column // 4) + 8 * (row // 2) + block[row % 2, column % 4]).astype(np.int32)


def layout(name: str, p0_Pa_m: float = DEFAULT_P0_PA_M) -> Array:
    """Array of a known board.

    name: a key of LAYOUTS
    p0_Pa_m: peak pressure of one transducer at 1 m on its axis at full drive [Pa m]
    Raises SceneError for another name, and for a p0 that is not positive.
    """
    if name not in LAYOUTS:
        raise SceneError(f"array layout '{name}' is unknown: use one of {', '.join(LAYOUTS)}")
    if not 0.0 < p0_Pa_m < np.inf:
        raise SceneError(f"p0_Pa_m = {p0_Pa_m} is not positive and finite: give the peak pressure at 1 m, about 1 to 8")
    normals = np.tile([0.0, 0.0, 1.0], (256, 1))
    if name == "uhev1":
        return Array(name, grid(10.3e-3), normals, p0_Pa_m)
    positions = grid(10.5e-3)[np.argsort(sonicsurface_order())]
    return Array(name, positions, normals, p0_Pa_m, address=np.arange(256, dtype=np.int32))
