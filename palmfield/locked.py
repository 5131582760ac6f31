"""Compute values only once, also if several threads read them."""

import threading
from collections.abc import Callable
from functools import cached_property
from itertools import count
from typing import Any, Generic, Self, TypeVar, overload

T = TypeVar("T")
next_serial: Callable[[], int] = count(1).__next__
"""Return a number that is unique in this process. Data cached for an object are valid while its number is unchanged."""


class locked_cached_property(cached_property[T]):
    """A cached property of an object that has a `lock`. The first thread computes the value; the others wait."""

    @overload
    def __get__(self, instance: None, owner: type[Any] | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type[Any] | None = None) -> T: ...
    def __get__(self, instance: Any, owner: type[Any] | None = None) -> Self | T:
        if instance is None:
            return self
        # `cached_property` stores the value in the instance, so that later reads do not call this
        with instance.lock:
            return super().__get__(instance, owner)


class Lazy(Generic[T]):
    """An object that takes long to make, and is made at the first use."""

    def __init__(self, make: Callable[[], T]):
        self._make, self.lock = make, threading.RLock()

    @property
    def made(self) -> bool:
        """Whether the object has been made."""
        return "value" in vars(self)

    @locked_cached_property
    def value(self) -> T:
        """The object, made at the first use. Errors while it is made are raised."""
        return self._make()

    def forget(self) -> None:
        """Free the value. The next use makes it again."""
        with self.lock:
            vars(self).pop("value", None)
