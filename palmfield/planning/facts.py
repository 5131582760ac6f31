"""What several parts of a plan ask of a model."""

import numpy as np

from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.types import Complex, Float


def first_drive(model: HapticModel, stimulus: int) -> Complex:
    """What all transducers are told for a stimulus's first focus at the loudest moment, shape (N,)."""
    drive = array_drives(model, model.arrays)[stimulus]
    return drive.unit_drive(model.stimuli[stimulus].first_focus).amplitudes


def where_it_arrives(posed: PosedScene, skin: int, drive: Complex) -> tuple[Float, Float, float]:
    """Where a drive of all transducers (N,) is loudest in free air on a skin that looks at them, wherever the focus is.

    A node and its outward normal, array frame, shapes (3,) [m], with the peak pressure there [Pa]: 0 where no node
    looks at the transducers. Nothing is solved for: shadows and scattering are left to the run.
    """
    nodes, outwards = posed.skins[skin].nodes
    loud = np.abs(drive)
    back = loud @ posed.arrays.array.positions / max(float(loud.sum()), 1e-300) - nodes
    faces = np.einsum("ij,ij->i", outwards, back) > 0.0
    pressures = np.where(faces, np.abs(posed.arrays.pressure64(nodes, drive)), 0.0)
    highest = int(pressures.argmax())
    return nodes[highest], outwards[highest], float(pressures[highest])


def force_samples(model: HapticModel) -> int:
    """Places at which the sound pushes bodies; a disc is pushed at its skin's points."""
    return sum(0 if body.surface is None else len(body.sample_mesh.corners) for body in model.bodies)
