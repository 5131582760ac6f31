"""A USD scene of the synthetic run: what is in it, and that it reads back as the result says."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom, UsdLux, UsdShade, UsdSkel, Vt

from palmfield.errors import OutputError
from palmfield.outputs.frames import to_world
from palmfield.outputs.motion import normal_component
from palmfield.outputs.schema import instances, tree
from palmfield.outputs.store import Store, open_result
from palmfield.outputs.usd import validate_usd, write_usd
from palmfield.outputs.usd.bodies import identifiers

PALM = "/Scene/Bodies/hand/Skins/palm"


@pytest.fixture(scope="module")
def written(tmp_path_factory, result):
    path = tmp_path_factory.mktemp("usd") / "scene.usdc"
    write_usd(result, path)
    return path


def _primvar(stage, name, place=PALM):
    return UsdGeom.PrimvarsAPI(stage.GetPrimAtPath(place)).GetPrimvar(name)


def _as_stored(stage, values, place=PALM):
    """Values by vertex of a skin, in the order of the result."""
    out = np.empty(len(values))
    out[np.array(_primvar(stage, "vertex_number", place).Get())] = values
    return out


def test_validators_find_nothing(written):
    assert validate_usd(written) == []


def test_stage_metadata(written):
    stage = Usd.Stage.Open(str(written))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert stage.GetFramesPerSecond() == 30.0
    assert stage.GetDefaultPrim().GetPath() == "/Scene"
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 499)


def test_time_codes_give_seconds(written, result):
    stage = Usd.Stage.Open(str(written))
    times = np.arange(500) / stage.GetTimeCodesPerSecond()
    np.testing.assert_allclose(times, result.coords["time"].values, atol=1e-12)
    clock = stage.GetDefaultPrim().GetAttribute("palmfield:time_s")
    assert [clock.Get(code) for code in (0, 123, 499)] == pytest.approx(times[[0, 123, 499]].tolist(), abs=1e-12)


def test_every_instance_has_a_prim_of_its_name(written):
    stage = Usd.Stage.Open(str(written))
    kinds = {
        "/Scene/Arrays/below": UsdGeom.Xform,
        "/Scene/Arrays/beside/Transducers": UsdGeom.PointInstancer,
        "/Scene/Arrays/beside/Drive": UsdGeom.Mesh,
        "/Scene/Stimuli/pulse/Foci": UsdGeom.BasisCurves,
        "/Scene/Cameras/Main": UsdGeom.Camera,
        "/Scene/Legend/Labels": UsdGeom.Mesh,
        "/Scene/MuJoCo/Bodies/hand": UsdGeom.Xform,
        "/Scene/Bodies/hand": UsdGeom.Xform,
        "/Scene/Bodies/hand/Surface": UsdGeom.Mesh,
        PALM: UsdGeom.Mesh,
        "/Scene/Bodies/finger": UsdSkel.Root,
        "/Scene/Bodies/finger/Skeleton": UsdSkel.Skeleton,
        "/Scene/Bodies/finger/Skins/tip": UsdGeom.Mesh,
    }
    for path, kind in kinds.items():
        assert stage.GetPrimAtPath(path).IsA(kind), path


@pytest.mark.parametrize(("body", "name"), [("hand", "palm"), ("finger", "tip")])
@pytest.mark.parametrize("variable", ["arp", "pressure", "normal_displacement", "normal_velocity"])
def test_values_read_back_within_the_stated_bound(written, result, body, name, variable):
    stage, place = Usd.Stage.Open(str(written)), f"/Scene/Bodies/{body}/Skins/{name}"
    primvar = _primvar(stage, variable, place)
    bound = primvar.GetAttr().GetCustomDataByKey("palmfield:error_bound")
    step = primvar.GetAttr().GetCustomDataByKey("palmfield:quantisation_step")
    skin = instances(result, "skin")[name]
    kind = variable.removeprefix("normal_")
    exact = (normal_component(skin, kind) if "normal" in variable else skin[variable]).values.astype(float)
    read = np.array([_as_stored(stage, primvar.Get(code), place) for code in range(500)])
    error = np.abs(read - exact).max()
    # Within 1/255 of the range, and the bound is no looser than rounding makes it
    assert bound == pytest.approx(np.ptp(exact) / (255 if variable == "arp" else 256), rel=1e-3)
    assert 0.5 * bound < error <= bound
    np.testing.assert_allclose(read, np.rint(read / step) * step, atol=1e-3 * step)


def test_a_push_is_negative_and_pressure_pushes(written):
    """From the file alone: where the sound presses the skin goes against its outward normal."""
    stage = Usd.Stage.Open(str(written))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PALM))
    points = np.array(mesh.GetPointsAttr().Get(), float)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    normal = np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]).sum(axis=0)
    assert normal[2] < 0.0  # the palm looks down, to the array
    pressed = np.mean([np.array(_primvar(stage, "arp").Get(code)) for code in range(25)], axis=0)
    moved = np.mean([np.array(_primvar(stage, "normal_displacement").Get(code)) for code in range(25)], axis=0)
    assert pressed.min() >= 0.0 and pressed.argmax() == moved.argmin() and moved.min() < 0.0


def test_the_sum_of_radiation_pressure_over_areas_stays(written, result):
    """In every frame as of the result, to a step on one vertex, though most places are pressed by less than a step."""
    stage = Usd.Stage.Open(str(written))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath(PALM))
    points = np.array(mesh.GetPointsAttr().Get(), float)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    skin = instances(result, "skin")["palm"]
    step = _primvar(stage, "arp").GetAttr().GetCustomDataByKey("palmfield:quantisation_step")
    vertex_m2 = 0.03**2 * np.pi / len(points)

    def force(points, faces, values):
        edges = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
        return float((0.5 * np.linalg.norm(np.cross(*edges), axis=1) * values[faces].mean(axis=1)).sum())

    for code in range(0, 500, 7):
        own = force(points, faces, np.array(_primvar(stage, "arp").Get(code), float))
        exact = force(skin["rest_position"].values, skin["face"].values, skin["arp"].values[code].astype(float))
        assert own == pytest.approx(exact, rel=1e-6, abs=1.5 * step * vertex_m2), code
    assert exact > 100 * step * vertex_m2


def test_the_surface_holds_the_loudest_instant(written, whole):
    stage = Usd.Stage.Open(str(written))
    for name in ("loudest_arp", "loudest_pressure"):
        values = np.array(_primvar(stage, name, "/Scene/Bodies/hand/Surface").Get())
        np.testing.assert_array_equal(values, whole["/surface/palm"][name])


def test_the_force_is_what_presses_the_faces(written, whole):
    """From the file alone: ARP times area over the surface in each frame is what the result's faces add up to."""
    stage = Usd.Stage.Open(str(written))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Bodies/hand/Surface"))
    points = np.array(mesh.GetPointsAttr().Get(), float)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    area = 0.5 * np.cross(points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]])
    force = -(np.array(_primvar(stage, "arp", mesh.GetPath()).Get(3), float)[:, None] * area).sum(axis=0)
    exact = -(whole["/surface/palm"]["face_arp"][3][:, None] * area).sum(axis=0)
    assert np.linalg.norm(force - exact) < 1e-3 * np.linalg.norm(exact)
    attribute = stage.GetPrimAtPath("/Scene/Bodies/hand").GetAttribute("palmfield:force")
    assert list(attribute.Get(7)) == [0.0, 0.0, 0.003] and attribute.GetNumTimeSamples() == 0


