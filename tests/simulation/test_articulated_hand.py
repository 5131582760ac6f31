"""An articulated hand in a scene: its skin, sound, forces and results follow the bones."""

import numpy as np
import pytest
from pxr import Usd, UsdGeom, UsdSkel
from unestimated import UNESTIMATED

from palmfield.data import folder
from palmfield.estimate.estimated_run import run
from palmfield.hand.articulated import bone_poses
from palmfield.hand.poses import named_pose
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand
from palmfield.outputs.frames import posed
from palmfield.outputs.schema import instances
from palmfield.outputs.usd import validate_usd
from palmfield.session.simulation import load
from palmfield.simulation.emission import array_drives

SCENES = folder("mjcf") / "scenes"


@pytest.fixture(scope="module")
def sim():
    loaded = load(SCENES / "approach_withdraw.xml", device="cpu", keys={"motion.follow": "exact"})
    loaded.start_at(0.1)
    return loaded


def test_surface_is_the_posed_skin_of_the_library(sim):
    """MuJoCo's bodies carry the skin to where the library's own forward kinematics has it."""
    hand = SkinnedHand(load_preset("open_men_p50"))
    flat = named_pose(hand.hand, "flat")
    expected = hand.posed(*bone_poses(hand.hand, flat))
    result = sim.runtime.posed.bodies[0].vertices
    # The library keeps the forearm where it is, the scene's frame is the palm's: at wrist angles of 0 they agree.
    assert result == pytest.approx(expected, abs=2e-6)
    assert np.abs(result - hand.surface.vertices).max() > 0.01


def test_forces_on_the_bones_add_up_to_the_force_on_the_whole(sim):
    """Of a posed hand, from its closed surface in one piece: no part of it is lost between the bones."""
    [(forces, torques)] = sim.runtime.body_forces()
    [parts] = sim.runtime.parts
    offsets = sim.data.xpos[list(parts)] - sim.data.body("hand").xpos
    force, torque = forces.sum(axis=0), (torques + np.cross(offsets, forces)).sum(axis=0)
    assert len(forces) == len(parts) == 17
    assert np.count_nonzero(np.linalg.norm(forces, axis=1)) > 5
    scene = sim.runtime.posed
    [drive] = array_drives(sim.runtime.model, scene.arrays)
    unit = drive.unit_drive(scene.focal_points(sim.runtime.model.stimuli[0], 0).at(np.array([0.0, 0.0, 0.2])))
    radiation = sim.runtime.work.radiation
    points, normals, areas, _ = radiation.samples(scene, 0)
    load = radiation.at(scene, 0, "samples", points, normals, unit.amplitudes).arp
    push = -(load * areas)[:, None] * scene.array_frame.vectors(normals)
    arms = scene.array_frame.points(points) - sim.data.body("hand").xpos
    whole, moment = push.sum(axis=0), np.cross(arms, push).sum(axis=0)
    assert np.linalg.norm(whole) > 1e-3
    share = (force @ whole) / (whole @ whole)
    assert 0.0 < share < 1.0
    assert force == pytest.approx(share * whole, rel=1e-5, abs=1e-9)
    assert torque == pytest.approx(share * moment, rel=1e-4, abs=1e-9)


def test_sound_bends_a_finger_of_a_soft_hand():
    """ARP on the index finger moves its own joints: the finger yields towards its back, the others hardly."""
    text = {"stimulus.frame": "index_pad", "stimulus.focus_m": (0, 0, 0), "stimulus.modulation": None,
            "stimulus.am_quantity": None, "stimulus.am_frequency_Hz": None, "stimulus.am_depth": None}  # fmt: skip
    moved = {}
    for level in (0.0, 1.0):
        keys = text | {"stimulus.drive_amplitude": level, "skin.accuracy": 0.5}
        soft = load(SCENES / "approach_withdraw.xml", device="cpu", keys=keys)
        soft.step(12)
        moved[level] = np.array([soft.data.joint(f"{f}_mcp_flexion").qpos[0] for f in ("index", "ring")])
    index, ring = moved[1.0] - moved[0.0]
    assert index < -1e-6
    assert abs(ring) < 0.3 * abs(index)


@UNESTIMATED
def test_results_and_usd_carry_the_bones(sim, tmp_path):
    """The skin that USD blends from the skeleton is the posed surface of the result, which is the scene's own."""
    result = run(sim, tmp_path / "run", duration_s=0.004, progress=False, plots=[])
    tree = result.dataset
    body, surface = instances(tree, "body")["skin"], instances(tree, "surface")["skin"]
    assert body.sizes["bone"] == 17 and body["bone_pose"].dims == ("step_time", "bone", "pose7")
    last = float(tree["step_time"].values[-1])
    expected = posed(surface, body, last)
    assert expected == pytest.approx(sim.runtime.posed.bodies[0].vertices, abs=1e-4)
    assert validate_usd(result.files["scene.usdc"]) == []
    stage = Usd.Stage.Open(str(result.files["scene.usdc"]))
    root = UsdSkel.Root.Get(stage, "/Scene/Bodies/hand")
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    mesh = UsdGeom.Mesh.Get(stage, "/Scene/Bodies/hand/Surface")
    skinning = cache.GetSkinningQuery(mesh.GetPrim())
    skeleton = cache.GetSkelQuery(UsdSkel.Skeleton.Get(stage, "/Scene/Bodies/hand/Skeleton"))
    code = stage.GetEndTimeCode()
    points = mesh.GetPointsAttr().Get()
    assert skinning.ComputeSkinnedPoints(skeleton.ComputeSkinningTransforms(code), points, code)
    assert np.array(points) == pytest.approx(expected, abs=2e-6)
