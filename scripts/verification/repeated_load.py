"""Compute the steady motion of an infinite flat layer under a periodic spot by its lines, exact in frequency.

A load with period T has lines at n/T. Each is a pattern of pressure, which the compliance of the layer (`layer_oracle`)
converts into motion. The layer is periodic with `span_m` in both directions, far enough for waves to decay.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import fftfreq, ifft2
from scipy.interpolate import CubicSpline

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import layer_compliance
from palmfield.skin.materials.material import Material
from palmfield.types import Complex, Float

TABLE = 400
"""Wavenumbers of the computed compliance; between them a cubic interpolates."""
NEAR_M = 1e-5
"""Half of the distance of the two depths whose difference is used for a compression [m]."""


@dataclass(frozen=True)
class RepeatedSpot:
    """A Gaussian spot; each position and pressure lasts for one of equal parts of a period.

    centres_m: shape (p, 2) [m]; peak_Pa: peak pressure at each [Pa], shape (p,); fwhm_m: full width at half maximum [m]
    Raises SceneError for other shapes, and a width that is not above 0.
    """

    centres_m: Float
    peak_Pa: Float
    fwhm_m: float

    def __post_init__(self) -> None:
        count = len(np.atleast_1d(self.peak_Pa))
        if np.shape(self.centres_m) != (count, 2) or np.shape(self.peak_Pa) != (count,):
            raise SceneError(
                f"centres_m has shape {np.shape(self.centres_m)} and peak_Pa {np.shape(self.peak_Pa)}; allowed: (p, 2) "
                "and (p,)"
            )
        if not self.fwhm_m > 0.0:
            raise SceneError(f"fwhm_m is {self.fwhm_m}; give a width above 0")


@dataclass(frozen=True)
class FlatLayer:
    """An infinite layer bonded to bone, evaluated on a square.

    span_m: period of the square [m]; cells: number of points along it, span_m / cells apart
    """

    material: Material
    thickness_m: float
    span_m: float = 0.4
    cells: int = 160

    def places(self) -> Float:
        """Return the coordinates of the grid along x and along y [m], shape (cells,), including 0."""
        return np.asarray((np.arange(self.cells) - self.cells // 2) * (self.span_m / self.cells), dtype=float)

    def lines(
        self,
        spots: Sequence[RepeatedSpot],
        rate_Hz: float,
        orders: Sequence[int],
        depth_m: float = 0.0,
        compression: bool = False,
    ) -> Complex:
        """Return the displacement into the layer at lines of some orders [m], shape (n, cells, cells), x last.

        Complex peak amplitudes for e^{-iwt} at `places`; order 0 is the mean. spots: simultaneous spots, all with the
        period 1/rate_Hz. depth_m: below the surface. compression: the compression along the normal instead Raises
        SceneError for orders below 0, and a rate that is not above 0.
        """
        if not rate_Hz > 0.0 or min(orders) < 0:
            raise SceneError(f"rate_Hz {rate_Hz}, orders {list(orders)}; allowed: above 0, and orders of 0 or more")
        k = 2.0 * math.pi * fftfreq(self.cells, self.span_m / self.cells)
        length = np.hypot(k[:, None], k[None, :])
        pressure = np.sum([_over_face(spot, k, length, orders) for spot in spots], axis=0)
        table = np.linspace(0.0 if depth_m == 0.0 else 1e-3, float(length.max()), TABLE)
        result = np.empty((len(orders), self.cells, self.cells), dtype=complex)
        for row, order in enumerate(orders):
            values = self._compliance(table, order * rate_Hz, depth_m, compression)
            waves = CubicSpline(table, values)(np.maximum(length, table[0])) * pressure[row]
            result[row] = np.fft.fftshift(ifft2(waves)) * (self.cells / self.span_m) ** 2
        return result

    def _compliance(self, k: Float, f_Hz: float, depth_m: float, compression: bool) -> Complex:
        def at(depth: float) -> Complex:
            return layer_compliance(k, f_Hz, self.material, self.thickness_m, depth_m=depth)

        return (at(depth_m - NEAR_M) - at(depth_m + NEAR_M)) / (2.0 * NEAR_M) if compression else at(depth_m)


def transform(spot: RepeatedSpot, orders: Sequence[int]) -> Complex:
    """Return the lines of the pressure at each position of a spot [Pa], shape (n, p); order 0 is the mean."""
    count = len(spot.peak_Pa)
    number = np.asarray(orders, dtype=float)[:, None]
    edges = np.exp(2j * math.pi * number * np.arange(count + 1) / count)
    # Twice the mean of q e^{+iwt}: Re(line e^{-iwt}) is the line
    weights = np.where(number == 0.0, 1.0 / count, np.diff(edges, axis=1) / (1j * math.pi * np.maximum(number, 1.0)))
    return np.asarray(weights * spot.peak_Pa)


def _over_face(spot: RepeatedSpot, k: Float, length: Float, orders: Sequence[int]) -> Complex:
    """Return the lines of the pressure transformed over the face [Pa m2], shape (n, cells, cells)."""
    along_x, along_y = (np.exp(-1j * np.outer(spot.centres_m[:, axis], k)) for axis in (0, 1))
    at_places = (along_y[:, :, None] * along_x[:, None, :]).reshape(len(along_x), -1)
    waves = (transform(spot, orders) @ at_places).reshape(-1, *length.shape)
    spread = spot.fwhm_m / math.sqrt(8.0 * math.log(2.0))
    return np.asarray(waves * (2.0 * math.pi * spread**2 * np.exp(-0.5 * (length * spread) ** 2)))
