import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pxr import Sdf, Usd, UsdGeom, Vt

from palmfield.errors import OutputError
from palmfield.outputs.frames import to_world
from palmfield.outputs.schema import dataset
from palmfield.outputs.usd import MOST_FRAMES, quantise, validate_usd, write_usd


@pytest.fixture(scope="module")
def written(tmp_path_factory, result):
    path = tmp_path_factory.mktemp("usd") / "scene.usdc"
    write_usd(result, path)
    return path


def _primvar(stage, name):
    return UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/Scene/Body/Skin")).GetPrimvar(name)


def test_validators_find_nothing(written):
    assert validate_usd(written) == []


def test_stage_metadata(written):
    stage = Usd.Stage.Open(str(written))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetTimeCodesPerSecond() == 30.0
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 499)
    assert stage.GetPrimAtPath("/Scene/Array").IsA(UsdGeom.PointInstancer)


@pytest.mark.parametrize("name", ["arp", "normal_displacement"])
def test_values_read_back_within_the_stated_bound(written, result, name):
    stage = Usd.Stage.Open(str(written))
    primvar = _primvar(stage, name)
    bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
    exact = result[name].values.astype(float)
    read = np.array([primvar.Get(code) for code in range(500)], dtype=float)
    error = np.abs(read - exact).max()
    # Half of 1/1000 of the maximum, and the bound is no looser than rounding makes it.
    assert bound == pytest.approx(0.0005 * np.abs(exact).max(), rel=1e-3)
    assert 0.9 * bound < error <= bound


@given(arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False)))
def test_rounding_keeps_its_bound_and_few_levels(values):
    rounded, _, bound = quantise(values)
    assert np.abs(rounded.astype(float) - values.astype(float)).max() <= bound
    assert len(np.unique(rounded)) <= 2001


def test_the_body_moves_the_skin_as_the_result_says(tmp_path, static_arrays, block_arrays):
    blocks = block_arrays(0, 20)
    turn = np.linspace(0.0, 0.4, 20)
    blocks["body_pose"][:, 3], blocks["body_pose"][:, 4] = np.cos(turn), np.sin(turn)
    blocks["body_pose"][:, 0] = np.linspace(0.0, 0.05, 20)
    ds = dataset(**static_arrays, **blocks)
    write_usd(ds, tmp_path / "s.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    rest = ds["skin_position"].values[:5]
    clock = stage.GetDefaultPrim().GetAttribute("palmfield:time_s")
    for code in (0, 7, 19):
        matrix = UsdGeom.Xformable(stage.GetPrimAtPath("/Scene/Body/Skin")).ComputeLocalToWorldTransform(code)
        moved = np.column_stack([rest, np.ones(5)]) @ np.array(matrix)
        np.testing.assert_allclose(moved[:, :3], to_world(rest, blocks["body_pose"][code]), atol=1e-12)
        assert clock.Get(code) == blocks["time"][code]


def test_long_runs_are_thinned_and_say_so(tmp_path, static_arrays, block_arrays):
    ds = dataset(**static_arrays, **block_arrays(0, 1300))
    write_usd(ds, tmp_path / "s.usdc", fps=24.0)
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    said = stage.GetRootLayer().customLayerData["palmfield"]
    frames = _primvar(stage, "arp").GetTimeSamples()
    assert (said["stride"], len(frames)) == (3, 434)
    assert len(frames) <= MOST_FRAMES
    assert said["seconds_per_time_code"] == pytest.approx(6e-4)
    assert said["slow_motion_factor"] == pytest.approx(1.0 / (6e-4 * 24.0))
    assert validate_usd(tmp_path / "s.usdc") == []


def test_no_display_colour_over_time(written):
    stage = Usd.Stage.Open(str(written))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Gprim):
            assert UsdGeom.Gprim(prim).GetDisplayColorAttr().GetNumTimeSamples() == 0


def test_a_run_without_steps_is_a_still(tmp_path, static):
    write_usd(static, tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    assert not Usd.Stage.Open(str(tmp_path / "s.usdc")).HasAuthoredTimeCodeRange()


def _break_index(stage):
    attr = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Body/Skin")).GetFaceVertexIndicesAttr()
    indices = np.array(attr.Get())
    indices[0] = 10_000
    attr.Set(Vt.IntArray.FromNumpy(indices))


def _break_primvar(stage):
    _primvar(stage, "arp").Set(Vt.FloatArray([1.0, 2.0]), 3)


def _break_metadata(stage):
    stage.ClearMetadata("defaultPrim")


def _break_counts(stage):
    UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Body/Skin")).GetFaceVertexCountsAttr().Set(Vt.IntArray([3]))


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (_break_index, "/Scene/Body/Skin: face index 0..10000 outside 0..468"),
        (_break_primvar, "primvar arp has 2 values at 3.0, not 469"),
        (_break_metadata, "defaultPrim"),
        (_break_counts, "/Scene/Body/Skin"),
    ],
)
def test_the_validation_finds_what_is_broken(tmp_path, written, break_it, words):
    layer = Sdf.Layer.FindOrOpen(str(written))
    layer.Export(str(tmp_path / "broken.usdc"))
    stage = Usd.Stage.Open(str(tmp_path / "broken.usdc"))
    break_it(stage)
    stage.Save()
    found = validate_usd(tmp_path / "broken.usdc")
    assert any(words in line for line in found), found


def test_bad_names_and_places(tmp_path, static):
    with pytest.raises(OutputError, match=r"ends in \.usdc"):
        write_usd(static, tmp_path / "scene.usda")
    with pytest.raises(OutputError, match="above 0"):
        write_usd(static, tmp_path / "scene.usdc", fps=0.0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Not a directory; choose"):
        write_usd(static, tmp_path / "file" / "scene.usdc")
    with pytest.raises(OutputError, match="cannot be opened as USD"):
        validate_usd(tmp_path / "missing.usdc")


def test_an_old_scene_stays_until_the_new_one_is_whole(tmp_path, static, result, monkeypatch):
    path = tmp_path / "scene.usdc"
    write_usd(static, path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_usd(result, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["scene.usdc"]
