"""Every package of the skin exports its names, and loads them when they are asked for."""

import pkgutil
import subprocess
import sys
from importlib import import_module

import pytest

import palmfield.skin

PACKAGES = ["palmfield.skin"] + [
    module.name for module in pkgutil.walk_packages(palmfield.skin.__path__, "palmfield.skin.") if module.ispkg
]


@pytest.mark.parametrize("name", PACKAGES)
def test_names_are_there_and_nothing_else_is_listed(name: str) -> None:
    package = import_module(name)
    assert package.__doc__
    assert sorted(package.__all__) == dir(package)
    modules = {module.name for module in pkgutil.iter_modules(package.__path__)}
    # The import of such a module would take the name's place.
    assert not modules & set(package.__all__)
    for public in package.__all__:
        assert getattr(package, public) is not None
    with pytest.raises(AttributeError, match="attribute nonsense"):
        _ = package.nonsense


def test_importing_the_packages_loads_neither_warp_nor_scipy() -> None:
    lines = [*(f"import {name}" for name in PACKAGES), "import sys", "assert not {'warp', 'scipy'} & set(sys.modules)"]
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True)
