"""Moved, joined and faulty arrays against what their fields must be."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from palmfield.acoustics.arrays import combined, from_poses, layout, placed, with_faults
from palmfield.acoustics.focus import compensate, focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError, SceneError
from palmfield.types import Air, Array, Complex

AIR = Air()
POINTS = np.random.default_rng(1).uniform([-0.1, -0.1, 0.05], [0.1, 0.1, 0.4], (50, 3))


def some(count: int, seed: int) -> Array:
    random = np.random.default_rng(seed)
    normals = random.normal(size=(count, 3)) * 0.3 + [0.0, 0.0, 1.0]
    return from_poses("some", random.uniform(-0.1, 0.1, (count, 3)) * [1, 1, 0.1], normals)


def some_drive(count: int, seed: int) -> Complex:
    random = np.random.default_rng(seed)
    return random.uniform(0, 1, count) * np.exp(2j * np.pi * random.uniform(0, 1, count))


@settings(max_examples=40, deadline=None)
@given(
    vector=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    shift=st.tuples(*[st.floats(-0.5, 0.5)] * 3),
    count=st.integers(1, 20),
    seed=st.integers(0, 2**31),
)
def test_a_moved_array_sounds_the_same_at_moved_points(
    vector: tuple[float, float, float], shift: tuple[float, float, float], count: int, seed: int
) -> None:
    turn = Rotation.from_rotvec(vector).as_matrix()
    array, drive = some(count, seed), some_drive(count, seed)
    p, gradient = pressure64(POINTS, array, drive, AIR, gradient=True)
    moved, moved_gradient = pressure64(POINTS @ turn.T + shift, placed(array, shift, turn), drive, AIR, gradient=True)
    assert gradient is not None and moved_gradient is not None
    scale = array.p0_Pa_m / 0.05 * count
    np.testing.assert_allclose(moved, p, atol=1e-9 * scale)
    np.testing.assert_allclose(moved_gradient, gradient @ turn.T, atol=1e-6 * scale)


@settings(max_examples=20, deadline=None)
@given(
    quaternion=st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1),
    shift=st.tuples(*[st.floats(-1.0, 1.0)] * 3),
)
def test_placing_back_restores_the_array(quaternion: tuple[float, ...], shift: tuple[float, ...]) -> None:
    array, turn = layout("two_bow_corrected"), Rotation.from_quat(quaternion).as_matrix()
    back = placed(placed(array, shift, turn), -turn.T @ shift, turn.T)
    np.testing.assert_allclose(back.positions, array.positions, atol=1e-12)
    np.testing.assert_allclose(back.normals, array.normals, atol=1e-12)


@pytest.mark.parametrize("matrix", [np.diag([1.0, 1.0, -1.0]), 2 * np.eye(3), np.full((3, 3), np.nan), np.eye(2)])
def test_only_rotations_are_allowed(matrix: np.ndarray) -> None:
    with pytest.raises(SceneError, match="rotation"):
        placed(layout("uhev1"), np.zeros(3), matrix)
    with pytest.raises(SceneError, match="position"):
        placed(layout("uhev1"), [0.0, np.nan, 0.0], np.eye(3))


def test_a_combined_array_sounds_like_the_sum_of_its_parts() -> None:
    left = with_faults(placed(some(30, 1), [-0.1, 0.0, 0.0], np.eye(3)), dead=[2], inverted=[5])
    turn = Rotation.from_euler("y", -30.0, degrees=True).as_matrix()
    right = placed(replace(some(20, 2), p0_Pa_m=4.0), [0.1, 0.0, 0.02], turn)
    drives = [some_drive(30, 3), some_drive(20, 4)]
    both = combined([left, right])
    assert both.name == "some + some" and both.p0_Pa_m == 4.0 and len(both) == 50
    found, _ = pressure64(POINTS, both, np.concatenate(drives), AIR)
    parts = [pressure64(POINTS, a, d, AIR)[0] for a, d in zip((left, right), drives, strict=True)]
    np.testing.assert_allclose(found, parts[0] + parts[1], rtol=1e-10)


def test_addresses_go_on_from_board_to_board() -> None:
    board = layout("sonicsurface")
    two = combined([board, placed(board, [0.2, 0.0, 0.0], np.eye(3))], "two")
    assert two.address is not None and two.gain is None
    np.testing.assert_array_equal(two.address, np.arange(512))
    assert combined([board, layout("uhev1")]).address is None


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"frequency_Hz": 41e3}, "frequency_Hz, 40000 and 41000"),
        ({"piston_radius_m": 4e-3}, "piston_radius_m"),
        ({"directivity_table": np.array([[0.0, 1.0], [45.0, 0.7], [90.0, 0.3]])}, "directivity .'piston', 'table'"),
    ],
)
def test_arrays_of_unlike_transducers_are_not_combined(change: dict[str, object], match: str) -> None:
    with pytest.raises(SceneError, match=match):
        combined([layout("uhev1"), replace(layout("uhev1"), **change)])
    with pytest.raises(SceneError, match="at least 1"):
        combined([])


def test_dead_elements_are_missing_and_inverted_ones_change_sign() -> None:
    array = layout("uhev1")
    drive = focus(array, AIR, (0.01, 0.0, 0.2))
    faultless, _ = pressure64(POINTS, array, drive, AIR)
    alone = {i: pressure64(POINTS, array, drive * (np.arange(256) == i), AIR)[0] for i in (3, 200)}
    faulty, _ = pressure64(POINTS, with_faults(array, dead=[3], inverted=[200]), drive, AIR)
    np.testing.assert_allclose(faulty, faultless - alone[3] - 2 * alone[200], atol=1e-9)


def test_inverting_twice_is_no_fault() -> None:
    array = layout("autd3")
    twice = with_faults(with_faults(array, inverted=[7, 8]), inverted=[8, 7])
    np.testing.assert_array_equal(twice.gain, np.ones(249))


@pytest.mark.parametrize(
    ("dead", "inverted", "match"), [([256], [], "0 to 255"), ([], [-1], "0 to 255"), ([4], [4], "listed twice")]
)
def test_faults_must_name_transducers(dead: list[int], inverted: list[int], match: str) -> None:
    with pytest.raises(SceneError, match=match):
        with_faults(layout("uhev1"), dead, inverted)


def test_compensation_restores_the_focus_of_a_board_wired_at_random() -> None:
    """Half the elements inverted, phases off by up to 15 deg: unfocused as it is, and all in phase once compensated."""
    random = np.random.default_rng(5)
    array = with_faults(
        layout("sonicsurface"), dead=[9], inverted=random.permutation(np.arange(10, 256))[:123].tolist()
    )
    assert array.gain is not None
    array = replace(array, gain=array.gain * np.exp(1j * np.radians(random.uniform(-15, 15, 256))))
    target = np.array([[0.01, 0.02, 0.15]])
    asked = focus(array, AIR, target[0])
    drive = compensate(array, asked)
    assert drive[9] == 0.0
    np.testing.assert_allclose(np.abs(np.delete(drive, 9)), 1.0, rtol=1e-12)
    sound = layout("sonicsurface")
    ideal, _ = pressure64(target, sound, np.where(np.arange(256) == 9, 0.0, asked), AIR)
    assert abs(pressure64(target, array, drive, AIR)[0][0]) == pytest.approx(abs(ideal[0]), rel=1e-12)
    assert abs(pressure64(target, array, asked, AIR)[0][0]) < 0.2 * abs(ideal[0])


def test_compensation_leaves_a_faultless_array_alone_and_refuses_bad_drives() -> None:
    array = layout("uhev1")
    np.testing.assert_array_equal(compensate(array, some_drive(256, 1)), some_drive(256, 1))
    with pytest.raises(PalmfieldError, match="256 transducers"):
        compensate(array, np.ones(255))


def test_sites_of_an_mjcf_file_make_an_array() -> None:
    model = mujoco.MjModel.from_xml_string(
        """<mujoco><worldbody><body pos="0.1 0 0.5" euler="0 90 0">
        <site name="a" pos="0 0.01 0"/><site name="b" pos="0 0 0.02" euler="180 0 0"/>
        </body></worldbody></mujoco>"""
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    array = from_poses("sites", data.site_xpos, data.site_xmat.reshape(-1, 3, 3)[:, :, 2], 1.3)
    np.testing.assert_allclose(array.positions, [[0.1, 0.01, 0.5], [0.12, 0.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(array.normals, [[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]], atol=1e-12)
    assert array.p0_Pa_m == 1.3


@pytest.mark.parametrize(
    ("positions", "normals", "match"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "n at least 1"),
        (np.zeros(3), np.ones(3), "n at least 1"),
        (np.zeros((2, 3)), np.ones((3, 3)), "normals"),
        (np.zeros((2, 3)), [[0, 0, 1], [0, 0, 0]], r"normals\[1\] is zero"),
        (np.full((1, 3), np.nan), [[0, 0, 1]], "positions"),
    ],
)
def test_poses_must_be_whole(positions: object, normals: object, match: str) -> None:
    with pytest.raises(SceneError, match=match):
        from_poses("bad", positions, normals)


@pytest.mark.parametrize("gain", [np.ones(3, complex), np.full(256, np.nan + 0j)])
def test_gain_must_fit_the_array(gain: np.ndarray) -> None:
    with pytest.raises(SceneError, match="gain"):
        pressure64(POINTS, replace(layout("uhev1"), gain=gain), np.ones(256), AIR)