def test_a_file_opened_lazily_gives_the_same(tmp_path, static_arrays, block_arrays, attributes, merge):
    store = Store(tmp_path, static_arrays, attributes)
    store.append(block_arrays(0, 30))
    with open_result(store.finish({}, True)) as result:
        write_usd(result, tmp_path / "scene.usdc")
    write_usd(tree(merge(static_arrays, block_arrays(0, 30)), attributes), tmp_path / "other.usdc")
    texts = [Sdf.Layer.FindOrOpen(str(tmp_path / f"{name}.usdc")).ExportToString() for name in ("scene", "other")]
    assert texts[0] == texts[1]


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
    for code in (0, 7, 19):
        for place, path in ((PALM, "/body/palm"), ("/Scene/Arrays/beside", "/array/beside")):
            matrix = UsdGeom.Xformable(stage.GetPrimAtPath(place)).ComputeLocalToWorldTransform(code)
            moved = np.column_stack([rest, np.ones(5)]) @ np.array(matrix)
            np.testing.assert_allclose(moved[:, :3], to_world(rest, blocks[path]["pose"][code]), atol=1e-12)
    # What stands still has no time samples.
    still = UsdGeom.Xformable(stage.GetPrimAtPath("/Scene/Arrays/below"))
    assert not still.TransformMightBeTimeVarying()


