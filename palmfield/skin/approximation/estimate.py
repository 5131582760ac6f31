"""Sizes of mesh, patch and step for a target accuracy, and the error from two meshes.

The rules were fitted to the 120 x 20 mm Ecoflex disc with a spot of 10.3 mm. The table has the error of the centre
displacement against the exact series. Shear wavelength: 18.7 mm; edges at the rim: 2.5 times those at the spot.

| edge / spot width | rows | static | 200 Hz |
|---|---|---|---|
| 0.78 | 1 | 5.0 % | 24.6 % |
| 1.07 | 2 | 4.4 % | 12.8 % |
| 0.78 | 2 | 0.36 % | 1.35 % |
| 0.58 | 3 | 0.38 % | 0.41 % |
| 0.44 | 4 | 0.36 % | 0.20 % |
| 0.29 | 4 | 0.23 % | 0.15 % |

With 20, 40, 80 steps per period the error is 0.99, 0.25, 0.063 %, that is 0.1 (w h)^2. Roller sides at R = 40, 50,
60 mm change the 200 Hz response of the infinite disc by 2.3, 0.3, 0.2 %; its shear wave falls to 1/e in l = 19.8 mm.
For a 12 mm layer of the palm preset (l = 43 mm), R = 40, 60, 80 mm: 15, 4.8, 2.0 %, about exp(-2 R / l). Slower waves
decay over longer paths: at 70 Hz on the 20 mm disc, a side at 60 mm still changes the response by 14 %. This
calibration is not valid for a layer much thinner or thicker than the spot: compare two meshes there.
"""

import math

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, shear_wave
from palmfield.types import Complex, Float

# Measured on the disc between the meshes of the table; for smooth loads the order of the element is higher.
ORDER = 2.0
GROWTH = 1.6


def choose_sizes(
    material: Material, fwhm_m: float, max_frequency_Hz: float, accuracy: float
) -> tuple[float, float, float, Float, float, float]:
    """Return the sizes for a relative error of the displacement under a spot of about `accuracy`.

    fwhm_m: full width at half maximum of the spot [m]. max_frequency_Hz: highest frequency of the load [Hz].
    accuracy: target relative error, 0.001 to 0.5.
    Returns (fine_m, coarse_m, fine_radius_m, fractions, step_s, patch_radius_m): edge length under the spot and at
    the rim [m], radius of the fine part [m], depth fractions (L+1,), time step [s], radius of the patch [m].
    Raises SceneError for values outside these ranges.
    """
    if not (fwhm_m > 0.0 and max_frequency_Hz > 0.0 and 1e-3 <= accuracy <= 0.5):
        raise SceneError(
            f"spot {fwhm_m} m, frequency {max_frequency_Hz} Hz, accuracy {accuracy}: the first two must be above 0, "
            "accuracy in 0.001 to 0.5"
        )
    speed, length = shear_wave(material, max_frequency_Hz)
    wavelength = speed / max_frequency_Hz
    if accuracy >= 0.03:
        share, layers = 0.78, 2
    elif accuracy >= 0.01:
        share, layers = 0.58, 3
    else:
        share, layers = 0.44 * math.sqrt(accuracy / 0.01), 4
    # The coarsest accurate mesh has edges of 0.43 wavelengths under the spot, 1.07 at the rim, where waves are weak.
    fine = min(share * fwhm_m, 0.43 * wavelength)
    coarse = max(fine, min(2.5 * fine, wavelength))
    edges = np.concatenate([[0.0], np.cumsum(GROWTH ** np.arange(layers))])
    step = math.sqrt(2.0 * min(accuracy, 0.05)) / (2.0 * math.pi * max_frequency_Hz)
    # A wave to the rim and back must decay to half the target error; an elastic layer needs an explicit radius.
    away = 0.5 * length * math.log(2.0 / accuracy) if math.isfinite(length) else 4.0 * wavelength
    return fine, coarse, 1.2 * fwhm_m, edges / edges[-1], step, max(4.0 * fwhm_m, away)


def largest_change(answers: Complex | Float, reference: Complex | Float) -> float:
    """Return the largest relative difference from results of another mesh, both (n,), or (n, p) with the norm over p.

    Raises SceneError for a reference of 0.
    """
    answers, reference = (values.reshape(len(reference), -1) for values in (answers, reference))
    size = np.linalg.norm(reference, axis=1)
    if not np.all(size > 0.0):
        raise SceneError(f"reference values are {reference}; a relative error needs values other than 0")
    return float(np.max(np.linalg.norm(answers - reference, axis=1) / size))
