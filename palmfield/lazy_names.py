"""Public names of a package that are loaded when they are asked for: Warp, MuJoCo and USD take long to import."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, where: Mapping[str, str]) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """A package's `__getattr__` and `__dir__`.

    package: its name; where: for each public name the module of the package that defines it
    A name that is also a module's can't be among them: the first import of that module would take its place.
    """

    def find(name: str) -> Any:
        if name not in where:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        return getattr(import_module(f"{package}.{where[name]}"), name)

    def names() -> list[str]:
        return sorted(where)

    return find, names
