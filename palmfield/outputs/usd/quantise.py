"""Round values to 1/255 of their range. USD crate files compress few distinct values well."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Float, Float32, Int

PART = 255
"""Range of the values divided by the largest rounding error."""


class Rounding(NamedTuple):
    """Rounding of values in a range to multiples of a step. Value 0 is unchanged.

    low, high: the range
    bound: largest error
    weights: weight of each value, if the weighted sum must be preserved
    An example of such a sum is a force: pressures weighted by areas. To preserve it, each time has its own threshold
    above which values are rounded up. With rounding to the nearest step, large areas with small pressures would lose 2
    % of the force on a hand.
    """

    low: float
    high: float
    step: float
    bound: float
    weights: Float | None = None

    def of(self, values: NDArray[np.floating]) -> Float32:
        """Return the rounded values of one time, shape (n,), or of several, shape (t, n)."""
        exact: Float = np.asarray(values, np.float64)
        if self.step == 0.0:
            return exact.astype(np.float32)
        if self.weights is None:
            return np.asarray(np.rint(exact / self.step) * self.step + 0.0, np.float32)
        if exact.ndim > 1:
            return np.array([self.of(row) for row in exact], np.float32)
        steps = exact / self.step
        whole: Float = np.floor(steps)
        rest = steps - whole
        whole[_largest(rest, self.weights, float(np.add.reduce(self.weights * rest)))] += 1.0
        return np.asarray(whole * self.step + 0.0, np.float32)


def _largest(values: Float, weights: Float, total: float) -> Int:
    """Return the indices of the largest values.

    values: from 0 to 1; the weights of the result add up to less than `total`.
    """
    # Short integers are sorted ten times as fast as floats, which are sorted only where the sum passes the total
    coarse = (-32767.0 * values).astype(np.int16)
    order: Int = np.argsort(coarse, kind="stable").astype(np.int32)
    added = np.cumsum(weights[order])
    passes = int(np.searchsorted(added, total))
    if passes == len(order):
        return order
    low, high = np.searchsorted(coarse[order], coarse[order[passes]] + np.array([0, 1]))
    equal = order[low:high][np.argsort(-values[order[low:high]], kind="stable")]
    more = np.cumsum(weights[equal]) + (added[low - 1] if low else 0.0)
    return np.concatenate([order[:low], equal[: int(np.searchsorted(more, total))]])


def rounding(low: float, high: float, weights: Float | None = None, part: int = PART) -> Rounding:
    """Return the rounding of values from low to high, with error (high - low) / part. An empty range is not rounded."""
    if not high > low:
        return Rounding(low, high, 0.0, 0.0)
    step = (high - low) / (part if weights is not None else (part + 1) // 2)
    largest = np.float32(max(abs(low), abs(high)) + step)
    bound = (0.5 if weights is None else 1.0) * step + 0.5 * float(np.spacing(largest))
    return Rounding(low, high, step, bound, weights)
