"""Inputs and results of a skin solver: body, load, motion.

Frame of a slab: the face is the plane z = 0, the body lies below it, and the origin is in the middle of the face. A
layer is in the frame of its patch. A positive pressure pushes into the body. Displacements are vectors, so a slab
under a spot moves by negative z.
"""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from palmfield.errors import SceneError
from palmfield.skin.base import Base, SideKind, check_base_and_side
from palmfield.skin.materials.material import Sheet
from palmfield.types import Float, Patch

Law = Literal["linear", "held"]
Quantity = Literal["displacement", "velocity", "normal"]
Shape = Literal["infinite", "disc", "box"]
QUANTITIES: tuple[Quantity, ...] = ("displacement", "velocity", "normal")
"""Quantities to which a target accuracy can apply, in the order of the three errors of solvers; "normal" is the
displacement along the normal of the face."""
SHAPES = ("infinite", "disc", "box")
LEAST_M, THICKEST_M, WIDEST_M = 1e-4, 1.0, 10.0
"""Limits of slab sizes [m]. Larger sizes are probably lengths in millimetres. Below the first, waves cross the slab so
fast that a solution takes too long."""
ONLY_WEDGES = "only wedges, reduced and lateral_waves support a Foundation: choose one of them, or use another base"
"""Error message of other solvers for a body with a Foundation."""
GAUSSIAN = 4.0 * math.log(2.0)
"""exp(-GAUSSIAN (r / fwhm)^2) is half at r = fwhm / 2."""


@dataclass(frozen=True)
class Slab:
    """Flat sheets on a base, from the surface down.

    shape: "infinite", "disc" (radius_m) or "box" (size_m along x and y).
    base: "bonded" (no motion), "free_slip" (no normal motion, no shear traction), "free" (no traction), Springs
        or a Foundation.
    side: "fixed" (no motion), "free" (no traction), "roller" (no normal motion, no shear traction) or "absorbing";
        not used if the shape is infinite.
    Raises SceneError for other values, missing sizes, and sizes below LEAST_M or above THICKEST_M and WIDEST_M.
    """

    sheets: tuple[Sheet, ...]
    shape: Shape = "infinite"
    base: Base = "bonded"
    side: SideKind | None = None
    radius_m: float | None = None
    size_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        check_base_and_side(self.base, self.side, none=self.shape == "infinite")
        if not self.sheets:
            raise SceneError("slab: sheets is empty; give at least one")
        if self.shape not in SHAPES:
            raise SceneError(f"slab: shape is '{self.shape}'; use one of {', '.join(SHAPES)}")
        sizes = {"disc": (self.radius_m,), "box": self.size_m or (None,), "infinite": ()}[self.shape]
        for size in sizes:
            if size is None or not (math.isfinite(size) and size > 0.0):
                name = "radius_m" if self.shape == "disc" else "size_m"
                raise SceneError(f"slab: {name} is {getattr(self, name)}; a {self.shape} needs lengths above 0")
        for name, length, most in (
            ("thickness", self.thickness_m, THICKEST_M),
            *(("width", x, WIDEST_M) for x in sizes),
        ):
            if length is not None and not LEAST_M <= length <= most:
                raise SceneError(f"slab: {name} is {length:g} m; allowed: {LEAST_M:g} to {most:g} m (20 mm is 0.02)")

    @property
    def thickness_m(self) -> float:
        return sum(sheet.thickness_m for sheet in self.sheets)


@dataclass(frozen=True)
class Layer:
    """Sheets below a patch of surface, from the surface down; their thicknesses are shares of the depth of the patch.

    Raises SceneError for an unknown base or side, and for a depth that is not above 0, with its place. Also for a patch
    with positions that are not finite, inward directions that are not of length 1, or faces with unknown vertices.
    """

    patch: Patch
    sheets: tuple[Sheet, ...]
    base: Base = "bonded"
    side: SideKind = "fixed"

    def __post_init__(self) -> None:
        check_base_and_side(self.base, self.side, none=False)
        if not self.sheets:
            raise SceneError("layer: sheets is empty; give at least one")
        check_patch(self.patch)
        depth = np.asarray(self.patch.depth, dtype=float)
        thin = int(np.argmin(np.where(np.isfinite(depth), depth, -np.inf)))
        if not depth[thin] > 0.0:
            place = ", ".join(f"{x:.4g}" for x in self.patch.vertices[thin])
            raise SceneError(
                f"layer: its depth near ({place}) m is {depth[thin]:g} m, so elements there are flat or inverted; "
                "give depths above 0"
            )


