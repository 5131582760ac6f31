"""Name the phases of a run. They are measured only inside `palmfield.profile.measured`."""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")
running: list[Any] = []
"""Active profiles of `palmfield.profile`. The last one is used."""


class phase:
    """A phase of a run: a block, `with phase("matrices"):`, or each call of a function, `@phase("matrices")`.

    If the function returns an object, the arrays of the object are counted under this name until they are freed.
    """

    def __init__(self, name: str) -> None:
        self.name = name

    def __enter__(self) -> None:
        self._profile: Any = running[-1] if running else None
        if self._profile is not None:
            self._profile.begin(self.name)

    def __exit__(self, *error: object) -> None:
        if self._profile is not None:
            self._profile.end()

    def __call__(self, function: Callable[P, T]) -> Callable[P, T]:
        @wraps(function)
        def measured(*args: P.args, **kwargs: P.kwargs) -> T:
            with phase(self.name):
                made = function(*args, **kwargs)
            for profile in running[-1:]:
                profile.count(self.name, made)
            return made

        return measured