def test_bones_move_the_bound_meshes(written, whole):
    stage = Usd.Stage.Open(str(written))
    root = UsdSkel.Root(stage.GetPrimAtPath("/Scene/Bodies/finger"))
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.PrimDefaultPredicate)
    binding = cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate)[0]
    assert len(binding.GetSkinningTargets()) == 3
    query = cache.GetSkelQuery(binding.GetSkeleton())
    assert list(query.GetJointOrder()) == ["proximal", "distal"]
    order = np.array(_primvar(stage, "vertex_number", "/Scene/Bodies/finger/Skins/tip").Get())
    rest = whole["/skin/tip"]["rest_position"][order]
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
    meshes = [str(p.GetPath()) for p in stage.Traverse() if p.IsA(UsdGeom.Mesh) and "Scene/Bodies" in str(p.GetPath())]
    assert meshes == [f"/Scene/Bodies/hand/{name}" for name in ("Surface", "Drawn", "Skins/palm", "Skins/second")]


def test_it_is_lit_and_shaded_alike_in_every_renderer(written):
    stage = Usd.Stage.Open(str(written))
    dome = UsdLux.DomeLight(stage.GetPrimAtPath("/Scene/Lights/Dome"))
    key = UsdLux.DistantLight(stage.GetPrimAtPath("/Scene/Lights/Key"))
    # Blender takes a dome without a written colour for none; a lamp that is not normalised is darker by its solid angle
    assert dome.GetColorAttr().HasAuthoredValue() and key.GetColorAttr().HasAuthoredValue()
    assert key.GetNormalizeAttr().Get() is True
    assert stage.GetFramesPerSecond() == 30.0
    for place in ("/Scene/Bodies/hand/Drawn", "/Scene/Bodies/hand/Skins/palm"):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(place))
        normals, points = np.array(mesh.GetNormalsAttr().Get()), np.array(mesh.GetPointsAttr().Get())
        assert mesh.GetNormalsInterpolation() == "vertex" and normals.shape == points.shape
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)


def test_skin_at_rest_has_its_bodys_colour(written):
    stage = Usd.Stage.Open(str(written))
    body = _primvar(stage, "displayColor", "/Scene/Bodies/hand/Drawn").Get()[0]
    colours = np.array(_primvar(stage, "displayColor", "/Scene/Bodies/hand/Skins/palm").Get())
    np.testing.assert_allclose(body, colours[127:129].mean(axis=0), atol=0.02)


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
    assert (said["stride"], stage.GetEndTimeCode()) == (3, 433)
    assert stage.GetEndTimeCode() / stage.GetTimeCodesPerSecond() == pytest.approx(433 * 6e-4)
    read = _as_stored(stage, _primvar(stage, "arp").Get(100))
    np.testing.assert_allclose(read, long["/skin/palm"]["arp"][300], atol=0.13)
    assert validate_usd(tmp_path / "s.usdc") == []


def test_colours_are_a_palette_with_numbers_over_time(written, result):
    """What any viewer shows, in one palette whose ends are the legend's."""
    stage = Usd.Stage.Open(str(written))
    legend = stage.GetPrimAtPath("/Scene/Legend")
    low, high = (legend.GetCustomDataByKey(f"palmfield:{end}") for end in ("low", "high"))
    assert legend.GetCustomDataByKey("palmfield:quantity") == "normal_displacement"
    largest = max(float(np.abs(normal_component(skin).values).max()) for skin in instances(result, "skin").values())
    assert high == pytest.approx(largest, rel=1e-6) and low == -high
    bar = _primvar(stage, "displayColor", "/Scene/Legend/Bar")
    for body, name in (("hand", "palm"), ("finger", "tip")):
        place = f"/Scene/Bodies/{body}/Skins/{name}"
        colour = _primvar(stage, "displayColor", place)
        assert colour.GetAttr().GetNumTimeSamples() == 0 and colour.GetInterpolation() == "vertex"
        assert colour.GetAttr().GetCustomDataByKey("palmfield:low") == low
        assert colour.GetAttr().GetCustomDataByKey("palmfield:high") == high
        assert list(colour.Get()) == list(bar.Get()) and len(colour.Get()) == 256
        assert colour.GetIndicesAttr().GetNumTimeSamples() > 400
        exact = normal_component(instances(result, "skin")[name]).values
        for code in (0, 12, 300):
            numbers = _as_stored(stage, colour.GetIndices(code), place)
            np.testing.assert_allclose(low + numbers / 255 * (high - low), exact[code], atol=0.51 / 255 * (high - low))
    ticks = np.array(legend.GetCustomDataByKey("palmfield:ticks"))
    assert len(ticks) >= 3 and (ticks >= low).all() and (ticks <= high).all()
    np.testing.assert_allclose(np.array(legend.GetCustomDataByKey("palmfield:shown_ticks")), 1e6 * ticks, rtol=1e-9)


