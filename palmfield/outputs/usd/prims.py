"""Add meshes, curves and primvars for all parts of a USD scene."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from palmfield.outputs.usd.quantise import Rounding
from palmfield.outputs.usd.samples import Samples
from palmfield.types import Float

NAMESPACE = "palmfield"


def about(thing: Any, **facts: Any) -> None:
    """Set customData of a prim or an attribute: one entry `palmfield:NAME` for each name."""
    for name, value in facts.items():
        if isinstance(value, list):
            value = (Vt.StringArray if value and isinstance(value[0], str) else Vt.DoubleArray)(value)
        thing.SetCustomDataByKey(f"{NAMESPACE}:{name}", value)


def floats(values: NDArray[Any]) -> Vt.FloatArray:
    return Vt.FloatArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def integers(values: NDArray[Any]) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def vectors(values: ArrayLike) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32).reshape(-1, 3))


def vector(values: NDArray[Any]) -> Gf.Vec3d:
    return Gf.Vec3d(*values.tolist())


def add_mesh(
    stage: Usd.Stage,
    path: str,
    points: ArrayLike,
    faces: ArrayLike,
    colour: tuple[float, ...] | None,
    normals: ArrayLike | None = None,
) -> UsdGeom.Mesh:
    """Add a mesh of polygons, in one colour or without colour.

    faces: shape (m, corners); all polygons have the same number of corners
    normals: normals of vertices, for smooth shading; None for flat faces
    """
    mesh = UsdGeom.Mesh.Define(stage, path)
    placed, corners = vectors(points), np.asarray(faces, np.int32)
    mesh.CreatePointsAttr(placed)
    mesh.CreateFaceVertexCountsAttr(integers(np.full(len(corners), corners.shape[1])))
    mesh.CreateFaceVertexIndicesAttr(integers(corners.ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDoubleSidedAttr(True)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(placed))
    if normals is not None:
        mesh.CreateNormalsAttr(vectors(normals))
        mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    if colour is not None:
        mesh.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(*colour)]))
    return mesh


def add_lines(
    stage: Usd.Stage, path: str, lines: list[Float], width_m: float, colour: tuple[float, ...]
) -> UsdGeom.BasisCurves:
    """Add polygonal lines, each of shape (n, 3), n >= 2 [m]."""
    curves = UsdGeom.BasisCurves.Define(stage, path)
    curves.CreateTypeAttr(UsdGeom.Tokens.linear)
    curves.CreateCurveVertexCountsAttr(integers(np.array([len(line) for line in lines])))
    points = vectors(np.concatenate(lines))
    curves.CreatePointsAttr(points)
    curves.CreateWidthsAttr(Vt.FloatArray([width_m]))
    curves.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    curves.CreateExtentAttr(UsdGeom.Curves.ComputeExtent(points, Vt.FloatArray([width_m])))
    curves.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(*colour)]))
    return curves


def describe_rounding(rounded: Rounding) -> dict[str, Any]:
    """Describe the rounding of the values of a primvar."""
    return {
        "low": rounded.low, "high": rounded.high, "error_bound": rounded.bound, "quantisation_step": rounded.step,
        "quantisation": "to the nearest" if rounded.weights is None else "up or down, to preserve the sum over areas",
    }  # fmt: skip


def add_primvar(
    prim: Usd.Prim, name: str, unit: str, sign: str, facts: Mapping[str, Any], interpolation: str = "vertex"
) -> UsdGeom.Primvar:
    """Add a primvar of floats with its unit, sign and further descriptions."""
    created = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(name, Sdf.ValueTypeNames.FloatArray, interpolation)
    about(created.GetAttr(), units=unit, sign=sign, **facts)
    return created


class Moves:
    """Translation and orientation of a prim over time. There are no time samples while the pose is constant."""

    def __init__(self, prim: UsdGeom.Xformable):
        precise = UsdGeom.XformOp.PrecisionDouble
        self._ops = (
            Samples(prim.AddTranslateOp(precise).GetAttr(), vector),
            Samples(prim.AddOrientOp(precise).GetAttr(), lambda turn: Gf.Quatd(*turn.tolist())),
        )

    def extend(self, codes: Sequence[float], poses: Float) -> None:
        """Add poses, shape (n, 7), at rising time codes."""
        for op, part in zip(self._ops, (poses[:, :3], poses[:, 3:]), strict=True):
            op.extend(codes, part)
