"""Exact solutions for a flat viscoelastic layer, by plane waves in depth: an independent check of the finite elements.

Two estimates also use this file at run time: the distance to which a layer affects a load
(approximation.truncate_domain) and the effect of a smaller bulk modulus (approximation.reduce_bulk_modulus). Solvers
that do not use this file test these estimates: axisymmetric elements the former, lateral waves the latter.

Plane strain, e^{ikx - i w t}, depth z from the loaded face (z = 0) to the base (z = h). With
alpha^2 = k^2 - w^2/c_p^2 and beta^2 = k^2 - w^2/c_s^2 the fields are a compression wave P = (ik, -alpha) e^{-alpha z},
a shear wave S = (i beta, -k) e^{-beta z}, and their mirror images from the base (Achenbach 1973, ch. 5; Ewing,
Jardetzky & Press 1957). P and S coincide for w -> 0. So (S - P)/(beta - alpha) replaces S, in a form without
cancellation; its limit is the second static solution, with a factor z. All exponentials decay away from their own
face, so nothing overflows at large k h.
"""

import math

import numpy as np
from scipy.special import j0, jn_zeros

from palmfield.errors import SceneError
from palmfield.skin.base import BASES, BaseKind
from palmfield.skin.materials.material import Material, complex_bulk, complex_shear
from palmfield.types import Complex, Float


def layer_compliance(
    k: Float | float,
    f_Hz: float,
    material: Material,
    thickness_m: float,
    base: BaseKind = "bonded",
    depth_m: float = 0.0,
) -> Complex:
    """Return the normal compliance of an infinite layer under pressure exp(ik.x) on its face [m/Pa], positive inwards.

    k: lateral wavenumber, >= 0 [rad/m], any shape. f_Hz: frequency, 0 for static [Hz]. thickness_m: layer depth [m].
    base: "bonded" (no motion), "free_slip" (no normal motion, no shear traction) or "free" (no traction).
    depth_m: depth of the displacement, 0 to thickness_m [m]; below the face k must be > 0.
    Returns complex128 in the shape of k, under e^{-i w t}. At k = 0 the layer cannot widen. A static free-slip layer
    under long waves can widen, so its limit for k -> 0 is different: h (1 - nu^2) / E.
    Raises SceneError for an unknown base, a thickness <= 0, a negative frequency, or a free layer under static
    uniform pressure, because it has no support.
    """
    if base not in BASES:
        raise SceneError(f"base '{base}' is unknown; use one of {', '.join(BASES)}")
    if not thickness_m > 0.0 or not f_Hz >= 0.0:
        raise SceneError(f"thickness {thickness_m} m, frequency {f_Hz} Hz; thickness must be > 0, frequency >= 0")
    if not 0.0 <= depth_m <= thickness_m:
        raise SceneError(f"depth_m is {depth_m}; allowed: 0 to the thickness {thickness_m}")
    shape = np.shape(k)
    k_flat = np.atleast_1d(np.asarray(k, dtype=float)).ravel()
    result = np.empty(len(k_flat), dtype=complex)
    zero = k_flat * thickness_m < 1e-9
    if zero.any():
        if depth_m > 0.0:
            raise SceneError(f"depth_m is {depth_m}, but a uniform pressure (k = 0) is computed at the surface only")
        result[zero] = _uniform_compliance(f_Hz, material, thickness_m, base)
    if not zero.all():
        frequencies = np.full(int((~zero).sum()), float(f_Hz))
        result[~zero] = _wave_compliance(k_flat[~zero], frequencies, material, thickness_m, base, depth_m)
    return result.reshape(shape)


def _uniform_compliance(f_Hz: float, material: Material, h: float, base: BaseKind) -> complex:
    """Return the compliance for k = 0: a column in one-dimensional compression."""
    omega = 2.0 * math.pi * f_Hz
    modulus = complex_bulk(material, f_Hz) + 4.0 / 3.0 * complex_shear(material, f_Hz)
    if omega == 0.0:
        if base == "free":
            raise SceneError("a layer with a free base has no static answer to uniform pressure; use base='bonded'")
        return h / modulus
    kappa = omega * np.sqrt(material.density_kg_m3 / modulus)
    tangent = np.tan(kappa * h)
    return complex(tangent / (modulus * kappa) if base != "free" else -1.0 / (modulus * kappa * tangent))


