"""Draw a picture of a USD file from the file alone, through its camera and with the colours of the prims.

    .venv/bin/python scripts/verification/draw_usd.py out/palm/scene.usdc palm.png --code 250

Flat shading and the painter's algorithm: it shows whether geometry, colours, skeletons and the camera are right.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from pxr import Usd, UsdGeom, UsdSkel, Vt

WIDTH, HEIGHT = 960, 720
NEAR_M = 1e-3


class Piece(NamedTuple):
    """Parts of a scene.

    corners: of triangles or lines in the world [m], shape (n, 3 or 2, 3); colours: linear, (n, 3)
    """

    corners: np.ndarray
    colours: np.ndarray
    opacity: float


def pieces_of(stage: Usd.Stage, code: float, purposes: tuple[str, ...] = ("default", "render")) -> list[Piece]:
    """Return all visible parts at a time code."""
    skinned = skinned_points(stage, code)
    found: list[Piece] = []
    walk = iter(Usd.PrimRange(stage.GetPseudoRoot()))
    for prim in walk:
        if not prim.IsA(UsdGeom.Imageable):
            continue
        imageable = UsdGeom.Imageable(prim)
        if imageable.ComputeVisibility(code) == "invisible" or imageable.ComputePurpose() not in purposes:
            continue
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code)) if prim.IsA(
            UsdGeom.Xformable) else np.eye(4)  # fmt: skip
        if prim.IsA(UsdGeom.PointInstancer):
            walk.PruneChildren()
            instancer = UsdGeom.PointInstancer(prim)
            case = UsdGeom.Mesh(stage.GetPrimAtPath(instancer.GetPrototypesRel().GetTargets()[0]))
            one = _mesh(case, code, np.array(case.GetPointsAttr().Get(code)), np.eye(4))
            for place in np.array(instancer.GetPositionsAttr().Get(code)):
                found.append(Piece(_moved(one.corners + place, matrix), one.colours, 1.0))
        elif prim.IsA(UsdGeom.Mesh):
            points = skinned.get(str(prim.GetPath()))
            if points is None:
                points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(code), float).reshape(-1, 3)
            found.append(_mesh(UsdGeom.Mesh(prim), code, points, matrix))
        elif prim.IsA(UsdGeom.BasisCurves):
            found.append(_curves(UsdGeom.BasisCurves(prim), code, matrix))
        elif prim.IsA(UsdGeom.Points):
            found.append(_points(UsdGeom.Points(prim), code, matrix))
        elif prim.IsA(UsdGeom.Gprim) and (solid := _solid(prim)) is not None:
            colour = np.array(UsdGeom.Gprim(prim).GetDisplayColorPrimvar().ComputeFlattened(code))[0]
            corners = np.asarray(solid.vertices)[solid.faces]
            found.append(Piece(_moved(corners, matrix), np.tile(colour, (len(corners), 1)), 1.0))
    return [piece for piece in found if len(piece.corners)]


def skinned_points(stage: Usd.Stage, code: float) -> dict[str, np.ndarray]:
    """Return the points of meshes that a skeleton moves, in their own frames."""
    found = {}
    cache = UsdSkel.Cache()
    for prim in stage.Traverse():
        if prim.IsA(UsdSkel.Root):
            root = UsdSkel.Root(prim)
            cache.Populate(root, Usd.PrimDefaultPredicate)
            for binding in cache.ComputeSkelBindings(root, Usd.PrimDefaultPredicate):
                query = cache.GetSkelQuery(binding.GetSkeleton())
                for target in binding.GetSkinningTargets():
                    points = UsdGeom.Mesh(target.GetPrim()).GetPointsAttr().Get(code)
                    moved = Vt.Vec3fArray(points)
                    target.ComputeSkinnedPoints(query.ComputeSkinningTransforms(code), moved, code)
                    found[str(target.GetPrim().GetPath())] = np.array(moved, float)
    return found


def _mesh(mesh: UsdGeom.Mesh, code: float, points: np.ndarray, matrix: np.ndarray) -> Piece:
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(code), int)
    corners = np.array(mesh.GetFaceVertexIndicesAttr().Get(code), int)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(int)
    triangles, faces = [], []
    for k in range(1, int(counts.max(initial=0)) - 1):
        has = np.flatnonzero(counts > k + 1)
        triangles.append(
            np.stack([corners[starts[has]], corners[starts[has] + k], corners[starts[has] + k + 1]], axis=1)
        )
        faces.append(has)
    if not triangles:
        return Piece(np.zeros((0, 3, 3)), np.zeros((0, 3)), 1.0)
    own, face = np.concatenate(triangles), np.concatenate(faces)
    primvar = mesh.GetDisplayColorPrimvar()
    colours = np.array(primvar.ComputeFlattened(code))
    kind = primvar.GetInterpolation()
    by_triangle = {
        "constant": lambda: np.tile(colours[:1], (len(own), 1)),
        "uniform": lambda: colours[face],
        "vertex": lambda: colours[own].mean(axis=1),
    }[kind]()
    opacity = mesh.GetDisplayOpacityPrimvar().Get(code)
    return Piece(_moved(points[own], matrix), by_triangle, float(opacity[0]) if opacity else 1.0)


def _curves(curves: UsdGeom.BasisCurves, code: float, matrix: np.ndarray) -> Piece:
    points = np.array(curves.GetPointsAttr().Get(code), float)
    ends, start = [], 0
    for count in curves.GetCurveVertexCountsAttr().Get(code):
        ends += [[k, k + 1] for k in range(start, start + count - 1)]
        start += count
    colour = np.array(curves.GetDisplayColorPrimvar().ComputeFlattened(code))[0]
    return Piece(_moved(points[np.array(ends)], matrix), np.tile(colour, (len(ends), 1)), 1.0)


def _points(points: UsdGeom.Points, code: float, matrix: np.ndarray) -> Piece:
    places = np.array(points.GetPointsAttr().Get(code), float)
    width = points.GetWidthsAttr().Get(code)[0]
    small = trimesh.creation.icosahedron()
    corners = 0.5 * width * np.asarray(small.vertices)[small.faces]
    colours = np.array(points.GetDisplayColorPrimvar().ComputeFlattened(code))
    every = (places[:, None, None] + corners).reshape(-1, 3, 3)
    return Piece(_moved(every, matrix), np.repeat(colours, len(corners), axis=0), 1.0)


def _solid(prim: Usd.Prim) -> trimesh.Trimesh | None:
    if prim.IsA(UsdGeom.Sphere):
        return trimesh.creation.icosphere(2, UsdGeom.Sphere(prim).GetRadiusAttr().Get())
    if prim.IsA(UsdGeom.Cube):
        return trimesh.creation.box([UsdGeom.Cube(prim).GetSizeAttr().Get()] * 3)
    if prim.IsA(UsdGeom.Capsule):
        one = UsdGeom.Capsule(prim)
        return trimesh.creation.capsule(one.GetHeightAttr().Get(), one.GetRadiusAttr().Get())
    if prim.IsA(UsdGeom.Cylinder):
        round_ = UsdGeom.Cylinder(prim)
        return trimesh.creation.cylinder(round_.GetRadiusAttr().Get(), round_.GetHeightAttr().Get())
    return None


def _moved(corners: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return corners @ matrix[:3, :3] + matrix[3, :3]


def draw(stage: Usd.Stage, code: float, path: Path, title: str = "", seen: list[Piece] | None = None) -> None:
    """Write a PNG of a stage at a time code, through its camera."""
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Scene/Cameras/Main")).GetCamera(code)
    to_clip = np.array(camera.frustum.ComputeViewMatrix() * camera.frustum.ComputeProjectionMatrix())
    to_eye = np.array(camera.frustum.ComputeViewMatrix())
    polygons, colours, depths = [], [], []
    for piece in pieces_of(stage, code) if seen is None else seen:
        corners = piece.corners
        flat = np.concatenate([corners, np.ones((*corners.shape[:2], 1))], axis=2)
        clip = flat @ to_clip
        depth = -(flat @ to_eye)[..., 2]
        kept = depth.min(axis=1) > NEAR_M
        places = clip[kept][..., :2] / clip[kept][..., 3:]
        shade = np.ones(int(kept.sum()))
        if corners.shape[1] == 3:
            eye = (flat @ to_eye)[kept][..., :3]
            normal = np.cross(eye[:, 1] - eye[:, 0], eye[:, 2] - eye[:, 0])
            length = np.linalg.norm(normal, axis=1)
            shade = 0.55 + 0.45 * np.abs(normal[:, 2]) / np.maximum(length, 1e-30)
        linear = np.clip(piece.colours[kept] * shade[:, None], 0.0, 1.0)
        rgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
        colours += [(*one, piece.opacity) for one in rgb]
        polygons += list(places)
        depths += depth[kept].mean(axis=1).tolist()
    order = np.argsort(depths)[::-1]
    figure = Figure(figsize=(WIDTH / 100, HEIGHT / 100), dpi=100)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    drawn = PolyCollection([polygons[k] for k in order], closed=False)
    rgba = [colours[k] for k in order]
    drawn.set_facecolor(rgba)
    drawn.set_edgecolor(rgba)
    drawn.set_linewidth(0.4)
    axes.add_collection(drawn)
    axes.set(xlim=(-1, 1), ylim=(-1, 1))
    axes.set_axis_off()
    figure.text(0.02, 0.97, title, va="top")
    path.parent.mkdir(parents=True, exist_ok=True)
    FigureCanvasAgg(figure).print_png(str(path))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path)
    parser.add_argument("picture", type=Path)
    parser.add_argument("--code", type=float, default=None, help="time code [default: the middle]")
    parser.add_argument("--magnified", action="store_true", help="choose the variant with magnified motion")
    args = parser.parse_args()
    stage = Usd.Stage.Open(str(args.scene))
    if args.magnified:
        stage.SetEditTarget(stage.GetSessionLayer())
        for prim in stage.Traverse():
            if "motion" in prim.GetVariantSets().GetNames() and prim.IsA(UsdGeom.Mesh):
                prim.GetVariantSets().GetVariantSet("motion").SetVariantSelection("magnified")
    code = args.code if args.code is not None else 0.5 * (stage.GetStartTimeCode() + stage.GetEndTimeCode())
    draw(stage, code, args.picture, f"{args.scene.name}, {code / stage.GetTimeCodesPerSecond() * 1e3:.2f} ms")


if __name__ == "__main__":
    main()
