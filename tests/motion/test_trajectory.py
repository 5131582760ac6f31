import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palmfield.errors import OutputError, SceneError
from palmfield.motion.pose import HandPose
from palmfield.motion.trajectory import from_callable, read_trajectory, write_trajectory

HEADER = "time_s,x_m,y_m,z_m,qw,qx,qy,qz"
PLAIN = "0,0,0,0.2,1,0,0,0\n1,0.1,0,0.2,1,0,0,0\n"


@pytest.fixture
def table(tmp_path):
    def written(text):
        (tmp_path / "motion.csv").write_text(text)
        return tmp_path / "motion.csv"

    return written


@pytest.mark.smoke
@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_what_is_written_is_read_back(tmp_path, median, swing, kind):
    times = np.linspace(0.1, 0.9, 9)
    write_trajectory(tmp_path / f"motion.{kind}", median, times, [swing(t) for t in times])
    motion = read_trajectory(tmp_path / f"motion.{kind}", median)
    assert motion.span_s == (0.1, 0.9)
    for time in times:
        read, meant = motion(time), swing(time)
        assert read.position == pytest.approx(meant.position, abs=1e-12)
        turn = Rotation.from_quat([read.quaternion, meant.quaternion], scalar_first=True)
        assert (turn[0] * turn[1].inv()).magnitude() < 1e-9
        assert {name: read.angles_deg[name] for name in meant.angles_deg} == pytest.approx(meant.angles_deg, abs=1e-9)
    assert motion(-5.0).position == pytest.approx(swing(0.1).position)
    assert motion(5.0).position == pytest.approx(swing(0.9).position)


def test_between_samples_it_converges_to_the_motion(tmp_path, median, swing):
    def miss(n):
        times = np.linspace(0.0, 1.0, n)
        write_trajectory(tmp_path / "motion.npz", median, times, [swing(t) for t in times])
        motion = read_trajectory(tmp_path / "motion.npz", median)
        return max(np.abs(motion(t).position - swing(t).position).max() for t in np.linspace(0.3, 0.7, 101))

    # Monotone cubics are of second order where they turn round, of third elsewhere.
    assert np.log2(miss(21) / miss(81)) / 2.0 > 1.8


