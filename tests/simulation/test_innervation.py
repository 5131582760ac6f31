"""Afferents of scenes: places, recorded motion, levels, the picture, and keys that are refused."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom

import palmfield
from palmfield.config.skin import SkinConfig
from palmfield.errors import PalmfieldError
from palmfield.outputs import instances
from palmfield.outputs.afferents import spikes_of
from palmfield.outputs.pictures.kinds import KINDS
from palmfield.outputs.pictures.options import Options
from palmfield.outputs.usd import write_usd
from palmfield.perception.afferents import AFFERENTS, largest_under_probe
from palmfield.perception.populations import DENSITIES_PER_CM2
from palmfield.session import Simulation
from palmfield.simulation.innervation import _densities
from palmfield.skin.fem.probe import nearest_on_surface
from palmfield.skin.mesh.element import triangle_shape

DENSITIES = (20.0, 30.0, 10.0)
ON = {"receptors": "on", "receptor_densities_per_cm2": "20 30 10"}


@pytest.fixture(scope="module")
def finished(module_scene, kept_operators):
    return palmfield.run(module_scene(skin=ON, duration_s=0.03), None, progress=False)


def skin_of(result):
    return next(iter(instances(result.dataset, "skin").values()))


def test_places_are_drawn_by_density(finished, module_scene):
    skin = skin_of(finished)
    area_cm2 = 1e4 * np.pi * 0.02**2
    classes = skin["afferent_class"].values
    for name, density in zip(AFFERENTS, DENSITIES, strict=True):
        assert (classes == name).sum() == pytest.approx(density * area_cm2, rel=0.03)
    again, other = (
        Simulation(module_scene(skin=ON | more)).runtime.model.skins[0].innervation.positions
        for more in ({}, {"receptor_seed": "1"})
    )
    np.testing.assert_array_equal(again, skin["afferent_position"].values)
    assert np.abs(other - again).max() > 1e-3
    # As many in each half of the disc
    halves = (again[:, 0] > 0.0).mean(), (again[:, 1] > 0.0).mean()
    assert np.abs(np.array(halves) - 0.5).max() < 3.0 * 0.5 / np.sqrt(len(again))


def test_recorded_motion_is_that_of_the_stepper(module_scene, kept_operators):
    """PC at no depth move as the nodes above them, and the end of a run is what the state gives."""
    keys = ON | {"receptor_depths_m": "0.0007 0.0007 0.000001"}
    sim = Simulation(module_scene(skin=keys, duration_s=0.01))
    result = palmfield.run(sim, None, progress=False)
    skin, model = skin_of(result), sim.runtime.model.skins[0]
    motion = skin["afferent_motion"].values
    [(stepper, numbers)] = sim.runtime.skin_states()
    now = stepper.read(numbers, stepper.reader(model.innervation.operator))[0, 0]
    np.testing.assert_allclose(motion[-1], now, rtol=1e-4, atol=1e-5 * np.abs(now).max())
    pc = skin["afferent_class"].values == "pc"
    near, _, triangles, local = nearest_on_surface(model.layer.mesh, skin["afferent_position"].values[pc])
    np.testing.assert_allclose(near, skin["afferent_position"].values[pc], atol=1e-9)
    nodes = model.layer.mesh.surface_triangles6[triangles]
    pushed = -np.einsum("pi,pi->p", triangle_shape(local), skin["normal_displacement"].values[-1][nodes])
    under = largest_under_probe(AFFERENTS["pc"])
    np.testing.assert_allclose(motion[-1, pc] * under, pushed, atol=2e-3 * np.abs(pushed).max())


def test_levels_follow_the_drive(finished, module_scene, kept_operators):
    """Half of the ARP is 6.02 dB less for every population; units that fire are counted."""
    loud = finished.summary["skins"][0]
    soft = palmfield.run(
        module_scene(skin=ON, stimulus={"drive_amplitude": 0.5**0.5}, duration_s=0.03), None, progress=False
    ).summary["skins"][0]
    for name in ("population_all", "population_pc", "population_ra", "population_sa"):
        assert loud[f"level_{name}_dB_SL"] - soft[f"level_{name}_dB_SL"] == pytest.approx(6.02, abs=0.05)
        assert loud[f"level_{name}_why"].startswith("applies: ")
    assert loud["level_population_all_dB_SL"] == max(
        loud[f"level_population_{one}_dB_SL"] for one in ("pc", "ra", "sa")
    )
    assert loud["afferents_pc"] == (skin_of(finished)["afferent_class"].values == "pc").sum()
    assert 0 <= loud["afferents_pc_firing"] <= loud["afferents_pc"]


def test_a_run_without_the_key_is_unchanged(module_scene, kept_operators, finished):
    plain = palmfield.run(module_scene(duration_s=0.03), None, progress=False)
    skin, with_units = skin_of(plain), skin_of(finished)
    assert not [name for name in skin if str(name).startswith("afferent")]
    assert not [key for key in plain.summary["skins"][0] if "population" in key]
    np.testing.assert_allclose(with_units["displacement"].values, skin["displacement"].values, rtol=1e-5, atol=1e-12)


def test_the_picture_shows_each_class(finished):
    figure = KINDS["receptors"].draw(finished.dataset, Options())
    titles = [axes.get_title() for axes in figure.axes]
    assert sum(title.startswith(("SA1: ", "RA1: ", "PC: ")) for title in titles) == 3


def test_densities_of_a_hand_are_those_of_its_regions():
    config = SkinConfig(patch_site="palm", receptors="on")
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.03]])
    found = _densities(config, points)
    assert found[:, 0].tolist() == list(DENSITIES_PER_CM2["palm"].values()) and not found[:, 1].any()
    with pytest.raises(PalmfieldError, match="no densities are known for hairy skin"):
        _densities(config, points[1:])


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"receptors": "on"}, "densities of afferents on shape 'disc' are unknown"),
        ({"receptor_seed": "1"}, "receptor_seed applies to receptors 'on', but receptors is 'off'"),
        (ON | {"receptor_densities_per_cm2": "1 2"}, "has 2 numbers; give three: SA1, RA1 and PC"),
        (ON | {"receptor_densities_per_cm2": "0 0 0"}, "is 0 for all classes"),
        (ON | {"receptor_depths_m": "0.001 0.001 0.03"}, "a point 30 mm below the skin lies outside the layer"),
        (ON | {"receptor_densities_per_cm2": "0.001 0 0"}, "less than one afferent"),
    ],
)
def test_keys_that_cannot_be_are_refused(module_scene, keys, message):
    with pytest.raises(PalmfieldError, match=message):
        palmfield.run(module_scene(skin=keys), None, progress=False)


def test_usd_has_the_afferents_with_their_rates(finished, tmp_path):
    write_usd(finished.dataset, tmp_path / "felt.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "felt.usdc"))
    [points] = [UsdGeom.Points(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Points)]
    skin = skin_of(finished)
    np.testing.assert_allclose(points.GetPointsAttr().Get(), skin["afferent_position"].values, atol=1e-7)
    rates = np.array(UsdGeom.PrimvarsAPI(points).GetPrimvar("mean_rate").Get())
    fired = sum(len(moments) for moments, _ in spikes_of(skin).values())
    assert rates.sum() * 0.03 == pytest.approx(fired, abs=0.01) and fired > 0
