"""An articulated hand in a scene: its skin, sound, forces and results follow the bones."""

import mujoco
import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel

import palmfield
from palmfield.data import folder
from palmfield.engine.host import raise_errors
from palmfield.hand.articulated import bone_poses
from palmfield.hand.poses import named_pose
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.outputs.v1_frames import posed
from palmfield.outputs.v1_store import load
from palmfield.outputs.v1_usd import validate_usd

SCENES = folder("mjcf") / "scenes"


@pytest.fixture(scope="module")
def scene():
    loaded = palmfield.load(SCENES / "approach_withdraw.xml", device="cpu", keys={"motion.follow": "exact"})
    loaded.data.time = 0.1
    next(m for m in loaded.skin.world.modules.values() if m.name == "palmfield.motion").place()
    mujoco.mj_forward(loaded.model, loaded.data)
    raise_errors(loaded.data)
    return loaded


def test_surface_is_the_posed_skin_of_the_library(scene):
    """MuJoCo's bodies carry the skin to where the library's own forward kinematics has it."""
    hand = SkinnedHand(load_preset("open_men_p50"))
    flat = named_pose(hand.hand, "flat")
    expected = hand.posed(*bone_poses(hand.hand, flat))
    skin = scene.skin
    found = skin.rig.posed(skin.pose()).vertices
    # The library keeps the forearm where it is, the scene's frame is the palm's: at wrist angles of 0 they agree.
    assert found == pytest.approx(expected, abs=2e-6)
    assert np.abs(found - hand.surface.vertices).max() > 0.01


def test_forces_on_the_bones_add_up_to_the_force_on_the_whole(scene):
    """Of a posed hand, from its closed surface in one piece: no part of it is lost between the bones."""
    skin = scene.skin
    forces, _ = skin.body_forces()
    force, torque = skin.body_force()
    assert len(forces) == len(skin.bones) and np.count_nonzero(np.linalg.norm(forces, axis=1)) > 5
    pose = skin.pose()
    sound = skin.chain.sound(skin.to_array(np.array([0.0, 0.0, 0.2])), pose)
    points, normals, areas = skin.rig.posed(pose).samples
    load, _ = skin.chain.arp_at(points, normals, pose, sound.drive)
    push = -(load * areas)[:, None] * normals @ skin.world.pose("body", skin.body)[1].T
    arms = points @ skin.world.pose("body", skin.body)[1].T
    whole, moment = push.sum(axis=0), np.cross(arms, push).sum(axis=0)
    assert np.linalg.norm(whole) > 1e-3
    share = (force @ whole) / (whole @ whole)
    assert 0.0 < share < 1.0
    assert force == pytest.approx(share * whole, rel=1e-5, abs=1e-9)
    assert torque == pytest.approx(share * moment, rel=1e-4, abs=1e-9)


def test_sound_bends_a_finger_of_a_soft_hand():
    """ARP on the index finger moves its own joints: the finger yields towards its back, the others hardly."""
    text = {"stimulus.frame": "index_pad", "stimulus.focus_m": "0 0 0", "stimulus.modulation": None,
            "stimulus.am_of": None, "stimulus.am_frequency_Hz": None, "stimulus.am_depth": None}  # fmt: skip
    moved = {}
    for level in (0.0, 1.0):
        keys = text | {"stimulus.drive_amplitude": level, "skin.accuracy": 0.5}
        found = palmfield.load(SCENES / "approach_withdraw.xml", device="cpu", keys=keys)
        for _ in range(12):
            mujoco.mj_step(found.model, found.data)
            raise_errors(found.data)
        moved[level] = np.array([found.data.joint(f"{f}_mcp_flexion").qpos[0] for f in ("index", "ring")])
    index, ring = moved[1.0] - moved[0.0]
    assert index < -1e-6
    assert abs(ring) < 0.3 * abs(index)


def test_results_and_usd_carry_the_bones(scene, tmp_path):
    """The skin that USD blends from the skeleton is the posed surface of the result, which is the module's own."""
    result = palmfield.run(scene, tmp_path / "run", duration_s=0.004, progress=False)
    ds = load(result.files["result.nc"])
    assert ds.sizes["bone"] == 17 and ds["bone_pose"].dims == ("step_time", "bone", "pose7")
    last = float(ds["step_time"].values[-1])
    expected = posed(ds, "surface", last)
    assert expected == pytest.approx(scene.skin.rig.posed(scene.skin.pose()).vertices, abs=1e-4)
    assert validate_usd(result.files["scene.usdc"]) == []
    stage = Usd.Stage.Open(str(result.files["scene.usdc"]))
    root = UsdSkel.Root.Get(stage, "/Scene/Body")
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    mesh = UsdGeom.Mesh.Get(stage, "/Scene/Body/Surface")
    skinning = cache.GetSkinningQuery(mesh.GetPrim())
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/Scene/Body/Skeleton"))
    code = stage.GetEndTimeCode()
    points = mesh.GetPointsAttr().Get()
    assert skinning.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(code), points, code)
    assert np.array(points) == pytest.approx(expected, abs=2e-6)
