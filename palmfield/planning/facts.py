"""Compute properties of a model that several parts of a plan need."""

import numpy as np

from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import turn_rate_Hz
from palmfield.types import Complex, Float


def first_drive(model: HapticModel, stimulus: int) -> Complex:
    """Return the drive of all transducers for the first focus of a stimulus at the loudest moment, shape (N,)."""
    drive = array_drives(model, model.arrays)[stimulus]
    return drive.unit_drive(model.stimuli[stimulus].first_focus).amplitudes


def where_it_arrives(posed: PosedScene, skin: int, drive: Complex) -> tuple[Float, Float, float]:
    """Return the point of highest free-field pressure on the side of a skin that faces the transducers.

    drive: drive of all transducers (N,)
    Returns a node and its outward normal, both in the array frame, shapes (3,) [m], and the peak pressure at the node
    [Pa]. The pressure is 0 if no node faces the transducers. Shadows and scattering are not included.
    """
    nodes, outwards = posed.skins[skin].nodes
    loud = np.abs(drive)
    back = loud @ posed.arrays.array.positions / max(float(loud.sum()), 1e-300) - nodes
    faces = np.einsum("ij,ij->i", outwards, back) > 0.0
    pressures = np.where(faces, np.abs(posed.arrays.pressure64(nodes, drive)), 0.0)
    highest = int(pressures.argmax())
    return nodes[highest], outwards[highest], float(pressures[highest])


def turn_times(stimulus: StimulusModel, count: int) -> Float:
    """Return times in one turn of the path of a stimulus [s], shape (count,).

    Without turns, return its start, shape (1,).
    """
    rate = turn_rate_Hz(stimulus.config)
    count = count if rate else 1
    return np.asarray(stimulus.config.start_s + np.arange(count) / (count * (rate or 1.0)))


def force_samples(model: HapticModel) -> int:
    """Return the approximate number of force samples on bodies.

    It is 0 for a disc, where the force is computed on the skin.
    """
    return sum(0 if body.surface is None else body.sample_count for body in model.bodies)
