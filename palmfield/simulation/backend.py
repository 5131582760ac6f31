"""What may take the place of the stages in a step of one world in a pose. Here: nothing, the stages do it all."""

from palmfield.drive.transducer_response import EmittedCourse
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import SensorPlace
from palmfield.skin.stepper import Outside, SkinStepper
from palmfield.stimulus.schedule import Moments
from palmfield.types import Float, Float32, Int


class Backend:
    """The host's stages. What computes steps elsewhere overrides this. Belongs to one state.

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
