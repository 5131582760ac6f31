"""The bands that depth and base of a layer leave of a displacement, against finite elements with others."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import scipy
import trimesh
from half_space import impedance
from whole_finger import DENSITY_KG_M3, LENGTHS_M, RADII_M, chain, modes

import palmfield
from palmfield.estimate.biases import _whole_finger
from palmfield.estimate.numerics.base_band import base_band, responses
from palmfield.estimate.numerics.depth_band import depth_band
from palmfield.estimate.numerics.point_response import Response
from palmfield.outputs.summary_table import format_summary
from palmfield.skin import Sheet, half_space, preset
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.fem.depth import condensed, on_impedance
from palmfield.skin.problem import spread

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


@pytest.mark.parametrize("depth_m", [0.005, 0.012])
def test_responses_on_each_base(depth_m):
    """On bone against the exact layer, on tissue without end against plane waves in a half space."""
    palm, muscle = preset("palm"), preset("muscle")
    width = spread(0.0103)
    k = np.linspace(0.05, 6.0 / width, 6001)
    weights = k * width**2 * np.exp(-0.5 * (k * width) ** 2) * (k[1] - k[0])
    for f_Hz in (0.0, 60.0, 200.0):
        bases = ("bonded", half_space(palm), half_space(muscle))
        bone, *found = responses([Sheet(palm, depth_m)], 0.0103, f_Hz, bases)
        assert bone == pytest.approx(abs(centre_response(f_Hz, palm, depth_m, 0.0103)), rel=2e-3)
        upper = condensed(k, f_Hz, [Sheet(palm, depth_m)])
        for moved, material in zip(found, (palm, muscle), strict=True):
            exact = abs(weights @ on_impedance(upper, impedance(k, max(f_Hz, 0.1), material)))
            print(depth_m, f_Hz, material.name, moved / exact - 1.0)
            assert moved == pytest.approx(exact, rel=0.02 if material is palm else 0.05)


def test_a_run_has_the_band_of_bases_by_name(small_scene):
    summary = palmfield.run(block(small_scene, 60.0, depth_m=0.008), progress=False).summary
    found = summary["skins"][0]["error_budget"]["left_out"]
    (below,) = [one for one in found if one["what"] == "tissue below the layer"]
    assert below["low"] == 0.0 < below["high"] and "muscle +" in below["why"]


def test_below_a_finger_there_is_no_muscle():
    scene = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_and_fingertip.xml"
    palm, fingertip = (base_band(skin.layer) for skin in palmfield.Simulation(scene).runtime.model.skins)
    assert set(palm) == {"bonded", "deep", "muscle"} and set(fingertip) == {"bonded", "deep"}
    assert palm["bonded"] == fingertip["bonded"] == 1.0 < palm["deep"] < fingertip["deep"]


def test_only_a_finger_moves_as_a_whole():
    scene = Path(__file__).parents[2] / "mjcf" / "scenes" / "palm_and_fingertip.xml"
    palm, fingertip = palmfield.Simulation(scene).runtime.model.skins
    [line] = _whole_finger(fingertip)
    assert not _whole_finger(palm) and line.low is None and "1 to 2 times at 100 Hz" in line.why


def test_a_finger_is_a_chain_of_cylinders():
    """Against the mass matrix of MuJoCo."""
    springs = np.array([0.038, 0.05, 0.02])
    body = ""
    for length, radius, spring in zip(LENGTHS_M[::-1], RADII_M[::-1], springs[::-1], strict=True):
        place = f'size="{radius} {0.5 * length}" pos="{0.5 * length} 0 0" quat="0.7071068 0 0.7071068 0"'
        next_at = body.replace("<body>", f'<body pos="{length} 0 0">', 1)
        joint = f'<joint axis="0 1 0" stiffness="{spring}"/>'
        body = f'<body>{joint}<geom type="cylinder" density="{DENSITY_KG_M3}" {place}/>{next_at}</body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    mass = np.zeros((3, 3))
    mujoco.mj_fullM(model, data, mass)
    exact = np.sqrt(scipy.linalg.eigh(np.diag(springs), mass, eigvals_only=True)) / (2.0 * np.pi)
    line, stiffness, _ = chain(springs)
    np.testing.assert_allclose(modes(line, stiffness)[0], exact, rtol=1e-6)