def _wave_compliance(
    k: Float, f_Hz: Float, material: Material, h: float, base: BaseKind, depth_m: float = 0.0
) -> Complex:
    """Return the compliance for pairs of wavenumber and frequency, all (n,)."""
    unique, back = np.unique(f_Hz, return_inverse=True)
    omega = 2.0 * math.pi * f_Hz
    shear = np.array([complex_shear(material, float(f)) for f in unique])[back]
    bulk = np.array([complex_bulk(material, float(f)) for f in unique])[back]
    pressure_modulus = bulk + 4.0 / 3.0 * shear
    lame = bulk - 2.0 / 3.0 * shear
    ks2 = material.density_kg_m3 * omega**2 / shear
    ratio = shear / pressure_modulus
    kp2 = ratio * ks2
    alpha = np.sqrt(k**2 - kp2 + 0j)
    beta = np.sqrt(k**2 - ks2 + 0j)

    def waves(z: float) -> list[dict[str, Complex]]:
        """Return u_x/i, u_z, their z-derivatives and the divergence of P and of (S - P)/(beta - alpha) at depth z."""
        e = np.exp(-alpha * z)
        delta = -ks2 * (1.0 - ratio) / (alpha + beta)
        d = e * np.divide(np.expm1(-delta * z), delta, out=np.full_like(alpha, -z), where=np.abs(delta) > 1e-200)
        s = (alpha + beta) / (1.0 - ratio)
        p_wave = {"x": k * e, "z": -alpha * e, "dx": -k * alpha * e, "dz": alpha**2 * e, "div": -kp2 * e}
        beta_k = s / (beta + k)
        difference = {
            "x": k * d + beta_k * np.exp(-beta * z),
            "z": -k * d + ratio * s / (alpha + k) * e,
            "dx": -(beta**2) * d - s * (1.0 - ratio * k / (alpha + k)) * e,
            "dz": k * beta * d + s * (k / (beta + k) - ratio) * e,
            "div": -ratio * s * e,
        }
        return [p_wave, difference]

    def rows(z: float) -> dict[str, Complex]:
        """Return the displacements and tractions of the four waves at depth z, shapes (n, 4)."""
        columns = []
        for sign, depth in ((1.0, z), (-1.0, h - z)):
            for w in waves(depth):
                # The mirror image z -> h - z keeps u_x and reverses u_z.
                columns.append(
                    {
                        "x": w["x"],
                        "z": sign * w["z"],
                        "normal": lame * w["div"] + 2.0 * shear * w["dz"],
                        "tangential": shear * sign * (w["dx"] + k * w["z"]),
                    }
                )
        return {name: np.stack([c[name] for c in columns], axis=1) for name in columns[0]}

    top, bottom = rows(0.0), rows(h)
    zero = {"bonded": ("x", "z"), "free_slip": ("z", "tangential"), "free": ("normal", "tangential")}[base]
    equations = [top["normal"], top["tangential"], bottom[zero[0]], bottom[zero[1]]]
    matrix = np.stack([row / np.abs(row).max(axis=1, keepdims=True) for row in equations], axis=1)
    load = np.zeros((len(k), 4, 1), dtype=complex)
    load[:, 0, 0] = -1.0 / np.abs(top["normal"]).max(axis=1)
    amplitudes = np.linalg.solve(matrix, load)[:, :, 0]
    return np.einsum("ni,ni->n", (rows(depth_m) if depth_m else top)["z"], amplitudes)


