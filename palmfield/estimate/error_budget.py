"""Report the accuracy of the motion of a skin: numerical errors, omitted effects, and uncertainty of inputs.

All parts refer to one quantity: the response of the skin under the focus to the sound of the loudest moment, static and
at the main frequency. It represents the displacement of a run, although the peak of the run is at another moment and
possibly at another point. The parts are of different kinds and are never added to one number.
"""

from dataclasses import asdict
from typing import Any

import numpy as np

from palmfield.estimate.array_inputs import p0_band_at, p0_known, stimulus_of
from palmfield.estimate.bias import QUANTITY
from palmfield.estimate.biases import biases
from palmfield.estimate.numerical_error import SteppedRun, error_estimate, of_sources
from palmfield.estimate.numerics.depth_band import depth_band
from palmfield.session.loudest_moment import LoudestMoment, loudest_place, nearest_focus, place_under_focus
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.radiation import Radiation
from palmfield.stimulus.schedule import frame_at
from palmfield.types import Float

LOUDEST_POINTS = 64
"""Number of skin points at which the field is also computed in double precision."""
DEPTH = "depth to the bone"
SOURCES = ("mesh", "step", "reduction", "edge", "field", "law")
"""Sources of the numerical error: each has the key `SOURCE_error_relative`; law only for a series."""


def error_budget(
    model: HapticModel,
    skin: int,
    loudest: LoudestMoment,
    radiation: Radiation,
    course: SteppedRun,
    *,
    thorough: bool = False,
) -> dict[str, Any]:
    """Return the budget of the motion of a skin as plain JSON.

    Arguments and errors raised (SceneError): as in `palmfield.estimate.numerical_error.error_estimate`.
    quantity: quantity to which all parts are relative. estimate: "full" if `thorough`, else "quick".
    numerical: SOURCE_error_relative for each of SOURCES, displacement_error_relative of all sources together, the
        same of the velocity (velocity_error_relative), and the other entries of the numerical estimate.
    left_out: list of what, low, high (bias; None if not estimated) and why.
    inputs: list of what, low, high (factors of the displacement; None if not estimated), kind and why.
    """
    estimate = error_estimate(model, skin, loudest, radiation, course, thorough=thorough)
    band = estimate.pop("material_band_low", None), estimate.pop("material_band_high", None)
    estimate["field_error_relative"] = field_error(model, skin, loudest, radiation)
    law = max(sheet.material.series_error for sheet in model.skins[skin].layer.sheets)
    if law > 0.0:
        estimate["law_error_relative"] = law
    estimate |= of_sources(estimate, SOURCES)
    stimulus = stimulus_of(model, skin)
    places = loudest.posed.focal_points(model.stimuli[stimulus], stimulus)
    foci = places.at(frame_at(model.stimuli[stimulus].config, loudest.time_s).focus)
    focus = nearest_focus(foci, loudest.posed.skins[skin].nodes[0])
    highest = loudest_place(loudest.posed, skin, radiation, loudest.drive)
    found = biases(model, skin, stimulus, loudest.posed, loudest.drive, focus, highest)
    return {
        "quantity": QUANTITY,
        "estimate": "full" if thorough else "quick",
        "numerical": estimate,
        "left_out": [asdict(bias) for bias in found],
        "inputs": [
            *_level(model, stimulus, loudest, highest[0]),
            _material(model, skin, band),
            *_depth(model, skin, place_under_focus(model, skin, loudest)),
            *_unknown_inputs(model, skin, stimulus),
        ],
    }


def field_error(model: HapticModel, skin: int, loudest: LoudestMoment, radiation: Radiation) -> float:
    """Return the relative error of the highest ARP on a skin from the precision of the field.

    It compares with a sum in double precision at LOUDEST_POINTS points; the ARP is proportional to the squared
    pressure.
    """
    posed = loudest.posed
    loads = radiation.on(posed, skin, "quadrature", loudest.drive).arp
    points = posed.skins[skin].quadrature[0][np.argsort(loads)[-LOUDEST_POINTS:]]
    exact = posed.arrays.with_echoes64(points, loudest.drive)
    fast = posed.arrays.field.pressure(points, loudest.drive).pressure
    largest = float(np.abs(exact).max())
    return 2.0 * float(np.abs(fast - exact).max()) / largest if largest > 0.0 else 0.0


