"""What `palmfield.acoustics` exports, and that it loads nothing before it is asked."""

import subprocess
import sys

import pytest

import palmfield.acoustics


def python(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_importing_it_loads_neither_warp_nor_scipy() -> None:
    code = "import sys, palmfield.acoustics\nprint([name for name in ('warp', 'scipy') if name in sys.modules])"
    assert python(code) == "[]"


@pytest.mark.parametrize("name", palmfield.acoustics.__all__)
def test_every_name_is_there_and_callable(name: str) -> None:
    assert callable(getattr(palmfield.acoustics, name))


def test_modules_are_still_found() -> None:
    from palmfield.acoustics import check
    from palmfield.acoustics.focus import compensate

    assert callable(check.points) and callable(compensate)
    with pytest.raises(AttributeError, match="attribute nothing"):
        palmfield.acoustics.__getattr__("nothing")
