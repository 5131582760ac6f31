import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate, checked_angles
from palmfield.hand.preset import DIGITS, load_preset, preset_names
from palmfield.motion.joints import JOINTS, POSITION_VALID
from palmfield.motion.pose import HandPose
from palmfield.motion.prediction import resample
from palmfield.motion.retarget import retarget
from palmfield.motion.tracking import Stream, stream_of

TIPS = [JOINTS.index(f"{digit}_tip") for digit in DIGITS]
WRIST = JOINTS.index("wrist")


@pytest.fixture(scope="module")
def times():
    return np.arange(0.0, 1.0, 1.0 / 30.0)


def tips_from_wrist(stream):
    return stream.positions[:, TIPS] - stream.positions[:, [WRIST]]


def tip_errors(hand, motion, meant, times):
    """Fingertips from the wrist of our hand in two motions, apart [m], shape (n, 5)."""
    found, ideal = (tips_from_wrist(stream_of(hand, m, times)) for m in (motion, meant))
    return np.linalg.norm(found - ideal, axis=2)


def of_other_bones(preset, seed):
    """The preset with each bone and tip up to 12 % longer or shorter, each by itself."""
    rng = np.random.default_rng(seed)
    digits = {
        name: digit.model_copy(
            update={
                "bones_m": tuple(bone * rng.uniform(0.88, 1.12) for bone in digit.bones_m),
                "tip_m": digit.tip_m * rng.uniform(0.88, 1.12),
            }
        )
        for name, digit in preset.digits.items()
    }
    return preset.model_copy(update={"digits": digits})


@pytest.mark.parametrize("name", preset_names())
def test_our_fingertips_are_where_our_hand_has_them_at_the_true_angles(median, swing, times, name):
    preset = load_preset(name)
    ours = median if preset.side == "right" else articulate(load_preset("open_men_p50_left"))
    seen = stream_of(articulate(preset), swing, times)
    motion = retarget(ours, seen)
    assert tip_errors(ours, motion, swing, times).max() < 1e-4
    assert motion.report.tip_max_m < 1e-4 and motion.report.palm_rms_m < 1e-6
    assert motion.report.frames == len(times) and motion.report.skipped == 0
    for t in times[::10]:
        checked_angles(ours, motion(t).angles_deg)


@pytest.mark.parametrize("name", ["open_women_p05", "open_men_p95"])
@pytest.mark.parametrize("seed", [0, 1])
def test_hands_with_other_proportions_and_noise_stay_within_3_mm(median, swing, disturbed, times, name, seed):
    other = articulate(of_other_bones(load_preset(name), seed))
    seen = disturbed(stream_of(other, swing, times), 3e-4, 0.01, seed)
    motion = retarget(median, seen)
    errors = tip_errors(median, motion, swing, times)
    assert errors.max() < 0.003 and np.sqrt(np.mean(errors**2)) < 0.0015
    assert motion.report.tip_max_m < 0.002


def test_wrist_comes_to_the_tracked_wrist_and_scales_are_those_of_the_hands(median, swing, times):
    seen = stream_of(articulate(load_preset("open_women_p05")), swing, times)
    motion = retarget(median, seen)
    ours = stream_of(median, motion, times)
    assert ours.positions[:, WRIST] == pytest.approx(seen.positions[:, WRIST], abs=1e-4)
    breadths = [load_preset(name).breadth_m for name in ("open_men_p50", "open_women_p05")]
    assert motion.report.scale_across == pytest.approx(breadths[0] / breadths[1], rel=0.02)
    assert motion.report.at_limit < 0.05


def test_hand_of_our_size_is_followed_in_the_world_with_its_wrist_bent(median, swing, times):
    seen = stream_of(median, lambda t: swing(t, wrist_deg=50.0), times)
    motion = retarget(median, seen)
    ours = stream_of(median, motion, times)
    assert np.abs(ours.positions - seen.positions).max() < 1e-4
    assert motion(0.9).angles_deg["wrist_flexion"] == 0.0


def test_left_hands_are_followed_by_left_hands_only(median, swing, times):
    left = articulate(load_preset("open_women_p50").model_copy(update={"side": "left"}))
    seen = stream_of(left, swing, times)
    with pytest.raises(SceneError, match="mm from its mirror image; use a hand of the other side"):
        retarget(median, seen)
    own = articulate(load_preset("open_men_p50").model_copy(update={"side": "left"}))
    assert tip_errors(own, retarget(own, seen), swing, times).max() < 1e-4


