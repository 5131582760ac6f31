"""Effects of bodies on the sound on a skin: shadows by rays, diffraction at edges, or boundary elements.

This file is loaded only for scenes with such a skin. Search trees and weights are moved in place. Worlds that one
thread steps share them.
"""

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.knife_edge import Emitters, KnifeEdges, ShadowNodes, shadow_nodes
from palmfield.acoustics.occlusion import Occlusion, distance_to_arrays
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.surface_arp import Shades, rows_of
from palmfield.simulation.cached import Cached
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface, reference_scene
from palmfield.simulation.skin_sound import ChosenPoints, FreeSound, SkinPoints, Solution, VisibleSamples
from palmfield.types import Complex, Float, Int

SKIN_SPACING_m, BODY_SPACING_m = 0.008, 0.024
"""Spacing of the shadow nodes: on the layer of a skin, and on the body for the force on it."""


class _Behind(FreeSound):
    """Sound on a skin behind bodies. shared: search trees and weights that are moved in place"""

    def __init__(self, model: HapticModel, shared: Cached):
        self.model, self._shared = model, shared

    def _obstacles(self, posed: PosedScene, skin: int) -> Occlusion:
        """Return the obstacles of a skin: its own body, the bodies of the other skins, and its listed obstacles."""
        return self._shared.of(
            ("obstacles", skin),
            posed.sound_keys[skin],
            lambda: occlusion(posed, skin, self.model.spec.device),
            move=lambda obstacles: obstacles.move(_vertices(posed, skin)),
        )


class ShadedSound(_Behind):
    """Sound on a skin with sharp shadows. A ray from each point, opposite to the energy flux, tests for bodies."""

    one_by_one = True

    def sound(self, at: SkinPoints, drive: Complex) -> SurfaceSound:
        posed, skin, _, points, normals, _, field = at
        sound = field.evaluate(points, normals, drive, flux=True)
        assert sound.flux is not None
        arp = sound.arp.copy()
        # Points without pressure need no ray: these would be half of the rays, and the more expensive half
        sound.flux[arp == 0.0] = 0.0
        reach = distance_to_arrays(points, sound.flux, posed.arrays)
        arp[~self._obstacles(posed, skin).lit(points, sound.flux, reach)] = 0.0
        return SurfaceSound(arp, sound.amplitude.copy())


class BentSound(_Behind):
    """Sound on a skin with diffraction at the edges of bodies."""

    bends = True

    def shades(self, at: SkinPoints) -> Shades | None:
        posed, skin, role, points, normals, numbers, _ = at
        buffers = skin, role, len(points)
        # Chosen numbers are stored, so that their ids stay unique
        free = role in ("vertices", "probe")
        places = (points.tobytes(), normals.tobytes()) if free else (id(numbers),)
        # For arbitrary points, nodes are at their present places, so that the result does not depend on earlier calls
        key = *posed.sound_keys[skin], *places
        nodes = key if free and len(points) > 1 else ()
        return self._shared.of(("shades", *buffers), key, self._shade, at, ("edges", *buffers), nodes)

    def _shade(self, at: SkinPoints, name: tuple[object, ...], key: tuple[object, ...]) -> Shades | None:
        posed, skin, role, points, normals, numbers, _ = at
        arrays, obstacles = posed.arrays, self._obstacles(posed, skin)
        emitters = self._shared.of(
            "emitters",
            arrays.serial,
            lambda: Emitters(arrays, rows_of(arrays.field), arrays.field.device),
            move=lambda emitters: emitters.move(arrays, rows_of(arrays.field)),
        )
        edges, nodes = self._shared.of(name, key, self._edges, at, obstacles, emitters)
        if numbers is not None:
            edges.choose(numbers)
        body = posed.skins[skin].body
        if nodes is not None:
            places, normals = body.moved(*nodes.rest)
        else:
            of_all = body.samples[:2] if role == "samples" else (points, normals)
            places, normals = (values[edges.nodes.numbers] for values in of_all)
        return edges.shades if edges.evaluate(places, normals) else None

    def _edges(
        self, at: SkinPoints, obstacles: Occlusion, emitters: Emitters
    ) -> tuple[KnifeEdges, ChosenPoints | None]:
        """Return the evaluator of transmitted fractions at the points of a role.

        Also return the shadow nodes, if these are other points.
        """
        _, skin, role, points, normals, _, _ = at
        rest, bound = self._shared.of("reference", (), reference_scene, self.model).skins[skin], None
        if role in ("quadrature", "load"):
            nodes = load_nodes(rest)
            if role == "load":
                bound = ChosenPoints(self.model.skins[skin], nodes.numbers)
        elif role == "nodes":
            nodes = shadow_nodes(*rest.nodes, SKIN_SPACING_m)
        elif role == "samples":
            nodes = sample_nodes(rest.body)
        else:
            nodes = shadow_nodes(points, normals, BODY_SPACING_m)
        return KnifeEdges(obstacles.outline, emitters, nodes, len(points)), bound


