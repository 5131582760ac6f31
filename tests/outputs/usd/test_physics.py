"""MuJoCo's scene in USD: places, masses, colliders and joints, against MuJoCo itself."""

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdPhysics
from scipy.spatial.transform import Rotation

from palmfield.outputs.schema import tree
from palmfield.outputs.usd import Shown, validate_usd, write_usd
from palmfield.session.mujoco_scene import mujoco_arrays

BODIES = "/Scene/MuJoCo/Bodies"
JOINTS = "/Scene/MuJoCo/Joints"


@pytest.fixture(scope="module")
def model(mjcf):
    return mujoco.MjModel.from_xml_string(mjcf)


@pytest.fixture(scope="module")
def stage(tmp_path_factory, whole, keep, attributes):
    path = tmp_path_factory.mktemp("physics") / "s.usdc"
    less = keep(whole, ("palm",), ("below",), ("pulse",))
    told = {"/body/palm": attributes["/body/palm"], "/mujoco/scene": {"shown_better": '["hand"]'}}
    write_usd(tree(less, told), path, Shown(frames=5))
    assert validate_usd(path) == []
    return Usd.Stage.Open(str(path))


def _world(prim, code):
    return np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code))


def test_bodies_and_geoms_are_where_mujoco_has_them(stage, model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for number in range(model.nbody):
        matrix = _world(stage.GetPrimAtPath(f"{BODIES}/{model.body(number).name}"), 3)
        np.testing.assert_allclose(matrix[3, :3], data.xpos[number], atol=1e-12)
        np.testing.assert_allclose(matrix[:3, :3].T, data.xmat[number].reshape(3, 3), atol=1e-12)
    for number in range(model.ngeom):
        prim = stage.GetPrimAtPath(f"{BODIES}/{model.body(model.geom_bodyid[number]).name}/geom_{number}")
        matrix = _world(prim, 3)
        np.testing.assert_allclose(matrix[3, :3], data.geom_xpos[number], atol=1e-9)
        size = 1.0 if not prim.IsA(UsdGeom.Cube) else model.geom_size[number]
        np.testing.assert_allclose(matrix[:3, :3].T / size, data.geom_xmat[number].reshape(3, 3), atol=1e-9)
        assert prim.HasAPI(UsdPhysics.CollisionAPI) == bool(model.geom_contype[number])


def test_shapes_have_mujocos_sizes(stage, model):
    """By the volume inside USD's own box round each, and by radius and height."""
    capsule = UsdGeom.Capsule(stage.GetPrimAtPath(f"{BODIES}/finger/geom_3"))
    assert (capsule.GetRadiusAttr().Get(), capsule.GetHeightAttr().Get()) == (0.008, 0.04)
    cylinder = UsdGeom.Cylinder(stage.GetPrimAtPath(f"{BODIES}/ball/geom_6"))
    assert (cylinder.GetRadiusAttr().Get(), cylinder.GetHeightAttr().Get()) == (0.01, 0.04)
    assert cylinder.GetDisplayOpacityAttr().Get()[0] == 0.5
    palm = UsdGeom.Mesh(stage.GetPrimAtPath(f"{BODIES}/hand/geom_2"))
    np.testing.assert_allclose(np.abs(np.array(palm.GetPointsAttr().Get())).max(axis=0), [0.04, 0.08, 0.01], rtol=1e-3)
    wedge = UsdGeom.Mesh(stage.GetPrimAtPath(f"{BODIES}/nail/geom_5"))
    np.testing.assert_allclose(np.array(wedge.GetPointsAttr().Get()), model.mesh_vert, atol=1e-8)
    red = UsdGeom.Gprim(stage.GetPrimAtPath(f"{BODIES}/tip/geom_4"))
    assert list(red.GetDisplayColorAttr().Get()[0]) == [1.0, 0.0, 0.0]


def test_masses_and_inertia(stage, model):
    for name in ("hand", "finger", "nail", "ball"):
        api = UsdPhysics.MassAPI(stage.GetPrimAtPath(f"{BODIES}/{name}"))
        body = model.body(name)
        assert api.GetMassAttr().Get() == pytest.approx(body.mass[0], rel=1e-6)
        np.testing.assert_allclose(np.array(api.GetCenterOfMassAttr().Get()), body.ipos, atol=1e-8)
        quat = api.GetPrincipalAxesAttr().Get()
        turn = Rotation.from_quat([*quat.GetImaginary(), quat.GetReal()]).as_matrix()
        own = np.empty(9)
        mujoco.mju_quat2Mat(own, body.iquat)
        inertia = turn @ np.diag(np.array(api.GetDiagonalInertiaAttr().Get(), float)) @ turn.T
        exact = own.reshape(3, 3) @ np.diag(body.inertia) @ own.reshape(3, 3).T
        np.testing.assert_allclose(inertia, exact, atol=1e-6 * np.abs(exact).max())
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    scene = UsdPhysics.Scene(stage.GetPrimAtPath("/Scene/MuJoCo/PhysicsScene"))
    assert scene.GetGravityMagnitudeAttr().Get() == pytest.approx(9.81)
    assert list(scene.GetGravityDirectionAttr().Get()) == [0.0, 0.0, -1.0]


def test_what_stands_is_no_rigid_body_and_what_is_placed_is_kinematic(stage):
    assert not stage.GetPrimAtPath(f"{BODIES}/board").HasAPI(UsdPhysics.RigidBodyAPI)
    assert not stage.GetPrimAtPath(f"{BODIES}/world").HasAPI(UsdPhysics.RigidBodyAPI)
    variants = stage.GetPrimAtPath("/Scene/MuJoCo").GetVariantSets().GetVariantSet("motion")
    kinematic = {}
    for name in ("recorded", "simulated"):
        variants.SetVariantSelection(name)
        kinematic[name] = [
            UsdPhysics.RigidBodyAPI(stage.GetPrimAtPath(f"{BODIES}/{body}")).GetKinematicEnabledAttr().Get()
            for body in ("target", "hand", "ball")
        ]
    assert kinematic == {"recorded": [True, True, True], "simulated": [True, False, False]}


def test_joint_frames_meet_and_turn_about_mujocos_axes(stage, model):
    """Both sides of each joint lie at one place of the world at the reference, and its axis is MuJoCo's."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    for name, joint in (("hand", "x"), ("finger", "flexion"), ("nail", "hinge"), ("tip", None)):
        made = UsdPhysics.Joint(stage.GetPrimAtPath(f"{JOINTS}/{name}"))
        frames = []
        for side in (0, 1):
            targets = getattr(made, f"GetBody{side}Rel")().GetTargets()
            matrix = _world(stage.GetPrimAtPath(targets[0]), 0) if targets else np.eye(4)
            place = np.array(getattr(made, f"GetLocalPos{side}Attr")().Get(), float)
            quat = getattr(made, f"GetLocalRot{side}Attr")().Get()
            turn = Rotation.from_quat([*quat.GetImaginary(), quat.GetReal()]).as_matrix()
            frames.append((place @ matrix[:3, :3] + matrix[3, :3], matrix[:3, :3].T @ turn))
        np.testing.assert_allclose(frames[0][0], frames[1][0], atol=1e-7)
        np.testing.assert_allclose(frames[0][1], frames[1][1], atol=1e-6)
        if joint is not None:
            number = model.joint(joint).id
            np.testing.assert_allclose(frames[1][1][:, 0], data.xaxis[number], atol=1e-6)
            if name != "hand":
                np.testing.assert_allclose(frames[1][0], data.xanchor[number], atol=1e-7)


def test_limits_count_from_the_reference(stage):
    hinge = UsdPhysics.RevoluteJoint(stage.GetPrimAtPath(f"{JOINTS}/nail"))
    assert hinge.GetLowerLimitAttr().Get() == pytest.approx(-20.0)
    assert hinge.GetUpperLimitAttr().Get() == pytest.approx(40.0)
    finger, hand = (stage.GetPrimAtPath(f"{JOINTS}/{name}") for name in ("finger", "hand"))

    def limits(prim):
        found = {}
        for degree in ("transX", "transY", "transZ", "rotX", "rotY", "rotZ"):
            if prim.HasAPI(UsdPhysics.LimitAPI, degree):
                api = UsdPhysics.LimitAPI(prim, degree)
                found[degree] = api.GetLowAttr().Get(), api.GetHighAttr().Get()
        return found

    locked = (1.0, -1.0)
    assert limits(finger) == {
        "transX": locked, "transY": locked, "transZ": locked, "rotX": pytest.approx((-15.0, 75.0)), "rotZ": locked,
    }  # fmt: skip
    assert limits(hand) == {
        "transY": pytest.approx((-0.01, 0.02)), "transZ": locked, "rotX": locked, "rotY": locked, "rotZ": locked,
    }  # fmt: skip
    assert not stage.GetPrimAtPath(f"{JOINTS}/ball")


def test_better_shown_bodies_are_guides(stage):
    assert UsdGeom.Imageable(stage.GetPrimAtPath(f"{BODIES}/hand/geom_2")).ComputePurpose() == "guide"
    assert UsdGeom.Imageable(stage.GetPrimAtPath(f"{BODIES}/ball/geom_6")).ComputePurpose() == "default"


def test_oblique_joints_are_left_out_and_said(tmp_path, still):
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body name="bob"><joint name="a" axis="1 0 0"/><joint name="b" axis="1 1 0"/>
        <geom type="sphere" size="0.1"/></body></worldbody></mujoco>"""
    )
    write_usd(tree({"/mujoco/scene": mujoco_arrays(model)}), tmp_path / "s.usda")
    assert validate_usd(tmp_path / "s.usda") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usda"))
    assert stage.GetPrimAtPath("/Scene/MuJoCo").GetCustomDataByKey("palmfield:left_out") == "a, b"
    assert not stage.GetPrimAtPath(f"{JOINTS}/bob")


def test_results_without_mujocos_scene_go_without(tmp_path, whole, keep):
    old = {path: dict(variables) for path, variables in keep(whole, ("palm",), ("below",), ()).items()}
    del old["/mujoco/scene"], old["/skin/palm"]["pressure"], old["/surface/palm"]["face_arp"]
    write_usd(tree(old), tmp_path / "s.usdc", Shown(frames=5))
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    assert not stage.GetPrimAtPath("/Scene/MuJoCo")
    assert "pressure: the result does not store it" in stage.GetRootLayer().customLayerData["palmfield"]["left_out"]
