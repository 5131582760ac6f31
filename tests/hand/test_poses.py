import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, bone_poses, checked_angles
from palmfield.hand.poses import POSE_NAMES, Keyframes, named_pose, posed_and_repaired, posed_surface
from palmfield.hand.preset import DIGITS, load_preset, preset_names
from palmfield.hand.selfcross import crossings
from palmfield.hand.skinning import SkinnedHand

FIST = {
    f"{digit}_{joint}": angle
    for digit in DIGITS[1:]
    for joint, angle in (("mcp_flexion", 88.0), ("pip_flexion", 98.0), ("dip_flexion", 70.0))
}
ANGLES_deg = st.floats(0.0, 100.0).map(lambda angle: round(angle, 6))
HAND = articulate(load_preset("open_men_p50"))


@pytest.fixture(scope="module", params=["open_men_p50", "open_women_p50"])
def hand(request):
    return SkinnedHand(load_preset(request.param), 0.003)


@pytest.mark.parametrize("name", POSE_NAMES)
def test_named_poses_do_not_cross_themselves(hand, name):
    surface = posed_surface(hand, named_pose(hand.hand, name))
    assert len(crossings(surface.vertices, surface.faces)) == 0


def test_fist_is_refused_with_parts_and_places(hand):
    with pytest.raises(SceneError, match=r"crosses itself: .*(index|middle|ring|little)_.* in \d+ places about \("):
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


@pytest.mark.parametrize("preset", ["open_men_p05", "open_women_p05"])
def test_narrow_hands_point_with_a_small_repair_of_the_web(preset):
    narrow = SkinnedHand(load_preset(preset), 0.003)
    with pytest.raises(SceneError, match=r"(index|middle)_proximal in \d places about"):
        posed_surface(narrow, named_pose(narrow.hand, "point"))
    surface, report = posed_and_repaired(narrow, named_pose(narrow.hand, "point"), 0.002)
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


@settings(max_examples=20, deadline=None)
@given(angles=st.lists(ANGLES_deg, min_size=2, max_size=6), scale=st.floats(0.01, 10.0))
def test_keyframes_pass_smoothly_through_their_keys_and_stay_between(angles, scale):
    times = scale * np.cumsum(np.linspace(1.0, 2.0, len(angles)))
    curve = Keyframes(HAND, times.tolist(), [{"index_pip_flexion": angle} for angle in angles])
    for time, angle in zip(times, angles, strict=True):
        assert curve(time)["index_pip_flexion"] == pytest.approx(angle, abs=1e-9)
    for n in range(len(angles) - 1):
        between = [curve(t)["index_pip_flexion"] for t in np.linspace(times[n], times[n + 1], 20)]
        assert min(angles[n : n + 2]) - 1e-9 <= min(between) <= max(between) <= max(angles[n : n + 2]) + 1e-9
    for time in times[1:-1]:
        before, after = (curve.speed(time + d)["index_pip_flexion"] for d in (-1e-7 * scale, 1e-7 * scale))
        assert before == pytest.approx(after, abs=1e-3 / scale)


def test_keyframes_stand_still_outside():
    curve = Keyframes(HAND, [1.0, 2.0], [{"wrist_flexion": 5.0}, {"wrist_flexion": 20.0}])
    assert curve(0.0) == curve(1.0) and curve(9.0) == curve(2.0)
    assert set(curve.speed(0.0).values()) == {0.0}


@pytest.mark.parametrize(
    ("times", "poses", "words"),
    [
        ([0.0], [{}], "two or more that rise"),
        ([0.0, 0.0], [{}, {}], "two or more that rise"),
        ([0.0, 1.0], [{}], "1 poses for 2 times"),
        ([0.0, 1.0], [{}, {"wrist_flexion": 80.0}], "wrist_flexion is 80 degrees; use -70 to 75"),
    ],
)
def test_wrong_keyframes_are_refused(times, poses, words):
    with pytest.raises(SceneError, match=words):
        Keyframes(HAND, times, poses)
