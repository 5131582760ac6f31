"""What `import palmfield` gives, and what every package exports."""

import subprocess
import sys
from importlib import import_module
from importlib.metadata import version
from pathlib import Path

import pytest

import palmfield

FOLDER = Path(palmfield.__file__).parent
PACKAGES = (
    "hardware", "planning", "estimate", "session", "engine", "simulation", "outputs", "drive", "perception", "stimulus",
    "acoustics", "skin", "motion", "hand", "instruments", "metrics", "mujoco_host", "config",
)  # fmt: skip


def fresh(code: str) -> str:
    """What a Python of its own prints."""
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True
    ).stdout


def test_dir_lists_what_is_public_and_nothing_else():
    assert dir(palmfield) == [
        "DeviceError", "OutputError", "PalmfieldError", "Plan", "Result", "SceneError", "Simulation", "__version__",
        "load", "plan", "raise_errors", "recover", "run", "sweep",
    ]  # fmt: skip
    assert all(getattr(palmfield, name) is not None for name in dir(palmfield))
    assert palmfield.__version__ == version("palmfield")
    with pytest.raises(AttributeError, match="no attribute 'nose'"):
        _ = palmfield.nose


@pytest.mark.parametrize("name", PACKAGES)
def test_a_package_exports_names_that_no_module_hides(name):
    package = import_module(f"palmfield.{name}")
    assert package.__all__ and package.__doc__
    modules = {path.stem for path in (FOLDER / name).iterdir()}
    assert not modules & set(package.__all__)
    for public in package.__all__:
        assert getattr(package, public) is not None
    if name != "config":
        assert dir(package) == sorted(package.__all__)
        with pytest.raises(AttributeError, match=f"No palmfield.{name} attribute nose"):
            _ = package.nose


@pytest.mark.parametrize("stub", sorted(FOLDER.rglob("__init__.pyi")), ids=lambda stub: stub.parent.name)
def test_every_name_of_a_stub_is_there(stub):
    package = import_module(".".join(stub.parent.relative_to(FOLDER.parent).parts))
    assert package.__all__ and all(getattr(package, name) is not None for name in package.__all__)


def test_every_package_with_names_is_in_the_list():
    found = {path.parent.name for path in FOLDER.glob("*/__init__.py") if "__all__" in path.read_text()}
    assert found == set(PACKAGES)


def test_no_package_bears_the_name_of_a_public_function_nor_the_module_where_it_is():
    """`palmfield.session.run` would be a module, or after another import a function."""
    public = {name for name in palmfield.__all__ if callable(getattr(palmfield, name))}
    assert {"load", "plan", "recover", "run", "sweep"} <= public
    assert not {folder.name for folder in FOLDER.rglob("*") if folder.is_dir()} & public
    assert not {path.stem for path in FOLDER.glob("*.py")} & public
    assert not {getattr(palmfield, name).__module__.split(".")[-1] for name in public} & public
    four = [FOLDER / name for name in ("hardware", "planning", "estimate", "session")]
    assert not {path.stem for folder in four for path in folder.rglob("*.py")} & public


@pytest.mark.parametrize("name", ["", *PACKAGES])
def test_importing_a_package_does_not_load_warp(name):
    imported = ".".join(["palmfield", *filter(None, [name])])
    assert fresh(f"import {imported}, sys; print('warp' in sys.modules)") == "False\n"


@pytest.mark.parametrize(
    "module", ["engine.host", "engine.scene_runtime", "mujoco_host.mujoco_view", "simulation.scene_reader"]
)
def test_any_module_may_be_the_first_import(module):
    """MuJoCo imports palmfield's plugins while it is imported itself: whoever comes first, they are registered."""
    code = f"import palmfield.{module}, mujoco; print(mujoco.MjSpec.from_string('''{{}}''').compile().nplugin)"
    mjcf = '<mujoco><extension><plugin plugin="palmfield.driver"><instance name="d"/></plugin></extension></mujoco>'
    assert fresh(code.format(mjcf)) == "1\n"
