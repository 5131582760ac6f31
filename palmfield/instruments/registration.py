"""Register a measured scan to a surface, by a rigid motion from the frame of the scan to that of the surface."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from palmfield.errors import MeasurementError
from palmfield.hand.triangles import face_normals
from palmfield.instruments.surface_motion import on_mesh
from palmfield.metrics.checks import finite
from palmfield.transforms import IDENTITY, Transform
from palmfield.types import Float, Int

ROUNDS = 60
LEAST_DIRECTION = 1e-2
"""Share of the motion of the points normal to the surface above which the surface determines a rigid motion."""
SETTLED_M = 1e-9


class Registration(NamedTuple):
    """Pose of a scan on a surface.

    transform: transform from the frame of the scan to that of the surface; residual_m: distances from the surface,
    shape (n,)
    fiducials_m: distance of each fiducial from its partner, shape (k,), empty without fiducials
    undetermined: number of the six rigid motions (three shifts, three rotations) that the surface does not determine
    turns: number of these that rotate the scan without a shift, 1 on a plane
    """

    transform: Transform
    residual_m: Float
    fiducials_m: Float
    undetermined: int
    turns: int = 3

    @property
    def rms_m(self) -> float:
        """Root mean square distance from the surface [m]."""
        return float(np.sqrt(np.mean(self.residual_m**2)))


def by_fiducials(measured_m: ArrayLike, surface_m: ArrayLike) -> Transform:
    """Return the rigid motion from points to their partners, shapes (k, 3), k >= 3, by least squares (Kabsch 1976).

    Raises MeasurementError for fewer points, NaN, and points on one line.
    """
    theirs, ours = np.asarray(measured_m, dtype=float), np.asarray(surface_m, dtype=float)
    if theirs.shape != ours.shape or theirs.ndim != 2 or theirs.shape[1] != 3 or len(theirs) < 3:
        raise MeasurementError(
            f"fiducials have shapes {theirs.shape} and {ours.shape}; give pairs of (k, 3), three or more"
        )
    finite("the fiducials", np.hstack([theirs, ours]))
    spread = np.linalg.svd(theirs - theirs.mean(axis=0), compute_uv=False)
    if spread[1] < 1e-3 * max(spread[0], 1e-300):
        raise MeasurementError("the fiducials lie on one line, so the rotation about it is undetermined; give others")
    turn, _ = Rotation.align_vectors(ours - ours.mean(axis=0), theirs - theirs.mean(axis=0))
    rotation = turn.as_matrix()
    return Transform(ours.mean(axis=0) - rotation @ theirs.mean(axis=0), rotation)


def to_surface(
    points_m: ArrayLike, vertices: Float, faces: Int, begin: Transform = IDENTITY
) -> tuple[Transform, int, int]:
    """Return the rigid motion near `begin` that moves points onto a mesh, and the numbers of undetermined directions
    (of six) and of undetermined rotations.

    Least squares minimise the distances along the surface normals, point to plane (Chen & Medioni 1992), until
    convergence. Motions by which the points slide along the surface (on a plane two shifts, one rotation) are not made.
    """
    points = np.asarray(points_m, dtype=float)
    across, _ = face_normals(np.asarray(vertices, dtype=float), np.asarray(faces))
    transform, fixed = begin, np.zeros((0, 6))
    for _ in range(ROUNDS):
        at = transform.points(points)
        nearest = on_mesh(vertices, faces, at)
        normals = across[nearest.triangle]
        gaps = np.einsum("ni,ni->n", at - nearest.nearest, normals)
        middle = at.mean(axis=0)
        # Rotations are scaled by the distance of the outermost points, so that all six columns are lengths
        radius = max(float(np.linalg.norm(at - middle, axis=1).max()), 1e-9)
        columns = np.hstack([normals, np.cross(at - middle, normals) / radius]) / np.sqrt(len(at))
        left, sizes, right = np.linalg.svd(columns, full_matrices=False)
        determined = sizes > LEAST_DIRECTION
        fixed = right[determined]
        inverse = np.where(determined, 1.0 / np.where(determined, sizes, 1.0), 0.0)
        step = -right.T @ (inverse * (left.T @ (gaps / np.sqrt(len(at)))))
        turn = Rotation.from_rotvec(step[3:] / radius).as_matrix()
        position = turn @ (transform.position - middle) + middle + step[:3]
        transform = Transform(position, turn @ transform.rotation)
        if np.abs(step).max() < SETTLED_M:
            break
    free = null_space(fixed) if len(fixed) else np.eye(6)
    shifts = int((np.linalg.svd(free[:3], compute_uv=False) > LEAST_DIRECTION).sum()) if free.size else 0
    return transform, free.shape[1], free.shape[1] - shifts


def registration(
    points_m: ArrayLike, vertices: Float, faces: Int, *, pairs: tuple[ArrayLike, ArrayLike] | None = None,
    surface: bool = True,
) -> Registration:  # fmt: skip
    """Return the pose of a scan, by pairs of fiducials (measured, on the surface) if given, then by the surface."""
    begin = IDENTITY if pairs is None else by_fiducials(*pairs)
    transform, undetermined, turns = to_surface(points_m, vertices, faces, begin) if surface else (begin, 6, 3)
    residual = on_mesh(vertices, faces, transform.points(np.asarray(points_m, dtype=float))).distance_m
    fiducials = np.zeros(0)
    if pairs is not None:
        measured, ours = (np.asarray(part, dtype=float) for part in pairs)
        fiducials = np.linalg.norm(transform.points(measured) - ours, axis=1)
    return Registration(transform, residual, fiducials, undetermined, turns)
