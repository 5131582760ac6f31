"""Fit the presets "palm", "finger_pad" and "hitohada_*" of the catalogue, and print fit and preset.

    python scripts/fit_palm_material.py

The presets are in palmfield.skin.materials.catalogue. Palm and finger pad are fitted with a standard linear solid each,
to the same speeds and the same decay.

Speed: phase speed of the Rayleigh wave on deep, nearly incompressible tissue, 0.9553 of that of the shear wave. Target:
rising to a plateau near 7 m/s at 400 Hz, as on the finger pad (Manfredi et al. 2012). The values of 3.6, 4.6, 6.0 and
7.1 m/s at 50, 100, 200 and 400 Hz are this project's reading of such a curve; that paper has no table of them. Forearm
skin is slower, 3.25 m/s at 200 Hz (Zhang et al. 2011).

Decay: u(40 mm) / u(5 mm) at 200 Hz of a spot of 10 mm full width on a layer bonded to bone, 12 mm deep. Target: 0.085,
the middle of the range 0.07-0.10 from Manfredi's power law. No isotropic solid meets both targets: a speed that
rises so fast requires more loss than the decay allows (docs/materials.md). On the palm, waves are observed over the
whole hand, so the decay has five times the weight of one speed. The finger pad is smaller than the wavelength
there, so only the speeds count.

HITOHADA gels: Mizushima & Sato 2024 print E' at 10 Hz, and state that the loss tangent rises to 100 Hz and is flat
above. A fractional Kelvin-Voigt law has that shape. Its exponent 0.2 (loss tangent at most 0.32) is assumed, and its
spring is a tenth of the storage modulus of the spring-pot at 100 Hz.
"""

import math

import numpy as np
from scipy.optimize import least_squares

from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.catalogue import GEL_BAND_HZ, GEL_STORAGE_PA, PRESETS
from palmfield.skin.materials.material import Material, shear_wave, standard_linear
from palmfield.skin.materials.prony_fit import PronyFit, fractional, fractional_kelvin_voigt

FREQUENCIES = (50.0, 100.0, 200.0, 400.0)
SPEEDS = np.array([3.6, 4.6, 6.0, 7.1])
DECAY = 0.085
RAYLEIGH = 0.9553
BOUNDS = ([2e3, 2e3, 2e-5], [2e5, 2e5, 1e-2])
DECAY_WEIGHT = {"palm": 5.0, "finger_pad": 0.0}
EXPONENT = 0.2
GEL_BRANCHES = 4


def solid(logs: np.ndarray) -> Material:
    relaxed, branch, tau = np.exp(logs)
    return standard_linear("trial", 1100.0, relaxed, branch, tau)


def speeds(material: Material) -> np.ndarray:
    return RAYLEIGH * np.array([shear_wave(material, f)[0] for f in FREQUENCIES])


def decay(material: Material, thickness_m: float = 0.012) -> float:
    near, far = np.abs(centre_response(200.0, material, thickness_m, 0.010, at=np.array([0.005, 0.040])))
    return float(far / near)


def misfit(logs: np.ndarray, decay_weight: float) -> np.ndarray:
    material = solid(logs)
    misfits = np.log(speeds(material) / SPEEDS)
    return np.append(misfits, decay_weight * np.log(decay(material) / DECAY)) if decay_weight else misfits


def fit_site(site: str) -> Material:
    starts = [(10e3, 60e3, 4e-4), (20e3, 30e3, 2e-4), (30e3, 40e3, 1e-4)]
    fits = [least_squares(misfit, np.log(start), bounds=np.log(BOUNDS), args=(DECAY_WEIGHT[site],)) for start in starts]
    for start, fit in zip(starts, fits, strict=True):
        print(f"{site}, start {start}: cost {fit.cost:.5f}, {np.round(np.exp(fit.x), 7).tolist()}")
    return solid(min(fits, key=lambda fit: fit.cost).x)


def fit_gel(name: str) -> tuple[Material, PronyFit]:
    """Return the Prony series of the gel over GEL_BAND_HZ; its density is that of the preset."""
    loss_angle = 0.5 * math.pi * EXPONENT

    def pot(f: float) -> float:
        return (2.0 * math.pi * f) ** EXPONENT * math.cos(loss_angle)

    coefficient = GEL_STORAGE_PA[name] / 3.0 / (pot(10.0) + 0.1 * pot(100.0))
    spring = 0.1 * coefficient * pot(100.0)
    return fractional(
        name,
        PRESETS[name].density_kg_m3,
        lambda f: fractional_kelvin_voigt(f, spring, coefficient, EXPONENT),
        GEL_BAND_HZ,
        GEL_BRANCHES,
    )


def report(label: str, material: Material) -> None:
    print(
        f"{label}: G_r {material.shear_relaxed_Pa:.0f} Pa, G_m {material.branches[0].shear_Pa:.0f} Pa, "
        f"tau {material.branches[0].time_s * 1e6:.1f} us"
    )
    print("  speed [m/s] at 50/100/200/400 Hz:", np.round(speeds(material), 2), "aim", SPEEDS)
    print("  speed misfit [%]:", np.round(100 * (speeds(material) / SPEEDS - 1), 1))
    for depth in (0.012, 0.016, 0.020):
        print(f"  u(40 mm)/u(5 mm) at 200 Hz, {depth * 1e3:.0f} mm bonded: {decay(material, depth):.4f}")


def report_gel(label: str, material: Material) -> None:
    moduli, times = ([f"{value:.4g}" for value in values] for values in zip(*parts(material), strict=True))
    print(
        f"{label}: G_r {material.shear_relaxed_Pa:.4g} Pa, G_i [{', '.join(moduli)}] Pa, tau_i [{', '.join(times)}] s"
    )


def parts(material: Material) -> list[tuple[float, float]]:
    return [(branch.shear_Pa, branch.time_s) for branch in material.branches]


def main() -> None:
    for site in DECAY_WEIGHT:
        report(f"best fit '{site}'", fit_site(site))
        report(f"preset '{site}'", PRESETS[site])
    for name in GEL_STORAGE_PA:
        material, fit = fit_gel(name)
        report_gel(f"best fit '{name}'", material)
        print(f"  misfit to the fractional law: storage {fit.storage_misfit:.2%}, loss {fit.loss_misfit:.2%} rms")
        report_gel(f"preset '{name}'", PRESETS[name])


if __name__ == "__main__":
    main()