def test_the_material_reads_the_colours(written):
    stage = Usd.Stage.Open(str(written))
    material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(PALM)).ComputeBoundMaterial()
    surface = material.ComputeSurfaceSource()[0]
    reader = surface.GetInput("diffuseColor").GetConnectedSource()[0]
    assert surface.GetIdAttr().Get() == "UsdPreviewSurface"
    assert UsdShade.Shader(reader.GetPrim()).GetInput("varname").Get() == "displayColor"


def test_magnified_points_are_a_variant(written, result):
    stage = Usd.Stage.Open(str(written))
    prim = stage.GetPrimAtPath(PALM)
    mesh, skin = UsdGeom.Mesh(prim), instances(result, "skin")["palm"]
    factor = prim.GetCustomDataByKey("palmfield:magnification")
    order = np.array(_primvar(stage, "vertex_number").Get())
    rest = skin["rest_position"].values[order]
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(9)), rest, atol=1e-8)
    prim.GetVariantSets().GetVariantSet("motion").SetVariantSelection("magnified")
    push = normal_component(skin).values[9].astype(float)
    moved = rest + factor * (push[:, None] * skin["rest_normal"].values)[order]
    np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(9)), moved, atol=1e-8)
    largest = np.abs(normal_component(skin).values).max()
    assert 0.8e-3 < factor * largest <= 2e-3


def test_transducers_are_where_the_scene_has_them(written, whole):
    stage = Usd.Stage.Open(str(written))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Scene/Arrays/beside/Transducers"))
    matrix = np.array(UsdGeom.Xformable(instancer).ComputeLocalToWorldTransform(5))
    local = np.array(instancer.GetPositionsAttr().Get(), float)
    places = local @ matrix[:3, :3] + matrix[3, :3]
    exact = to_world(whole["/array/beside"]["transducer_position"], whole["/array/beside"]["pose"][5])
    np.testing.assert_allclose(places, exact, atol=1e-8)


