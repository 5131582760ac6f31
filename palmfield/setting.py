"""What a scene's configuration amounts to, before anything is computed."""

from typing import NamedTuple

from palmfield.config import DriverConfig, SkinConfig, StimulusConfig
from palmfield.emitter import Board, Placement
from palmfield.hand.collision_shapes import Obstacle

Triple = tuple[float, float, float]


class Setting(NamedTuple):
    """What a scene's configuration says about one skin. Equal settings share a rig.

    boards: the scene's arrays; timestep_s: MuJoCo's step [s]
    stimulus_frame: frame of focus and path, in the frame of the first array, in the reference pose
    patch_centre: middle of the skin layer in the body frame [m]
    body: the skin's body in the frame of the first array, in the reference pose
    duration_s: how long the scene runs by default [s]
    path_sites: sites that a path runs through, in the body frame in the reference pose [m]
    obstacles: what casts shadows on the body besides itself, and placements of those bodies in the body frame
    moves: whether a script moves a hand; aim_moves: whether what the focus is given in moves against the array
    """

    boards: tuple[Board, ...]
    stimulus: StimulusConfig
    skin: SkinConfig
    driver: DriverConfig
    timestep_s: float
    stimulus_frame: Placement
    patch_centre: Triple
    body: Placement
    duration_s: float
    path_sites: tuple[Triple, ...] = ()
    obstacles: tuple[tuple[Obstacle, Placement], ...] = ()
    moves: bool = False
    aim_moves: bool = False
