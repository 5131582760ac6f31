"""Write the skins of a run to USD: quantities at each vertex over time, colours and magnified motion."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from pxr import Sdf, Usd, UsdGeom

from palmfield.hand.triangles import vertex_areas
from palmfield.outputs.afferents import mean_rates, spikes_of
from palmfield.outputs.levels import LevelCourse
from palmfield.outputs.motion import PIECE_BYTES
from palmfield.outputs.schema import has_records
from palmfield.outputs.usd.clock import Clock
from palmfield.outputs.usd.looks import Palette, indices_of, paint
from palmfield.outputs.usd.prims import about, add_mesh, add_primvar, describe_rounding, floats, integers, vectors
from palmfield.outputs.usd.quantise import Rounding, rounding
from palmfield.outputs.usd.quantities import QUANTITIES, Quantity, values_at
from palmfield.outputs.usd.samples import Samples
from palmfield.types import Float, Float32, Int

MOTION = "motion"
REST, MAGNIFIED = "rest", "magnified"
"""Variant set of each skin, and its two variants: points at rest, and points moved by a factor."""
LOUDEST = {
    "loudest_arp": "at the loudest instant; positive values push into the surface",
    "loudest_pressure": "peak amplitude at the loudest instant",
}
"""Quantities of skins and bodies at the loudest moment [Pa], with their signs."""
AFFERENT_M = 5e-4
"""Drawn width of the point of an afferent [m]."""


def strip_order(points: Float) -> Int:
    """Return the order of points [m], shape (n, 3), as indices, shape (n,).

    They are in strips of alternating direction.

    The strips are parallel to the longest axis and as wide as the point spacing. This order compresses well: the file
    of a wave on 71 x 71 points is 6 % smaller than with a Hilbert curve, and 30 % smaller than with unordered points.
    """
    local = points - points.mean(axis=0)
    along, across = (local @ np.linalg.svd(local, full_matrices=False)[2][:2].T).T
    width = np.sqrt(np.ptp(along) * np.ptp(across) / len(points))
    strip = np.rint((across - across.min()) / width if width > 0.0 else np.zeros(len(points))).astype(int)
    return np.lexsort((np.where(strip % 2, -along, along), strip)).astype(np.int32)


def frame_blocks(skin: xr.Dataset | None, clock: Clock, most: int) -> Iterator[slice]:
    """Yield the frames in blocks of at most `most` frames.

    Blocks are smaller if the vectors of a skin would be too large.
    """
    row = 12 * (1 if skin is None else skin.sizes["vertex"])
    size = max(1, min(most, PIECE_BYTES // row))
    for start in range(0, len(clock.codes), size):
        yield slice(start, min(start + size, len(clock.codes)))


def result_times(clock: Clock, frames: slice) -> slice:
    """Return the indices of frames among the times of the result."""
    step = clock.places.step
    return slice(clock.places.start + frames.start * step, clock.places.start + (frames.stop - 1) * step + 1, step)


def recorded_quantities(skin: xr.Dataset) -> dict[str, Quantity]:
    """Return the quantities of a skin that the result has over time."""
    return {name: q for name, q in QUANTITIES.items() if q.variable and has_records(skin, q.variable)}


def ranges_of(skin: xr.Dataset, clock: Clock, names: list[str]) -> dict[str, tuple[float, float]]:
    """Return the lowest and highest value of recorded quantities at the times of the clock, in one pass."""
    found = {name: (np.inf, -np.inf) for name in names}
    for frames in frame_blocks(skin, clock, PIECE_BYTES):
        for name, (low, high) in found.items():
            values = values_at(skin, QUANTITIES[name], result_times(clock, frames))
            found[name] = min(low, float(values.min())), max(high, float(values.max()))
    return found


class _Track(NamedTuple):
    """One quantity that is written. colour: palette and target of its indices, if this quantity gives the colour"""

    quantity: Quantity
    rounding: Rounding
    samples: Samples
    colour: tuple[Palette, Samples] | None

    def extend(self, codes: Sequence[float], values: Float32, rows: Any = slice(None)) -> None:
        """Add values at rising time codes; rows: rows of the values, shape (t, vertices), for each code"""
        self.samples.extend(codes, self.rounding.of(values)[rows])
        if self.colour is not None:
            palette, numbers = self.colour
            numbers.extend(codes, palette.numbers(values)[rows])


def add_afferents(stage: Usd.Stage, path: str, skin: xr.Dataset) -> None:
    """Add the afferents of a skin at rest, if it has any, with their classes and mean rates."""
    if not has_records(skin, "afferent_motion") or skin.sizes["time"] < 2:
        return
    points = UsdGeom.Points.Define(stage, path)
    points.CreatePointsAttr(vectors(skin["afferent_position"].values))
    points.CreateWidthsAttr(floats(np.full(skin.sizes["afferent"], AFFERENT_M)))
    classes = UsdGeom.PrimvarsAPI(points).CreatePrimvar("afferent_class", Sdf.ValueTypeNames.TokenArray, "vertex")
    classes.Set(skin["afferent_class"].values.tolist())
    add_primvar(points.GetPrim(), "mean_rate", "s-1", "spikes per second over the run", {}).Set(
        floats(mean_rates(skin, spikes_of(skin)))
    )


class SkinWriter:
    """Writes one skin, frame by frame.

    mesh: mesh of the skin, with vertices in the order of `strip_order`; order: number of each vertex in the result
    """

    def __init__(self, stage: Usd.Stage, path: str, skin: xr.Dataset, colour: tuple[float, ...]):
        """colour: colour of the skin if it has no colours over time"""
        rest = skin["rest_position"].values
        self._stage, self._skin = stage, skin
        self.order: Int = strip_order(rest)
        place = np.empty(len(rest), np.int32)
        place[self.order] = np.arange(len(rest), dtype=np.int32)
        self._areas = vertex_areas(rest, skin["face"].values)[self.order]
        normals = skin["rest_normal"].values[self.order]
        self.mesh = add_mesh(stage, path, rest[self.order], place[skin["face"].values], colour, normals)
        numbers = UsdGeom.PrimvarsAPI(self.mesh).CreatePrimvar("vertex_number", Sdf.ValueTypeNames.IntArray, "vertex")
        numbers.Set(integers(self.order))
        about(numbers.GetAttr(), units="1", sign="number of the vertex in result.nc, from 0")
        for name, sign in LOUDEST.items():
            if has_records(skin, name):
                add_primvar(self.mesh.GetPrim(), name, "Pa", sign, {}).Set(floats(skin[name].values[self.order]))
        self._tracks: dict[str, _Track] = {}
        self._levels: LevelCourse | None = None
        self._magnify: tuple[float, Any] | None = None

    def add_quantity(self, name: str, low: float, high: float, palette: Palette | None, **facts: Any) -> None:
        """Add a quantity with values from low to high; with a palette it also colours the skin."""
        quantity = QUANTITIES[name]
        rounded = rounding(low, high, self._areas if quantity.keeps_sum else None)
        details = describe_rounding(rounded) | facts
        primvar = add_primvar(self.mesh.GetPrim(), name, quantity.unit, quantity.sign, details)
        coloured = None
        if palette is not None:
            colour = paint(self.mesh, palette, "vertex", quantity=name, units=quantity.unit)
            coloured = palette, Samples(indices_of(colour), integers)
        self._tracks[name] = _Track(quantity, rounded, Samples(primvar.GetAttr(), floats), coloured)

    def set_levels(self, course: LevelCourse) -> None:
        """Set the source of the level above threshold. Call `add_quantity` for this quantity first."""
        self._levels = course

    def magnify(self, factor: float) -> None:
        """Move the points by a factor in the variant "magnified"; the variant "rest" is selected."""
        about(self.mesh.GetPrim(), magnification=factor)
        variants = self.mesh.GetPrim().GetVariantSets().AddVariantSet(MOTION)
        # A value of the prim overrides those in variants, so it is set only in variants
        shape = self.mesh.GetPointsAttr(), self.mesh.GetExtentAttr(), self.mesh.GetNormalsAttr()
        initial = {attribute: attribute.Get() for attribute in shape}
        for attribute in initial:
            attribute.Clear()
        for name in (MAGNIFIED, REST):
            variants.AddVariant(name)
            variants.SetVariantSelection(name)
            with variants.GetVariantEditContext():
                for attribute, value in initial.items():
                    # Normals at rest are wrong for the magnified skin; viewers compute its normals
                    if name == REST or attribute.GetName() != UsdGeom.Tokens.normals:
                        attribute.Set(value)
        self._magnify = factor, variants

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones."""
        times, codes = result_times(clock, frames), clock.codes[frames].tolist()
        for track in self._tracks.values():
            if track.quantity.variable:
                track.extend(codes, values_at(self._skin, track.quantity, times)[:, self.order])
        if self._levels is not None:
            each = [self._levels.window_at(time_s) for time_s in clock.times_s[frames].tolist()]
            windows, rows = np.unique(each, return_inverse=True)
            levels = np.stack([self._levels.levels(window) for window in windows.tolist()])
            self._tracks["level"].extend(codes, levels[:, self.order], rows)
        self._write_points(clock, frames)

    def _write_points(self, clock: Clock, frames: slice) -> None:
        if self._magnify is None:
            return
        factor, variants = self._magnify
        rest = self._skin["rest_position"].values[self.order]
        normals = self._skin["rest_normal"].values[self.order]
        motion = values_at(self._skin, QUANTITIES["normal_displacement"], result_times(clock, frames))[:, self.order]
        moved = (rest + factor * motion[:, :, None].astype(np.float64) * normals).astype(np.float32)
        boxes = np.stack([moved.min(axis=1), moved.max(axis=1)], axis=1)
        variants.SetVariantSelection(MAGNIFIED)
        with variants.GetVariantEditContext(), Sdf.ChangeBlock():
            points, extent = self.mesh.GetPointsAttr(), self.mesh.GetExtentAttr()
            for code, row, box in zip(clock.codes[frames].tolist(), moved, boxes, strict=True):
                points.Set(vectors(row), code)
                extent.Set(vectors(box), code)
        variants.SetVariantSelection(REST)
