"""Hands moved by script inside a scene: the sources, both ways to follow, and what is refused."""

import math

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palmfield
from palmfield.data import folder
from palmfield.engine.host import raise_errors
from palmfield.errors import SceneError
from palmfield.hand.articulated import articulate
from palmfield.hand.preset import load_preset
from palmfield.motion.joints import JOINTS
from palmfield.motion.keyframes import keyframes
from palmfield.motion.tracking import stream_of, write_stream
from palmfield.motion.trajectory import write_trajectory

SCENE = folder("mjcf") / "scenes" / "approach_withdraw.xml"
SILENT = {"stimulus.drive_amplitude": 0, "skin.accuracy": 0.5, "motion.keyframes": None}


@pytest.fixture(scope="module")
def hand():
    return articulate(load_preset("open_men_p50"))


@pytest.fixture(scope="module")
def wave(hand):
    """The hand turns and bends while it moves by 30 mm."""
    turn = Rotation.from_euler("z", [[0], [20], [0]], degrees=True).as_quat(scalar_first=True)
    places = [[0.0, 0.0, 0.22], [0.03, 0.0, 0.2], [0.0, 0.02, 0.22]]
    return keyframes(hand, [0.0, 0.1, 0.2], places, turn, ["flat", {"index_mcp_flexion": 30.0}, "relaxed"])


def opened(**keys):
    return palmfield.load(SCENE, device="cpu", keys=SILENT | keys)


def run(scene, seconds):
    while scene.data.time < seconds - 1e-9:
        mujoco.mj_step(scene.model, scene.data)
        raise_errors(scene.data)


def wave_of_the_tests(time_s):
    """A motion for the key `function`: up and down by 10 mm, two times a second."""
    return [0.0, 0.0, 0.21 + 0.01 * math.sin(4.0 * math.pi * time_s)], [1.0, 0.0, 0.0, 0.0], {"index_pip_flexion": 20.0}


def test_a_trajectory_is_followed_exactly(hand, wave, tmp_path):
    times = np.linspace(0.0, 0.2, 81)
    write_trajectory(tmp_path / "wave.npz", hand, times, [wave(t) for t in times])
    scene = opened(**{"motion.trajectory": tmp_path / "wave.npz", "motion.follow": "exact"})
    run(scene, 0.05)
    mujoco.mj_forward(scene.model, scene.data)
    pose = wave(scene.data.time)
    assert scene.data.body("hand").xpos == pytest.approx(pose.position, abs=1e-4)
    assert np.rad2deg(scene.data.joint("index_mcp_flexion").qpos[0]) == pytest.approx(
        pose.angles_deg["index_mcp_flexion"], abs=0.1
    )
    expected = (wave(scene.data.time).position - wave(scene.data.time - 1e-3).position) / 1e-3
    assert scene.data.joint("hand_root").qvel[:3] == pytest.approx(expected, rel=0.05)


def test_servos_follow_a_little_later_and_yield(hand, wave, tmp_path):
    """Springs of 10 ms: the hand comes after, by a few times that, and ends, the wrist rung down, where it should."""
    times = np.linspace(0.0, 0.2, 81)
    write_trajectory(tmp_path / "wave.csv", hand, times, [wave(t) for t in times])
    scene = opened(**{"motion.trajectory": tmp_path / "wave.csv"})
    run(scene, 0.05)
    behind = np.linalg.norm(scene.data.body("hand").xpos - wave(0.05).position)
    assert 1e-3 < behind < 0.02
    run(scene, 0.7)
    assert scene.data.body("hand").xpos == pytest.approx(wave(0.2).position, abs=1e-4)
    assert scene.data.joint("index_mcp_flexion").qpos[0] == pytest.approx(
        np.deg2rad(wave(0.2).angles_deg["index_mcp_flexion"]), abs=0.02
    )


def test_a_recorded_hand_of_another_size_in_a_space_with_y_up(wave, tmp_path):
    """Pulps of our hand are where the tracked hand's were, once both wrists agree, to 3 mm after scaling by 4 %."""
    other = articulate(load_preset("open_men_p50"))
    times = np.arange(0.0, 0.2, 1.0 / 90.0)
    stream = stream_of(other, wave, times)
    lying = Rotation.from_euler("x", -90.0, degrees=True)
    turned = lying * Rotation.from_quat(stream.quaternions.reshape(-1, 4), scalar_first=True)
    positions = lying.apply(stream.positions.reshape(-1, 3) - [0.0, 0.0, 0.1]).reshape(stream.positions.shape)
    quaternions = turned.as_quat(scalar_first=True).reshape(stream.quaternions.shape)
    write_stream(tmp_path / "seen.npz", type(stream)(times, positions, quaternions, stream.radii, stream.flags))
    keys = {"motion.tracking": tmp_path / "seen.npz", "motion.tracking_origin_m": "0 0 0.1", "motion.follow": "exact"}
    scene = opened(**keys)
    run(scene, 0.1)
    mujoco.mj_forward(scene.model, scene.data)
    near = int(np.abs(times - scene.data.time).argmin())
    for digit in ("index", "thumb", "little"):
        seen = stream.positions[near, JOINTS.index(f"{digit}_tip")]
        assert np.linalg.norm(scene.data.site(f"{digit}_tip").xpos - seen) < 3e-3