def _level(model: HapticModel, nearest: int, loudest: LoudestMoment, point: Float) -> list[dict[str, Any]]:
    """Return the p0 band of the arrays active at the loudest moment. nearest: stimulus for which the layer is built"""
    band = p0_band_at(model, loudest.posed.arrays, loudest.drive, point)
    sounding = [
        number for number, stimulus in enumerate(model.stimuli) if np.any(loudest.drive[stimulus.transducers])
    ] or [nearest]
    p0_values = list(dict.fromkeys(p0 for number in sounding for p0 in p0_known(model, number)))
    kinds = " and ".join(dict.fromkeys(p0.kind for p0 in p0_values))
    if band is None:
        why = "arp_peak_Pa sets the level"
        return [{"what": "p0", "low": 1.0, "high": 1.0, "kind": kinds, "why": why}]
    scaled = any(model.stimuli[number].config.arp_peak_Pa is not None for number in sounding)
    law = "at the highest ARP, for all active stimuli; stimuli with arp_peak_Pa do not depend on p0" if scaled else ""
    why = "; ".join(f"{p0.value:g} Pa m ({p0.low:g} to {p0.high:g}): {p0.source}" for p0 in p0_values)
    why = f"{law or 'exactly its square'}; {why}"
    return [{"what": "p0", "low": band[0], "high": band[1], "kind": kinds, "why": why}]


def _material(model: HapticModel, skin: int, band: tuple[float | None, float | None]) -> dict[str, Any]:
    config = model.skins[skin].spec.config
    names = ", ".join(config.materials or (config.material,))
    why = f"{names}: the scene sets numbers without a range"
    if band[0] is not None:
        why = (
            f"{names}: all moduli at the soft ends and at the stiff ends of their ranges at once; correlation is "
            "ignored"
        )
    return {"what": "material", "low": band[0], "high": band[1], "kind": "inferred", "why": why}


def _depth(model: HapticModel, skin: int, point: Float) -> list[dict[str, Any]]:
    """Return the depth to bone under a point of the resting skin, body frame [m], shape (3,); None for a disc."""
    part = model.skins[skin]
    if part.carrier.surface is None:
        return []
    band = depth_band(part.layer, point)
    if band is None:
        config = part.spec.config
        why = f"at most {1e3 * config.depth_m:g} mm by key depth_m, on base {config.base}; its range is unknown"
        return [{"what": DEPTH, "low": None, "high": None, "kind": "assumed", "why": why}]
    own, least, most = (1e3 * depth for depth in (band.own_m, band.least_m, band.most_m))
    why = f"{own:.2g} mm under the focus; {least:.2g} to {most:.2g} mm at such places on people; exact for a flat layer"
    return [{"what": DEPTH, "low": band.low, "high": band.high, "kind": "inferred", "why": why}]


def _unknown_inputs(model: HapticModel, skin: int, stimulus: int) -> list[dict[str, Any]]:
    """Return other uncertain inputs, whose effect is not computed."""
    inputs = []
    part = model.skins[skin]
    if part.spec.config.arp_law == "alpha":
        alpha = 2.0 * part.spec.arp_law.pressure
        key = "arp_law" if part.spec.config.arp_alpha is None else "arp_alpha"
        why = f"{alpha:g} by key {key}; allowed: 1 to 2; the ARP on the skin is proportional to it"
        inputs.append(("alpha of the ARP", "assumed", why))
    instances, arrays = array_instances(model.spec), model.stimuli[stimulus].spec.arrays
    qualities = list(dict.fromkeys(instances[number].quality for number in arrays))
    kinds = " and ".join(dict.fromkeys(one.kind for one in qualities))
    ranges = "; ".join(f"{one.value:g} ({one.low:g} to {one.high:g}): {one.source}" for one in qualities)
    inputs.append(("quality factor of the transducers", kinds, f"{ranges}; affects onsets and fast modulation"))
    return [{"what": what, "low": None, "high": None, "kind": kind, "why": why} for what, kind, why in inputs]
