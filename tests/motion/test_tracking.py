from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.errors import SceneError
from palmfield.hand.articulated import bone_poses, posed_landmark
from palmfield.motion.joints import ALL_FLAGS, JOINTS, POSITION_VALID, hand_joints
from palmfield.motion.tracking import (
    Stream,
    column_names,
    read_stream,
    stream_of,
    stream_report,
    write_stream,
)


@pytest.fixture(scope="module")
def times():
    return np.arange(0.0, 1.0, 1.0 / 90.0)


@pytest.fixture
def stream(median, swing, times):
    return stream_of(median, swing, times)


def taken(stream, order):
    return Stream(*(getattr(stream, name)[order] for name in ("times_s", "positions", "quaternions", "radii", "flags")))


def test_joints_are_those_of_openxr():
    assert len(JOINTS) == 26
    # XrHandJointEXT: THUMB_TIP = 5, INDEX_METACARPAL = 6, MIDDLE_INTERMEDIATE = 13, LITTLE_TIP = 25.
    assert [JOINTS[n] for n in (0, 1, 5, 6, 13, 25)] == [
        "palm",
        "wrist",
        "thumb_tip",
        "index_metacarpal",
        "middle_intermediate",
        "little_tip",
    ]


def test_frames_point_along_the_bones_with_the_back_up(median):
    joints = hand_joints(median)
    assert joints.frames.transpose(0, 2, 1) @ joints.frames == pytest.approx(np.tile(np.eye(3), (26, 1, 1)), abs=1e-12)
    assert np.linalg.det(joints.frames) == pytest.approx(np.ones(26))
    for digit in ("index", "middle", "ring", "little"):
        chain = [JOINTS.index(f"{digit}_{place}") for place in ("proximal", "intermediate", "distal", "tip")]
        steps = np.diff(joints.positions[chain], axis=0)
        along = steps / np.linalg.norm(steps, axis=1)[:, None]
        assert -joints.frames[chain[:-1], :, 2] == pytest.approx(along, abs=1e-9)
    assert np.all(joints.frames[:, 2, 1] > 0.5)
    assert np.all((joints.radii > 0.004) & (joints.radii < 0.03))


def test_tips_of_the_stream_are_the_hands(median, swing):
    seen = stream_of(median, lambda t: swing(t, wrist_deg=40.0), np.array([0.7]))
    pose = swing(0.7, wrist_deg=40.0)
    bones = bone_poses(median, pose.angles_deg)
    turn = Rotation.from_quat(pose.quaternion, scalar_first=True)
    for name in ("thumb_tip", "index_tip", "little_tip", "wrist"):
        place = turn.apply(posed_landmark(median, name, *bones)) + pose.position
        assert seen.positions[0, JOINTS.index(name)] == pytest.approx(place, abs=1e-12)


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_what_is_written_is_read_back(tmp_path, stream, kind):
    short = taken(stream, [0, 2, 1, 3])
    short.flags[1, 4] = 0
    short.positions[1, 4] = np.nan
    write_stream(tmp_path / f"stream.{kind}", short)
    read = read_stream(tmp_path / f"stream.{kind}")
    assert read.times_s.tolist() == short.times_s.tolist()
    assert read.flags.tolist() == short.flags.tolist()
    valid = short.flags != 0
    assert read.positions[valid] == pytest.approx(short.positions[valid], abs=1e-12)
    assert read.quaternions[valid] == pytest.approx(short.quaternions[valid], abs=1e-12)
    assert read.radii[valid] == pytest.approx(short.radii[valid], abs=1e-12)


