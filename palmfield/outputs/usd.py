"""The run as a USD scene: arrays, moving bodies, and each skin's ARP and displacement as primvars over time."""

import os
import re
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import xarray as xr
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdSkel, UsdValidation, Vt
from scipy.spatial import cKDTree

from palmfield.errors import OutputError
from palmfield.outputs.frames import bodies, poses_at
from palmfield.outputs.motion import normal_pieces, pieces
from palmfield.outputs.schema import has_records, instances
from palmfield.outputs.usdskel import add_skeleton, bind, identifiers
from palmfield.types import Float

MOST_FRAMES = 600
SAVE_EVERY = 50
LEVELS = 1000
SKIN_PRIMVARS: dict[str, tuple[str, Any, str]] = {
    "arp": ("arp", pieces, "Pa"),
    "normal_displacement": ("displacement", normal_pieces, "m"),
}
"""Variable of the result, how it is read, and units, by primvar."""
SKIN_COLOUR = (0.86, 0.66, 0.55)
PATCH_COLOUR = (0.80, 0.50, 0.42)
CASE_COLOUR = (0.62, 0.64, 0.67)


def write_usd(result: xr.DataTree, path: Path, fps: float = 30.0) -> None:
    """USD crate of a result: a slow-motion film, one stored frame a time code, at most 600 frames.

    result: of `open_result` or `tree`; path: name of the .usdc file; fps: time codes per second [1/s]
    /Scene/Arrays/NAME is a point instancer that moves as the array did. /Scene/Bodies/NAME moves as the body did, with
    the bones of an articulated hand as a UsdSkel skeleton; under it, Surface has the primvars loudest_arp and
    loudest_pressure [Pa], and Skins/NAME has arp [Pa] and normal_displacement [m] by vertex over time, each rounded to
    1/1000 of its largest magnitude: the primvar's customData holds that step and the error bound. The vertices stay at
    rest. The root layer's customLayerData says how time codes map to seconds (start_s + code * seconds_per_time_code).
    Raises OutputError where `path` cannot be written or does not end in .usdc, and for an fps that is not positive.
    """
    path = Path(path)
    if path.suffix != ".usdc":
        raise OutputError(f"cannot write {path}: the scene is a USD crate; name a file that ends in .usdc")
    if not fps > 0:
        raise OutputError(f"{fps} frames per second is not possible; give a number above 0")
    temporary = path.with_name(f".{path.stem}.tmp.usdc")
    try:
        temporary.unlink(missing_ok=True)
        temporary.touch()
        temporary.unlink()
        _write(result, temporary, fps)
        os.replace(temporary, path)
    except (OSError, Tf.ErrorException) as error:
        raise OutputError(
            f"cannot write {path}: {_cause(error)}; choose a folder on a disk with room for it"
        ) from error
    finally:
        if temporary.parent.is_dir():
            temporary.unlink(missing_ok=True)


def validate_usd(path: Path) -> list[str]:
    """What is wrong with a USD file: findings of USD's own validators and of checks that these leave out; [] is good.

    Every mesh must have a valid topology with indices in range, and every primvar as many values as its interpolation
    asks for, at each of its time samples. Raises OutputError where the file cannot be opened.
    """
    try:
        stage = Usd.Stage.Open(str(path))
    except Exception as error:
        raise OutputError(f"{path} cannot be opened as USD: {str(error).splitlines()[0]}; write it again") from error
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    problems = [e.GetErrorAsString() for e in UsdValidation.ValidationContext(validators).Validate(stage)]
    for prim in stage.TraverseAll():
        if prim.IsA(UsdGeom.Mesh):
            problems += _mesh_errors(UsdGeom.Mesh(prim))
    return problems


def quantise(values: NDArray[np.floating]) -> tuple[np.ndarray, float, float]:
    """Values rounded to 1/1000 of their largest magnitude, as float32; the step; the largest possible error.

    The error is half a step plus the rounding of the result to float32 (half a unit in its last place).
    """
    largest = float(np.abs(values).max(initial=0.0))
    if largest == 0.0:
        return np.zeros(values.shape, np.float32), 0.0, 0.0
    step = largest / LEVELS
    rounded = (np.rint(values / step) * step).astype(np.float32)
    return rounded, step, 0.5 * step + 0.5 * float(np.spacing(np.float32(largest)))


