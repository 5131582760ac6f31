"""Cached results. They are computed again only if their inputs, usually the pose or the drive, change."""

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from palmfield.types import Float

Bool = NDArray[np.bool_]
Rows = NDArray[np.intp]
Serials = NDArray[np.int64]
T = TypeVar("T")


class Cached:
    """The last result under each name, with a key: serial numbers, or a value that stays equal while it is valid."""

    def __init__(self, worlds: int = 1):
        """worlds: number of rows of results in `rows`"""
        self._worlds = worlds
        self._last: dict[Hashable, tuple[object, Any]] = {}
        self._rows: dict[Hashable, tuple[Serials, Float]] = {}

    def of(self, name: Hashable, key: object, make: Callable[..., T], *parts: Any, move: Any = None) -> T:
        """Return the result under a name. If the key has changed, it is computed from `parts`.

        move: function of the last result and of `parts`, for an object that is made once and then moved in place
        """
        stored = self._last.get(name)
        if stored is not None and stored[0] == key:
            return stored[1]  # type: ignore[no-any-return]
        if stored is None or move is None:
            value = make(*parts)
        else:
            value = stored[1]
            move(value, *parts)
        self._last[name] = key, value
        return value

    def last(self, name: Hashable) -> Any:
        """Return the last result under a name, for any key; None without one."""
        return self._last.get(name, (None, None))[1]

    def rows(
        self, name: Hashable, shape: tuple[int, ...], worlds: Rows, keys: Serials, make: Callable[..., Any], *parts: Any
    ) -> Float:
        """Return the results of some worlds, shape (g, *shape). keys: pairs of serial numbers, shape (g, 2)

        make: function that computes the result of a world from its number and `parts`, once for equal serial numbers
        """
        stored = self._rows.get(name)
        if stored is None:
            stored = self._rows[name] = np.zeros((self._worlds, 2), np.int64), np.zeros((self._worlds, *shape))
        last, values = stored
        stale = np.logical_or.reduce(last[worlds] != keys, axis=1)
        made: dict[bytes, int] = {}
        for i in stale.nonzero()[0].tolist():
            world = int(worlds[i])
            same = made.setdefault(keys[i].tobytes(), world)
            values[world] = make(world, *parts) if same == world else values[same]
            last[world] = keys[i]
        return values[worlds]

    def adopt(self, other: "Cached") -> None:
        """Copy all results of another Cached, for a copy of its state."""
        self._last = dict(other._last)
        self._rows = {name: (last.copy(), values.copy()) for name, (last, values) in other._rows.items()}