class ScatteredSound(FreeSound):
    """Total sound on the rigid body of a skin. cached: stores the last solution"""

    one_by_one = True

    def __init__(self, model: HapticModel, cached: Cached):
        self.model, self._cached = model, cached

    @staticmethod
    def samples(body: PosedSurface, arrays: PhasedArray) -> VisibleSamples:
        """Return all samples, because sound is diffracted around the body."""
        return *body.samples, np.arange(len(body.samples[2]), dtype=np.int32)

    def sound(self, at: SkinPoints, drive: Complex) -> SurfaceSound:
        posed, skin, _, points, *_ = at
        key = Solution.key(posed, skin, drive)
        solution = self._cached.of(("solution", skin), key, self._solve, posed, skin, drive)
        return solution.at(posed.skins[skin].body.frame.inverse_points(points))

    def _solve(self, posed: PosedScene, skin: int, drive: Complex) -> Solution:
        from palmfield.acoustics.body_scattering import RigidScatteredField, boundary_mesh

        arrays, body = posed.arrays, posed.skins[skin].body
        wavenumber = 2.0 * np.pi * arrays.array.frequency_Hz / sound_speed(arrays.air)

        def incident(points: Float) -> Complex:
            return arrays.field.pressure(body.frame.points(points), drive).pressure.astype(np.complex128)

        mesh = boundary_mesh(body.vertices, body.faces, 2.0 * np.pi / wavenumber)
        solved = RigidScatteredField.of(mesh, incident, wavenumber, arrays.air, self.model.spec.device)
        return Solution(posed, drive, solved.at)


def load_nodes(skin: PosedSkin) -> ShadowNodes:
    """Return which quadrature points of a skin are shadow nodes, in the reference scene."""
    return shadow_nodes(*skin.quadrature, SKIN_SPACING_m)


def sample_nodes(body: PosedSurface) -> ShadowNodes:
    """Return which force samples of a body are shadow nodes, in the reference scene."""
    return shadow_nodes(*body.samples[:2], BODY_SPACING_m)


def occlusion(posed: PosedScene, skin: int, device: str) -> Occlusion:
    """Return the object that tests for obstacles of a skin in a pose."""
    meshes = [(len(body.vertices), body.faces) for body in posed.bodies]
    obstacles = posed.skins[skin].obstacles
    if obstacles is not None:
        meshes.append((len(obstacles[0]), obstacles[1]))
    counts = [count for count, _ in meshes]
    starts = np.cumsum([0, *counts])
    faces: Int = np.concatenate([own + start for (_, own), start in zip(meshes, starts, strict=False)]).astype(np.int32)
    return Occlusion(_vertices(posed, skin), faces, device, counts)


def _vertices(posed: PosedScene, skin: int) -> Float:
    """Return the vertices of all obstacles of a skin, array frame [m], shape (v, 3)."""
    parts = []
    for body in posed.bodies:
        parts.append(body.vertices_in_array)
    obstacles = posed.skins[skin].obstacles
    if obstacles is not None:
        parts.append(obstacles[0])
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
