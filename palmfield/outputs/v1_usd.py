# Schema 1: for the old recorder, and deleted with it.
"""The run as a USD scene: array, moving hand, and the skin's ARP and displacement as primvars over time."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
import xarray as xr
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdSkel, UsdValidation, Vt
from scipy.spatial import cKDTree

from palmfield.errors import OutputError
from palmfield.outputs.v1_frames import body_pose_at, has_records
from palmfield.outputs.v1_usdskel import add_skeleton, bind
from palmfield.types import Float, Int

MOST_FRAMES = 600
SAVE_EVERY = 50
LEVELS = 1000
SKIN_PRIMVARS = {"arp": "Pa", "normal_displacement": "m"}
SKIN_COLOUR = (0.86, 0.66, 0.55)
PATCH_COLOUR = (0.80, 0.50, 0.42)
CASE_COLOUR = (0.62, 0.64, 0.67)


def write_usd(ds: xr.Dataset, path: Path, fps: float = 30.0) -> None:
    """USD crate of a result: a slow-motion film, one stored frame a time code, at most 600 frames.

    ds: a result (outputs/schema.py); path: name of the .usdc file; fps: time codes per second [1/s]
    /Scene/Array is a point instancer, /Scene/Body moves as the body did, with the bones of an articulated hand as a
    UsdSkel skeleton; under it, Surface has the primvars surface_arp
    and surface_pressure [Pa], and Skin has arp [Pa] and normal_displacement [m] by vertex over time, each rounded to
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
        _write(ds, temporary, fps)
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
    found = [e.GetErrorAsString() for e in UsdValidation.ValidationContext(validators).Validate(stage)]
    for prim in stage.TraverseAll():
        if prim.IsA(UsdGeom.Mesh):
            found += _mesh_errors(UsdGeom.Mesh(prim))
    return found


def quantise(values: Float) -> tuple[np.ndarray, float, float]:
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


def _write(ds: xr.Dataset, path: Path, fps: float) -> None:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    stage.SetTimeCodesPerSecond(fps)
    stage.SetFramesPerSecond(fps)
    root = UsdGeom.Xform.Define(stage, "/Scene")
    stage.SetDefaultPrim(root.GetPrim())
    if "transducer_position" in ds:
        _add_array(stage, ds["transducer_position"].values, ds["array_pose"].values)
    boned = has_records(ds, "bone_pose")
    body = (UsdSkel.Root if boned else UsdGeom.Xform).Define(stage, "/Scene/Body")
    if "surface_vertices" in ds:
        surface = _add_mesh(
            stage, "/Scene/Body/Surface", ds["surface_vertices"].values, ds["surface_faces"].values, SKIN_COLOUR
        )
        for name in ("surface_arp", "surface_pressure"):
            if name in ds:
                _primvar(surface, name, "Pa").Set(Vt.FloatArray.FromNumpy(ds[name].values))
    skin = _add_mesh(stage, "/Scene/Body/Skin", ds["skin_position"].values, ds["skin_faces"].values, PATCH_COLOUR)
    _add_frames(stage, ds, body, skin, fps)
    if boned:
        skeleton = add_skeleton(stage, "/Scene/Body", ds, kept_frames(ds))
        bind(skin, skeleton, ds["skin_bone"].values, ds["skin_share"].values)
        if "surface_bone" in ds:
            bind(surface, skeleton, ds["surface_bone"].values, ds["surface_share"].values)
    stage.Save()


def kept_frames(ds: xr.Dataset) -> Int:
    """Which of the stored times become time codes, shape (n,)."""
    count = ds.sizes["time"] if has_records(ds, "time") else 0
    return np.arange(0, count, max(1, -(-count // MOST_FRAMES)), dtype=np.int32)


def _add_frames(stage: Usd.Stage, ds: xr.Dataset, body: UsdGeom.Xform, skin: UsdGeom.Mesh, fps: float) -> None:
    time_s = ds["time"].values if has_records(ds, "time") else np.zeros(0)
    kept = kept_frames(ds)
    stride = int(kept[1] - kept[0]) if len(kept) > 1 else 1
    move, turn = body.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble), body.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
    if len(kept) == 0:
        _place(move, turn, body_pose_at(ds, 0.0))
        return
    step_s = float(time_s[kept[-1]] - time_s[0]) / max(1, len(kept) - 1)
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(len(kept) - 1)
    stage.GetRootLayer().customLayerData = {
        "palmfield": {
            "start_s": float(time_s[0]),
            "seconds_per_time_code": step_s,
            "stride": stride,
            "slow_motion_factor": 1.0 / (step_s * fps) if step_s > 0 else 1.0,
        }
    }
    clock = stage.GetDefaultPrim().CreateAttribute("palmfield:time_s", Sdf.ValueTypeNames.Double, custom=True)
    samples: list[tuple[Any, np.ndarray]] = []
    for name, units in SKIN_PRIMVARS.items():
        if has_records(ds, name):
            values, step, bound = quantise(ds[name].values[kept])
            primvar = _primvar(skin, name, units)
            primvar.GetAttr().SetCustomDataByKey("palmfield:quantisation_step", step)
            primvar.GetAttr().SetCustomDataByKey("palmfield:error_bound", bound)
            samples.append((primvar, values))
    for code, index in enumerate(kept):
        _place(move, turn, body_pose_at(ds, float(time_s[index])), code)
        clock.Set(float(time_s[index]), code)
        for primvar, values in samples:
            primvar.Set(Vt.FloatArray.FromNumpy(values[code]), code)
        if code % SAVE_EVERY == SAVE_EVERY - 1:
            stage.Save()


def _place(move: UsdGeom.XformOp, turn: UsdGeom.XformOp, pose: Float, code: int | None = None) -> None:
    at = Usd.TimeCode.Default() if code is None else Usd.TimeCode(code)
    move.Set(Gf.Vec3d(*pose[:3].tolist()), at)
    turn.Set(Gf.Quatd(*pose[3:].tolist()), at)


def _add_array(stage: Usd.Stage, positions: Float, pose: Float) -> None:
    gap = float(cKDTree(positions).query(positions, k=2)[0][:, 1].min()) if len(positions) > 1 else 0.010
    case = trimesh.creation.cylinder(0.46 * gap, 0.7 * gap, sections=24)
    case.apply_translation([0, 0, -0.35 * gap])
    array = UsdGeom.PointInstancer.Define(stage, "/Scene/Array")
    _place(
        array.AddTranslateOp(UsdGeom.XformOp.PrecisionDouble), array.AddOrientOp(UsdGeom.XformOp.PrecisionDouble), pose
    )
    prototype = _add_mesh(stage, "/Scene/Array/Transducer", case.vertices, case.faces, CASE_COLOUR)
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
    found = [] if valid else [f"{where}: {reason}"]
    numbers = np.array(indices)
    if numbers.size and (numbers.min() < 0 or numbers.max() >= points):
        found.append(f"{where}: face index {numbers.min()}..{numbers.max()} outside 0..{points - 1}")
    wanted = {"constant": 1, "uniform": len(counts), "varying": points, "vertex": points, "faceVarying": len(indices)}
    for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues():
        length = wanted[primvar.GetInterpolation()] * primvar.GetElementSize()
        for code in primvar.GetTimeSamples() or [Usd.TimeCode.Default()]:
            value = primvar.ComputeFlattened(code)
            has = 1 if isinstance(value, Gf.Matrix4d) else len(value)
            if has != length:
                found.append(f"{where}: primvar {primvar.GetPrimvarName()} has {has} values at {code}, not {length}")
                break
    return found
