"""Write the bones of an articulated hand to USD: a skeleton with moving joints, and meshes bound to it."""

from collections.abc import Iterable, Sequence

import xarray as xr
from pxr import Gf, Tf, Usd, UsdGeom, UsdSkel, Vt

from palmfield.outputs.usd.prims import vectors
from palmfield.outputs.usd.samples import Samples
from palmfield.types import Float, Float32, Int


def identifiers(names: Iterable[str]) -> dict[str, str]:
    """Return unique names that USD allows for prims and joints. The keys are the original names."""
    result: dict[str, str] = {}
    for name in names:
        # USD would remove a digit at the beginning
        base = Tf.MakeValidIdentifier(f"_{name}" if name[:1].isdigit() else name)
        used = set(result.values())
        result[name] = next(n for k in range(len(used) + 1) if (n := f"{base}_{k}" if k else base) not in used)
    return result


def add_skeleton(stage: Usd.Stage, root: str, body: xr.Dataset) -> tuple[UsdSkel.Skeleton, UsdSkel.Animation]:
    """Add a skeleton, and an animation without motion, under a UsdSkel root.

    The frame of the root is that of the body.
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
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    return skeleton, animation


class BoneMoves:
    """Translations and rotations of the bones of a skeleton over time."""

    def __init__(self, animation: UsdSkel.Animation):
        self._moves = Samples(animation.CreateTranslationsAttr(), vectors)
        self._turns = Samples(
            animation.CreateRotationsAttr(), lambda turns: Vt.QuatfArray([Gf.Quatf(*turn) for turn in turns.tolist()])
        )

    def extend(self, codes: Sequence[float], poses: Float) -> None:
        """Add poses of all bones in the body frame, shape (n, bones, 7), at rising time codes."""
        self._moves.extend(codes, poses[..., :3])
        self._turns.extend(codes, poses[..., 3:])


def bind(mesh: UsdGeom.Mesh, skeleton: UsdSkel.Skeleton, bones: Int, weights: Float32) -> None:
    """Let a mesh follow the skeleton by linear blending; bones, weights: shape (n, 4)."""
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])
    influences = bones.shape[1]
    binding.CreateJointIndicesPrimvar(False, influences).Set(Vt.IntArray.FromNumpy(bones.ravel()))
    binding.CreateJointWeightsPrimvar(False, influences).Set(Vt.FloatArray.FromNumpy(weights.ravel()))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