def depth_of(body: "Slab | Layer") -> float:
    """Return the thickness of a slab, or the median depth of a layer [m]."""
    return float(np.median(body.patch.depth)) if isinstance(body, Layer) else body.thickness_m


def check_patch(patch: Patch) -> None:
    """Raise SceneError for numbers not finite, directions not of length 1, and faces with unknown vertices."""
    for name in ("vertices", "inward", "depth"):
        values = np.asarray(getattr(patch, name), dtype=float)
        if not np.isfinite(values).all():
            worst = int(np.flatnonzero(~np.isfinite(values.reshape(len(values), -1)).all(axis=1))[0])
            raise SceneError(f"layer: {name} of its patch has {values[worst].tolist()} at vertex {worst}; give numbers")
    length = np.linalg.norm(patch.inward, axis=1)
    worst = int(np.argmax(np.abs(length - 1.0)))
    if abs(length[worst] - 1.0) > 1e-3:
        raise SceneError(f"layer: inward direction of vertex {worst} has length {length[worst]:.3g}; give unit vectors")
    low, high = int(patch.faces.min(initial=0)), int(patch.faces.max(initial=-1))
    if low < 0 or high >= len(patch.vertices) or high < 0:
        raise SceneError(f"layer: faces name vertices {low} to {high}; there are {len(patch.vertices)}")


Body = Slab | Layer


@dataclass(frozen=True)
class Spot:
    """A round Gaussian spot of pressure a(t) exp(-4 ln 2 |x - c(t)|^2 / fwhm^2), x and c in the plane z = 0.

    On a layer the distance is measured in x and y, so the normal of its face should be along +z or -z.

    fwhm_m: full width at half maximum [m].
    times_s: [s], ascending, shape (f,); the load is 0 before the first time and constant after the last.
    peak_Pa: a at these times, shape (f,). centre_m: c, shape (f, 2), or (2,) if it is constant.
    law: a and c between these times: "linear", or "held" at the earlier value.
    A static load, for use with `static`, has one time, 0, and law "held".
    Raises SceneError for other shapes, times that do not ascend, and numbers that are not finite.
    """

    fwhm_m: float
    times_s: Float
    peak_Pa: Float
    centre_m: Float = field(default_factory=lambda: np.zeros(2))
    law: Law = "linear"

    def __post_init__(self) -> None:
        as_floats(self, "times_s", "peak_Pa", "centre_m")
        if not LEAST_M <= self.fwhm_m < math.inf:
            raise SceneError(f"spot: fwhm_m is {self.fwhm_m}; give a width of {LEAST_M:g} m or more")
        check_times("spot", self.times_s, self.law)
        count = len(self.times_s)
        check_finite("spot: peak_Pa", self.peak_Pa, (count,))
        still = np.shape(self.centre_m) == (2,)
        check_finite("spot: centre_m", self.centre_m, (2,) if still else (count, 2))

    def centres(self) -> Float:
        """Return the centre at each time, shape (f, 2)."""
        return np.broadcast_to(np.asarray(self.centre_m, dtype=float), (len(self.times_s), 2))


@dataclass(frozen=True)
class Traction:
    """Pressure given at points of the face.

    points: [m], shape (n, 3). weights_m2: area of each point [m^2], shape (n,).
    times_s: [s], ascending, shape (f,). pressure_Pa: shape (f, n). law: as for Spot.
    Raises SceneError as Spot, and for a weight below 0.
    """

    points: Float
    weights_m2: Float
    times_s: Float
    pressure_Pa: Float
    law: Law = "linear"

    def __post_init__(self) -> None:
        as_floats(self, "points", "weights_m2", "times_s", "pressure_Pa")
        check_times("traction", self.times_s, self.law)
        count = len(self.points)
        check_finite("traction: points", self.points, (count, 3))
        check_finite("traction: weights_m2", self.weights_m2, (count,))
        if self.weights_m2.min(initial=0.0) < 0.0:
            raise SceneError(f"traction: weights_m2 has {self.weights_m2.min()}; areas must be 0 or above")
        check_finite("traction: pressure_Pa", self.pressure_Pa, (len(self.times_s), count))


Load = Spot | Traction


def is_pressed(load: Load) -> bool:
    return bool(np.any(load.peak_Pa if isinstance(load, Spot) else load.pressure_Pa))


def between(load: Load, values: Float, times_s: Float) -> Float:
    """Interpolate values at the times of a load, (f, ...), by its law; return them at times [s], (t,): (t, ...)."""
    if load.law == "held":
        place = np.searchsorted(load.times_s, times_s, side="right") - 1
        return values[np.clip(place, 0, len(values) - 1)]
    columns = [np.interp(times_s, load.times_s, column) for column in values.reshape(len(values), -1).T]
    return np.stack(columns, axis=1).reshape(-1, *values.shape[1:])


