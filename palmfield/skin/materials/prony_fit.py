"""Prony series from data: measured storage and loss moduli, and fractional laws.

The moduli are linear in the stiffnesses of the branches, but not in their times. Least squares find the times; for
given times, non-negative least squares find the stiffnesses (variable projection, Golub & Pereyra 1973).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

from palmfield.errors import SceneError
from palmfield.skin.materials.material import Material, prony
from palmfield.types import Complex, Float

SOFTEST = 1e-3
"""Least relaxed modulus of a fit over the smallest storage modulus: a Material needs a relaxed modulus above 0."""


@dataclass(frozen=True)
class PronyFit:
    """Spring and Maxwell branches fitted to moduli, and the misfit.

    relaxed_Pa: G_r [Pa]. branches_Pa: G_i [Pa]. times_s: tau_i [s], rising, shape (n,).
    storage_misfit, loss_misfit: root mean square of (fit - data) / data over the data.
    band_Hz: lowest and highest frequency of the data; outside it the fit is not valid.
    """

    relaxed_Pa: float
    branches_Pa: tuple[float, ...]
    times_s: tuple[float, ...]
    storage_misfit: float
    loss_misfit: float
    band_Hz: tuple[float, float]

    def material(self, name: str, density_kg_m3: float, nu: float = 0.4999, source: str = "") -> Material:
        """Return the material of this fit; nu applies to the instantaneous modulus."""
        return prony(name, density_kg_m3, self.relaxed_Pa, self.branches_Pa, self.times_s, nu, source=source)


def fit_prony(
    f_Hz: Float, storage_Pa: Float, loss_Pa: Float, branches: int, relaxed_Pa: float | None = None
) -> PronyFit:
    """Fit a spring and a number of Maxwell branches to storage and loss moduli, with relative errors as residuals.

    f_Hz: frequencies [Hz], above 0, shape (m,). storage_Pa, loss_Pa: G' and G'' [Pa], both positive, shape (m,).
    branches: n, 1 or more; the fit has 2 n + 1 numbers, so at least n + 1 frequencies are needed.
    relaxed_Pa: the spring G_r [Pa] if it is given; otherwise it is fitted.
    The fit is the best local minimum of three starts. A branch that the data do not need has stiffness 0.
    Raises SceneError for other shapes, numbers that are not finite and above 0, and too many branches.
    """
    f, storage, loss = (np.asarray(values, dtype=float) for values in (f_Hz, storage_Pa, loss_Pa))
    for what, values in (("f_Hz", f), ("storage_Pa", storage), ("loss_Pa", loss)):
        if values.shape != (f.size,) or not (np.isfinite(values).all() and (values > 0.0).all()):
            raise SceneError(f"fit: {what} has shape {values.shape}; give ({f.size},) finite numbers above 0")
    if not 1 <= branches < f.size:
        raise SceneError(f"fit: {branches} branches from {f.size} frequencies; give 1 to {f.size - 1}")
    omega = 2.0 * math.pi * f
    floor = SOFTEST * float(storage.min()) if relaxed_Pa is None else relaxed_Pa
    target = np.concatenate([(storage - floor) / storage, np.ones(f.size)])

    def stiffness(logs: Float) -> tuple[Float, Float]:
        """Return G_r - floor and G_i for these log times, and the residual."""
        x = omega[:, None] * np.exp(logs)
        spring = np.concatenate([1.0 / storage if relaxed_Pa is None else np.zeros(f.size), np.zeros(f.size)])
        parts = np.concatenate([x**2 / (1.0 + x**2) / storage[:, None], x / (1.0 + x**2) / loss[:, None]])
        matrix = np.column_stack([spring, parts])
        moduli, _ = nnls(matrix, target)
        return moduli, matrix @ moduli - target

    shortest, longest = -math.log(omega.max()), -math.log(omega.min())
    bounds = (shortest - math.log(100.0), longest + math.log(100.0))
    tries = []
    for margin in (0.0, 1.0, 2.0):
        start = np.linspace(shortest - margin, longest + margin, branches + 2)[1:-1]
        tries.append(least_squares(lambda logs: stiffness(logs)[1], start, bounds=bounds, xtol=1e-12, ftol=1e-12))
    best = min(tries, key=lambda result: result.cost)
    logs = np.sort(best.x)
    moduli, residual = stiffness(logs)
    return PronyFit(
        floor + float(moduli[0]),
        tuple(moduli[1:].tolist()),
        tuple(np.exp(logs).tolist()),
        float(np.sqrt(np.mean(residual[: f.size] ** 2))),
        float(np.sqrt(np.mean(residual[f.size :] ** 2))),
        (float(f.min()), float(f.max())),
    )


def fractional_kelvin_voigt(f_Hz: Float, relaxed_Pa: float, coefficient_Pa_s: float, exponent: float) -> Complex:
    """Return G(w) = G_0 + C (i w)^a as G' - iG'' [Pa], shape of f_Hz; C in Pa s^a, a in 0..1.

    At high frequency the loss tangent approaches tan(pi a / 2), that of the spring-pot.
    """
    omega = 2.0 * math.pi * np.asarray(f_Hz, dtype=float)
    return np.asarray(relaxed_Pa + coefficient_Pa_s * (-1j * omega) ** exponent, dtype=np.complex128)


def fractional(
    name: str,
    density_kg_m3: float,
    modulus: Callable[[Float], Complex],
    band_Hz: tuple[float, float],
    branches: int,
    nu: float = 0.4999,
    source: str = "",
) -> tuple[Material, PronyFit]:
    """Return a material that approximates a fractional law over a band, and its Prony fit with the misfit.

    modulus: G' - iG'' [Pa] at frequencies [Hz], for example
        `lambda f: fractional_kelvin_voigt(f, 2e3, 300.0, 0.25)`.
    band_Hz: lowest and highest frequency [Hz]; the fit has 20 points per decade, evenly spaced in log f.
    One branch per decade fits a spring-pot of exponent 0.2 within a few per cent: `PronyFit` has the misfit.
    Raises SceneError for a band that is not 0 < low < high, and as fit_prony and Material.
    """
    low, high = band_Hz
    if not (math.isfinite(high) and 0.0 < low < high):
        raise SceneError(f"material '{name}': band is {low} to {high} Hz; give 0 < low < high")
    f = np.geomspace(low, high, 1 + math.ceil(20.0 * math.log10(high / low)))
    shear = modulus(f)
    result = fit_prony(f, shear.real, -shear.imag, branches)
    return result.material(name, density_kg_m3, nu, source), result