def test_lost_joints_may_be_nan_in_a_file_and_others_not(tmp_path, stream):
    write_stream(tmp_path / "stream.csv", taken(stream, [0, 1, 2]))
    lines = (tmp_path / "stream.csv").read_text().splitlines()
    names = lines[0].split(",")
    assert names == column_names()

    def with_cells(**cells):
        row = lines[2].split(",")
        for name, cell in cells.items():
            row[names.index(name)] = cell
        (tmp_path / "changed.csv").write_text("\n".join([*lines[:2], ",".join(row), lines[3]]) + "\n")
        return tmp_path / "changed.csv"

    read = read_stream(with_cells(ring_tip_x_m="nan", ring_tip_flags="0"))
    assert read.flags[1, JOINTS.index("ring_tip")] == 0
    for cells, words in (
        ({"ring_tip_x_m": "nan"}, "line 3, ring_tip: position is not finite, but it is flagged as valid"),
        ({"palm_radius_m": "0"}, "line 3, palm: radius is not positive"),
        (dict.fromkeys(("palm_qw", "palm_qx", "palm_qy", "palm_qz"), "0"), "line 3, palm: quaternion has no length"),
        ({"palm_flags": "16"}, "line 3, column palm_flags: 16; use a whole number from 0 to 15"),
        ({"palm_flags": "nan"}, "line 3, column palm_flags: nan"),
        ({"time_s": "inf"}, "line 3, column time_s: inf"),
    ):
        with pytest.raises(SceneError, match=words):
            read_stream(with_cells(**cells))
    (tmp_path / "less.csv").write_text("\n".join(line.rsplit(",", 1)[0] for line in lines))
    with pytest.raises(SceneError, match="column 'little_tip_flags' is missing"):
        read_stream(tmp_path / "less.csv")
    (tmp_path / "more.csv").write_text("\n".join(f"{line},{n}" for n, line in enumerate(lines)))
    with pytest.raises(SceneError, match="column '0' is unknown"):
        read_stream(tmp_path / "more.csv")


def test_report_names_what_was_done_to_the_stream(stream, times):
    clean = stream_report(stream)
    assert (clean.dropouts, clean.reordered, clean.repeated, clean.lost, clean.invalid) == (0, 0, 0, 0.0, 0.0)
    assert clean.period_s == pytest.approx(1.0 / 90.0)
    assert clean.jitter_s < 1e-9
    shifts = np.random.default_rng(0).normal(0.0, 4e-4, len(times))
    order = [n for n in range(len(times)) if n not in (20, 21, 22, 23, 50)]
    order[10], order[11] = order[11], order[10]
    order.insert(31, order[30])
    broken = taken(replace(stream, times_s=times + shifts), order)
    broken.flags[60:63] = 0
    report = stream_report(broken)
    assert (report.packets, report.dropouts, report.reordered, report.repeated) == (len(order), 3, 1, 1)
    assert report.longest_s == pytest.approx(times[24] - times[19] + shifts[24] - shifts[19])
    # Four packets, one, and three without a hand are away.
    assert report.lost == pytest.approx(8.0 / 89.0, rel=0.03)
    # Both ends of an interval jitter.
    assert report.jitter_s == pytest.approx(np.sqrt(2.0) * 4e-4, rel=0.25)
    assert report.invalid == pytest.approx(3.0 / (len(order) - 1))


def test_lost_joints_are_not_looked_at(stream):
    stream.flags[:, 9] = ALL_FLAGS - POSITION_VALID
    assert stream_report(stream).invalid == pytest.approx(1.0 / 26.0)


def test_wrong_shapes_are_refused(tmp_path, stream):
    with pytest.raises(SceneError, match=r"radii have shape \(90, 3\); give \(90, 26\)"):
        write_stream(tmp_path / "stream.npz", replace(stream, radii=np.ones((90, 3))))
    with pytest.raises(SceneError, match="1 packets of different times; give two or more"):
        write_stream(tmp_path / "stream.npz", taken(stream, [0, 0]))


@pytest.mark.parametrize("scale", [1000.0, 100.0, 39.37, 0.001])
def test_a_recording_in_another_unit_than_metres_is_refused(tmp_path, stream, scale):
    write_stream(tmp_path / "m.csv", stream)
    read_stream(tmp_path / "m.csv")
    head, *lines = (tmp_path / "m.csv").read_text().splitlines()
    lengths = [name.endswith(("_x_m", "_y_m", "_z_m", "_radius_m")) for name in head.split(",")]
    rows = [[scale * float(cell) if length else cell for cell, length in zip(line.split(","), lengths, strict=True)]
            for line in lines]  # fmt: skip
    (tmp_path / "other.csv").write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]))
    with pytest.raises(SceneError, match=r"other\.csv.*give metres"):
        read_stream(tmp_path / "other.csv")
