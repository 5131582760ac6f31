"""Predict the force on a plate in the focus relative to the usual formula, for laboratories.

A laboratory measures the pressure in the focus without the plate, by a small microphone, and the force on a plate
there, by a scale. The formula is 2 p_rms^2/(rho c^2), integrated over the plate. `python
scripts/verification/predictions.py` writes the page.
"""

from dataclasses import dataclass

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.echo import image_count
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.focus import focus
from palmfield.acoustics.nonlinear import arp_left, beam_steepening, fundamental_left
from palmfield.instruments.force import Plate, plate_force
from palmfield.types import Air, Complex, Field, Float

LAYOUTS = ("uhev1", "autd2018_2x2")
DEPTHS_M = (0.1, 0.2, 0.3)
PLATES_M = (0.012, 0.2, 0.4)
LEVELS = (0.25, 0.5, 1.0)
"""Amplitudes of the drive relative to full."""
FRINGE_PLACES = 8
"""Number of plate positions within half a wavelength, to sample the fringe."""
SPACING_M, FRINGE_SPACING_M = 2e-3, 4e-3
SMALL_SPACINGS = 24
"""Number of spacings on the edge of a small plate."""


@dataclass(frozen=True)
class Case:
    """Force [N] on a plate by the law and by the formula, at full drive and p0 of the layout.

    coarser: the ratio of both with a doubled spacing; fringe: largest minus smallest force over the mean, while the
    plate moves by half a wavelength and the face of the array reflects like a wall; fringe_mean: that mean over the
    force without echoes; sigma: steepening of the beam at full drive
    """

    layout: str
    depth_m: float
    plate_m: float
    force_N: float
    formula_N: float
    coarser: float
    fringe: float
    fringe_mean: float
    sigma: float

    @property
    def ratio(self) -> float:
        """Return the force by the law over that by the formula, without nonlinear steepening."""
        return self.force_N / self.formula_N

    def as_measured(self, level: float) -> float | None:
        """Return the ratio if the formula uses the fundamental of the microphone; None above sigma 1."""
        sigma = level * self.sigma
        return None if sigma > 1.0 else self.ratio * arp_left(sigma) / fundamental_left(sigma) ** 2


def case(name: str, depth_m: float, plate_m: float) -> Case:
    array, air = layout(name), Air()
    field = FieldEvaluator(array, air, device="cpu")
    drive = focus(array, air, [0.0, 0.0, depth_m])
    force, coarse = _force(field, drive, depth_m, plate_m, "default")
    formula, coarse_formula = _force(field, drive, depth_m, plate_m, "alpha")
    images = image_count(air, array.frequency_Hz, depth_m)
    half = 0.5 * sound_speed(air) / array.frequency_Hz
    places = depth_m + half * (np.arange(FRINGE_PLACES) / FRINGE_PLACES - 0.5)
    # The beam stays focused where it was: only the plate moves
    echoing, alone = (
        np.array([_force(field, drive, place, plate_m, "default", count, FRINGE_SPACING_M)[0] for place in places])
        for count in (images, 0)
    )
    return Case(
        name, depth_m, plate_m, force, formula, coarse / coarse_formula,
        float(np.ptp(echoing) / echoing.mean()), float(echoing.mean() / alone.mean()),
        beam_steepening(array, drive, [0.0, 0.0, depth_m], air),
    )  # fmt: skip


def _force(
    field: FieldEvaluator,
    drive: Complex,
    depth_m: float,
    plate_m: float,
    law: str,
    images: int = 0,
    spacing_m: float = SPACING_M,
) -> tuple[float, float]:
    """Return the force on a square plate in the focal plane [N], also with doubled spacing; `images` echoes."""

    def arp_at(points: Float, normals: Float) -> Float:
        incident = field.pressure(points, drive, gradient=True)
        assert incident.gradient is not None
        pressure, gradient = incident.pressure.astype(complex), incident.gradient.astype(complex)
        for number in range(1, images + 1):
            back = field.pressure(points + np.array([0.0, 0.0, 2.0 * depth_m * number]), drive, gradient=True)
            assert back.gradient is not None
            pressure += back.pressure
            gradient += back.gradient
        total = Field(pressure.astype(np.complex64), gradient.astype(np.complex64))
        return arp(total, normals, field.air, field.array.frequency_Hz, law=law, device="cpu").astype(np.float64)

    spacing = min(spacing_m, plate_m / SMALL_SPACINGS)
    plate = Plate(width_m=plate_m, height_m=plate_m, centre_m=(0.0, 0.0, depth_m), spacing_m=spacing)
    return tuple(plate_force(arp_at, plate))  # type: ignore[return-value]
