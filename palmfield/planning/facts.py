"""Properties of a model for several parts of a plan."""

import numpy as np

from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import turn_rate_Hz
from palmfield.types import Complex, Float


def first_drive(model: HapticModel, stimulus: int) -> Complex:
    """Return the commanded drive of all transducers for a stimulus's first focus at the loudest moment, shape (N,)."""
    drive = array_drives(model, model.arrays)[stimulus]
    return drive.unit_drive(model.stimuli[stimulus].first_focus).amplitudes


def where_it_arrives(posed: PosedScene, skin: int, drive: Complex) -> tuple[Float, Float, float]:
    """Return the loudest place, in free air, of a drive of all transducers (N,) on a skin that faces them.

    A node and its outward normal, array frame, shapes (3,) [m], with the peak pressure there [Pa]: 0 if no node faces
    the transducers. Shadows and scattering are not solved here; the run includes them.
    """
    nodes, outwards = posed.skins[skin].nodes
    loud = np.abs(drive)
    back = loud @ posed.arrays.array.positions / max(float(loud.sum()), 1e-300) - nodes
    faces = np.einsum("ij,ij->i", outwards, back) > 0.0
    pressures = np.where(faces, np.abs(posed.arrays.pressure64(nodes, drive)), 0.0)
    highest = int(pressures.argmax())
    return nodes[highest], outwards[highest], float(pressures[highest])


def turn_times(stimulus: StimulusModel, count: int) -> Float:
    """Return times on one turn of the path of a stimulus [s], shape (count,); without turns its start, shape (1,)."""
    rate = turn_rate_Hz(stimulus.config)
    count = count if rate else 1
    return np.asarray(stimulus.config.start_s + np.arange(count) / (count * (rate or 1.0)))


def force_samples(model: HapticModel) -> int:
    """About how many samples give the force on bodies; none for a disc, whose skin gives it."""
    return sum(0 if body.surface is None else body.sample_count for body in model.bodies)
