"""A scene imports the solvers that it uses, and what bodies do to its sound; nothing else of either."""

import subprocess
import sys

import pytest

CODE = """
import sys, palmfield
palmfield.Simulation(sys.argv[1]).step()
parts = {part for name in sys.modules if name.startswith(("palmfield", "warp_kernels")) for part in name.split(".")}
print(*sorted(parts & {"particles", "spectral_elements", "hexa", "knife_edge", "occlusion", "bem"}))
"""
WEDGES = {"element_m": 0.008}


@pytest.mark.parametrize(
    "keys, loaded",
    [
        ({"solver": "reduced"} | WEDGES, []),
        ({"solver": "reduced", "body_sound": "shadows"} | WEDGES, ["knife_edge", "occlusion"]),
        ({"solver": "spectral_elements"}, ["hexa", "spectral_elements"]),
    ],
)
def test_a_scene_imports_what_it_uses_only(small_scene, keys, loaded):
    told = subprocess.run([sys.executable, "-c", CODE, str(small_scene(skin=keys))], capture_output=True, text=True)
    assert told.stdout.split() == loaded, told.stderr
