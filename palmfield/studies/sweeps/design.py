"""Points of a sweep: every combination of values, a list, or points drawn from ranges."""

import json
import math
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from scipy.stats import qmc

from palmfield.errors import SceneError

Value = float | int | bool | str | tuple[float, ...]
"""Value of a key: a number, a text, or the numbers of a vector."""
Kind = Literal["grid", "list", "random", "sobol"]
MOST_POINTS = 10_000_000


class Range(NamedTuple):
    """All numbers from `low` to `high`. In a logarithmic range, all octaves are equally likely."""

    low: float
    high: float
    logarithmic: bool = False


@dataclass(frozen=True)
class Design:
    """Points of a sweep.

    kind: how the points were made
    keys: names of the swept keys
    values: values by key; for a grid, the values along the dimension of the key; otherwise one value for each point
    """

    kind: Kind
    values: dict[str, tuple[Value, ...]]

    @property
    def keys(self) -> tuple[str, ...]:
        """Swept keys, `INSTANCE.KEY` or `INSTANCE.KEY[i]`."""
        return tuple(self.values)

    @property
    def dims(self) -> tuple[str, ...]:
        """Dimensions of the dataset: the keys for a grid, otherwise `point`."""
        return self.keys if self.kind == "grid" else ("point",)

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """Number of points along each dimension."""
        lengths = tuple(len(values) for values in self.values.values())
        return lengths if self.kind == "grid" else lengths[:1]

    @property
    def count(self) -> int:
        """Number of points."""
        return math.prod(self.shape)

    def index(self, number: int) -> tuple[int, ...]:
        """Return a point's index along each dimension; the last one varies fastest."""
        return tuple(int(place) for place in np.unravel_index(number, self.shape))

    def point(self, number: int) -> dict[str, Value]:
        """Return the values of a point, by key."""
        places = self.index(number) if self.kind == "grid" else (number,) * len(self.values)
        return {key: values[place] for (key, values), place in zip(self.values.items(), places, strict=True)}

    def as_json(self) -> str:
        """Return the whole design as JSON. Equal designs give equal text."""
        return json.dumps({"kind": self.kind, "values": self.values})


def grid(values: Mapping[str, Sequence[Any] | np.ndarray]) -> Design:
    """Return a grid: every combination of the values of the keys. The last key varies fastest.

    values: values by key; for the key of a vector, a sequence of tuples or an array of shape (n, m)
    Raises SceneError without keys, for a key without values or with equal values, and for more points than MOST_POINTS.
    """
    if not values:
        raise SceneError("a grid has no keys; give at least one key with its values")
    plain_values = {key: _plain(key, of_key) for key, of_key in values.items()}
    for key, plain in plain_values.items():
        if len(set(plain)) < len(plain):
            twice = next(value for number, value in enumerate(plain) if value in plain[:number])
            raise SceneError(f"key '{key}' has the value {twice!r} twice; give each value of a grid once")
    _check_count(math.prod(len(plain) for plain in plain_values.values()))
    return Design("grid", plain_values)


def listed(values: Mapping[str, Sequence[Any] | np.ndarray]) -> Design:
    """Return a list of points. The first point has the first value of each key, and so on.

    Raises SceneError for keys without values or with different numbers of them.
    """
    plain_values = {key: _plain(key, of_key) for key, of_key in values.items()}
    lengths = {key: len(plain) for key, plain in plain_values.items()}
    if not lengths or len(set(lengths.values())) > 1:
        counts = ", ".join(f"{key}: {count}" for key, count in lengths.items()) or "no keys"
        raise SceneError(f"a list has one value of each key for each point; it has {counts}")
    _check_count(next(iter(lengths.values())))
    return Design("list", plain_values)


def random(values: Mapping[str, Range | Sequence[Any]], count: int, seed: int = 0) -> Design:
    """Draw points at random; equal seeds give equal points.

    values: values by key, a Range of numbers, or a sequence of which one element is drawn
    Raises SceneError for an empty range and for a count that is not above 0.
    """
    _check_drawn(values, count, "random")
    return Design("random", _spread(values, np.random.default_rng(seed).random((count, len(values)))))


def sobol(values: Mapping[str, Range | Sequence[Any]], count: int, seed: int = 0) -> Design:
    """Return scrambled Sobol points, which fill the ranges more evenly than random points. Best is a power of 2.

    Arguments and errors as `random`.
    """
    _check_drawn(values, count, "Sobol")
    with warnings.catch_warnings():
        # Scipy warns that counts other than powers of 2 are less balanced; the docs explain it
        warnings.simplefilter("ignore", UserWarning)
        unit = qmc.Sobol(len(values), scramble=True, rng=np.random.default_rng(seed)).random(count)
    return Design("sobol", _spread(values, unit))


def _check_drawn(values: Mapping[str, Any], count: int, kind: str) -> None:
    if not values:
        raise SceneError(f"a {kind} design has no key to draw; give at least one with a range, such as a:b")
    if count < 1:
        raise SceneError(f"a {kind} design has {count} points; allowed: at least 1")
    _check_count(count)


def _check_count(count: int) -> None:
    if count > MOST_POINTS:
        raise SceneError(f"the design has {count} points; allowed: at most {MOST_POINTS}; remove keys or values")


def _spread(values: Mapping[str, Range | Sequence[Any]], unit: np.ndarray) -> dict[str, tuple[Value, ...]]:
    """Map points of the unit cube, shape (points, keys), to values of the keys."""
    result: dict[str, tuple[Value, ...]] = {}
    for (key, of_key), shares in zip(values.items(), unit.T, strict=True):
        if isinstance(of_key, Range):
            low, high, logarithmic = of_key
            check_range(key, of_key)
            if logarithmic:
                drawn = np.exp(math.log(low) + shares * (math.log(high) - math.log(low)))
            else:
                drawn = low + shares * (high - low)
            result[key] = tuple(float(number) for number in drawn)
        else:
            plain = _plain(key, of_key)
            result[key] = tuple(plain[int(share * len(plain))] for share in shares)
    return result


def check_range(key: str, span: Range) -> None:
    """Check a range. Raises SceneError for a range that is empty or cannot be logarithmic."""
    low, high, logarithmic = span
    if not (math.isfinite(low) and math.isfinite(high) and low != high):
        raise SceneError(f"key '{key}' has the range {low:g}:{high:g}; allowed: two different finite numbers")
    if logarithmic and min(low, high) <= 0.0:
        raise SceneError(f"key '{key}' has the logarithmic range {low:g}:{high:g}; allowed: both ends above 0")


def _plain(key: str, values: Iterable[Any]) -> tuple[Value, ...]:
    """Return values as plain Python, vectors as tuples. Raises SceneError if there are none, or for other types."""
    if isinstance(values, str) or not isinstance(values, Iterable):
        raise SceneError(f"key '{key}' has values {values!r}; allowed: a sequence of values")
    plain = tuple(_one(key, value) for value in values)
    if not plain:
        raise SceneError(f"key '{key}' has no values; give at least one")
    return plain


def _one(key: str, value: Any) -> Value:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int | float) and math.isfinite(value):
        return value
    if isinstance(value, tuple | list | np.ndarray) and len(value):
        numbers = [_one(key, part) for part in value]
        if all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
            return tuple(float(number) for number in numbers)  # type: ignore[arg-type]
    raise SceneError(f"key '{key}' has the value {value!r}; allowed: a finite number, a text or a vector of numbers")