def test_units_of_columns_and_joints_at_rest(table, median):
    path = table(
        "qz,qy,qx,qw,time_s,x_mm,y_m,z_mm,wrist_flexion_rad,index_pip_flexion_deg\n"
        "0,0,0,2,0,100,0.1,200,0.5,30\n\n0,0,0,2,1,100,0.1,200,0.5,30\n"
    )
    pose = read_trajectory(path, median)(0.5)
    assert pose.position == pytest.approx([0.1, 0.1, 0.2])
    assert pose.quaternion == pytest.approx([1.0, 0.0, 0.0, 0.0])
    assert pose.angles_deg["wrist_flexion"] == pytest.approx(math.degrees(0.5))
    assert pose.angles_deg["index_pip_flexion"] == pytest.approx(30.0)
    rest = {joint.name: joint.rest_deg for joint in median.joints}
    assert pose.angles_deg["ring_dip_flexion"] == pytest.approx(rest["ring_dip_flexion"])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        (f"{HEADER}\n", "has 0 rows of numbers; needed: two or more"),
        (f"{HEADER}\n0,0,0,0,1,0,0,0\n", "has 1 rows of numbers; needed: two or more"),
        (f"{HEADER},x_m\n", "column 'x_m' occurs twice"),
        (f"{HEADER}\n0,0,0,0.2,1,0,0,0\n1,0,nan,0.2,1,0,0,0\n", "line 3, column y_m: nan; give a finite number"),
        (f"{HEADER}\n0,0,0,0.2,1,0,0,0\n\n1,0,0,here,1,0,0,0\n", "line 4, column z_m: 'here' is not a number"),
        (f"{HEADER}\n0,0,0,0.2,1,0,0,0\n1,0,0\n", "line 3 has 3 values for 8 columns"),
        (f"{HEADER}\n{PLAIN}1,0,0,0.2,1,0,0,0\n", "line 4, column time_s: 1 s comes after 1 s; allowed: rising times"),
        (f"{HEADER}\n{PLAIN}2,0,0,0.2,0,0,0,0\n", "line 4, columns qw to qz: a quaternion of length 0"),
        ("time_s,x_m,z_m,qw,qx,qy,qz\n0,0,0,1,0,0,0\n1,0,0,1,0,0,0\n", "column 'y_m' or 'y_mm' is missing"),
        ("x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,1,0,0,0\n", "column 'time_s' is missing"),
        ("time_s,x_m,y_m,z_m,qw,qx,qy\n0,0,0,0,1,0,0\n1,0,0,0,1,0,0\n", "column 'qz' is missing"),
        (f"{HEADER},x_mm\n0,0,0,0,1,0,0,0,0\n1,0,0,0,1,0,0,0,0\n", "columns x_m and x_mm exclude each other"),
        (f"{HEADER},elbow_deg\n0,0,0,0,1,0,0,0,5\n1,0,0,0,1,0,0,0,5\n", "column 'elbow_deg' is unknown; .*wrist_flex"),
        (f"{HEADER},wrist_flexion\n0,0,0,0,1,0,0,0,5\n1,0,0,0,1,0,0,0,5\n", "column 'wrist_flexion' is unknown"),
        (
            f"{HEADER},wrist_flexion_rad\n0,0,0,0,1,0,0,0,0\n1,0,0,0,1,0,0,0,1.5\n",
            "line 3, column wrist_flexion_rad: 85.9437 degrees; use -70 to 75 degrees",
        ),
        (
            f"{HEADER},wrist_flexion_rad,wrist_flexion_deg\n0,0,0,0,1,0,0,0,0,0\n1,0,0,0,1,0,0,0,0,0\n",
            "columns wrist_flexion_deg and wrist_flexion_rad exclude each other",
        ),
    ],
)
def test_wrong_tables_are_refused_with_line_and_column(table, median, text, words):
    with pytest.raises(SceneError, match=words):
        read_trajectory(table(text), median)


def test_wrong_files_are_refused(tmp_path, median):
    with pytest.raises(SceneError, match=r"none\.csv: cannot be read"):
        read_trajectory(tmp_path / "none.csv", median)
    with pytest.raises(SceneError, match=r"the kind of the file is '\.txt'; use \.csv or \.npz"):
        read_trajectory(tmp_path / "motion.txt", median)
    (tmp_path / "text.npz").write_text("not an archive")
    with pytest.raises(SceneError, match=r"text\.npz: is not an NPZ archive"):
        read_trajectory(tmp_path / "text.npz", median)
    (tmp_path / "bytes.csv").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(SceneError, match=r"bytes\.csv: cannot be read"):
        read_trajectory(tmp_path / "bytes.csv", median)
    np.savez(tmp_path / "ragged.npz", time_s=np.arange(3.0), x_m=np.arange(2.0))
    with pytest.raises(SceneError, match="arrays of one length"):
        read_trajectory(tmp_path / "ragged.npz", median)
    np.savez(tmp_path / "object.npz", time_s=np.array([{}, {}], dtype=object))
    with pytest.raises(SceneError, match="column time_s does not contain numbers"):
        read_trajectory(tmp_path / "object.npz", median)
    columns = {name: np.zeros(2) for name in HEADER.split(",")} | {"time_s": np.arange(2.0), "qw": np.ones(2)}
    np.savez(tmp_path / "lost.npz", **columns | {"y_m": np.array([0.0, np.nan])})
    with pytest.raises(SceneError, match="row 2, column y_m: nan"):
        read_trajectory(tmp_path / "lost.npz", median)


