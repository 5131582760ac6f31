"""What a USD scene of a real run says, from the file alone, against the run's own numbers."""

import json

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom
from unestimated import UNESTIMATED

import palmfield
from palmfield.outputs import open_result
from palmfield.outputs.usd import validate_usd

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.fixture(scope="module")
def run(module_scene, tmp_path_factory):
    scene, out = module_scene(duration_s=0.02), tmp_path_factory.mktemp("usd") / "run"
    with UNESTIMATED:
        palmfield.run(scene, out, plots=[])
    return scene, out, Usd.Stage.Open(str(out / "scene.usdc"))


def test_nothing_is_found(run):
    assert validate_usd(run[1] / "scene.usdc") == []


def test_pressure_times_area_is_the_force_in_every_frame(run):
    """ARP over the body's faces, in the file, against the resultant that MuJoCo got, and the summary's mean."""
    _, out, stage = run
    body = next(iter(stage.GetPrimAtPath("/Scene/Bodies").GetChildren()))
    mesh = UsdGeom.Mesh(body.GetChild("Surface"))
    points = np.array(mesh.GetPointsAttr().Get(), float)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    area = 0.5 * np.cross(points[corners[:, 1]] - points[corners[:, 0]], points[corners[:, 2]] - points[corners[:, 0]])
    arp = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("arp")
    assert arp.GetInterpolation() == "uniform"
    told = body.GetAttribute("palmfield:force")
    step_codes = 1e-3 * stage.GetTimeCodesPerSecond() * (np.arange(20) + 0.5)
    codes = np.arange(stage.GetEndTimeCode() + 1)
    largest = max(np.linalg.norm(told.Get(code)) for code in codes)
    for code in codes:
        turn = np.array(UsdGeom.Xformable(mesh).ComputeLocalToWorldTransform(code))[:3, :3]
        force = -(np.array(arp.Get(code), float)[:, None] * area).sum(axis=0) @ turn
        exact = np.array(told.Get(code))
        assert np.linalg.norm(force - exact) <= 0.01 * np.linalg.norm(exact) + 1e-9 * largest, code
    mean = np.mean([-(np.array(arp.Get(code), float)[:, None] * area).sum(axis=0) @ turn
                    for code in np.round(step_codes)], axis=0)  # fmt: skip
    summary = json.loads((out / "summary.json").read_text())["skins"][0]
    exact = np.array(summary["total_force_mean_N"])
    assert np.linalg.norm(mean - exact) < 0.01 * np.linalg.norm(exact)


def test_transducers_are_where_mujoco_has_the_array(run):
    scene, out, stage = run
    model = mujoco.MjModel.from_xml_path(str(scene)) if not isinstance(scene, mujoco.MjSpec) else scene.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    site = data.site("array")
    name = next(iter(stage.GetPrimAtPath("/Scene/Arrays").GetChildren())).GetName()
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/Scene/Arrays/{name}/Transducers"))
    matrix = np.array(UsdGeom.Xformable(instancer).ComputeLocalToWorldTransform(0))
    places = np.array(instancer.GetPositionsAttr().Get(), float) @ matrix[:3, :3] + matrix[3, :3]
    with open_result(out) as result:
        local = result[f"array/{name}"]["transducer_position"].values
    np.testing.assert_allclose(places, local @ site.xmat.reshape(3, 3).T + site.xpos, atol=1e-6)


def test_the_run_holds_the_sound_pressure_of_its_radiation_pressure(run):
    """ARP is at most |p|^2/(rho c^2) (default law: less what flows along the skin), and nearly that under the focus."""
    with open_result(run[1]) as result:
        skin = result["skin/skin"]
        arp, pressure = skin["arp"].values.astype(float), skin["pressure"].values.astype(float)
        assert skin["loudest_pressure"].values.max() == pytest.approx(pressure.max(), rel=1e-3)
    ratio = arp.max() / pressure.reshape(-1)[arp.argmax()] ** 2 * 1.204 * 343.2**2
    assert 0.8 < ratio <= 1.01
