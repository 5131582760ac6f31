"""Quantities at the vertices of skins over time, in a USD scene."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from palmfield.types import Float32


class Quantity(NamedTuple):
    """A quantity of a skin. Its key in QUANTITIES is the name of its primvar.

    variable: variable of group /skin of the result; "" for a quantity computed from the displacement
    along_normal: whether it is the component along the outward normal at rest
    unit: SI unit of the primvar
    sign: meaning of a positive value
    title: title in legends
    shown_unit: unit in the legend
    per_unit: number of shown units in one unit of the primvar
    two_sided: whether values have both signs
    keeps_sum: whether rounding must preserve the sum over areas
    """

    variable: str
    along_normal: bool
    unit: str
    sign: str
    title: str
    shown_unit: str
    per_unit: float
    two_sided: bool
    keeps_sum: bool


OUTWARD = "positive along the outward normal: a push is negative"
QUANTITIES: dict[str, Quantity] = {
    "normal_displacement": Quantity(
        "displacement", True, "m", OUTWARD, "normal displacement", "µm", 1e6, True, False
    ),
    "normal_velocity": Quantity("velocity", True, "m/s", OUTWARD, "normal velocity", "mm/s", 1e3, True, False),
    "arp": Quantity(
        "arp", False, "Pa", "positive values push into the surface", "radiation pressure", "Pa", 1.0, False, True
    ),
    "pressure": Quantity(
        "pressure", False, "Pa", "peak amplitude of the sound pressure, never negative", "sound pressure", "Pa",
        1.0, False, False,
    ),
    "level": Quantity(
        "", False, "dB", "dB SL: values above 0 are felt", "level", "dB SL", 1.0, False, False
    ),
}  # fmt: skip


def values_at(skin: xr.Dataset, quantity: Quantity, times: slice) -> Float32:
    """Return a recorded quantity at some times of the run, shape (t, vertices), float32."""
    values = skin[quantity.variable].isel(time=times).values
    if not quantity.along_normal:
        return np.asarray(values, np.float32)
    normals = skin["rest_normal"].values.astype(np.float32)
    return np.asarray(np.einsum("tvi,vi->tv", values, normals), np.float32)
