"""Uncertainty of the arrays of a stimulus: p0 and quality factor of their transducers."""

import numpy as np

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.simulation.build import nearest_stimulus
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, StimulusModel, array_instances
from palmfield.types import Complex, Estimate, Float

PLACES = 201
"""Number of p0 values in the range at which the ARP is evaluated, since sounds of several stimuli may cancel there."""


def stimulus_of(model: HapticModel, skin: int) -> int:
    """Return the number of the stimulus for which the layer of a skin is built."""
    nearest = nearest_stimulus(model.skins[skin].spec, model.stimuli)
    return next(number for number, stimulus in enumerate(model.stimuli) if stimulus is nearest)


def p0_band(model: HapticModel, stimulus: int) -> tuple[float, float] | None:
    """Return factors of the ARP of one stimulus alone at its focus, at the low and high ends of all p0 ranges.
    None if arp_peak_Pa sets the level, and in silence."""
    part = model.stimuli[stimulus]
    drive = array_drives(model, model.arrays)[stimulus].unit_drive(part.first_focus).amplitudes
    return None if part.config.arp_peak_Pa is not None else p0_band_at(model, model.arrays, drive, part.first_focus)


def p0_band_at(model: HapticModel, arrays: PhasedArray, drive: Complex, point: Float) -> tuple[float, float] | None:
    """Return the least and largest factor of the ARP at a point while p0 of all arrays varies over their ranges.

    Pressures of arrays, each with its own p0, add up at the point; the ARP is proportional to the square of the sum. A
    stimulus with arp_peak_Pa keeps its pressure, because its drive is scaled to p0. All arrays are at the same fraction
    of their ranges. None if arp_peak_Pa sets the level of all active stimuli, and in silence.

    arrays: arrays in one pose. drive: drive of all transducers, shape (N,). point: point in the frame of the first
    array [m], shape (3,).
    """
    independent = np.zeros(len(drive), bool)
    for stimulus in model.stimuli:
        independent[stimulus.transducers] = stimulus.config.arp_peak_Pa is not None
    fixed = arrays.pressure64(point[None], np.where(independent, drive, 0.0))[0]
    p0_values = [array.p0 for array in array_instances(model.spec)]
    pressures = []
    for own in arrays.slices:
        alone = np.zeros_like(drive)
        alone[own] = np.where(independent[own], 0.0, drive[own])
        pressures.append(arrays.pressure64(point[None], alone)[0])
    whole = abs(fixed + sum(pressures)) ** 2
    if whole == 0.0 or not any(pressures):
        return None
    low, high = (np.array([getattr(p0, end) / p0.value for p0 in p0_values]) for end in ("low", "high"))
    places = np.linspace(0.0, 1.0, PLACES)[:, None]
    factors = np.abs(fixed + (low + places * (high - low)) @ np.array(pressures)) ** 2 / whole
    return float(factors.min()), float(factors.max())


def p0_known(model: HapticModel, stimulus: int) -> list[Estimate]:
    """Return the p0 of the arrays of a stimulus; equal values once."""
    instances = array_instances(model.spec)
    return list(dict.fromkeys(instances[number].p0 for number in model.stimuli[stimulus].spec.arrays))


def qualities(stimulus: StimulusModel) -> str:
    """Return the quality factors of the transducers that a stimulus drives, in words."""
    response = stimulus.response
    own = np.broadcast_to(response.pole.Q, response.delays_s.shape)[stimulus.transducers]
    return "Q " + " and ".join(f"{quality:g}" for quality in np.unique(own))