@dataclass(frozen=True)
class Motion:
    """Motion of the skin at the requested times and points.

    times_s: shape (t,). points: [m], shape (n, 3).
    displacement_m, velocity_m_s: shape (t, n, 3).
    error: estimated relative error of the quantity `accuracy_of` (L2 over the times at a point, at the worst point).
    error_source: method of the estimate. solver: name and resolution, in words. seconds: computing time [s].
    displacement_error, velocity_error, normal_error: the same error for displacement, velocity, and displacement
        along the normal of the face; NaN without an estimate.
    """

    times_s: Float
    points: Float
    displacement_m: Float
    velocity_m_s: Float
    error: float
    error_source: str
    solver: str
    seconds: float
    accuracy_of: Quantity = "displacement"
    displacement_error: float = math.nan
    velocity_error: float = math.nan
    normal_error: float = math.nan


@dataclass(frozen=True)
class SkinProblem:
    """Input of a solver: body, load, requested times and points, and target accuracy. The body starts at rest.

    times: requested times [s], ascending, shape (t,). at: points of the face [m], shape (n, 2) or (n, 3).
    accuracy: target relative error of accuracy_of, L2 over the times at a point, at the worst point.
    accuracy_of: one of QUANTITIES. device: "auto", "cpu" or "cuda:N", for solvers that also run on a GPU.
    Raises SceneError for times that do not ascend, other shapes, numbers that are not finite, and another quantity.
    """

    body: Body
    load: Load
    times: Float
    at: Float
    accuracy: float = 0.05
    accuracy_of: Quantity = "displacement"
    device: str = "cpu"

    def __post_init__(self) -> None:
        check_quantity(self.accuracy_of)
        object.__setattr__(self, "times", rising("times", self.times))
        object.__setattr__(self, "at", requested_points(self.at))

    @property
    def judged(self) -> int:
        """Return the index of `accuracy_of` in QUANTITIES."""
        return check_quantity(self.accuracy_of)

    @cached_property
    def points(self) -> Float:
        """Points on the face of the body [m], shape (n, 3). Raises SceneError like `points_on_face`."""
        return points_on_face(self.body, self.at)

    def refuse(self, solver: str, refusal: Callable[[Body, Load], str | None]) -> None:
        """Raise SceneError if refusal_NAME of a solver returns a reason."""
        reason = refusal(self.body, self.load)
        if reason is not None:
            raise SceneError(f"solver '{solver}': {reason}")

    def solved(
        self,
        displacement_m: Float,
        velocity_m_s: Float,
        errors: Float,
        source: str,
        solver: str,
        begun: float,
        points: Float | None = None,
    ) -> Motion:
        """Make the Motion from the results of a solver, shapes (t, n, 3).

        errors: errors of the QUANTITIES, (3,); source, solver: texts; begun: time.perf_counter() at the start
        points: positions [m], shape (n, 3); default `points`
        """
        return Motion(
            times_s=self.times,
            points=self.points if points is None else points,
            displacement_m=displacement_m,
            velocity_m_s=velocity_m_s,
            error=float(errors[self.judged]),
            error_source=source,
            solver=solver,
            seconds=time.perf_counter() - begun,
            accuracy_of=self.accuracy_of,
            **{f"{name}_error": float(error) for name, error in zip(QUANTITIES, errors, strict=True)},
        )


def check_quantity(accuracy_of: str) -> int:
    """Return the index of a quantity in QUANTITIES. Raises SceneError for an unknown one."""
    if accuracy_of not in QUANTITIES:
        raise SceneError(f"accuracy_of is '{accuracy_of}'; use one of {', '.join(QUANTITIES)}")
    return QUANTITIES.index(accuracy_of)


