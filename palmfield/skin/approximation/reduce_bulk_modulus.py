"""Reduce the bulk modulus if this changes the motion little, because the pressure wave limits explicit steps."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_responses
from palmfield.skin.approximation.bands import bands, course_moves, resonance
from palmfield.skin.approximation.load_scales import load_width
from palmfield.skin.base import BASES, Foundation, Springs
from palmfield.skin.materials.material import Material, bulk_from_poisson
from palmfield.skin.problem import Body, Layer, Load, Spot
from palmfield.types import Float

RATIOS = (0.49, 0.495, 0.497, 0.499)
"""Trial values of the instantaneous Poisson's ratio, from the largest to the smallest step."""

SHARE = 0.5
"""Largest share of the target accuracy for the error of an automatically chosen bulk modulus."""

FAR = 1e-3
"""Share of the motion in the middle that is the least reference for relative changes."""

FAINT = 1e-5
"""Share of the energy of the load below which a band is ignored."""


def reduce_bulk_modulus(
    body: Body, load: Load, end_s: float, at: Float, accuracy: float, nu_at_most: float | None
) -> tuple[Body, float]:
    """Return the body with a limited instantaneous Poisson's ratio, and the relative change of its motion.

    end_s: last requested time [s]. at: requested points [m], shape (n, 2) or (n, 3).
    nu_at_most: limit; 0.5 changes nothing. None: the smallest of RATIOS with a change of at most SHARE of the accuracy,
        for layers and infinite slabs of one sheet; other bodies are unchanged.
    The change is that of a flat infinite layer (palmfield.skin.analytic.layer_oracle) at the frequencies of the load.
    Raises SceneError for a given nu_at_most if the change is above the accuracy, or for several sheets, springs or a
    foundation, because the flat layer does not include them.
    """
    plain = len(body.sheets) == 1 and body.base in BASES
    if nu_at_most == 0.5:
        return body, 0.0
    if nu_at_most is not None:
        if not plain:
            raise SceneError("solver 'spectral_elements': nu_at_most needs one sheet on a plain base; omit it")
        result, change = _tried(body, relative_change(body, load, end_s, at), nu_at_most)
        if change > accuracy:
            raise SceneError(
                f"solver 'spectral_elements': nu_at_most {nu_at_most} would change the motion of this layer by "
                f"{change:.2g}, more than the target accuracy of {accuracy:g}: omit it, or use wedges or "
                "lateral_waves"
            )
        return result, change
    material = body.sheets[0].material
    soft = material.bulk_Pa <= bulk_from_poisson(RATIOS[0], material.shear_instant_Pa)
    if plain and not soft and (isinstance(body, Layer) or body.shape == "infinite"):
        try:
            change_of = relative_change(body, load, end_s, at)
            for nu in RATIOS:
                result, change = _tried(body, change_of, nu)
                if change <= SHARE * accuracy:
                    return result, change
        except SceneError:
            # A layer with undamped waves gives no estimate
            return body, 0.0
    return body, 0.0


def _tried(body: Body, change_of: Callable[[Material], float], nu: float) -> tuple[Body, float]:
    """Return the body with a Poisson's ratio of at most nu, and the relative change of its motion."""
    sheet = body.sheets[0]
    most = bulk_from_poisson(nu, sheet.material.shear_instant_Pa)
    if sheet.material.bulk_Pa <= most:
        return body, 0.0
    soft = replace(sheet.material, bulk_Pa=most)
    return replace(body, sheets=(replace(sheet, material=soft),)), change_of(soft)


def relative_change(body: Body, load: Load, end_s: float, at: Float) -> Callable[[Material], float]:
    """Return a function that estimates the relative change of the motion with another material.

    The change is L2 over the times, at the worst of the middle of the spot and the requested points.
    """
    material, width = body.sheets[0].material, load_width(load)
    depth = float(np.mean(body.patch.depth)) if isinstance(body, Layer) else body.thickness_m
    away = np.array([0.0, width])
    if isinstance(load, Spot) and len(np.unique(load.centres(), axis=0)) == 1:
        away = np.append(0.0, np.hypot(*(np.asarray(at, dtype=float)[:, :2] - load.centres()[0]).T))
    if not course_moves(load, end_s):
        return lambda soft: 0.0
    frequencies, energies = bands(load, end_s, resonance(material, depth))
    base = body.base
    assert not isinstance(base, Springs | Foundation)
    counted = (energies > FAINT * energies.sum()) & ((frequencies > 0.0) | (base != "free"))
    exact = centre_responses(frequencies[counted], material, depth, width, away, base, 1e-5)

    def change(soft: Material) -> float:
        near = centre_responses(frequencies[counted], soft, depth, width, away, base, 1e-5)
        difference, size = (energies[counted] @ np.abs(values) ** 2 for values in (near - exact, exact))
        # At large distances only the numerical error of the integral is left
        return float(np.sqrt(difference / np.maximum(size, FAR**2 * size[0])).max())

    return change
