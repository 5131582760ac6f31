"""Read the motion of skins from a result piece by piece: components along the normal, and extremes over time."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from palmfield.types import Float, Float32, Int

PIECE_BYTES = 16_000_000


def pieces(skin: xr.Dataset, name: str, times: slice = slice(None)) -> Iterator[tuple[slice, Float32]]:
    """Yield a variable along `time` in pieces of 16 MB: indices along the chosen times, and the values at them.

    skin: one of `instances(result, "skin")`; times: slice with a positive step
    """
    chosen = range(*times.indices(skin.sizes["time"]))
    row = skin[name].dtype.itemsize * int(np.prod(skin[name].shape[1:]))
    count = max(1, PIECE_BYTES // max(1, row))
    for start in range(0, len(chosen), count):
        part = chosen[start : start + count]
        values = skin[name].isel(time=slice(part.start, part.stop, part.step)).values
        yield slice(start, start + len(part)), values


def normal_pieces(
    skin: xr.Dataset, name: str = "displacement", times: slice = slice(None)
) -> Iterator[tuple[slice, Float32]]:
    """Yield the pieces of `pieces` as components along the outward normal at rest, shape (times, vertices)."""
    normals = skin["rest_normal"].values.astype(np.float32)
    for place, values in pieces(skin, name, times):
        yield place, np.einsum("tvi,vi->tv", values, normals)


def normal_component(skin: xr.Dataset, name: str = "displacement", times: slice = slice(None)) -> xr.DataArray:
    """Return displacement [m] or velocity [m/s] along the outward normal at rest, shape (time, vertex), float32.

    skin: one of `instances(result, "skin")`; name: `displacement` or `velocity`; times: slice, all by default Motion
    into the skin is negative. Vectors are read in pieces, so only this component is in memory.
    """
    chosen = skin["time"].isel(time=times)
    out = np.empty((len(chosen), skin.sizes["vertex"]), np.float32)
    for place, values in normal_pieces(skin, name, times):
        out[place] = values
    attributes = {"units": skin[name].attrs.get("units", ""), "long_name": f"normal component of {name}",
                  "sign": "positive outward: a push is negative"}  # fmt: skip
    return xr.DataArray(out, {"time": chosen}, ("time", "vertex"), f"normal_{name}", attributes)


class Extremes(NamedTuple):
    """Extremes over time of a normal component at every vertex, shapes (vertices,).

    peak: largest magnitude
    when: index of the largest magnitude along `time`
    mean, mean_square: means over time
    """

    peak: Float
    when: Int
    mean: Float
    mean_square: Float


def extremes(skin: xr.Dataset, name: str = "displacement") -> Extremes:
    """Return the extremes of `normal_component`, in one pass."""
    count = skin.sizes["vertex"]
    peak, when = np.full(count, -1.0), np.zeros(count, np.int32)
    total, squares = np.zeros(count), np.zeros(count)
    for place, values in normal_pieces(skin, name):
        sizes = np.abs(values)
        best = sizes.argmax(axis=0)
        largest = np.take_along_axis(sizes, best[None], axis=0)[0]
        higher = largest > peak
        when[higher] = place.start + best[higher]
        peak[higher] = largest[higher]
        total += values.sum(axis=0, dtype=np.float64)
        squares += np.einsum("tv,tv->v", values, values, dtype=np.float64)
    records = max(1, skin.sizes["time"])
    return Extremes(np.maximum(peak, 0.0), when, total / records, squares / records)


def at_vertices(skin: xr.Dataset, vertices: list[int], name: str = "displacement") -> Float32:
    """Return the normal component over time at a few vertices, shape (times, len(vertices))."""
    few = skin.isel(vertex=vertices)
    return np.asarray(np.einsum("tvi,vi->tv", few[name].values, few["rest_normal"].values), dtype=np.float32)
