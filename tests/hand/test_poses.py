import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, bone_poses, checked_angles
from palmfield.hand.poses import POSE_NAMES, named_pose, posed_and_repaired, posed_surface
from palmfield.hand.preset import DIGITS, load_preset, preset_names
from palmfield.hand.selfcross import crossings
from palmfield.hand.skinning import SkinnedHand

FIST = {
    f"{digit}_{joint}": angle
    for digit in DIGITS[1:]
    for joint, angle in (("mcp_flexion", 88.0), ("pip_flexion", 98.0), ("dip_flexion", 70.0))
}
HAND = articulate(load_preset("open_men_p50"))


@pytest.fixture(scope="module", params=["open_men_p50", "open_women_p50"])
def hand(request):
    return SkinnedHand(load_preset(request.param), 0.003)


@pytest.mark.parametrize("name", POSE_NAMES)
def test_named_poses_do_not_cross_themselves(hand, name):
    surface = posed_surface(hand, named_pose(hand.hand, name))
    assert len(crossings(surface.vertices, surface.faces)) == 0


def test_fist_is_refused_with_parts_and_places(hand):
    with pytest.raises(SceneError, match=r"intersects itself: .*(index|middle|ring|little)_.* in \d+ places about \("):
        posed_surface(hand, FIST)


def test_crease_is_repaired_within_the_limit_and_reported(hand):
    bent = {"index_mcp_flexion": 60.0, "index_pip_flexion": 100.0}
    with pytest.raises(SceneError, match="index_middle and index_proximal"):
        posed_surface(hand, bent)
    plain = hand.posed(*bone_poses(hand.hand, bent))
    surface, report = posed_and_repaired(hand, bent, 0.002)
    moves = np.linalg.norm(surface.vertices - plain, axis=1)
    assert len(crossings(surface.vertices, surface.faces)) == 0
    assert report.crossings == len(crossings(plain, surface.faces)) == sum(report.places.values())
    assert report.moved == np.count_nonzero(moves) < 0.05 * len(moves)
    assert report.largest_m == pytest.approx(moves.max()) and 0.0 < report.largest_m <= 0.002 + 1e-12
    with pytest.raises(SceneError, match=r"even with repairs of up to 0\.05 mm"):
        posed_surface(hand, bent, repair_m=5e-5)


@pytest.mark.parametrize("preset", ["open_men_p95", "open_women_p95"])
def test_large_hands_point_with_a_small_repair_of_the_web(preset):
    large = SkinnedHand(load_preset(preset), 0.003)
    with pytest.raises(SceneError, match=r"(index|middle)_proximal in \d places about"):
        posed_surface(large, named_pose(large.hand, "point"))
    surface, report = posed_and_repaired(large, named_pose(large.hand, "point"), 0.002)
    assert len(crossings(surface.vertices, surface.faces)) == 0
    assert report.crossings <= 10 and report.largest_m <= 0.002 + 1e-12


def test_pinch_brings_the_pulps_together(hand):
    surface = posed_surface(hand, named_pose(hand.hand, "pinch"))
    owner = hand.dominant_bone()
    thumb, index = (surface.vertices[owner == hand.hand.bone(f"{d}_distal")] for d in ("thumb", "index"))
    gap = np.linalg.norm(thumb[:, None] - index[None], axis=2).min()
    assert 0.0005 < gap < 0.005


@pytest.mark.parametrize("preset", preset_names())
@pytest.mark.parametrize("name", POSE_NAMES)
def test_named_poses_are_within_the_ranges(preset, name):
    other = articulate(load_preset(preset))
    pose = named_pose(other, name)
    assert list(pose) == [joint.name for joint in other.joints]
    checked_angles(other, pose)


@pytest.mark.parametrize("angle", [-70.0, 75.0])
def test_wrist_bends_through_its_range(hand, angle):
    posed_surface(hand, {"wrist_flexion": angle})


def test_unknown_pose_is_refused():
    with pytest.raises(SceneError, match="'fist' is unknown; use one of: flat, relaxed, splay, point, pinch"):
        named_pose(HAND, "fist")


@pytest.mark.parametrize("repair_m", [-1e-3, 0.02, float("nan")])
def test_a_repair_has_bounds(repair_m):
    with pytest.raises(SceneError, match="repair_m is"):
        posed_and_repaired(SkinnedHand(load_preset("open_men_p50")), {}, repair_m)
