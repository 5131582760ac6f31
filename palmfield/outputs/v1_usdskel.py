# Schema 1: for the old recorder, and deleted with it.
"""The bones of an articulated hand in USD: a skeleton whose joints move over time, and meshes bound to it."""

import numpy as np
import xarray as xr
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from palmfield.types import Float, Float32, Int


def add_skeleton(stage: Usd.Stage, root: str, ds: xr.Dataset, kept: Int) -> UsdSkel.Skeleton:
    """Skeleton and animation under a UsdSkel root, whose frame is the body's.

    ds: a result with bone_rest and bone_pose; kept: stored times that are the time codes, shape (n,)
    """
    skeleton = UsdSkel.Skeleton.Define(stage, f"{root}/Skeleton")
    names = [f"bone_{number:02d}" for number in range(ds.sizes["bone"])]
    skeleton.CreateJointsAttr(names)
    rest = [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*origin)) for origin in ds["bone_rest"].values.tolist()]
    skeleton.CreateBindTransformsAttr(Vt.Matrix4dArray(rest))
    skeleton.CreateRestTransformsAttr(Vt.Matrix4dArray(rest))
    animation = UsdSkel.Animation.Define(stage, f"{root}/Skeleton/Motion")
    animation.CreateJointsAttr(names)
    animation.CreateScalesAttr(Vt.Vec3hArray([Gf.Vec3h(1.0, 1.0, 1.0)] * len(names)))
    moves, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    steps = ds["step_time"].values
    poses: Float = ds["bone_pose"].values
    for code, index in enumerate(kept):
        pose = poses[int(np.abs(steps - ds["time"].values[index]).argmin())]
        moves.Set(Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(pose[:, :3], np.float32)), code)
        turns.Set(Vt.QuatfArray([Gf.Quatf(*quaternion) for quaternion in pose[:, 3:].tolist()]), code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton


def bind(mesh: UsdGeom.Mesh, skeleton: UsdSkel.Skeleton, bones: Int, shares: Float32) -> None:
    """Let a mesh follow the skeleton by linear blending; bones, shares: shape (n, 4)."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = bones.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(bones.ravel()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(shares.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
