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
from palmfield.types import Complex, Float

T = TypeVar("T")


class LoudestSound:
    """ARP of the loudest moment on other meshes of a layer, and ARP along the path of a moving focus.

    path: emissions at the places of the focus, (k, N), or None.
    """

    def __init__(
        self,
        model: HapticModel,
        skin: int,
        loudest: LoudestMoment,
        radiation: Radiation,
        path: Complex | None = None,
    ):
        self.model, self.skin, self.loudest, self.radiation, self.path = model, skin, loudest, radiation, path
        self.on_own: Float = self._arp(radiation, loudest.posed)

    def on(self, layer: SceneLayer) -> Float:
        """Return the ARP [Pa] at the quadrature points of a layer, shape (q,)."""
        return self.on_own if layer is self.model.skins[self.skin].layer else self._arp(*self._posed(layer))

    def along(self, layer: SceneLayer) -> Float | None:
        """Return the ARP [Pa] at the places of the path, shape (k, q), or None."""
        if self.path is None:
            return None
        radiation, posed = self._posed(layer)
        return radiation.many(posed, self.skin, self.path).astype(np.float64)

    def _posed(self, layer: SceneLayer) -> tuple[Radiation, PosedScene]:
        """Return the radiation of the scene with a layer, and its pose."""
        model, skin, posed = self.model, self.skin, self.loudest.posed
        part = model.skins[skin]
        if layer is part.layer:
            return self.radiation, posed
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
        return radiation, varied

    def _arp(self, radiation: Radiation, posed: PosedScene) -> Float:
        return radiation.on(posed, self.skin, "quadrature", self.loudest.drive).arp.astype(np.float64)


def _exchanged(parts: Sequence[T], number: int, other: T) -> tuple[T, ...]:
    """Return the parts with one of them replaced."""
    return (*parts[:number], other, *parts[number + 1 :])
