"""Find where the sound of a focus is loudest: closer to the array than the focus itself."""

from collections.abc import Callable

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.types import Complex, Float

ALONG = np.linspace(0.55, 1.05, 101)
"""Initial search points, as shares of the distance from the middle of the array to the focus."""
CLOSE_M = 1e-5


def loudest_point(pressure: Callable[[Float], Complex], middle: Float, focus: Float) -> Float:
    """Return the maximum of |p| near a focus [m], shape (3,).

    pressure: complex pressure at points [m], shape (n, 3) -> (n,); middle: middle of the transducers that sound [m]
    """
    line = middle + ALONG[:, None] * (focus - middle)
    start = line[int(np.abs(pressure(line)).argmax())]
    scale = float(np.abs(pressure(start[None]))[0])
    result = scipy.optimize.minimize(
        lambda point: -float(np.abs(pressure(point[None]))[0]) / scale,
        start,
        method="Nelder-Mead",
        options={
            "xatol": CLOSE_M,
            "fatol": 1e-9,
            "initial_simplex": start + 2e-3 * np.vstack([np.zeros(3), np.eye(3)]),
        },
    )
    return np.asarray(result.x)
