"""A material law that the package doesn't know, in a file of its own, by several solvers and in a scene."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palmfield
from palmfield.config.skin import SkinConfig
from palmfield.errors import SceneError
from palmfield.estimate.error_budget import SOURCES
from palmfield.skin import extreme_sheets, materials, solve
from palmfield.skin.fem.assembly import assemble
from palmfield.skin.fem.load import SurfaceQuadrature
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.fem.solver import harmonic, harmonic_discrete
from palmfield.skin.from_config import material_of
from palmfield.skin.materials import catalogue
from palmfield.skin.materials.material import Sheet, complex_bulk, complex_shear
from palmfield.skin.mesh.disc import disc_patch
from palmfield.skin.mesh.wedges import extrude
from palmfield.skin.problem import Slab, Spot

PAGE = Path(__file__).parents[3] / "docs" / "materials.md"
NAME = "fractional gel"
G_Pa, K_Pa, DENSITY, DEPTH_M = 5e3, 1e4, 1000.0, 2e-3
"""A bulk modulus so low that a column's stiffness is mostly one of shear."""
RAMP_S, END_S, PRESSURE_Pa = 1e-3, 4e-3, 10.0


@pytest.fixture
def gel(tmp_path, monkeypatch):
    """The page's law, found in a file law_*.py of the package as a contributor's would be."""
    (code,) = re.findall(r"```python\n(\"\"\"Fractional.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    (tmp_path / "law_of_the_page.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(materials, "__path__", [*materials.__path__, str(tmp_path)])
    for name, entry in catalogue.law_presets().items():
        monkeypatch.setitem(catalogue.CATALOGUE, name, entry)
        monkeypatch.setitem(catalogue.PRESETS, name, entry.material)
    yield replace(catalogue.preset(NAME), bulk_Pa=K_Pa)
    sys.modules.pop(f"{materials.__name__}.law_of_the_page")


def shear(s):
    """The law, once more."""
    return G_Pa * (1.0 + (1e-3 * s) ** 0.3)


def column(s):
    """Inward displacement of the face [m] for 1 Pa e^{st}, on a bonded base, between sides that slide."""
    modulus = K_Pa + 4.0 / 3.0 * shear(s)
    wavenumber = s * np.sqrt(DENSITY / modulus)
    return np.tanh(wavenumber * DEPTH_M) / (modulus * wavenumber)


def ramped(times):
    """The same in time under a pressure that rises over RAMP_S and stays: Bromwich's integral by the midpoint rule."""
    shift, width = 1500.0, 20.0
    s = shift + 1j * width * (np.arange(20000) + 0.5)
    transform = column(s) * PRESSURE_Pa * (1.0 - np.exp(-s * RAMP_S)) / (RAMP_S * s**2)
    return np.array([width / np.pi * np.sum((transform * np.exp(s * time)).real) for time in times])


@pytest.mark.parametrize(("solver", "least"), [("wedges", 0.006), ("reduced", 0.004), ("spectral_elements", 0.004)])
def test_steps_as_its_transform(gel, solver, least):
    times = np.linspace(0.5 * RAMP_S, END_S, 36)
    load = Spot(10.0, np.array([0.0, RAMP_S, END_S]), PRESSURE_Pa * np.array([0.0, 1.0, 1.0]), (0.0, 0.0), "linear")
    body = Slab((Sheet(gel, DEPTH_M),), shape="disc", side="roller", radius_m=0.01)
    found = solve(body, load, times, np.zeros((1, 2)), solver=solver, accuracy=0.05, device="cpu")
    exact = ramped(times)
    error = np.linalg.norm(found.displacement_m[:, 0, 2] + exact) / np.linalg.norm(exact)
    print(solver, error, found.error)
    assert error < least
    assert error < found.error
    assert "branches in place of the law of a material" in found.error_source


@pytest.mark.parametrize("f_Hz", [60.0, 250.0, 500.0])
def test_harmonic_solution_takes_the_law_itself(gel, f_Hz):
    mesh = extrude(disc_patch(0.01, DEPTH_M, 0.01, 0.01, 0.01), np.linspace(0.0, 1.0, 4))
    system = assemble(mesh, gel, side="roller")
    quadrature = SurfaceQuadrature(mesh, system)
    force = quadrature.assemble(np.ones(len(quadrature.points)))
    read = SurfaceProbe(mesh, np.zeros((1, 3)), system).operator
    exact = column(-2j * np.pi * f_Hz)
    itself, stepped = (
        -(read @ u)[0] for u in (harmonic(system, force, f_Hz), harmonic_discrete(system, force, f_Hz, 1e-5))
    )
    print(f_Hz, abs(itself / exact - 1.0), abs(stepped / exact - 1.0))
    assert abs(itself / exact - 1.0) < 1e-4
    # Its series is another modulus by up to 3 % between 1 and 4000 Hz
    assert 1e-4 < abs(stepped / exact - 1.0) < 0.03


def test_moduli_and_bounds(gel):
    f_Hz = 200.0
    assert complex_shear(gel, f_Hz) == pytest.approx(shear(-2j * np.pi * f_Hz), rel=1e-12)
    assert complex_bulk(gel, f_Hz) == K_Pa
    s = -2j * np.pi * np.geomspace(1.0, 4000.0, 97)
    assert np.abs(G_Pa * gel.relaxation.stiffening(s) / shear(s) - 1.0).max() < 0.03
    assert gel.relaxes
    assert 0.0 < gel.series_error < 0.01
    assert catalogue.preset("palm").series_error == 0.0
    assert abs(shear(s)).max() < gel.shear_instant_Pa
    twice = extreme_sheets.scaled(gel, 2.0, "twice as stiff")
    assert np.allclose(twice.modulus(s), 2.0 * shear(s), rtol=1e-12)
    assert twice.law == gel.law
    assert replace(gel, exponent=0.4).law != gel.law


def test_a_law_without_a_spring_is_refused(gel):
    class Springpot(type(gel)):
        def stiffening(self, s):
            return super().stiffening(s) - 1.0

    with pytest.raises(SceneError, match=r"'pot': G\(0\) is 0\+0j G_r"):
        Springpot("pot", DENSITY, G_Pa, (), K_Pa, "", time_s=1.0, exponent=0.3)


def test_scenes_find_it_and_refuse_branches_for_it(gel):
    keys = {"shape": "disc", "radius_m": 0.02, "thickness_m": 0.01}
    changed = material_of(SkinConfig(material=NAME, shear_relaxed_Pa=1e4, **keys))
    assert complex_shear(changed, 200.0) == pytest.approx(2.0 * shear(-400j * np.pi), rel=1e-12)
    with pytest.raises(SceneError, match=r"'fractional gel' has its own law: remove shear_branch_Pa"):
        material_of(SkinConfig(material=NAME, shear_branch_Pa=1e3, **keys))
    with pytest.raises(SceneError, match=r"did you mean.*fractional gel"):
        catalogue.preset("fractional gell")


def test_a_run_counts_how_far_the_series_is_from_the_law(gel, small_scene):
    skin = {"material": NAME, "accuracy": 0.4, "solver": "wedges"}
    result = palmfield.run(palmfield.Simulation(small_scene(duration_s=0.005, skin=skin)), progress=False)
    (numbers,) = result.summary["skins"]
    parts = numbers["error_budget"]["numerical"]
    assert parts["law_error_relative"] == pytest.approx(gel.series_error)
    squares = sum(parts[f"{name}_error_relative"] ** 2 for name in SOURCES)
    assert numbers["displacement_error_relative"] == pytest.approx(squares**0.5)
