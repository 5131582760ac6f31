"""Write an attribute over time, with time samples only where it changes."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf, Usd

Make = Callable[[NDArray[Any]], Any]
"""Function that converts an array to a USD value."""


class Samples:
    """Writes an attribute from time code to time code.

    A constant attribute has a default value and no samples. A change has a sample at its time code and one at the code
    before, because viewers interpolate between samples.
    """

    def __init__(self, attribute: Usd.Attribute, make: Make):
        self._attribute, self._make = attribute, make
        self._last: NDArray[Any] | None = None
        self._written: float | None = None
        self._begun = self._until = 0.0

    def extend(self, codes: Sequence[float], values: NDArray[Any]) -> None:
        """Add values, shape (n, ...), at n rising time codes, which must be later than earlier ones."""
        changes = (values[1:] != values[:-1]).any(axis=tuple(range(1, values.ndim)))
        with Sdf.ChangeBlock():
            for number in [0, *(np.flatnonzero(changes) + 1).tolist()]:
                if number:
                    self._until = codes[number - 1]
                self.add(codes[number], values[number])
        self._until = codes[-1]

    def add(self, code: float, value: NDArray[Any]) -> None:
        """Add the value at a time code, which must be later than earlier ones."""
        if self._last is None:
            self._attribute.Set(self._make(value))
            self._begun = self._until = code
            self._last = value.copy()
            return
        if np.array_equal(self._last, value):
            self._until = code
            return
        before = self._make(self._last)
        if self._written is None:
            self._attribute.Set(before, self._begun)
            self._written = self._begun
        if self._until > self._written:
            self._attribute.Set(before, self._until)
        self._attribute.Set(self._make(value), code)
        self._written = self._until = code
        self._last = value.copy()