@pytest.mark.parametrize("kind", ["csv", "npz"])
def test_broken_files_are_read_or_refused_and_nothing_else(tmp_path, median, swing, kind):
    file = tmp_path / f"motion.{kind}"
    write_trajectory(file, median, [0.0, 1.0], [swing(0.0), swing(1.0)])
    whole, rng, refused = file.read_bytes(), np.random.default_rng(0), 0
    for _ in range(150):
        broken = bytearray(whole)
        for place in rng.integers(len(whole) - 40, size=2):
            broken[place : place + rng.integers(0, 30)] = rng.bytes(2)
        file.write_bytes(broken)
        try:
            read_trajectory(file, median)
        except SceneError:
            refused += 1
    assert refused > 100


def test_what_cannot_be_written_is_refused(tmp_path, median, swing):
    poses = [swing(0.0), swing(1.0)]
    with pytest.raises(OutputError, match=r"kind of the file is '\.txt'"):
        write_trajectory(tmp_path / "motion.txt", median, [0.0, 1.0], poses)
    with pytest.raises(OutputError, match="cannot write"):
        write_trajectory(tmp_path / "no_folder" / "motion.csv", median, [0.0, 1.0], poses)
    with pytest.raises(SceneError, match="2 poses for 3 times"):
        write_trajectory(tmp_path / "motion.csv", median, [0.0, 1.0, 2.0], poses)
    bad = HandPose(poses[0].position, poses[0].quaternion, {"wrist_flexion": 99.0})
    with pytest.raises(SceneError, match=r"at 1 s: .*99 degrees"):
        write_trajectory(tmp_path / "motion.csv", median, [0.0, 1.0], [poses[0], bad])


def test_functions_by_themselves_and_by_name(swing, tmp_path, monkeypatch):
    assert from_callable(swing)(0.3).position == pytest.approx(swing(0.3).position)
    assert from_callable(swing).span_s == (-math.inf, math.inf)
    (tmp_path / "users_motion.py").write_text(
        "calls = []\ndef rise(t):\n    calls.append(t)\n    return (0, 0, t), (2, 0, 0, 0), {'wrist_flexion': 5}\n"
        "rise.span_s = (0.0, 2.0)\nnumber = 3\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    motion = from_callable("users_motion:rise")
    assert motion.span_s == (0.0, 2.0)
    assert motion(9.0).position.tolist() == motion(2.0).position.tolist() == [0.0, 0.0, 2.0]
    assert motion(1.0).quaternion.tolist() == [1.0, 0.0, 0.0, 0.0]
    for name, words in (
        ("users_motion:fall", "'users_motion:fall' is not found: .*fall"),
        ("no_such_module_here:f", "is not found: there is no module 'no_such_module_here'"),
        (".relative:f", "is not found: TypeError"),
        ("users_motion", "not of the form package.module:function"),
        ("users_motion:number", "is int; name a function"),
    ):
        with pytest.raises(SceneError, match=words):
            from_callable(name)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (None, "the function returned NoneType; return a palmfield.motion.pose.HandPose"),
        (HandPose([0, 0], [1, 0, 0, 0], {}), r"position has shape \(2,\)"),
        (([0, 0, math.nan], [1, 0, 0, 0], {}), "position is .*nan"),
        (([0, 0, 0], [0, 0, 0, 0], {}), "quaternion has length 0"),
        (([0, 0, 0], [1, 0, 0, 0], {"wrist_flexion": "much"}), "angles_deg is .*much.*; give numbers"),
        (([0, 0, 0], [1, 0, 0, 0], {"wrist_flexion": 99}), "wrist_flexion is 99 degrees; use -70 to 75"),
    ],
)
def test_wrong_answers_of_functions_are_refused_with_their_time(median, answer, words):
    motion = from_callable(lambda time: answer if time > 0.2 else ([0, 0, 0], [1, 0, 0, 0], {}), median)
    motion(0.1)
    with pytest.raises(SceneError, match=r"'<lambda>' at 0\.25 s: .*" + words):
        motion(0.25)


def test_failing_functions_are_named_with_time_and_reason(median):
    with pytest.raises(SceneError, match=r"at 0 s: ZeroDivisionError: .*; correct the function"):
        from_callable(lambda time: 1 / time, median)(0)