def _cause(error: Exception) -> str:
    """The cause in one line; USD's own errors are pages long and name the function, then the cause, in quotes."""
    if isinstance(error, OSError):
        return error.strerror or str(error)
    quoted = re.findall("'([^']*)'", str(error))
    return quoted[1] if len(quoted) > 1 else "USD could not save it"


class _Clock(NamedTuple):
    """The time codes. kept: which of the stored times become one; times_s: those [s], shape (n,)"""

    kept: slice
    times_s: Float


def _write(result: xr.DataTree, path: Path, fps: float) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    root = UsdGeom.Xform.Define(stage, "/Scene")
    stage.SetDefaultPrim(root.GetPrim())
    clock = _clock(result)
    _add_clock(stage, clock, fps)
    for scope in ("/Scene/Arrays", "/Scene/Bodies"):
        UsdGeom.Scope.Define(stage, scope)
    arrays = instances(result, "array")
    for name, prim in identifiers(arrays).items():
        _add_array(stage, f"/Scene/Arrays/{prim}", arrays[name], clock)
    skins = bodies(result)
    for name, prim in identifiers(skins).items():
        _add_body(stage, f"/Scene/Bodies/{prim}", result, skins[name], clock)
    stage.Save()


def _clock(result: xr.DataTree) -> _Clock:
    count = result.sizes.get("time", 0)
    kept = slice(0, count, max(1, -(-count // MOST_FRAMES)))
    return _Clock(kept, result.coords["time"].values[kept] if count else np.zeros(0))


def _add_clock(stage: Usd.Stage, clock: _Clock, fps: float) -> None:
    """Say which times the time codes are."""
    count = len(clock.times_s)
    if count == 0:
        return
    step_s = float(clock.times_s[-1] - clock.times_s[0]) / max(1, count - 1)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(count - 1)
    stage.GetRootLayer().customLayerData = {
        "palmfield": {
            "start_s": float(clock.times_s[0]),
            "seconds_per_time_code": step_s,
            "stride": clock.kept.step if count > 1 else 1,
            "slow_motion_factor": 1.0 / (step_s * fps) if step_s > 0 else 1.0,
        }
    }
    attribute = stage.GetDefaultPrim().CreateAttribute("palmfield:time_s", Sdf.ValueTypeNames.Double, custom=True)
    for code, time_s in enumerate(clock.times_s.tolist()):
        attribute.Set(time_s, code)


def _add_body(stage: Usd.Stage, path: str, result: xr.DataTree, names: list[str], clock: _Clock) -> None:
    """A body with its surface, its bones and the skins of these names on it."""
    skins, surfaces = instances(result, "skin"), instances(result, "surface")
    body = instances(result, "body").get(names[0])
    boned = body is not None and has_records(body, "bone_pose")
    prim = (UsdSkel.Root if boned else UsdGeom.Xform).Define(stage, path)
    _move(prim, body, clock)
    meshes: list[tuple[UsdGeom.Mesh, xr.Dataset]] = []
    own = [surfaces[name] for name in names if name in surfaces]
    if own:
        mesh = _add_mesh(stage, f"{path}/Surface", own[0]["rest_position"].values, own[0]["face"].values, SKIN_COLOUR)
        meshes.append((mesh, own[0]))
        for name in ("loudest_arp", "loudest_pressure"):
            # Skins on one body share its surface; each brings its own loudest instant.
            values = [surface[name].values for surface in own if has_records(surface, name)]
            if values:
                _primvar(mesh, name, "Pa").Set(Vt.FloatArray.FromNumpy(np.maximum.reduce(values)))
    UsdGeom.Scope.Define(stage, f"{path}/Skins")
    for name, identifier in identifiers(names).items():
        skin = skins[name]
        place = f"{path}/Skins/{identifier}"
        mesh = _add_mesh(stage, place, skin["rest_position"].values, skin["face"].values, PATCH_COLOUR)
        meshes.append((mesh, skin))
        _add_motion(stage, mesh, skin, clock)
    if body is not None and boned:
        skeleton = add_skeleton(stage, path, body, clock.times_s)
        for mesh, ds in meshes:
            if "bone_index" in ds:
                bind(mesh, skeleton, ds["bone_index"].values, ds["bone_weight"].values)


def _add_motion(stage: Usd.Stage, mesh: UsdGeom.Mesh, skin: xr.Dataset, clock: _Clock) -> None:
    """ARP and normal displacement of a skin over time."""
    count = len(clock.times_s)
    for name, (variable, read, units) in SKIN_PRIMVARS.items():
        if not has_records(skin, variable):
            continue
        kept = np.empty((count, skin.sizes["vertex"]), np.float32)
        for place, part in read(skin, variable, clock.kept):
            kept[place] = part
        values, step, bound = quantise(kept)
        primvar = _primvar(mesh, name, units)
        primvar.GetAttr().SetCustomDataByKey("palmfield:quantisation_step", step)
        primvar.GetAttr().SetCustomDataByKey("palmfield:error_bound", bound)
        for code in range(count):
            primvar.Set(Vt.FloatArray.FromNumpy(values[code]), code)
            if code % SAVE_EVERY == SAVE_EVERY - 1:
                stage.Save()


def _move(prim: UsdGeom.Xformable, group: xr.Dataset | None, clock: _Clock) -> None:
    """Let a prim move as a group's pose does; where that does not change, stand there."""
    move, turn = prim.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble), prim.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
    poses = poses_at(group, clock.times_s if len(clock.times_s) else np.zeros(1))
    if (poses == poses[0]).all():
        _place(move, turn, poses[0])
        return
    for code, pose in enumerate(poses):
        _place(move, turn, pose, code)


def _place(move: UsdGeom.XformOp, turn: UsdGeom.XformOp, pose: Float, code: int | None = None) -> None:
    at = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
    move.Set(Gf.Vec3d(*pose[:3].tolist()), at)
    turn.Set(Gf.Quatd(*pose[3:].tolist()), at)


def _add_array(stage: Usd.Stage, path: str, group: xr.Dataset, clock: _Clock) -> None:
    positions: Float = group["transducer_position"].values
    gap = float(cKDTree(positions).query(positions, k=2)[0][:, 1].min()) if len(positions) > 1 else 0.010
    case = trimesh.creation.cylinder(0.46 * gap, 0.7 * gap, sections=24)
    case.apply_translation([0, 0, -0.35 * gap])
    array = UsdGeom.PointInstancer.Define(stage, path)
    _move(array, group, clock)
    prototype = _add_mesh(stage, f"{path}/Transducer", case.vertices, case.faces, CASE_COLOUR)
    array.CreatePrototypesRel().SetTargets([prototype.GetPath()])
    array.CreateProtoIndicesAttr(Vt.IntArray([0] * len(positions)))
    array.CreatePositionsAttr(Vt.Vec3fArray.FromNumpy(positions.astype(np.float32)))
    array.CreateExtentAttr(array.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))


def _add_mesh(stage: Usd.Stage, path: str, vertices: Any, faces: Any, colour: tuple[float, ...]) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, path)
    points = Vt.Vec3fArray.FromNumpy(np.asarray(vertices, dtype=np.float32))
    mesh.CreatePointsAttr(points)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(np.asarray(faces, dtype=np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(*colour)]))
    return mesh


