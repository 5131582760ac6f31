"""Write the sound field of a run to USD: a slice through the focus, points of high pressure, or isosurfaces."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from pxr import Gf, Usd, UsdGeom, Vt

from palmfield.outputs.frames import check_time, pose_at, to_local, to_world
from palmfield.outputs.sound import driven_arrays, sound_at, sounding_foci
from palmfield.outputs.usd.clock import Clock
from palmfield.outputs.usd.looks import Palette, indices_of, paint, palette_of
from palmfield.outputs.usd.prims import about, add_mesh, add_primvar, describe_rounding, floats, integers, vectors
from palmfield.outputs.usd.quantise import Rounding, rounding
from palmfield.outputs.usd.quantities import QUANTITIES
from palmfield.outputs.usd.samples import Samples
from palmfield.outputs.usd.shown import Shown
from palmfield.types import Float, Int

SLICE_STEP_M = 1.5e-3
"""Spacing of points of the slice [m], a sixth of a wavelength."""
MARGIN_M = 0.05
"""Distance by which the slice extends beyond the foci on both sides [m]."""
BEGINS_M, BEYOND_M = 0.01, 0.04
"""Distance from the array at which the slice begins, and distance by which it extends beyond the focus [m]."""
ROUND_M = 0.025
"""Margin around the foci of the box for points and isosurfaces [m]."""
MOST_IN_BOX = 100_000
REACH_M = 0.2
"""Distance of the focus from the array that is assumed for a drive without a focus [m]."""
POINT_M = 1.2e-3


class _Moment(NamedTuple):
    """The sound at one time.

    time_s: the time [s]
    slice_Pa: peak amplitudes on the slice, shape (n,)
    box_Pa: peak amplitudes in the box, shape (m,)
    """

    time_s: float
    slice_Pa: Float
    box_Pa: Float


class _Grid(NamedTuple):
    """Points in the world [m].

    slice: points of a grid of `shape`, shape (n, 3)
    box: points of a grid of `sides`, shape (m, 3)
    """

    slice: Float
    shape: tuple[int, int]
    box: Float
    sides: tuple[int, int, int]


def add_field(stage: Usd.Stage, result: xr.DataTree, shown: Shown, clock: Clock) -> Palette:
    """Add the requested shapes of the field at the requested times; return their common palette.

    The field is the peak amplitude of `palmfield.outputs.sound.sound_at` (incident, free air). Raises its errors,
    and OutputError for a result without drives and for times outside the run.
    """
    arrays = driven_arrays(result)
    loud = {name: array["drive_amplitude"].values.sum(axis=1) for name, array in arrays.items()}
    first = max(loud, key=lambda name: float(loud[name].max()))
    times = shown.field_times_s or (float(arrays[first]["frame_time"].values[int(loud[first].argmax())]),)
    recorded = result.coords["time"].values
    for time_s in times:
        check_time("--field-time", time_s, float(recorded[0]), float(recorded[-1]))
    root = UsdGeom.Scope.Define(stage, "/Scene/Field").GetPrim()
    grid = _grid(result, arrays[first], times)
    moments = []
    for time_s in sorted(times):
        places = [grid.slice, grid.box] if set(shown.field) - {"slice"} else [grid.slice]
        amplitude = np.abs(sound_at(arrays, np.concatenate(places), time_s))
        moments.append(_Moment(time_s, amplitude[: len(grid.slice)], amplitude[len(grid.slice) :]))
    boxed = max(float(moment.box_Pa.max(initial=0.0)) for moment in moments)
    top = max(boxed, *(float(moment.slice_Pa.max()) for moment in moments)) or 1.0
    palette, level = palette_of(0.0, top, False, None), 0.5 * boxed if shown.level_Pa is None else shown.level_Pa
    about(root, times_s=[moment.time_s for moment in moments], level_Pa=level)
    if "slice" in shown.field:
        _add_slice(stage, grid, moments, palette, rounding(0.0, top), clock)
    if "points" in shown.field:
        _add_points(stage, grid, moments, palette, level, rounding(0.0, top), clock)
    if "isosurface" in shown.field:
        _add_surface(stage, grid, moments, palette, level, clock)
    return palette


def _grid(result: xr.DataTree, array: xr.Dataset, times: tuple[float, ...]) -> _Grid:
    frame = pose_at(array, times[0])
    foci = np.concatenate([to_local(sounding_foci(result, time_s), frame) for time_s in times])
    if len(foci) == 0:
        foci = np.array([[0.0, 0.0, REACH_M]])
    middle = foci.mean(axis=0)
    spread = np.linalg.svd((foci - middle)[:, :2])[2][0] if len(foci) > 1 else np.array([1.0, 0.0])
    places = (foci - middle)[:, :2] @ spread
    across = np.arange(places.min() - MARGIN_M, places.max() + MARGIN_M, SLICE_STEP_M)
    ahead = np.arange(BEGINS_M, foci[:, 2].max() + BEYOND_M, SLICE_STEP_M)
    side, away = np.meshgrid(across, ahead, indexing="ij")
    flat = middle[:2] + side.ravel()[:, None] * spread
    low, high = foci.min(axis=0) - ROUND_M, foci.max(axis=0) + ROUND_M
    step = max(SLICE_STEP_M, float(np.prod(high - low) / MOST_IN_BOX) ** (1.0 / 3.0))
    ticks = [np.arange(a, b + 0.5 * step, step) for a, b in zip(low, high, strict=True)]
    box = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1)
    sides = box.shape[0], box.shape[1], box.shape[2]
    slice_ = to_world(np.column_stack([flat, away.ravel()]), frame)
    return _Grid(slice_, (len(across), len(ahead)), to_world(box.reshape(-1, 3), frame), sides)


def _add_slice(
    stage: Usd.Stage, grid: _Grid, moments: list[_Moment], palette: Palette, rounded: Rounding, clock: Clock
) -> None:
    rows, columns = grid.shape
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.stack([corner, corner + columns, corner + columns + 1, corner + 1], axis=1)
    mesh = add_mesh(stage, "/Scene/Field/Slice", grid.slice, faces, None)
    pressed, numbers = _pressure_of(mesh, palette, rounded)
    for moment in moments:
        pressed.add(clock.code(moment.time_s), rounded.of(moment.slice_Pa))
        numbers.add(clock.code(moment.time_s), palette.numbers(moment.slice_Pa))


def _add_points(
    stage: Usd.Stage,
    grid: _Grid,
    moments: list[_Moment],
    palette: Palette,
    level: float,
    rounded: Rounding,
    clock: Clock,
) -> None:
    points = UsdGeom.Points.Define(stage, "/Scene/Field/Points")
    points.CreateWidthsAttr(Vt.FloatArray([POINT_M]))
    points.SetWidthsInterpolation(UsdGeom.Tokens.constant)
    low, high = grid.box.min(axis=0) - POINT_M, grid.box.max(axis=0) + POINT_M
    points.CreateExtentAttr(Vt.Vec3fArray([Gf.Vec3f(*low.tolist()), Gf.Vec3f(*high.tolist())]))
    places = Samples(points.CreatePointsAttr(), vectors)
    pressed, numbers = _pressure_of(points, palette, rounded)
    for moment in moments:
        inside, code = moment.box_Pa >= level, clock.code(moment.time_s)
        places.add(code, grid.box[inside])
        pressed.add(code, rounded.of(moment.box_Pa[inside]))
        numbers.add(code, palette.numbers(moment.box_Pa[inside]))


def _pressure_of(prim: UsdGeom.Gprim, palette: Palette, rounded: Rounding) -> tuple[Samples, Samples]:
    quantity = QUANTITIES["pressure"]
    details = describe_rounding(rounded)
    primvar = add_primvar(prim.GetPrim(), "pressure", quantity.unit, quantity.sign, details)
    colour = paint(prim, palette, "vertex", quantity="pressure", units=quantity.unit)
    return Samples(primvar.GetAttr(), floats), Samples(indices_of(colour), integers)


def _add_surface(
    stage: Usd.Stage, grid: _Grid, moments: list[_Moment], palette: Palette, level: float, clock: Clock
) -> None:
    colour = palette.colours[int(palette.numbers(np.array(level)))]
    mesh = add_mesh(stage, "/Scene/Field/Isosurface", grid.box[:1], np.zeros((0, 3)), tuple(colour.tolist()))
    mesh.CreateDisplayOpacityPrimvar(UsdGeom.Tokens.constant).Set(Vt.FloatArray([0.6]))
    about(mesh.GetPrim(), level_Pa=level, quantity="pressure", units="Pa")
    low, high = grid.box.min(axis=0), grid.box.max(axis=0)
    mesh.GetExtentAttr().Set(Vt.Vec3fArray([Gf.Vec3f(*low.tolist()), Gf.Vec3f(*high.tolist())]))
    attributes = mesh.GetPointsAttr(), mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr()
    places, counts, corners = (
        Samples(attribute, make) for attribute, make in zip(attributes, (vectors, integers, integers), strict=True)
    )
    for moment in moments:
        points, faces = isosurface(moment.box_Pa.reshape(grid.sides), level)
        code = clock.code(moment.time_s)
        places.add(code, _between(grid, points))
        counts.add(code, np.full(len(faces), 3, np.int32))
        corners.add(code, faces.ravel())


def isosurface(values: Float, level: float) -> tuple[Float, Int]:
    """Return the isosurface of values on a grid: points in grid steps, shape (p, 3), and triangles, shape (m, 3).

    Triangles are counter-clockwise if seen from the side of lower values.
    """
    if not values.min() < level < values.max():
        return np.zeros((0, 3)), np.zeros((0, 3), np.int32)
    # Here, because it takes 0.15 s and most scenes have no surface
    import warp as wp
    from warp.geometry import IsoSurfaceMarchingCubes

    field: Any = wp.array(values, dtype=wp.float32, device="cpu")
    last = [float(side - 1) for side in values.shape]
    points, corners = IsoSurfaceMarchingCubes.extract(field, threshold=level, lower=wp.vec3(0.0), upper=wp.vec3(*last))
    return points.numpy().astype(float), corners.numpy().reshape(-1, 3)[:, ::-1]


def _between(grid: _Grid, points: Float) -> Float:
    """Convert points in steps of the box grid to the world [m]."""
    box = grid.box.reshape(*grid.sides, 3)
    origin = box[0, 0, 0]
    steps = np.stack([box[1, 0, 0] - origin, box[0, 1, 0] - origin, box[0, 0, 1] - origin])
    return origin + points @ steps