def test_a_function_moves_the_hand_and_is_asked_ahead_of_each_step(monkeypatch):
    monkeypatch.setattr("palmfield.cli.new.wave_of_the_tests", wave_of_the_tests, raising=False)
    keys = {"motion.function": "palmfield.cli.new:wave_of_the_tests", "motion.follow": "exact"}
    scene = opened(**keys)
    run(scene, 0.06)
    assert scene.data.mocap_pos[0] == pytest.approx(wave_of_the_tests(scene.data.time)[0], abs=1e-12)
    assert scene.data.joint("index_pip_flexion").qpos[0] == pytest.approx(np.deg2rad(20.0))


def test_copies_and_resets_follow_the_script_too(hand, wave, tmp_path):
    times = np.linspace(0.0, 0.2, 81)
    write_trajectory(tmp_path / "wave.npz", hand, times, [wave(t) for t in times])
    scene = opened(**{"motion.trajectory": tmp_path / "wave.npz"})
    run(scene, 0.02)
    twin = mujoco.MjData(scene.model)
    mujoco.mj_copyData(twin, scene.model, scene.data)
    run(scene, 0.04)
    while twin.time < 0.04 - 1e-9:
        mujoco.mj_step(scene.model, twin)
    assert np.array_equal(twin.qpos, scene.data.qpos)
    mujoco.mj_resetData(scene.model, twin)
    mujoco.mj_step(scene.model, twin)
    assert twin.mocap_pos[0] == pytest.approx(wave(1e-3).position, abs=1e-5)
    assert twin.joint("hand_root").qpos[:3] == pytest.approx(wave(1e-3).position, abs=1e-5)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({}, "sources of the motion: none; give exactly one of: keyframes"),
        ({"motion.function": "nowhere:move"}, "nowhere"),
        ({"motion.function": "math:sin", "motion.body": "palm"}, "no body 'palm'"),
        ({"motion.function": "math:sin", "motion.body": "forearm"}, "mocap='true'"),
        ({"motion.function": "math:sin", "motion.ahead_s": 0.01}, "ahead_s applies to tracking"),
        ({"motion.trajectory": "missing.csv"}, "missing.csv"),
        ({"motion.nose": 1}, "unknown key 'nose'"),
        ({"nose.length_m": 1}, "'nose.length_m' belongs to no instance or plugin"),
    ],
)
def test_bad_motions_are_named(keys, words):
    with pytest.raises(SceneError, match=words.replace("(", r"\(")):
        opened(**keys)


def test_bad_keyframes_are_named_with_their_number(tmp_path):
    good = "[[key]]\ntime_s = 0\nposition_m = [0, 0, 0.2]\n[[key]]\ntime_s = 1\nposition_m = [0, 0, 0.2]\n"
    for bad, words in (
        ("pose = 'fist'\n", "key 2: hand pose 'fist' is unknown"),
        ("turn_deg = [0, 90]\n", "key 2: turn_deg"),
        ("colour = 1\n", "key 2: field 'colour' is unknown"),
        ("joints_deg = { index_pip_flexion = 130 }\n", "key 2: .*index_pip_flexion is 130"),
        (
            "joints_deg = { ring_mcp_flexion = 80, ring_pip_flexion = 100 }\n",
            "key 2: .*intersects",
        ),
    ):
        (tmp_path / "keys.toml").write_text(good + bad)
        with pytest.raises(SceneError, match=words):
            opened(**{"motion.keyframes": tmp_path / "keys.toml"})
    (tmp_path / "keys.toml").write_text(good + "[[key]]\ntime_s = 2\nposition_m = [0, 0, 200]\n")
    with pytest.raises(
        SceneError, match=r"key 3: position_m is \[0, 0, 200\], 200 m away; allowed: metres, at most 10 "
    ):
        opened(**{"motion.keyframes": tmp_path / "keys.toml"})


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ('time_s = "a"', "key 2: time_s"),
        ("quaternion = [1, 0, 0]", "key 2: quaternion"),
        ('turn_deg = ["a", 0, 0]', "key 2: turn_deg"),
        ("joints_deg = 5", "key 2: joints_deg is 5"),
        ('joints_deg = { index_pip_flexion = "x" }', "key 2: joints_deg: index_pip_flexion"),
    ],
)
def test_keyframes_of_other_kinds_are_named(tmp_path, key, words):
    rest = "position_m = [0, 0, 0.2]\n" + ("" if key.startswith("time_s") else "time_s = 1\n")
    (tmp_path / "keys.toml").write_text(f"[[key]]\ntime_s = 0\nposition_m = [0, 0, 0.2]\n[[key]]\n{rest}{key}\n")
    with pytest.raises(SceneError, match=words):
        opened(**{"motion.keyframes": tmp_path / "keys.toml"})
    (tmp_path / "keys.toml").write_text("key = [1, 2]\n")
    with pytest.raises(SceneError, match="key 1 is 1"):
        opened(**{"motion.keyframes": tmp_path / "keys.toml"})
