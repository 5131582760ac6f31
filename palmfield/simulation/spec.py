"""What a scene says, before anything is computed: frozen, comparable, without physics.

Frames: the array frame is that of the scene's first array; a body's own points are in its body's frame. Placements are
those of MuJoCo's reference configuration.
"""

from dataclasses import dataclass

from palmfield.acoustics.arp import LAWS, ArpLaw, alpha_law
from palmfield.acoustics.calibration_file import Calibration
from palmfield.acoustics.transducer_file import TransducerTable
from palmfield.config import ArrayConfig, DriverConfig, SkinConfig, StimulusConfig
from palmfield.hand.collision_shapes import Obstacle
from palmfield.stimulus.am_file import AmTable
from palmfield.stimulus.focus_table import FocusTable
from palmfield.transforms import Placement

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class ArraySpec:
    """One phased array.

    placement: seen from the first array
    calibration, table: what the files of keys `calibration` and `transducers` hold
    """

    name: str
    config: ArrayConfig
    placement: Placement
    calibration: Calibration | None = None
    table: TransducerTable | None = None


@dataclass(frozen=True)
class StimulusSpec:
    """One stimulus.

    arrays: numbers of the arrays that it drives, rising; frame: of its focus and path, seen from the first array
    on_skin: number of the skin that its path runs on, None for a path in space
    path_sites: sites that the path runs through, in the frame of that skin's body [m]
    frame_moves: whether that frame, or the skin that the path runs on, can move against the arrays
    am_table: the waveform in the file of key am_file, None without; focus_table: foci over time, of key path_file
    """

    name: str
    config: StimulusConfig
    arrays: tuple[int, ...]
    frame: Placement
    on_skin: int | None
    path_sites: tuple[Triple, ...]
    frame_moves: bool
    am_table: AmTable | None = None
    focus_table: FocusTable | None = None


@dataclass(frozen=True)
class ObstacleSpec:
    """What casts shadows on a skin besides its own body. placement: of the obstacle's body, seen from the skin's"""

    shape: Obstacle
    placement: Placement


@dataclass(frozen=True)
class SkinSpec:
    """One skin layer and the body that carries it.

    body: placement of the body, seen from the first array; patch_centre: middle of the layer in the body's frame [m]
    moves: whether a script moves something in the scene, so that the body may not stay where it is
    """

    name: str
    config: SkinConfig
    body: Placement
    patch_centre: Triple
    obstacles: tuple[ObstacleSpec, ...]
    moves: bool

    @property
    def arp_law(self) -> ArpLaw:
        """The radiation-pressure law of keys arp_law and arp_alpha."""
        return LAWS[self.config.arp_law] if self.config.arp_alpha is None else alpha_law(self.config.arp_alpha)


@dataclass(frozen=True)
class SceneSpec:
    """All of a scene. Equal specs share a model.

    device: where fields are computed, "cpu" or "cuda:N"; timestep_s: MuJoCo's step [s]; duration_s: of a run [s]
    """

    arrays: tuple[ArraySpec, ...]
    stimuli: tuple[StimulusSpec, ...]
    skins: tuple[SkinSpec, ...]
    driver: DriverConfig
    device: str
    timestep_s: float
    duration_s: float