def test_joints_stay_in_their_ranges_where_the_tracked_hand_leaves_them(median, times):
    straight = stream_of(median, lambda t: HandPose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), {}), times)
    bent = straight.positions.copy()
    # The last bone of the index finger turned back by 60 degrees about the finger's own axis of flexion.
    joint, tip = JOINTS.index("index_distal"), JOINTS.index("index_tip")
    axis = next(j.axis for j in median.joints if j.name == "index_dip_flexion")
    back = Rotation.from_rotvec(-np.deg2rad(60.0) * axis)
    bent[:, tip] = bent[:, joint] + back.apply(bent[:, tip] - bent[:, joint])
    motion = retarget(median, Stream(straight.times_s, bent, straight.quaternions, straight.radii, straight.flags))
    angles = motion(0.5).angles_deg
    checked_angles(median, angles)
    assert angles["index_dip_flexion"] == pytest.approx(0.0, abs=0.05)
    assert motion.report.tip_max_m > 0.005 and motion.report.at_limit > 0.04


def test_lost_joints_keep_the_angles_of_before_and_lost_palms_are_skipped(median, swing, times):
    seen = stream_of(median, swing, times)
    tip, middle = JOINTS.index("ring_tip"), JOINTS.index("index_intermediate")
    seen.flags[15:, tip] = 0
    seen.flags[15:, middle] = 0
    seen.positions[15:, [tip, middle]] = np.nan
    knuckle = JOINTS.index("little_proximal")
    seen.flags[25:, knuckle] = 0
    seen.positions[25:, knuckle] = np.nan
    # Knuckles alone are as good as in a line; those with palm and wrist tell the palm's turn.
    seen.flags[20, [JOINTS.index(name) for name in JOINTS if "metacarpal" in name]] = 0
    seen.flags[21, [JOINTS.index(name) for name in JOINTS if "metacarpal" in name or name in ("palm", "wrist")]] = 0
    seen.flags[22] = 0
    motion = retarget(median, seen)
    assert motion.report.skipped == 2 and motion.report.frames == len(times) - 2
    before, after = motion(times[14]).angles_deg, motion(times[29]).angles_deg
    assert after["ring_dip_flexion"] == pytest.approx(before["ring_dip_flexion"], abs=0.01)
    assert after["index_mcp_flexion"] == pytest.approx(before["index_mcp_flexion"], abs=0.01)
    assert after["ring_pip_flexion"] == pytest.approx(swing(times[29]).angles_deg["ring_pip_flexion"], abs=0.1)
    assert after["little_mcp_flexion"] == pytest.approx(swing(times[29]).angles_deg["little_mcp_flexion"], abs=0.1)
    assert after["middle_dip_flexion"] == pytest.approx(swing(times[29]).angles_deg["middle_dip_flexion"], abs=0.1)


def test_streams_without_a_palm_are_refused(median, swing, times):
    seen = stream_of(median, swing, times)
    seen.flags[1:] = 0
    with pytest.raises(SceneError, match="1 of 30 packets have 4 valid palm joints"):
        retarget(median, seen)
    seen = stream_of(median, swing, times)
    seen.flags[:, WRIST] = 15 - POSITION_VALID
    with pytest.raises(SceneError, match="no packet has all palm joints; wrist is missing"):
        retarget(median, seen)


def test_a_bad_stream_predicted_ahead_is_followed(median, swing, disturbed):
    """Noise, jitter, lost and swapped packets of a small woman's hand, 20 ms ahead, on the median man's."""
    other = articulate(load_preset("open_women_p05"))
    times = np.arange(0.0, 1.5, 1.0 / 90.0)
    rng = np.random.default_rng(2)
    order = np.flatnonzero(rng.uniform(size=len(times)) > 0.05)
    order[[40, 41]] = order[[41, 40]]
    full = disturbed(stream_of(other, swing, times + rng.normal(0.0, 0.001, len(times))), 3e-4, 0.01)
    seen = Stream(*(part[order] for part in (full.times_s, full.positions, full.quaternions, full.radii, full.flags)))
    clock = np.arange(0.5, 1.4, 1.0 / 30.0)
    found = resample(seen, clock, 0.02)
    held = np.searchsorted(seen.times_s, clock, side="right") - 1
    late = Stream(clock + 0.02, seen.positions[held], seen.quaternions[held], seen.radii[held], seen.flags[held])
    predicted, plain = (
        np.sqrt(np.mean(tip_errors(median, retarget(median, s), swing, clock + 0.02) ** 2))
        for s in (found.stream, late)
    )
    assert found.skipped == 1 and found.report.dropouts > 0
    assert predicted < 0.003 and predicted < plain


def test_a_frame_takes_some_milliseconds(median, swing, times, yardsticks):
    seen = stream_of(articulate(load_preset("open_men_p95")), swing, times)
    assert min(yardsticks(lambda: retarget(median, seen)) for _ in range(3)) < 2.0 * len(times)
