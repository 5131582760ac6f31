"""Import the packages of palmfield's tests but not palmfield: a fork of this process can use any copy of it."""

import gc
from importlib import import_module, metadata
from unittest import mock

# MuJoCo loads palmfield's entry point on import.
with mock.patch.object(metadata, "entry_points", return_value=()):
    import_module("mujoco")
for name in (
    "h5netcdf", "hypothesis", "matplotlib.figure", "pydantic", "pygltflib", "pytest", "rich.console", "scipy.integrate",
    "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats", "trimesh", "typer", "warp", "xarray",
):  # fmt: skip
    import_module(name)
# A fault is found by any example: to look for a small one takes ten times as long
hypothesis = import_module("hypothesis")
hypothesis.settings.register_profile("found", phases=(hypothesis.Phase.explicit, hypothesis.Phase.generate))
hypothesis.settings.load_profile("found")
# What a fork collects is its own.
gc.freeze()
