"""What may take the place of the stages in a step. The classes here compute nothing: the stages do it all."""

import numpy as np

from palmfield.device import resolve
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.kept import Rows
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.skin.stepper import Outside, SkinStepper
from palmfield.stimulus.schedule import Moments
from palmfield.types import Float, Float32, Int


class Backend:
    """The stages for one world in a pose. What computes its steps elsewhere overrides this. Belongs to one state.

    whole: whether a step by itself costs least, so that several are not gathered, and bodies' ARP stays there
    course: what is emitted over the step that has begun and at which moments, if it is computed here; else None
    stepped: the skins whose step has been computed, each with the size of its state
    """

    whole = False

    def __init__(self) -> None:
        self.course: tuple[Moments, EmittedCourse] | None = None
        self.stepped: list[tuple[int, int]] = []

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute the ARP at a sensor's place as well, from the next step on."""

    def forget(self) -> None:
        """Begin again, after a reset or a step that was computed elsewhere."""
        self.course, self.stepped = None, []

    def begin(self, posed: PosedScene, t0: float, watched: bool) -> bool:
        """Compute the step that begins at t0 [s] in a pose; False leaves it to the stages.

        watched: whether the drives are recorded
        """
        return False

    def forces(self, body: int) -> Float:
        """Mean force [N] on a body's parts and torques about their origins [N m], array frame, shape (2, b, 3)."""
        raise NotImplementedError

    def arp(self, skin: int, place: SensorPlace) -> float:
        """ARP [Pa] as the step begins at a sensor's place that is watched."""
        raise NotImplementedError

    def patterns(self, skin: int, points: Int | None = None) -> Float32:
        """ARP [Pa] of the course at a skin's quadrature points, shape (m, q); points: the numbers of some of them.

        A view that the next step overwrites.
        """
        raise NotImplementedError

    def outside(self, skin: int, stepper: SkinStepper) -> Outside | None:
        """The part of a skin's load outside the class of this stepper; None as of `after`, and without a class."""
        return None

    def after(self, skin: int, stepper: SkinStepper) -> Float | None:
        """State of a skin as the step ends, shape (1, state_size), a view that the next step overwrites.

        None where this stepper's step is not computed here.
        """
        return None


class WorldsBackend:
    """The host's stages for all worlds. What computes steps of many from MuJoCo's frames overrides this.

    some: whether any world can ever take its step here; joined: numbers of those that take the present one, shape (g,)
    stepped: as of Backend
    """

    some = False

    def __init__(self) -> None:
        self.joined: Rows = np.zeros(0, dtype=np.intp)
        self.stepped: list[tuple[int, int]] = []

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute what a sensor reads there as well."""

    def forget(self) -> None:
        """What is in the state now has not come from here: after a reset, or in a copy."""

    def fetch(self) -> None:
        """Bring the state up to what the device has."""

    def begin(self, places: Float, axes: Float, t0: float, watched: bool) -> None:
        """Take the frames of all worlds where a step begins at t0 [s], and compute it in those that can join.

        places [m], axes: of the layout's rows, shapes (worlds, rows, 3) and (worlds, rows, 9); watched: whether every
        substep is recorded, which is not done here
        """

    def mean_forces(self) -> list[Float]:
        """Forces [N] on the parts of each body and torques about their origins [N m], world axes, shape (g, 2, b, 3).

        In the worlds that have joined: the mean over the step that begins.
        """
        return []

    def sensed(self, skin: int, place: SensorPlace) -> tuple[Float, Float]:
        """ARP [Pa], shape (g,), displacement [m] and velocity [m/s], (g, 2), at a sensor's place that is watched."""
        raise NotImplementedError

    def advance(self, skins: bool = True) -> None:
        """Carry joined worlds, their skins included, to the step's end; skins: False leaves these as they are."""


def serves(model: HapticModel) -> bool:
    """Whether a model's sound is computed here: on a GPU, but for echoes, boundary elements and 'accurate'."""
    fast = model.arrays.precision == "fast" and model.arrays.wall_m is None
    solved = any(skin.spec.config.body_sound == "scattering" for skin in model.skins)
    return resolve(model.spec.device) != "cpu" and fast and not solved
