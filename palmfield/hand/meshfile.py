"""A user's own mesh of a hand, read through trimesh and checked before anything is computed on it."""

from pathlib import Path

import numpy as np
import trimesh
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.hand.triangles import consistent_winding, directed_edges, face_normals, vertex_normals
from palmfield.types import Float, Int, Surface

METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
SUFFIXES = (".obj", ".ply", ".stl")
LEAST_EXTENT_m, GREATEST_EXTENT_m = 0.02, 0.6
# Vertices closer than this share of the extent are one: UV seams and STL repeat positions, bit for bit or rounded.
MERGE_SHARE = 1e-6


def load_mesh(path: str | Path, unit: str) -> Surface:
    """Closed surface from an OBJ, PLY or STL file, in metres, with outward normals.

    unit: what one unit in the file means: "m", "cm", "mm" or "in"; these formats do not carry it: no guess
    Vertices at the same position are merged and the winding is turned outward.

    Raises SceneError for an unknown unit or format; a file that is missing, unreadable or empty; a mesh of no size,
    with coordinates that are not finite, with holes, of several bodies, or not 20 to 600 mm long.
    """
    file = Path(path)
    if unit not in METRES:
        raise SceneError(f"mesh {file}: unit {unit!r} is unknown; use one of {', '.join(METRES)}")
    vertices, faces = _read(file)
    if not np.isfinite(vertices).all():
        bad = int((~np.isfinite(vertices)).any(axis=1).sum())
        raise SceneError(f"mesh {file}: {bad} of {len(vertices)} vertices are not finite numbers; export it again")
    extent = float(np.ptp(vertices, axis=0).max())
    if extent == 0.0:
        raise SceneError(f"mesh {file}: all {len(vertices)} vertices lie in one point; export it again")
    _check_size(file, extent, unit)
    vertices, faces = _merge(vertices * METRES[unit], faces, MERGE_SHARE * extent * METRES[unit])
    if len(faces) == 0 or face_normals(vertices, faces)[1].sum() == 0.0:
        raise SceneError(f"mesh {file}: its faces have no area; export it again")
    _check_closed(file, vertices, faces)
    faces = consistent_winding(faces)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    volume = float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum()) / 6.0
    if volume < 0.0:
        faces = np.ascontiguousarray(faces[:, ::-1])
    if abs(volume) < 1e-9 * (extent * METRES[unit]) ** 3:
        raise SceneError(f"mesh {file}: it encloses no volume; give a closed hand, not a flat sheet")
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def _read(file: Path) -> tuple[Float, Int]:
    if not file.is_file():
        raise SceneError(f"mesh {file} does not exist; give the path of an OBJ, PLY or STL file")
    if file.suffix.lower() not in SUFFIXES:
        raise SceneError(
            f"mesh {file}: format {file.suffix or '(none)'!r} is not read; export it as {', '.join(SUFFIXES)}"
        )
    try:
        mesh = trimesh.load_mesh(file, process=False)
    # trimesh lets every kind of exception of its parsers through (ValueError, IndexError, struct.error, ...).
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise SceneError(f"mesh {file} cannot be read ({reason}); export it again") from error
    vertices = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), dtype=np.float64)
    faces = np.asarray(getattr(mesh, "faces", np.zeros((0, 3))), dtype=np.int32)
    if len(vertices) == 0 or len(faces) == 0:
        raise SceneError(
            f"mesh {file} is empty ({len(vertices)} vertices, {len(faces)} faces); export it with its faces"
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise SceneError(f"mesh {file}: a face names vertex {faces.max()} of {len(vertices)}; export it again")
    return vertices, faces


def _check_size(file: Path, extent: float, unit: str) -> None:
    size = extent * METRES[unit]
    if LEAST_EXTENT_m <= size <= GREATEST_EXTENT_m:
        return
    others = [
        f"{extent * metres * 1e3:.4g} mm with unit {name}"
        for name, metres in METRES.items()
        if LEAST_EXTENT_m <= extent * metres <= GREATEST_EXTENT_m
    ]
    mend = f"it would be {' or '.join(others)}" if others else "no unit makes it a hand; scale it"
    raise SceneError(f"mesh {file} is {size * 1e3:.4g} mm long with unit {unit}; 20 to 600 mm are allowed; {mend}")


def _merge(vertices: Float, faces: Int, tolerance_m: float) -> tuple[Float, Int]:
    """One vertex for each position; faces that lose a side by that are dropped, and so are unused vertices."""
    _, first, inverse = np.unique(np.round(vertices / tolerance_m), axis=0, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces].astype(np.int32)
    sides = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    used, local = np.unique(faces[sides], return_inverse=True)
    return vertices[first[used]], local.reshape(-1, 3).astype(np.int32)


def _check_closed(file: Path, vertices: Float, faces: Int) -> None:
    edges, count = np.unique(np.sort(directed_edges(faces), axis=1), axis=0, return_counts=True)
    number = len(vertices)
    open_edges = edges[count == 1]
    if len(open_edges):
        graph = sparse.coo_array((np.ones(len(open_edges)), open_edges.T), shape=(number, number))
        label = sparse.csgraph.connected_components(graph, directed=False)[1]
        holes = np.unique(label[open_edges[:, 0]])
        places = [1e3 * vertices[np.unique(open_edges[label[open_edges[:, 0]] == h])].mean(axis=0) for h in holes[:3]]
        where = ", ".join(f"({p[0]:.1f}, {p[1]:.1f}, {p[2]:.1f})" for p in places)
        more = " and elsewhere" if len(holes) > 3 else ""
        plural = "s" if len(holes) > 1 else ""
        raise SceneError(
            f"mesh {file} is not watertight: {len(holes)} hole{plural} at {where}{more} mm; "
            "fill them in the program that it is from"
        )
    if (count > 2).any():
        place = 1e3 * vertices[edges[count > 2][0]].mean(axis=0)
        raise SceneError(
            f"mesh {file}: {int((count > 2).sum())} edges are shared by more than two faces, one at "
            f"({place[0]:.1f}, {place[1]:.1f}, {place[2]:.1f}) mm; remove the doubled faces"
        )
    graph = sparse.coo_array((np.ones(len(edges)), edges.T), shape=(number, number))
    bodies = sparse.csgraph.connected_components(graph, directed=False)[0]
    if bodies > 1:
        raise SceneError(f"mesh {file} has {bodies} separate bodies; keep the hand only")
