"""Working data of the steps of one world: emission, fields, and observed quantities."""

from copy import copy
from typing import TYPE_CHECKING

from scipy import sparse

from palmfield.simulation.emission import Emission, looks_ahead
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, reference_scene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.small_models.known_load import has_path
from palmfield.simulation.small_models.leaving import OutsideClass
from palmfield.skin.stepper import Reader, SkinStepper
from palmfield.types import Float

if TYPE_CHECKING:  # imported at use: few scenes have such a path
    from palmfield.simulation.path_sound import PathSound

MOST_OFF_PATH = 8
"""Number of consecutive courses off a path (as during ring-up) after which its stored fields are not used any more."""


class Workspace:
    """Working data of the steps of one world: emission, radiation, and observed quantities.

    path_sound: sound along a predicted path, None without one.
    outside: for each skin, the part of its load outside the class of its modes.
    observe: the operator (m, unknowns) of each skin that gives the watched values, last those in `model.rates`, or None
    in_coordinates: whether steps return coordinates of these values, see `coordinates`.
    """

    def __init__(self, model: HapticModel, beside: "Workspace | None" = None):
        """beside: Workspace of another world with the same bodies and thread; both share buffers"""
        self.model = model
        self.reference: PosedScene = reference_scene(model) if beside is None else beside.reference
        self.emission = Emission(model)
        self.radiation: Radiation = Radiation(model, None if beside is None else beside.radiation)
        self.path_sound: PathSound | None = None
        if has_path(model):
            self.path_sound = self._on_path(None if beside is None else beside.path_sound)
        self.outside = [OutsideClass() for _ in model.skins]
        self.observe: tuple[sparse.csr_matrix | None, ...] = self.watching() if beside is None else beside.observe
        self.in_coordinates = False
        self._may_look_ahead = looks_ahead(model)
        # Shared with the other worlds, because a reader of many vectors is as large as the vectors
        self._readers: dict[tuple[int, SkinStepper], tuple[sparse.csr_matrix, Reader, tuple[Reader, Float] | None]]
        self._readers = {} if beside is None else beside._readers

    def _on_path(self, beside: "PathSound | None") -> "PathSound":
        from palmfield.simulation.path_sound import PathSound

        return PathSound(self.model, self.radiation, self.reference, beside)

    def watching(self, *operators: sparse.csr_matrix) -> "tuple[sparse.csr_matrix | None, ...]":
        """Return `observe` for steps that give the values of these operators first, one for each skin, or of none."""
        if not self.model.rates:
            return operators or (None,) * len(self.model.skins)
        from palmfield.simulation.rates import watched

        return watched(self.model.rates, [skin.innervation for skin in self.model.skins], operators)

    def begin_run(self) -> None:
        """Drop the data of the previous run."""
        if self.path_sound is not None:
            self.path_sound.off = 0
        self.outside = [OutsideClass() for _ in self.outside]

    def adopt(self, other: "Workspace") -> None:
        """Continue from another Workspace of the same model, for a copy of its state in the same PosedScenes."""
        self.reference = other.reference
        self.emission.adopt(other.emission)
        self.radiation.continue_from(other.radiation)
        if self.path_sound is not None and other.path_sound is not None:
            self.path_sound.adopt(other.path_sound)
        self.outside = list(map(copy, other.outside))

    def look_ahead(self, posed: PosedScene) -> None:
        """Let the emission compute steps ahead if this saves time. On a path with predicted sound it does not."""
        path = self.path_sound
        on_path = path is not None and path.off < MOST_OFF_PATH and path.holds(posed)
        self.emission.ahead = self._may_look_ahead and not on_path

    def reader(self, skin: int, stepper: SkinStepper) -> Reader | None:
        """Return the operator from states of this stepper to observed values. The stepper may change in any step."""
        operator = self.observe[skin]
        if operator is None:
            return None
        cached = self._readers.get((skin, stepper))
        if cached is None or cached[0] is not operator:
            reader = stepper.reader(operator)
            cached = self._readers[skin, stepper] = operator, reader, stepper.coordinates(reader)
        return cached[1] if cached[2] is None or not self.in_coordinates else cached[2][0]

    def coordinates(self, skin: int, stepper: SkinStepper) -> Float | None:
        """Return the matrix (r, m) from the r coordinates that steps of this stepper return to observed values; None if
        steps return the values themselves.
        """
        cached = self._readers[skin, stepper][2] if self.in_coordinates else None
        return None if cached is None else cached[1]
