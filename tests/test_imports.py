"""Which modules commands and scenes load: those that they use. docs/bench/startup.md has the seconds."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import palmfield

SCENE = str(Path(palmfield.__file__).parents[1] / "mjcf" / "scenes" / "palm_am200.xml")
PICTURES = {"matplotlib", "pxr", "scipy.signal", "scipy.stats", "scipy.interpolate"}
FILES = {"xarray", "h5netcdf", "h5py"}
MESHES = {"trimesh", "networkx", "potpourri3d", "scipy.ndimage", "contourpy"}
RARE = {
    "palmfield.acoustics.calibration_file", "palmfield.acoustics.transducer_file", "palmfield.tables",
    "palmfield.hand.articulated", "palmfield.hand.posed_surface", "palmfield.hand.skinning",
    "palmfield.mujoco_host.drawing", "palmfield.simulation.small_models.load_class", "palmfield.skin.problem",
    "palmfield.stimulus.bursts", "palmfield.stimulus.curves", "warp_kernels.point_sound",
}  # fmt: skip
"""What few scenes have: files about arrays, bones of hands, viewers, modes, bursts, paths, shadows."""
COMMAND = """
from palmfield.cli.app import start
try:
    start()
except SystemExit as ended:
    assert not ended.code
"""
STEPS = "import sys, palmfield; palmfield.Simulation(sys.argv[1]).run(0.002)"
MOST_LINES = 25_000
"""Of palmfield and its kernels that a scene loads, without a cache."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache with what the first call keeps: a patch of skin, a surface, a reduced model."""
    folder = tmp_path_factory.mktemp("cache")
    loaded(STEPS, SCENE, cache=folder)
    return folder


def loaded(code, *words, cache="off"):
    """The modules that a Python of its own has at the end."""
    told = subprocess.run(
        [sys.executable, "-c", f"{code}\nimport sys; print(); print(*sys.modules)", *words],
        env=os.environ | {"PALMFIELD_CACHE": str(cache)}, capture_output=True, text=True,
    )  # fmt: skip
    assert told.returncode == 0, told.stderr
    return set(told.stdout.splitlines()[-1].split())


def test_keys_are_listed_without_what_computes():
    assert not loaded(COMMAND, "keys") & (PICTURES | FILES | MESHES | {"numpy", "scipy", "warp", "mujoco"})


@pytest.mark.parametrize(
    ("command", "more"),
    [
        ("info", {"scipy.optimize"}),
        ("plan", {"palmfield.acoustics.scattering", "palmfield.skin.fem.elimination"}),
    ],
)
def test_a_scene_is_described_without_pictures_files_and_meshes(command, more, cache):
    here = loaded(COMMAND, command, SCENE, cache=cache)
    assert "palmfield.simulation.build" in here
    assert not here & (PICTURES | FILES | MESHES | RARE | more)


def test_a_stepped_scene_loads_what_it_has(cache):
    here = loaded(STEPS, SCENE, cache=cache)
    assert "palmfield.simulation.step" in here
    assert not here & (PICTURES | FILES | MESHES | RARE | {"rich", "typer", "scipy.optimize"})


def test_a_scene_without_a_cache_loads_few_lines():
    own = [name for name in loaded(STEPS, SCENE) if name.split(".")[0] in ("palmfield", "warp_kernels")]
    assert not set(own) & RARE
    root = Path(palmfield.__file__).parents[1]
    files = [root.joinpath(*name.split(".")) for name in own]
    sources = [file / "__init__.py" if file.is_dir() else file.with_suffix(".py") for file in files]
    assert len(sources) > 100 and sum(len(source.read_text().splitlines()) for source in sources) <= MOST_LINES


def test_a_run_loads_neither_dask_nor_optimizers(cache, tmp_path):
    short = ["--duration", "0.002", "--estimate", "none", "--no-plots", "--no-usd"]
    words = ["run", SCENE, "--out", str(tmp_path), *short]
    here = loaded(COMMAND, *words, cache=cache)
    assert "h5netcdf" in here and not here & {"dask.base", "dask.array", "scipy.optimize"}


def test_a_recorded_run_loads_pictures_at_its_end():
    here = loaded("import palmfield; palmfield.run, palmfield.recover")
    assert "xarray" in here and not here & (PICTURES | {"trimesh"})


def test_pictures_and_usd_load_no_signal_processing():
    """scipy.signal takes half a second."""
    here = loaded("import palmfield.outputs.plots, palmfield.outputs.render, palmfield.outputs.usd.write")
    assert {"matplotlib", "pxr"} < here and not here & {"scipy.signal", "scipy.stats", "warp.geometry"}
