"""Values that are made once, also when several threads ask for them."""

import threading
from collections.abc import Callable
from functools import cached_property
from itertools import count
from typing import Any, Generic, Self, TypeVar, overload

T = TypeVar("T")
next_serial: Callable[[], int] = count(1).__next__
"""Gives a number that nothing else in this process has; what is kept for it holds as long as the number is the same."""


class locked_cached_property(cached_property[T]):
    """A cached property of an object with a `lock`: the first thread that asks computes, the others wait."""

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Self | T:
        if instance is None:
            return self
        # `cached_property` puts its value into the instance, where later reads find it before they come here.
        with instance.lock:
            return super().__get__(instance, owner)


class Lazy(Generic[T]):
    """Something costly that is made when it is first asked for."""

    def __init__(self, make: Callable[[], T]):
        self._make, self.lock = make, threading.RLock()

    @property
    def made(self) -> bool:
        """Whether it has been asked for."""
        return "value" in vars(self)

    @locked_cached_property
    def value(self) -> T:
        """The thing. Raises what making it raises."""
        return self._make()
