"""A scene's skin layer: sizes from the wanted accuracy and the keys, parts made once."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from palmfield.config.skin import SkinConfig
from palmfield.errors import SceneError, naming
from palmfield.skin.fem.wedge_stepper import WedgeStepper
from palmfield.skin.from_config import sheets_of
from palmfield.skin.scene_layer import LayerDemand, SceneLayer, layer_sizes

DISC = {"shape": "disc", "radius_m": 0.03, "thickness_m": 0.01, "material": "ecoflex_00-10"}
DEMAND = LayerDemand(0.0103, 200.0, 200.0, (0.0, 0.0), 1e-3)


def layer(**keys):
    return SceneLayer(SkinConfig(**(DISC | keys)), None, 0.01, np.zeros(3), DEMAND)


def sizes(resizing=1.0, reach=(0.0, 0.0), timestep_s=1e-3, **keys):
    config = SkinConfig(**(DISC | keys))
    return layer_sizes(config, sheets_of(config), 0.0103, 200.0, reach, timestep_s, resizing)


def test_substeps_divide_the_timestep():
    for accuracy in (0.2, 0.05, 0.01):
        found = sizes(accuracy=accuracy)
        assert 1e-3 / found.step_s == pytest.approx(round(1e-3 / found.step_s), rel=1e-12)
        assert found.step_s <= np.sqrt(2 * min(accuracy, 0.05)) / (2 * np.pi * 200) * (1 + 1e-9)
    assert sizes(step_s=2.5e-4).step_s == pytest.approx(2.5e-4)
    with pytest.raises(SceneError, match=r"must divide the timestep 0\.001") as caught:
        sizes(step_s=3e-4)
    assert caught.value.setting == "step_s"


def test_more_accuracy_and_a_path_change_the_sizes():
    plain = sizes()
    assert sizes(accuracy=0.01).edge_fine_m < plain.edge_fine_m
    assert sizes(reach=(0.01, 0.01)).fine_radius_m == pytest.approx(plain.fine_radius_m + 0.01)
    assert plain.radius_m == 0.03
    assert plain.edge_coarse_m <= 0.5 * 0.03
    pinned = sizes(element_m=0.004)
    assert pinned.edge_fine_m == 0.004
    assert pinned.edge_coarse_m >= 0.004


def test_a_body_that_is_no_disc_is_meshed_finer():
    keys = {"shape": "hand", "patch_site": "palm", "radius_m": None, "thickness_m": None, "patch_radius_m": 0.03}
    assert sizes(**keys).edge_fine_m < sizes().edge_fine_m


def test_resizing_scales_edges_and_rows():
    plain, finer, coarser = sizes(), sizes(0.5), sizes(2.0)
    assert finer.edge_fine_m == pytest.approx(0.5 * plain.edge_fine_m)
    assert len(finer.depth_fractions) - 1 == 2 * (len(plain.depth_fractions) - 1)
    assert len(coarser.depth_fractions) - 1 == (len(plain.depth_fractions) - 1) // 2
    assert finer.step_s == plain.step_s


def test_parts_fit_together():
    whole = layer(side="free", element_m=0.006)
    stepper = WedgeStepper(whole.system, whole.quadrature.operator, whole.step_s)
    assert whole.dofs == whole.system.ndof
    assert stepper.state_size <= whole.state_room
    assert whole.surface_operator.shape == (whole.mesh.surface_nodes, whole.system.ndof)
    assert whole.probe(np.array([0.001, 0.0, 0.002])).operator.shape == (1, whole.system.ndof)
    fixed = whole.altered(side="fixed")
    assert fixed.system.ndof < fixed.dofs
    assert whole.resized(0.5).mesh.surface_nodes > whole.mesh.surface_nodes


def test_threads_get_the_same_parts():
    whole = layer(element_m=0.006)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: (whole.system, whole.quadrature), range(8)))
    assert len({id(system) for system, _ in found}) == 1
    assert len({id(quadrature) for _, quadrature in found}) == 1


def test_a_layer_that_cannot_be_made_names_its_keys(tmp_path):
    from palmfield.types import Surface

    flat = Surface(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]), np.array([[0, 1, 2]], np.int32), np.eye(3))
    config = SkinConfig(shape="hand", patch_site="palm", patch_radius_m=0.03)
    far = SceneLayer(config, flat, 0.01, np.array([0.0, 0.0, 1.0]), DEMAND, named=naming("skin 'palm'"))
    with pytest.raises(SceneError, match=r"^skin 'palm': ") as caught:
        _ = far.patch
    assert caught.value.mends == ("patch_site", "patch_radius_m", "depth_m", "element_m")
