"""Scenes whose skin is stepped by spectral elements or particles: shipped scenarios, what is refused, what is said."""

import re

import numpy as np
import pytest

import palmfield
from palmfield.data import folder
from palmfield.errors import SceneError
from palmfield.planning.scene_plan import plan
from palmfield.session.simulation import load

SCENES = folder("mjcf") / "scenes"
SOLVERS = ("spectral_elements", "particles")
SCENARIOS = {
    "phantom_am200": {"skin.radius_m": 0.03, "skin.accuracy": 0.1},
    "palm_am200": {"skin.patch_radius_m": 0.02, "skin.accuracy": 0.2},
}
TIME = 0.006


def ran(name, solver):
    """Displacement (t, S, 3) over a run and the skin's summary."""
    sim = load(SCENES / f"{name}.xml", device="cpu", keys=SCENARIOS[name] | {"skin.solver": solver})
    result = palmfield.run(sim, None, duration_s=TIME, progress=False)
    return result.dataset["skin/skin"]["displacement"].values, result.summary["skins"][0]


@pytest.fixture(scope="module", params=SCENARIOS)
def by_wedges(request):
    return request.param, *ran(request.param, "wedges")


@pytest.mark.nightly
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_scenario_moves_as_by_wedges_within_what_both_state(by_wedges, solver):
    """The cut edge is the same for both and left out."""
    name, expected, theirs = by_wedges
    found, own = ran(name, solver)
    most = np.linalg.norm(expected, axis=2).max(axis=0).argmax()
    stated = sum(skin[f"{part}_error_relative"] for skin in (own, theirs) for part in ("mesh", "step"))
    difference = np.linalg.norm(found[:, most] - expected[:, most]) / np.linalg.norm(expected[:, most])
    assert difference < stated < 0.6
    assert own["mesh_error_relative"] > 0.0 and own["reduction_error_relative"] == 0.0
    assert own["edge_error_relative"] == pytest.approx(theirs["edge_error_relative"], rel=0.01)
    assert own["solver"].startswith("particles, a preview: " if solver == "particles" else "spectral_elements: ")
    assert own["dofs"] % 3 == 0


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_plan_says_what_steps_and_what_it_is_worth(small_scene, solver):
    told = plan(small_scene(skin={"solver": solver, "accuracy": 0.1}))
    rows = {row.what: row for row in told.modelled}
    assert f"mesh of {solver}" in rows
    errors = {row.what: row.size for row in told.error}
    if solver == "particles":
        assert "skin solver particles, a preview" in rows
        assert errors["particles"].startswith("a preview, about ") and errors["particles"].endswith("target 10 %")
        assert any(
            text.startswith("solver 'particles' of skin 'skin' is a preview: the expected error")
            for text in told.warnings
        )
    else:
        assert "skin solver spectral_elements" in rows
        [text] = [text for text in told.warnings if "solver 'spectral_elements'" in text]
        assert "designed for a GPU: about" in text


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({"side": "absorbing"}, r"no side 'absorbing'; allowed: fixed, free, roller; or solver wedges \(.* key side\)"),
        ({"bulk_Pa": 1e10}, r"times its shear modulus; allowed .*: at most .*keys material, materials, bulk_Pa\)"),
    ],
)
def test_what_the_solvers_refuse(small_scene, solver, keys, expected):
    with pytest.raises(SceneError) as refusal:
        load(small_scene(skin={"solver": solver} | keys))
    text = str(refusal.value)
    assert f"plugin 'palmfield.skin' instance 'skin': key 'solver' has value '{solver}': " in text
    assert re.search(expected, text)


@pytest.mark.parametrize("stimulus", [{}, {"drive_amplitude": 0.0}, {"stop_s": 0.005}])
def test_auto_takes_neither(small_scene, stimulus):
    for duration_s in (0.015, 100.0):
        sim = load(small_scene(stimulus=stimulus, duration_s=duration_s))
        assert sim.skin("skin").solver in ("wedges", "reduced", "modal")


def test_particles_are_not_bound_to_small_strain(small_scene):
    rows = {row.what for row in plan(small_scene(skin={"solver": "particles", "accuracy": 0.5})).left_out}
    assert "large strain" not in rows
    assert "large strain" in {row.what for row in plan(small_scene()).left_out}
