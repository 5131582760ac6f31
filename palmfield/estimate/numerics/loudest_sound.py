"""Compute the sound of the loudest moment of a run on any mesh of a skin layer."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from palmfield.session.loudest_moment import LoudestMoment
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface
from palmfield.simulation.radiation import Radiation
from palmfield.skin.scene_layer import SceneLayer
from palmfield.types import Float

T = TypeVar("T")


class LoudestSound:
    """ARP of the loudest moment on other meshes of a layer."""

    def __init__(self, model: HapticModel, skin: int, loudest: LoudestMoment, radiation: Radiation):
        self.model, self.skin, self.loudest, self.radiation = model, skin, loudest, radiation
        self.on_own: Float = self._arp(radiation, loudest.posed)

    def on(self, layer: SceneLayer) -> Float:
        """Return the ARP [Pa] at the quadrature points of a layer, shape (q,)."""
        model, skin, posed = self.model, self.skin, self.loudest.posed
        part = model.skins[skin]
        if layer is part.layer:
            return self.on_own
        other = SkinModel(part.spec, part.body, part.carrier, layer, part.choice)
        place, body = posed.skins[skin], posed.bodies[part.body]
        disc = part.carrier.surface is None
        if disc:
            # The boundary mesh of a disc is its skin mesh; other bodies have their own.
            body = PosedSurface(part.carrier, other, body.frame, (body.bone_positions, body.bone_rotations))
        obstacles = place.obstacle_positions, place.obstacle_rotations
        varied_model = replace(model, skins=_exchanged(model.skins, skin, other))
        bodies = _exchanged(posed.bodies, part.body, body)
        skins = _exchanged(posed.skins, skin, PosedSkin(other, body, obstacles))
        varied = PosedScene(posed.array_frame, posed.arrays, posed.frames, bodies, skins)
        radiation, solution = Radiation(varied_model), self.radiation.solution(skin)
        if solution is not None and not disc:
            radiation.adopt(skin, solution._replace(posed=varied))
        return self._arp(radiation, varied)

    def _arp(self, radiation: Radiation, posed: PosedScene) -> Float:
        return radiation.on(posed, self.skin, "quadrature", self.loudest.drive).arp.astype(np.float64)


def _exchanged(parts: Sequence[T], number: int, other: T) -> tuple[T, ...]:
    """Return the parts with one of them replaced."""
    return (*parts[:number], other, *parts[number + 1 :])
