"""Names for the phases of a run, which are measured only inside `palmfield.profile.measured`."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
running: list[Any] = []
"""The profiles of `palmfield.profile` that measure now; the last one counts."""


class phase:
    """The block is a phase: `with phase("matrices"):`; or each call of a function: `@phase("matrices")`.

    The arrays to which the results of such a function lead are counted under the name, until they are freed.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._profile: Any = None

    def __enter__(self) -> None:
        if running:
            self._profile = running[-1]
            self._profile.begin(self.name)

    def __exit__(self, *error: object) -> None:
        if self._profile is not None:
            self._profile.end()

    def __call__(self, function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def measured(*args: P.args, **kwargs: P.kwargs) -> T:
            with phase(self.name):
                made = function(*args, **kwargs)
            holds(self.name, made)
            return made

        return measured


def holds(name: str, thing: object) -> None:
    """Count the arrays to which an object leads under a name, until they are freed."""
    if running:
        running[-1].count(name, thing)
