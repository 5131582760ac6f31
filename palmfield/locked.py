"""Values that are made once, also when several threads ask for them."""

import threading
from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar

T = TypeVar("T")


class locked_cached_property(cached_property[T]):
    """A cached property of an object with a `lock`: the first thread that asks computes, the others wait."""

    def __get__(self, instance: Any, owner: Any = None) -> Any:
        if instance is None:
            return self
        # `cached_property` puts its value into the instance, where later reads find it before they come here.
        with instance.lock:
            return super().__get__(instance, owner)


class Lazy(Generic[T]):
    """Something costly that is made when it is first asked for."""

    def __init__(self, make: Callable[[], T]):
        self._make, self._lock = make, threading.RLock()
        self._made: tuple[T] | None = None

    @property
    def made(self) -> bool:
        """Whether it has been asked for."""
        return self._made is not None

    def get(self) -> T:
        """The thing. Raises what making it raises."""
        if self._made is None:
            with self._lock:
                if self._made is None:
                    self._made = (self._make(),)
        return self._made[0]