def test_drives_change_when_they_do(tmp_path, static_arrays, block_arrays, merge, attributes):
    blocks = block_arrays(0, 20)
    for name, count in (("below", 256), ("beside", 64)):
        group = dict(blocks[f"/array/{name}"])
        group["drive_phase"] = np.zeros((3, count), np.float32)
        group["drive_phase"][1] = np.linspace(-3.0, 3.0, count)
        group["drive_amplitude"] = np.ones((3, count), np.float32)
        group["drive_amplitude"][2] = 0.0
        blocks[f"/array/{name}"] = group
    blocks["/"] = blocks["/"] | {"frame_time": np.array([0.0, 1e-3, 2.1e-3])}
    write_usd(tree(merge(static_arrays, blocks), attributes), tmp_path / "s.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    phase = _primvar(stage, "drive_phase", "/Scene/Arrays/beside/Transducers")
    size = _primvar(stage, "drive_amplitude", "/Scene/Arrays/beside/Transducers")
    colour = _primvar(stage, "displayColor", "/Scene/Arrays/beside/Drive")
    # From 1 ms on, which is code 5; silent from 2.1 ms on, which comes after code 10
    assert phase.GetTimeSamples() == [0.0, 4.0, 5.0, 10.0, 11.0]
    assert np.ptp(np.array(phase.Get(4))) == 0.0 and np.ptp(np.array(phase.Get(4.9))) > 0.0
    told = np.mod(np.linspace(-3.0, 3.0, 64), 2 * np.pi)
    np.testing.assert_allclose(np.array(phase.Get(5)), told, atol=2 * np.pi / 255 * 1.001)
    assert (np.array(size.Get(10)) == 1.0).all() and (np.array(size.Get(11)) == 0.0).all()
    assert set(colour.GetIndices(11)) == {256} and len(colour.GetIndices(11)) == 128


def test_foci_and_their_ways(tmp_path, static_arrays, block_arrays, merge, attributes):
    blocks = block_arrays(0, 20)
    way = np.column_stack([np.linspace(0.0, 0.03, 20), np.zeros(20), np.full(20, 0.15)])
    sounds = np.arange(20) >= 10
    blocks["/stimulus/pulse"] = {"foci": way[:, None], "sounding": sounds}
    write_usd(tree(merge(static_arrays, blocks), attributes), tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    crosses = UsdGeom.BasisCurves(stage.GetPrimAtPath("/Scene/Stimuli/pulse/Foci"))
    foci = stage.GetPrimAtPath("/Scene/Stimuli/pulse").GetAttribute("palmfield:foci")
    for code in (0, 7, 19):
        np.testing.assert_allclose(np.array(foci.Get(code)), way[code][None], atol=1e-12)
        np.testing.assert_allclose(np.array(crosses.GetPointsAttr().Get(code)).mean(axis=0), way[code], atol=1e-8)
        assert (crosses.GetVisibilityAttr().Get(code) == "inherited") == sounds[code]
    path = UsdGeom.BasisCurves(stage.GetPrimAtPath("/Scene/Stimuli/pulse/Path"))
    np.testing.assert_allclose(np.array(path.GetPointsAttr().Get()), way, atol=1e-8)
    # Foci that rest have no way
    assert stage.GetPrimAtPath("/Scene/Stimuli/pair/Foci") and not stage.GetPrimAtPath("/Scene/Stimuli/pair/Path")


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


def _break_number(stage):
    numbers = _primvar(stage, "displayColor").GetIndicesAttr()
    numbers.Set(Vt.IntArray([300] * 469), 3)


def _break_metadata(stage):
    stage.ClearMetadata("defaultPrim")


def _break_counts(stage):
    UsdGeom.Mesh(stage.GetPrimAtPath(PALM)).GetFaceVertexCountsAttr().Set(Vt.IntArray([3]))


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (_break_index, f"{PALM}: face index 0..10000 outside 0..468"),
        (_break_primvar, "primvar arp has 2 values at 3.0, not 469"),
        (_break_number, "primvar displayColor has index 300..300 at 3.0, outside 0..255"),
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
    with pytest.raises(OutputError, match=r"ends in \.usdc, \.usda, \.usdz"):
        write_usd(still, tmp_path / "scene.obj")
    with pytest.raises(OutputError, match="above 0"):
        write_usd(still, tmp_path / "scene.usdc", fps=0.0)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="Not a directory; choose"):
        write_usd(still, tmp_path / "file" / "scene.usdc")
    with pytest.raises(OutputError, match="cannot be opened as USD"):
        validate_usd(tmp_path / "missing.usdc")


def test_tilted_transducers_face_where_they_do(tmp_path, static_arrays, block_arrays, merge, attributes):
    """Cases of the instancer and discs before them, one of which looks straight back."""
    static = dict(static_arrays)
    directions = np.tile([0.6, 0.0, 0.8], (64, 1))
    directions[5] = [0.0, 0.0, -1.0]
    static["/array/beside"] = static["/array/beside"] | {"transducer_direction": directions}
    write_usd(tree(merge(static, block_arrays(0, 3)), attributes), tmp_path / "s.usdc")
    assert validate_usd(tmp_path / "s.usdc") == []
    stage = Usd.Stage.Open(str(tmp_path / "s.usdc"))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/Scene/Arrays/beside/Transducers"))
    for number, matrix in enumerate(instancer.ComputeInstanceTransformsAtTime(0, 0)):
        np.testing.assert_allclose(np.array(matrix)[2, :3], directions[number], atol=2e-3)
    discs = np.array(UsdGeom.Mesh(stage.GetPrimAtPath("/Scene/Arrays/beside/Drive")).GetPointsAttr().Get(), float)
    ring = discs.reshape(2, 64, -1, 3)[0]
    np.testing.assert_allclose(
        np.einsum("ncj,nj->nc", ring - ring.mean(axis=1, keepdims=True), directions), 0, atol=1e-8
    )
