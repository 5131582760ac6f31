"""A scene imports the solvers that it uses, and no others."""

import subprocess
import sys

import pytest

CODE = """
import sys, palmfield
palmfield.Simulation(sys.argv[1]).step()
parts = {part for name in sys.modules if name.startswith(("palmfield", "warp_kernels")) for part in name.split(".")}
print(*sorted(parts & {"particles", "spectral_elements", "hexa"}))
"""
WEDGES = {"element_m": 0.008}


@pytest.mark.parametrize(
    "solver, loaded",
    [("reduced", []), ("spectral_elements", ["hexa", "spectral_elements"])],
)
def test_a_scene_imports_the_solvers_that_it_uses_only(small_scene, solver, loaded):
    path = small_scene(skin={"solver": solver, **(WEDGES if solver != "spectral_elements" else {})})
    told = subprocess.run([sys.executable, "-c", CODE, str(path)], capture_output=True, text=True, check=True)
    assert told.stdout.split() == loaded
