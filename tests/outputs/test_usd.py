import os

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from palmfield.outputs.usd.skeleton import identifiers
from pxr import Sdf, Usd, UsdGeom, UsdSkel, Vt

from palmfield.errors import OutputError
from palmfield.outputs.frames import to_world
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances, tree
from palmfield.outputs.store import Store, open_result
from palmfield.outputs.usd import validate_usd, write_usd

PALM = "/Scene/Bodies/hand/Skins/palm"


@pytest.fixture(scope="module")
def written(tmp_path_factory, result):
    path = tmp_path_factory.mktemp("usd") / "scene.usdc"
    write_usd(result, path)
    return path


def _primvar(stage, name, place=PALM):
    return UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(place)).GetPrimvar(name)


def test_validators_find_nothing(written):
    assert validate_usd(written) == []


def test_stage_metadata(written):
    stage = Usd.Stage.Open(str(written))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetTimeCodesPerSecond() == 30.0
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 499)


def test_every_instance_has_a_prim_of_its_name(written):
    stage = Usd.Stage.Open(str(written))
    kinds = {
        "/Scene/Arrays/below": UsdGeom.PointInstancer,
        "/Scene/Arrays/beside": UsdGeom.PointInstancer,
        "/Scene/Bodies/hand": UsdGeom.Xform,
        "/Scene/Bodies/hand/Surface": UsdGeom.Mesh,
        PALM: UsdGeom.Mesh,
        "/Scene/Bodies/finger": UsdSkel.Root,
        "/Scene/Bodies/finger/Skeleton": UsdSkel.Skeleton,
        "/Scene/Bodies/finger/Skins/tip": UsdGeom.Mesh,
    }
    for path, kind in kinds.items():
        assert stage.GetPrimAtPath(path).IsA(kind), path
    assert len(UsdGeom.PointInstancer(stage.GetPrimAtPath("/Scene/Arrays/beside")).GetPositionsAttr().Get()) == 64


@pytest.mark.parametrize(("body", "name"), [("hand", "palm"), ("finger", "tip")])
@pytest.mark.parametrize("variable", ["arp", "normal_displacement"])
def test_values_read_back_within_the_stated_bound(written, result, body, name, variable):
    stage = Usd.Stage.Open(str(written))
    primvar = _primvar(stage, variable, f"/Scene/Bodies/{body}/Skins/{name}")
    bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
    skin = instances(result, "skin")[name]
    exact = (skin["arp"] if variable == "arp" else normal_component(skin)).values.astype(float)
    read = np.array([primvar.Get(code) for code in range(500)], dtype=float)
    error = np.abs(read - exact).max()
    # Half of 1/1000 of the maximum, and the bound is no looser than rounding makes it.
    assert bound == pytest.approx(0.0005 * np.abs(exact).max(), rel=1e-3)
    assert 0.9 * bound < error <= bound


def test_the_surface_holds_the_loudest_instant(written, whole):
    stage = Usd.Stage.Open(str(written))
    for name in ("loudest_arp", "loudest_pressure"):
        values = np.array(_primvar(stage, name, "/Scene/Bodies/hand/Surface").Get())
        np.testing.assert_array_equal(values, whole["/surface/palm"][name])


