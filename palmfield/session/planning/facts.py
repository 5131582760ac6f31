"""What several parts of a plan ask of a model."""

from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel
from palmfield.types import Complex


def first_drive(model: HapticModel, stimulus: int) -> Complex:
    """What all transducers are told for a stimulus's first focus at the loudest moment, shape (N,)."""
    drive = array_drives(model, model.arrays)[stimulus]
    return drive.unit_drive(model.stimuli[stimulus].first_focus).amplitudes


def pushed_faces(model: HapticModel) -> int:
    """Faces of the surfaces at which the sound pushes bodies; a disc is pushed at its skin's points."""
    return sum(0 if body.surface is None else len(body.surface.faces) for body in model.bodies)