def _primvar(mesh: UsdGeom.Mesh, name: str, units: str) -> UsdGeom.Primvar:
    created = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex)
    created.GetAttr().SetCustomDataByKey("palmfield:units", units)
    return created


def _mesh_errors(mesh: UsdGeom.Mesh) -> list[str]:
    where = mesh.GetPath()
    indices, counts = mesh.GetFaceVertexIndicesAttr().Get(), mesh.GetFaceVertexCountsAttr().Get()
    points = len(mesh.GetPointsAttr().Get())
    valid, reason = UsdGeom.Mesh.ValidateTopology(indices, counts, points)
    problems = [] if valid else [f"{where}: {reason}"]
    numbers = np.array(indices)
    if numbers.size and (numbers.min() < 0 or numbers.max() >= points):
        problems.append(f"{where}: face index {numbers.min()}..{numbers.max()} outside 0..{points - 1}")
    lengths = {"constant": 1, "uniform": len(counts), "varying": points, "vertex": points, "faceVarying": len(indices)}
    for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues():
        length = lengths[primvar.GetInterpolation()] * primvar.GetElementSize()
        for code in primvar.GetTimeSamples() or [Usd.TimeCode.Default()]:
            value = primvar.ComputeFlattened(code)
            has = 1 if isinstance(value, Gf.Matrix4d) else len(value)
            if has != length:
                problems.append(f"{where}: primvar {primvar.GetPrimvarName()} has {has} values at {code}, not {length}")
                break
    return problems