def centre_response(
    f_Hz: float,
    material: Material,
    thickness: float,
    fwhm_m: float,
    radius_m: float | None = None,
    at: Float | float = 0.0,
    base: BaseKind = "bonded",
    settled: float = 1e-9,
) -> Complex:
    """Return the displacement into the layer at distances from the axis of a Gaussian spot per peak pressure [m/Pa].

    thickness: layer depth [m]. fwhm_m: full width at half maximum of the spot [m].
    radius_m: None for a layer without sides (Hankel integral), or radius of a disc with roller sides: no radial
        motion, no shear traction (Fourier-Bessel series over the zeros of J1(kR)).
    at: distances from the axis [m], any shape. settled: relative change at which the refinement of the integral ends.
    Returns complex128 in the shape of `at`, under e^{-i w t}.
    Raises SceneError as layer_compliance, for fwhm_m <= 0, and if the sum does not converge.
    """
    if not fwhm_m > 0.0:
        raise SceneError(f"spot width is {fwhm_m} m; give a number above 0")
    distance = np.asarray(at, dtype=float)
    spread = fwhm_m / math.sqrt(8.0 * math.log(2.0))
    if radius_m is None:
        flat = _hankel(np.array([f_Hz]), material, thickness, spread, distance.ravel(), base, settled)[0]
    else:
        flat = _fourier_bessel(f_Hz, material, thickness, spread, radius_m, distance.ravel(), base)
    return flat.reshape(distance.shape)


def centre_responses(
    f_Hz: Float, material: Material, thickness: float, fwhm_m: float, at: Float, base: BaseKind, settled: float
) -> Complex:
    """Return `centre_response` of a layer without sides for all frequencies (f,) and distances (r,), shape (f, r)."""
    spread = fwhm_m / math.sqrt(8.0 * math.log(2.0))
    return _hankel(np.asarray(f_Hz, dtype=float), material, thickness, spread, np.asarray(at), base, settled)


def _hankel(
    f_Hz: Float, material: Material, h: float, spread: float, r: Float, base: BaseKind, settled: float
) -> Complex:
    """Return u(r) = integral of C(k) s^2 exp(-k^2 s^2 / 2) J0(k r) k dk; Gauss panels double until results agree."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    end = 9.0 / spread
    response = np.zeros((len(f_Hz), len(r)), dtype=complex)
    todo, previous = np.arange(len(f_Hz)), None
    for panels in (5, 10, 20, 50, 100, 200, 400, 800, 1600, 3200, 6400):
        edges = np.linspace(0.0, end, panels + 1)
        half = 0.5 * (edges[1] - edges[0])
        k = (edges[:-1, None] + half * (1.0 + nodes)).ravel()
        load = spread**2 * np.exp(-0.5 * (k * spread) ** 2) * k * np.tile(weights * half, panels)
        rates = np.repeat(f_Hz[todo], len(k))
        compliance = _wave_compliance(np.tile(k, len(todo)), rates, material, h, base).reshape(len(todo), len(k))
        value = (compliance * load) @ j0(np.outer(k, r))
        if previous is not None:
            moving = np.abs(value - previous).max(axis=1) > settled * np.abs(value).max(axis=1)
            response[todo[~moving]] = value[~moving]
            todo, value = todo[moving], value[moving]
            if len(todo) == 0:
                return response
        previous = value
    raise SceneError(
        f"the wave integral of the layer does not converge at {f_Hz[todo[0]]} Hz; add a damping branch to the material"
    )


def _fourier_bessel(
    f_Hz: float, material: Material, h: float, spread: float, radius: float, r: Float, base: BaseKind
) -> Complex:
    count = math.ceil(9.0 / spread * radius / math.pi) + 2
    zeros = np.concatenate(([0.0], jn_zeros(1, count)))
    nodes, weights = np.polynomial.legendre.leggauss(max(200, 4 * count))
    rho = 0.5 * radius * (1.0 + nodes)
    spot = np.exp(-0.5 * (rho / spread) ** 2) * rho * weights * 0.5 * radius
    pressure = 2.0 / (radius * j0(zeros)) ** 2 * (j0(np.outer(zeros / radius, rho)) @ spot)
    return j0(np.outer(r, zeros / radius)) @ (pressure * layer_compliance(zeros / radius, f_Hz, material, h, base))
