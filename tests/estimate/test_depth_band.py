"""The band that the depth to the bone leaves of a displacement, against finite elements with other depths."""

import numpy as np
import pytest
import trimesh

import palmfield
from palmfield.estimate.numerics.depth_band import depth_band
from palmfield.estimate.numerics.point_response import Response
from palmfield.outputs.summary_table import format_summary

pytestmark = pytest.mark.usefixtures("kept_operators")

BLOCK = {"shape": "mesh", "mesh": "block.obj", "mesh_unit": "mm", "patch_site": "centre", "patch_radius_m": 0.025,
         "radius_m": None, "thickness_m": None, "element_m": 0.005, "solver": "wedges", "step_s": 2.5e-4,
         "material": "palm", "side": "fixed"}  # fmt: skip


def block(small_scene, thick_mm, **skin):
    path = small_scene(skin=BLOCK | skin)
    body = trimesh.creation.box((100, 100, thick_mm))
    body.apply_translation((0, 0, -thick_mm / 2))
    body.export(path.with_name("block.obj"))
    return path


def moved(path):
    """At rest and at the main frequency together, by elements, under a Gaussian spot; with the layer."""
    layer = palmfield.load(path).runtime.model.skins[0].layer
    radii = np.linalg.norm(layer.quadrature.points - layer.centre_m, axis=1)
    response = Response(layer, np.exp(-4.0 * np.log(2.0) * (radii / layer.demand.spot_fwhm_m) ** 2), layer.centre_m)
    response.solve()
    return abs(response.static) + abs(response.harmonic), layer


@pytest.mark.parametrize(("thick_mm", "least_m", "radius_m"), [(60.0, 0.008, 0.04), (11.0, 0.004, 0.02)])
def test_the_band_is_what_elements_of_the_least_depth_give(small_scene, thick_mm, least_m, radius_m):
    """Blocks in which a layer is as deep as on a palm, and as on a finger."""
    keys = {"patch_radius_m": radius_m}
    whole, layer = moved(block(small_scene, thick_mm, **keys))
    thinner, given = moved(block(small_scene, thick_mm, depth_m=least_m, **keys))
    band = depth_band(layer, layer.centre_m)
    assert band.least_m == least_m and band.least_m < band.own_m <= band.most_m and band.high >= 1.0
    assert thinner / whole - 1.0 == pytest.approx(band.low - 1.0, rel=0.1)
    assert depth_band(given, given.centre_m) is None


def test_a_run_of_a_body_without_key_depth_m_has_the_band_by_name(small_scene):
    summary = palmfield.run(block(small_scene, 11.0), progress=False).summary
    (depth,) = [one for one in summary["skins"][0]["error_budget"]["inputs"] if one["what"] == "depth to the bone"]
    assert depth["why"].startswith("4.9 mm under the focus; 4 to 6 mm") and depth["low"] < 0.9 < 1.1 < depth["high"]
    said = " ".join(format_summary(summary).replace("│", " ").split())
    assert f"depth to the bone x {depth['low']:.2g} to {depth['high']:.2g}" in said
    assert summary["skins"][0]["verdict"]["low_dB_SL"] < summary["skins"][0]["verdict"]["level_dB_SL"]
