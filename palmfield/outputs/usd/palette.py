"""Colours of a quantity: a constant palette, and numbers over time that index it."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray
from pxr import UsdGeom

from palmfield.outputs.style import linear_rgb, signed_colours
from palmfield.outputs.usd.prims import about, vectors
from palmfield.types import Float, Int

COLOURS = 256


class Palette(NamedTuple):
    """Colour palette of a quantity.

    low, high: mapped range, in the unit of the primvar
    colours: sRGB, shape (256, 3)
    map: name of the colour map
    """

    low: float
    high: float
    colours: Float
    map: str

    @property
    def at_rest(self) -> tuple[float, ...]:
        """Return the colour of zero in linear RGB.

        If the range excludes zero, return the colour of the end closest to zero.
        """
        return tuple(linear_rgb(self.colours[int(self.numbers(np.zeros(1))[0])]).tolist())

    def numbers(self, values: NDArray[np.floating]) -> Int:
        """Return the index of the colour of each value, clipped to the range."""
        share = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        return np.rint(np.clip(share, 0.0, 1.0) * (COLOURS - 1)).astype(np.int32)


def palette_of(low: float, high: float, two_sided: bool, limits: tuple[float, float] | None) -> Palette:
    """Return the palette of a quantity with values from low to high.

    two_sided: whether values have both signs. If so, blue is below zero and red above, symmetric unless limits are set.
    If not, colours go from pale (zero) to dark.
    """
    if limits is None:
        top = max(abs(low), abs(high)) or 1.0
        limits = (-top, top) if two_sided else (min(low, 0.0), max(high, 0.0) if high > min(low, 0.0) else 1.0)
    if two_sided:
        return Palette(*limits, signed_colours(*limits, cut_off=0.03)[:, :3], "RdBu_r")
    return Palette(*limits, np.asarray(colormaps["magma_r"](np.linspace(0.04, 0.90, COLOURS)))[:, :3], "magma_r")


def cyclic_palette(period: float) -> Palette:
    """Return the palette of phases from 0 to a period."""
    return Palette(0.0, period, np.asarray(colormaps["twilight"](np.linspace(0.0, 1.0, COLOURS)))[:, :3], "twilight")


def paint(prim: UsdGeom.Gprim, palette: Palette, interpolation: str, **facts: Any) -> UsdGeom.Primvar:
    """Add a palette with its description to a prim. The indices of the primvar select the colours."""
    colour = prim.CreateDisplayColorPrimvar(interpolation)
    colour.Set(vectors(linear_rgb(palette.colours)))
    about(colour.GetAttr(), low=palette.low, high=palette.high, map=palette.map, **facts)
    return colour


def indices_of(colour: UsdGeom.Primvar) -> Any:
    """Return the attribute with the indices of a painted primvar."""
    return colour.CreateIndicesAttr()