def normals_on_face(body: Body, points: Float) -> Float:
    """Return outward unit normals of the face at points (n, 3), for a layer at the nearest vertices; shape (n, 3)."""
    if isinstance(body, Slab):
        return np.tile([0.0, 0.0, 1.0], (len(points), 1))
    patch = body.patch
    corners = patch.vertices[patch.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area *= -np.sign(np.einsum("ij,ij->i", area, patch.inward[patch.faces[:, 0]]))[:, None]
    summed = np.zeros_like(np.asarray(patch.vertices, dtype=float))
    np.add.at(summed, patch.faces, area[:, None])
    normals: Float = summed[cKDTree(patch.vertices).query(points)[1]]
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def as_floats(load: object, *names: str) -> None:
    """Replace these fields of a frozen load by float64 arrays."""
    for name in names:
        try:
            object.__setattr__(load, name, np.asarray(getattr(load, name), dtype=float))
        except (TypeError, ValueError) as error:
            raise SceneError(f"load: {name} is not an array of numbers ({error})") from error


def numbers(what: str, values: ArrayLike) -> Float:
    """Return values as an array. Raises SceneError for values that are not numbers."""
    try:
        return np.asarray(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise SceneError(f"{what} is {str(values)[:60]!r}; give numbers") from error


def rising(what: str, times_s: ArrayLike) -> Float:
    """Return times [s] as an array, (t,), t >= 1. Raises SceneError unless they are finite and ascending."""
    times = numbers(what, times_s)
    if times.ndim != 1 or len(times) == 0 or not np.isfinite(times).all() or not np.all(np.diff(times) > 0.0):
        raise SceneError(f"{what} of shape {times.shape} must be finite, rising and at least one")
    return times


def requested_points(at: ArrayLike) -> Float:
    """Return points as an array, (n, 2) or (n, 3). Raises SceneError for other shapes, no points, NaN or infinity."""
    points = numbers("at", at)
    if points.ndim != 2 or points.shape[1] not in (2, 3) or len(points) == 0 or not np.isfinite(points).all():
        raise SceneError(f"at of shape {points.shape}: give finite positions on the face, shape (n, 2) or (n, 3)")
    return points


def in_space(at: ArrayLike) -> Float:
    """Return points as an array (n, 3), with z = 0 if they have no z. Raises SceneError like `requested_points`."""
    points = requested_points(at)
    return points if points.shape[1] == 3 else np.column_stack([points, np.zeros(len(points))])


def lifted(patch: Patch, places: Float) -> Float:
    """Return the points of the face above or below places of the plane [m], (n, 2); shape (n, 3)."""
    from palmfield.hand.meshquery import over_plane

    corners, weights = over_plane(patch.vertices[:, :2], patch.faces, places)
    return np.column_stack([places, np.einsum("nk,nk->n", weights, patch.vertices[corners][:, :, 2])])


def points_on_face(body: Body, at: ArrayLike) -> Float:
    """Return requested points [m], (n, 3); z = 0 on a slab. Raises SceneError like `requested_points`, or off the body.

    A point is off a layer if no vertex of the patch is nearer than the longest edge of the patch.
    """
    points = requested_points(at)
    if isinstance(body, Layer):
        vertices, across = np.asarray(body.patch.vertices), points.shape[1]
        corners = vertices[body.patch.faces]
        longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        distance = cKDTree(vertices[:, :across]).query(points)[0]
        if distance.max() > longest:
            worst = int(np.argmax(distance))
            raise SceneError(
                f"point {worst} at {points[worst].tolist()} m is {distance[worst]:.3g} m from the layer; give "
                "points on its face"
            )
        return points if across == 3 else lifted(body.patch, points)
    flat = np.column_stack([points[:, :2], np.zeros(len(points))])
    outside = np.zeros(len(flat), dtype=bool)
    if body.shape == "disc":
        outside = np.hypot(flat[:, 0], flat[:, 1]) > (1.0 + 1e-9) * np.array(body.radius_m)
    elif body.shape == "box":
        outside = np.any(np.abs(flat[:, :2]) > (0.5 + 1e-9) * np.array(body.size_m), axis=1)
    if outside.any():
        worst = int(np.flatnonzero(outside)[0])
        raise SceneError(
            f"point {worst} at {flat[worst].tolist()} m is outside the slab, a {body.shape} of "
            f"{body.radius_m or body.size_m} m; give points on its face"
        )
    return flat


def spread(fwhm_m: float) -> float:
    """Return the standard deviation [m] of a Gaussian with this full width at half maximum [m]."""
    return fwhm_m / math.sqrt(2.0 * GAUSSIAN)


def check_times(what: str, times_s: Float, law: str) -> None:
    rising(f"{what}: times_s", times_s)
    if law not in ("linear", "held"):
        raise SceneError(f"{what}: law is '{law}'; use 'linear' or 'held'")


def check_finite(what: str, values: Float, shape: tuple[int, ...]) -> None:
    result = np.asarray(values, dtype=float)
    if result.shape != shape:
        raise SceneError(f"{what} has shape {result.shape}; give {shape}")
    if not np.isfinite(result).all():
        place = np.argwhere(~np.isfinite(result))[0].tolist()
        raise SceneError(f"{what} is not finite at {place}: correct it")
