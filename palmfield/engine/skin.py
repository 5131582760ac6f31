"""Which solver steps a scene's skin, and how its state lies in MuJoCo's.

The state has room for the whole layer. A small model, made for the stimulus in the reference pose, takes the front of
it. Where something moves that was to stay, its motion is turned into one of the whole layer, which goes on; a number
behind the room tells the two apart, so that copies and saved states stay complete. All zeros is rest in both.
"""

from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from palmfield.aim import Aim
from palmfield.engine.pose import Pose
from palmfield.errors import SceneError
from palmfield.foresight import SHARE, STILL, known_load
from palmfield.skin.reduction.stepping import FullSkin, ReducedSkin, reduced_skin
from palmfield.stimulus.schedule import frame_at
from palmfield.types import Float

if TYPE_CHECKING:
    from palmfield.chain import Chain


class SceneSkin:
    """The solvers of one chain's rig; they are made when first needed and shared by all chains of the rig."""

    def __init__(self, chain: "Chain") -> None:
        self.chain, self.rig = chain, chain.rig
        self._readers: dict[tuple[int, bool], tuple[Any, Any]] = {}

    @property
    def reference(self) -> Pose:
        """The pose that MuJoCo's reference configuration gives."""
        return self.rig.reference_pose

    @property
    def begin(self) -> FullSkin | ReducedSkin:
        """The solver with which the scene begins. Raises SceneError for a small model that is asked for but fails."""
        with self.rig.lock:
            if self.rig.stepper is None:
                self.rig.stepper = self._made()
            return self.rig.stepper

    @property
    def full(self) -> FullSkin:
        """The whole layer's."""
        return FullSkin(self.rig.solver)

    def _made(self) -> FullSkin | ReducedSkin:
        rig, chain = self.rig, self.chain
        if rig.choice.name == "full":
            return self.full
        loaded = np.flatnonzero(np.diff(rig.quadrature.operator.indptr)).astype(np.int32)
        focus = (rig.reference_focus - self.reference.shift) @ self.reference.turn
        try:
            return reduced_skin(
                rig.system,
                known_load(chain, self.reference),
                chain.surface_operator,
                chain.probe(focus).operator,
                loaded,
                rig.sizes[4],
                rig.max_frequency_Hz,
                SHARE * rig.skin.accuracy,
            )
        except SceneError:
            if rig.skin.solver == "reduced":
                raise
            return self.full

    def of(self, state: Float) -> FullSkin | ReducedSkin:
        """The solver to which the skin's part of a plugin state belongs."""
        return self.full if state[self.rig.skin_room] else self.begin

    def read(self, state: Float, operator: Any) -> Float:
        """operator @ displacement [m] and operator @ velocity [m/s] of the skin in a plugin state, shape (2, k)."""
        skin = self.of(state)
        key = id(operator), isinstance(skin, FullSkin)
        if key not in self._readers:
            # With the operator itself, so that no other can come to have its number.
            self._readers[key] = operator, skin.reader(operator)
        return (self._readers[key][1] @ skin.motion(state[: skin.state_size]).T).T

    def settled(self, pose: Pose) -> Pose:
        """The reference pose where a small model is meant and body and arrays are as good as there, else the pose."""
        rig, reference = self.rig, self.reference
        if rig.choice.name != "reduced" or not rig.reference_emitter.same(pose.arrays):
            return pose
        away = pose.points(self._extent(pose)) - reference.points(self._extent(reference))
        return reference if np.abs(away).max() < self.limit_m else pose

    @cached_property
    def limit_m(self) -> float:
        """What moves by less than this counts as still [m]."""
        return STILL * self.rig.skin.accuracy * self.rig.spot_fwhm_m

    def _extent(self, pose: Pose) -> Float:
        """Points that tell how far anything moves: a box round the skin, with bones all of the hand; and obstacles."""
        posed = self.rig.posed(pose)
        points = self._corners if self.rig.hand is None else posed.vertices
        return points if posed.beside is None else np.concatenate([points, posed.beside[0]])

    @cached_property
    def _corners(self) -> Float:
        nodes = self.rig.mesh.nodes[: self.rig.mesh.surface_nodes]
        ends = np.array([nodes.min(axis=0), nodes.max(axis=0)])
        return np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)

    def stepper(self, state: Float, start: float, aim: Aim, pose: Pose) -> FullSkin | ReducedSkin:
        """What steps the skin from `start` [s] on; it changes to the whole layer, with its state, where it must.

        Raises SceneError instead where key `solver` asks for the small model.
        """
        skin = self.of(state)
        if isinstance(skin, FullSkin):
            return skin
        rig = self.rig
        focus = aim(frame_at(rig.stimulus, rig.stimulus.start_s).focus)
        far = float(np.abs(focus - rig.reference_foci).max())
        moved = pose is not self.reference or far > self.limit_m
        late = rig.stimulus.start_s < start - 1e-9 and not state[: skin.state_size].any() and not skin.any_course
        if not moved and not late:
            return skin
        if rig.skin.solver == "reduced":
            what = f"body '{rig.skin.body}', an array or the focus has moved" if moved else "the skin begins at rest"
            raise SceneError(
                f"plugin 'palmfield.skin': key 'solver' has value 'reduced', but {what} at {start:g} s, which the "
                "small model was not made for; set solver to auto or full"
            )
        full = self.full
        state[: full.state_size] = skin.lifted(state[: skin.state_size], self.chain.force(state, start, aim, pose))
        state[rig.skin_room] = 1.0
        return full
