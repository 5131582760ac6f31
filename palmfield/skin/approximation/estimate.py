"""Sizes of mesh, patch and step for a target accuracy, and the error that two meshes show.

The rules are read off the 120 x 20 mm Ecoflex disc with a spot of 10.3 mm, against its exact series (static / 200 Hz
error of the centre's displacement; shear wavelength 18.7 mm; edges grow 2.5 times from the spot to the rim):

| edge / spot width | layers | static | 200 Hz |
|---|---|---|---|
| 0.78 | 1 | 5.0 % | 24.6 % |
| 1.07 | 2 | 4.4 % | 12.8 % |
| 0.78 | 2 | 0.36 % | 1.35 % |
| 0.58 | 3 | 0.38 % | 0.41 % |
| 0.44 | 4 | 0.36 % | 0.20 % |
| 0.29 | 4 | 0.23 % | 0.15 % |

A step of 20, 40, 80 to a period errs by 0.99, 0.25, 0.063 %, that is 0.1 (w h)^2. Roller sides at 40, 50, 60 mm change
the 200 Hz answer of the endless disc by 2.3, 0.3, 0.2 % where the shear wave falls to 1/e in l = 19.8 mm, and those of
a 12 mm layer of the palm preset (l = 43 mm) at 40, 60, 80 mm by 15, 4.8, 2.0 %: about exp(-2 R / l). Slower waves die
out over longer ways: at 70 Hz on the 20 mm disc a side at 60 mm still changes the answer by 14 %. A layer much thinner
or thicker than the spot is outside this calibration: compare two meshes there, with mesh_error.
"""

import math

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.approximation.richardson import error_of_finer
from palmfield.skin.materials.material import Material, shear_wave
from palmfield.skin.problem import GAUSSIAN, Load, Spot
from palmfield.types import Complex, Float

# Observed on the disc between the meshes of the table; the element's own rate on smooth loads is higher.
ORDER = 2.0
GROWTH = 1.6


def choose_sizes(
    material: Material, fwhm_m: float, max_frequency_Hz: float, accuracy: float
) -> tuple[float, float, float, Float, float, float]:
    """Sizes for a relative error of about `accuracy` of the displacement under a spot.

    fwhm_m: full width of the pressure spot at half its peak [m]; max_frequency_Hz: highest frequency of the load [Hz]
    accuracy: target relative error, 0.001 to 0.5
    Returns (fine_m, coarse_m, fine_radius_m, fractions, step_s, patch_radius_m): edge length under the spot [m] and at
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
    # The table's coarsest good mesh has 0.43 of a wavelength under the spot and 1.07 at the rim, where waves are weak.
    fine = min(share * fwhm_m, 0.43 * wavelength)
    coarse = max(fine, min(2.5 * fine, wavelength))
    edges = np.concatenate([[0.0], np.cumsum(GROWTH ** np.arange(layers))])
    step = math.sqrt(2.0 * min(accuracy, 0.05)) / (2.0 * math.pi * max_frequency_Hz)
    # Out and back the wave must fall to half the wanted error; an elastic layer needs a radius of one's own.
    away = 0.5 * length * math.log(2.0 / accuracy) if math.isfinite(length) else 4.0 * wavelength
    return fine, coarse, 1.2 * fwhm_m, edges / edges[-1], step, max(4.0 * fwhm_m, away)


def mesh_error(coarse: Complex | Float, fine: Complex | Float, size_ratio: float, order: float = ORDER) -> float:
    """Relative error of the finer mesh's answers, the largest of them: |coarse - fine| / (r^order - 1) / |fine|.

    coarse, fine: the same answers (say static and harmonic displacement of the centre) on two meshes, shape (n,)
    size_ratio: r, element size of the coarse over that of the fine mesh, in all directions, > 1
    Richardson's estimate; it trusts `order` and two meshes that both resolve load and wave.
    Raises SceneError for a ratio <= 1 or an answer of 0 on the finer mesh.
    """
    size = np.abs(fine)
    if not size_ratio > 1.0 or not np.all(size > 0.0):
        raise SceneError(f"size ratio {size_ratio}, answers {fine}: the ratio must be above 1 and the answers not 0")
    return error_of_finer(float(np.max(np.abs(coarse - fine) / size)), size_ratio, order)


def load_width(load: Load) -> float:
    """Full width at half maximum [m] of a load's pressure.

    Of given pressures, that of the Gaussian with the same (int p)^2 / int p^2, the smallest over the times. Raises
    SceneError where there is no pressure at all.
    """
    if isinstance(load, Spot):
        return load.fwhm_m
    pressure = np.asarray(load.pressure_Pa, dtype=float)
    square = (pressure**2) @ load.weights_m2
    acting = square > 1e-12 * square.max(initial=0.0)
    if not acting.any():
        raise SceneError("traction: pressure_Pa is 0 everywhere; give one that acts")
    area = (np.abs(pressure[acting]) @ load.weights_m2) ** 2 / square[acting]
    return float(math.sqrt(GAUSSIAN * area.min() / (2.0 * math.pi)))


def load_centre(load: Load) -> tuple[Float, float]:
    """Middle (2,) of where a load acts and the distance from it to the farthest place of its centre [m]."""
    if isinstance(load, Spot):
        centres = load.centres()
    else:
        strength = np.abs(np.asarray(load.pressure_Pa, dtype=float)) * load.weights_m2
        acting = strength.sum(axis=1) > 0.0
        centres = strength[acting] @ load.points[:, :2] / strength[acting].sum(axis=1, keepdims=True)
    middle = 0.5 * (centres.min(axis=0) + centres.max(axis=0))
    return middle, float(np.hypot(*(centres - middle).T).max())


def load_frequency(load: Load, speed_m_s: float, width_m: float) -> float:
    """Highest frequency that a step must resolve [Hz].

    The largest of: c_s / (pi width), at which a spot let go rings; v / (2 width) of a spot that moves at v, which is
    where a Gaussian passing by has fallen to a third; and the rate above which a twentieth of the power of a
    piecewise-linear amplitude about its mean lies, at least 0.1 s before and after it included.
    """
    rates = [speed_m_s / (math.pi * width_m)]
    times = np.asarray(load.times_s, dtype=float)
    if len(times) > 1 and isinstance(load, Spot):
        moves = np.linalg.norm(np.diff(load.centres(), axis=0), axis=1) / np.diff(times)
        rates.append(float(moves.max()) / (2.0 * width_m))
    amplitude = np.asarray(load.peak_Pa) if isinstance(load, Spot) else np.abs(load.pressure_Pa) @ load.weights_m2
    if len(times) > 3 and load.law == "linear":
        margin = max(times[-1] - times[0], 0.1)
        even = np.linspace(times[0] - margin, times[-1] + margin, 1 << 14)
        values = np.interp(even, times, amplitude, left=0.0)
        power = np.abs(np.fft.rfft(values - values.mean())) ** 2
        if power.sum() > 0.0:
            place = int(np.searchsorted(np.cumsum(power), 0.95 * power.sum()))
            rates.append(float(np.fft.rfftfreq(len(even), even[1] - even[0])[place]))
    return max(rates)
