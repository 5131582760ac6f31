"""The contents of a scene before any computation: frozen, comparable, without physics.

Frames: the array frame is that of the first array of the scene; points of a body are in the frame of the body.
Placements are those of the reference configuration of MuJoCo.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from palmfield.acoustics.arp import LAWS, ArpLaw, alpha_law
from palmfield.config import AfferentsConfig, ArrayConfig, Config, DriverConfig, SkinConfig, StimulusConfig
from palmfield.config.base import naming_keys
from palmfield.transforms import Placement

if TYPE_CHECKING:  # contents of files and obstacles, which few scenes have
    from palmfield.acoustics.calibration_file import Calibration
    from palmfield.acoustics.transducer_file import TransducerTable
    from palmfield.hand.collision_shapes import Obstacle
    from palmfield.stimulus.am_table import AmTable
    from palmfield.stimulus.focus_table import FocusTable

Triple = tuple[float, float, float]


class Named:
    """A part of a scene with a name, for messages. config: its keys"""

    name: str
    config: Config

    @property
    def element(self) -> str:
        """Name of the element of the scene, for messages."""
        return self.config.element(self.name)

    def naming(self, setting: str = "") -> naming_keys:
        """Add the element and its keys to errors raised in the block. setting: invalid key, if the error names none"""
        return naming_keys(self.element, self.config, setting)


@dataclass(frozen=True)
class ArraySpec(Named):
    """One phased array.

    placement: pose relative to the first array
    calibration, table: contents of the files of keys `calibration` and `transducers`
    """

    name: str
    config: ArrayConfig
    placement: Placement
    calibration: "Calibration | None" = None
    table: "TransducerTable | None" = None


@dataclass(frozen=True)
class StimulusSpec(Named):
    """One stimulus.

    arrays: numbers of the arrays that it drives, ascending; frame: frame of its focus and path relative to the first
        array
    on_skin: number of the skin on which its path runs; None for a path in space
    path_sites: sites along the path, in the frame of the body of that skin [m]
    frame_moves: whether that frame, or the skin under the path, can move relative to the arrays
    am_table: waveform in the file of key am_file, or None; focus_table: foci over time in the file of key path_file
    """

    name: str
    config: StimulusConfig
    arrays: tuple[int, ...]
    frame: Placement
    on_skin: int | None
    path_sites: tuple[Triple, ...]
    frame_moves: bool
    am_table: "AmTable | None" = None
    focus_table: "FocusTable | None" = None


@dataclass(frozen=True)
class ObstacleSpec:
    """An obstacle of a skin, other than its own body. placement: pose of its body relative to the body of the skin"""

    shape: "Obstacle"
    placement: Placement


@dataclass(frozen=True)
class SkinSpec(Named):
    """One skin layer and the body that carries it.

    body: pose of the body relative to the first array; patch_centre: middle of the layer in the frame of the body [m]
    moves: whether a script moves a body in the scene, so that this body may move too
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
class RegionSpec(Named):
    """A region of a skin, by its number, whose rates of spikes sensors read. bone: the bone that carries it, or None.
    centre: of a sphere that contains it, in the frame of the body [m], or None; radius_m: radius of this sphere."""

    name: str
    config: AfferentsConfig
    skin: int
    bone: int | None
    centre: Triple | None
    radius_m: float


@dataclass(frozen=True)
class SceneSpec:
    """The whole scene. Equal specs share a model.

    device: device that computes fields, "cpu" or "cuda:N"; timestep_s: time step of MuJoCo [s]; duration_s: of a run
    """

    arrays: tuple[ArraySpec, ...]
    stimuli: tuple[StimulusSpec, ...]
    skins: tuple[SkinSpec, ...]
    driver: DriverConfig
    device: str
    timestep_s: float
    duration_s: float
    regions: tuple[RegionSpec, ...] = ()