def test_a_file_opened_lazily_gives_the_same(tmp_path, static_arrays, block_arrays, attributes, merge):
    store = Store(tmp_path, static_arrays, attributes)
    store.append(block_arrays(0, 30))
    with open_result(store.finish({}, True)) as result:
        write_usd(result, tmp_path / "scene.usdc")
    write_usd(tree(merge(static_arrays, block_arrays(0, 30)), attributes), tmp_path / "other.usdc")
    texts = [Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usdc")).ExportToString() for name in ("scene", "other")]
    assert texts[0] == texts[1]


@given(arrays(np.float32, st.integers(1, 50), elements=st.floats(-1e6, 1e6, width=32, allow_subnormal=False)))
def test_rounding_keeps_its_bound_and_few_levels(values):
    rounded, _, bound = quantise(values)
    assert np.abs(rounded.astype(float) - values.astype(float)).max() <= bound
    assert len(np.unique(rounded)) <= 2001


def test_bodies_and_arrays_move_as_the_result_says(tmp_path, static_arrays, block_arrays, merge, attributes):
    blocks = block_arrays(0, 20)
    turn = np.linspace(0.0, 0.4, 20)
    for path, along in (("/body/palm", 0.05), ("/array/beside", -0.02)):
        pose = blocks[path]["pose"].copy()
        pose[:, 3], pose[:, 4] = np.cos(turn), np.sin(turn)
        pose[:, 0] = np.linspace(0.0, along, 20)
        blocks[path] = blocks[path] | {"pose": pose}
    write_usd(tree(merge(static_arrays, blocks), attributes), tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    rest = static_arrays["/skin/palm"]["rest_position"][:5]
    clock = stage.GetDefaultPrim().GetAttribute("palmfield:time_s")
    for code in (0, 7, 19):
        for place, path in ((PALM, "/body/palm"), ("/Scene/Arrays/beside", "/array/beside")):
            matrix = UsdGeom.Xformable(stage.GetPrimAtPath(place)).ComputeLocalToWorldTransform(code)
            moved = np.column_stack([rest, np.ones(5)]) @ np.array(matrix)
            np.testing.assert_allclose(moved[:, :3], to_world(rest, blocks[path]["pose"][code]), atol=1e-12)
        assert clock.Get(code) == blocks["/"]["time"][code]
    # What stands still has no time samples.
    still = UsdGeom.Xformable(stage.GetPrimAtPath("/Scene/Arrays/below"))
    assert not still.TransformMightBeTimeVarying()


def test_bones_move_the_bound_meshes(written, whole):
    stage = Usd.Stage.Open(str(written))
    root = UsdSkel.Root(stage.GetPrimAtPath("/Scene/Bodies/finger"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    binding = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)[0]
    assert len(binding.GetSkinningTargets()) == 2
    query = cache.GetSkelQuery(binding.GetSkeleton())
    assert list(query.GetJointOrder()) == ["proximal", "distal"]
    rest = whole["/skin/tip"]["rest_position"]
    skin = next(t for t in binding.GetSkinningTargets() if t.GetPrim().GetName() == "tip")
    points = Vt.Vec3fArray.FromNumpy(rest.astype(np.float32))
    assert skin.ComputeSkinnedPoints(query.ComputeSkinningTransforms(250), points, 250)
    moved = rest + np.array([0.0, 0.0, 0.25 * whole["/body/tip"]["bone_pose"][250, 1, 2]])
    np.testing.assert_allclose(np.array(points), moved, atol=1e-6)


def test_skins_on_one_body_share_it(tmp_path, whole, keep):
    one = keep(whole, ("palm",), ("below",), ())
    both = one | {path.replace("palm", "second"): v for path, v in one.items() if path.endswith("palm")}
    write_usd(tree(both, {f"/body/{n}": {"body": "hand"} for n in ("palm", "second")}), tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    meshes = [str(p.GetPath()) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh) and "Bodies" in str(p.GetPath())]
    assert meshes == [f"/Scene/Bodies/hand/{name}" for name in ("Surface", "Skins/palm", "Skins/second")]


def test_names_that_usd_does_not_allow(tmp_path, whole, keep):
    assert identifiers(["a b", "a/b", "a_b", "1", "x"]) == {
        "a b": "a_b", "a/b": "a_b_1", "a_b": "a_b_2", "1": "_1", "x": "x"}  # fmt: skip
    one = keep(whole, ("palm",), ("below",), ())
    renamed = {path.replace("palm", "left%2Fpalm 1").replace("below", "1st"): v for path, v in one.items()}
    write_usd(tree(renamed), tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    assert stage.GetPrimAtPath("/Scene/Bodies/left_palm_1/Skins/left_palm_1") and stage.GetPrimAtPath(
        "/Scene/Arrays/_1st"
    )


def test_long_runs_are_thinned_and_say_so(tmp_path, static_arrays, block_arrays, merge, keep):
    long = keep(merge(static_arrays, block_arrays(0, 1300)), ("palm",), ("below",), ())
    write_usd(tree(long, {"/body/palm": {"body": "hand"}}), tmp_path / "s.usdc", fps=24.0)
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    said = stage.GetRootLayer().customLayerData["palmfield"]
    frames = _primvar(stage, "arp").GetTimeSamples()
    assert (said["stride"], len(frames)) == (3, 434)
    assert len(frames) <= MOST_FRAMES
    assert said["seconds_per_time_code"] == pytest.approx(6e-4)
    assert said["slow_motion_factor"] == pytest.approx(1.0 / (6e-4 * 24.0))
    read = np.array(_primvar(stage, "arp").Get(100))
    np.testing.assert_allclose(read, long["/skin/palm"]["arp"][300], atol=0.02)
    assert validate_usd(tmp_path / "s.usdc") == []


def test_no_display_colour_over_time(written):
    stage = Usd.Stage.Open(str(written))
    for prim in stage.Traverse():
        if prim.IsA(UsdGeom.Gprim):
            assert UsdGeom.Gprim(prim).GetDisplayColorAttr().GetNumTimeSamples() == 0


def test_a_run_without_steps_is_a_still(tmp_path, still):
    write_usd(still, tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    assert not Usd.Stage.Open(str(tmp_path / "s.usdc")).HasAuthoredTimeCodeRange()


def _break_index(stage):
    attr = UsdGeom.Mesh(stage.GetPrimAtPath(PALM)).GetFaceVertexIndicesAttr()
    indices = np.array(attr.Get())
    indices[0] = 10_000
    attr.Set(Vt.IntArray.FromNumpy(indices))


def _break_primvar(stage):
    _primvar(stage, "arp").Set(Vt.FloatArray([1.0, 2.0]), 3)


def _break_metadata(stage):
    stage.ClearMetadata("defaultPrim")


def _break_counts(stage):
    UsdGeom.Mesh(stage.GetPrimAtPath(PALM)).GetFaceVertexCountsAttr().Set(Vt.IntArray([3]))


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (_break_index, f"{PALM}: face index 0..10000 outside 0..468"),
        (_break_primvar, "primvar arp has 2 values at 3.0, not 469"),
        (_break_metadata, "defaultPrim"),
        (_break_counts, PALM),
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


def test_bad_names_and_places(tmp_path, still):
    with pytest.raises(OutputError, match=r"ends in \.usdc"):
        write_usd(still, tmp_path / "scene.usda")
    with pytest.raises(OutputError, match="above 0"):
        write_usd(still, tmp_path / "scene.usdc", fps=0.0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Not a directory; choose"):
        write_usd(still, tmp_path / "file" / "scene.usdc")
    with pytest.raises(OutputError, match="cannot be opened as USD"):
        validate_usd(tmp_path / "missing.usdc")


def test_an_old_scene_stays_until_the_new_one_is_whole(tmp_path, still, result, monkeypatch):
    path = tmp_path / "scene.usdc"
    write_usd(still, path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(OutputError, match="No space left on device"):
        write_usd(result, path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["scene.usdc"]
