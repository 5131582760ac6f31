"""Values of several worlds that are computed again only where pose or drive are others."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Float

Bool = NDArray[np.bool_]
Rows = NDArray[np.intp]
Serials = NDArray[np.int64]


class Kept:
    """An array with a row for each world, kept under the serial numbers of pose and drive."""

    def __init__(self, worlds: int, *shape: int):
        self._values: Float = np.zeros((worlds, *shape))
        self._keys: Serials = np.zeros((worlds, 2), np.int64)

    def rows(self, worlds: Rows, keys: Serials, make: Callable[..., Float | float], *given: Any) -> Float:
        """The values of some worlds, shape (g, ...), under serial numbers (g, 2).

        make: computes that of a world by its number and what is given, once for worlds with the same numbers
        """
        stale = np.logical_or.reduce(self._keys[worlds] != keys, axis=1)
        made: dict[bytes, int] = {}
        for i in stale.nonzero()[0].tolist():
            world = int(worlds[i])
            same = made.setdefault(keys[i].tobytes(), world)
            self._values[world] = make(world, *given) if same == world else self._values[same]
            self._keys[world] = keys[i]
        return self._values[worlds]

    def copy(self) -> "Kept":
        """An independent copy."""
        result = Kept(0)
        result._values, result._keys = self._values.copy(), self._keys.copy()
        return result
