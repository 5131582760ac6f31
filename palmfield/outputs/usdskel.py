"""The bones of an articulated hand in USD: a skeleton whose joints move over time, and meshes bound to it."""

from collections.abc import Iterable

import numpy as np
import xarray as xr
from pxr import Gf, Tf, Usd, UsdGeom, UsdSkel, Vt

from palmfield.outputs.frames import nearest
from palmfield.types import Float, Float32, Int


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Names that USD allows for prims and joints, by the name that each stands for; no two are alike."""
    result: dict[str, str] = {}
    for name in names:
        # Left to itself, USD takes a digit at the beginning away
        base = Tf.MakeValidIdentifier(f"_{name}" if name[:1].isdigit() else name)
        taken = set(result.values())
        result[name] = next(n for k in range(len(taken) + 1) if (n := f"{base}_{k}" if k else base) not in taken)
    return result


def add_skeleton(stage: Usd.Stage, root: str, body: xr.Dataset, times_s: Float) -> UsdSkel.Skeleton:
    """Skeleton and animation under a UsdSkel root, whose frame is the body's.

    body: a result's group /body with bone_rest and bone_pose; times_s: of the time codes [s], shape (n,)
    """
    skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/Skeleton")
    count = body.sizes["bone"]
    labels = [str(n) for n in body["bone"].values] if "bone" in body.coords else [f"bone_{k:02d}" for k in range(count)]
    names = list(identifiers(labels).values())
    skeleton.CreateJointsAttr(names)
    rest = [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*origin)) for origin in body["bone_rest"].values.tolist()]
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(rest))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    animation = UsdSkel.Animation.Define(stage, f"{root}/Skeleton/Motion")
    animation.CreateJointsAttr(names)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * count))
    moves, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    steps: Float = body["step_time"].values
    poses: Float = body["bone_pose"].values
    for code, time_s in enumerate(times_s):
        pose = poses[nearest(steps, float(time_s))]
        moves.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(pose[:, :3], np.float32)), code)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*quaternion) for quaternion in pose[:, 3:].tolist()]), code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton


def bind(mesh: UsdGeom.Mesh, skeleton: UsdSkel.Skeleton, bones: Int, weights: Float32) -> None:
    """Let a mesh follow the skeleton by linear blending; bones, weights: shape (n, 4)."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = bones.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(bones.ravel()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
