"""ARP on the surfaces of a posed scene: the stages field and ARP of a step, with what they keep for the next one.

A Radiation belongs to one state and is used by one thread at a time: it holds buffers for the points of each skin, and
the last ARP of each role, under the serial numbers of pose and drive.
"""

from collections.abc import Callable
from functools import partial
from typing import Literal, NamedTuple

import numpy as np

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import SurfaceSound
from palmfield.acoustics.body_scattering import Occlusion, RigidScatteredField, boundary_mesh
from palmfield.acoustics.knife_edge import Emitters, KnifeEdges
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.shadow_nodes import ShadowNodes, shadow_nodes
from palmfield.acoustics.surface_arp import Shades, SurfaceArp, rows_of
from palmfield.acoustics.surface_load import distance_to_arrays
from palmfield.drive.transducer_response import EmittedCourse
from palmfield.locked import next_serial
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene, PosedSkin, PosedSurface, reference_scene
from palmfield.simulation.seen_samples import SeenSamples, seen_samples
from palmfield.types import Complex, Float, Float32, Int

Role = Literal["quadrature", "load", "samples", "nodes", "vertices", "probe"]
"""Purposes of points: each role of a skin has its own buffers."""


SKIN_SPACING_m, BODY_SPACING_m = 0.008, 0.024
"""Distance between the nodes of the shadows: on the layer of a skin, and on the body for the force on it."""
ALWAYS = np.ones(1, dtype=bool)
Key = tuple[int, ...]
"""Serial numbers of what something was computed from."""


class Radiation:
    """ARP at the points of the skins of a model."""

    def __init__(self, model: HapticModel, beside: "Radiation | None" = None):
        """beside: of another world, stepped by the same thread: its buffers and trees are shared, not its results."""
        self.model = model
        self._evaluators: dict[tuple[int, str, int], tuple[int, SurfaceArp]] = {}
        self._occlusions: dict[int, tuple[PosedScene, Occlusion]] = {}
        self._scattered: dict[int, tuple[PosedScene, Complex, RigidScatteredField]] = {}
        self._sounds: dict[tuple[int, str], tuple[Key, SurfaceSound]] = {}
        self._batches: dict[tuple[int, str], tuple[Key, Float32]] = {}
        self._chosen: dict[int, _ChosenPoints] = {}
        self._choices: dict[tuple[int, int], _ChosenPoints] = {}  # which hold the numbers, so that ids stay theirs
        self._seen: dict[int, tuple[Key, SeenSamples]] = {}
        self._shadings: dict[tuple[int, str, int], _Shading] = {}
        self._bent = [bends(skin) for skin in model.skins]
        self._reference: list[PosedScene] = []
        self._emitters: list[tuple[int, Emitters]] = []
        if beside is not None:
            self._evaluators, self._occlusions = beside._evaluators, beside._occlusions
            self._chosen, self._choices, self._shadings = beside._chosen, beside._choices, beside._shadings
            self._reference, self._emitters = beside._reference, beside._emitters

    def choose(self, skin: int, points: Int) -> None:
        """Take these of the quadrature points of a skin, numbers of shape (p,), for the role "load"."""
        key = skin, id(points)
        if key not in self._choices:
            self._choices[key] = _ChosenPoints(self.model.skins[skin], points)
        self._chosen[skin] = self._choices[key]

    def chosen(self, skin: int) -> int:
        """The serial number of the points of a skin for the role "load"."""
        return self._chosen[skin].serial

    def on(self, posed: PosedScene, skin: int, role: Role, drive: Complex, serial: int = 0) -> SurfaceSound:
        """ARP at quadrature points, force samples or surface nodes of a skin, for the emission (N,) of the transducers.

        serial: of the drive, the key of the stored result; 0 for a drive without one.
        """
        key = *self._places(posed, skin, role), serial
        known = self._sounds.get((skin, role))
        if serial and known is not None and known[0] == key:
            return known[1]
        points, normals = self.points(posed, skin, role)
        sound = self.at(posed, skin, role, points, normals, drive)
        if serial:
            self._sounds[skin, role] = key, sound
        return sound

    def patterns(self, posed: PosedScene, skin: int, role: Role, course: EmittedCourse) -> Float32:
        """The patterns of ARP [Pa] to which the `weights` of a course apply, shape (p, n)."""
        if len(course.units) == 0:
            return np.zeros((1, len(self.points(posed, skin, role)[0])), np.float32)
        if len(course.units) == 1:
            return self.on(posed, skin, role, course.units[0], course.serial).arp[None]
        if len(course.units) < len(course.levels):
            return self.sums(posed, skin, course.units, course.levels, role)
        if course.batch is not None:
            key = *self._places(posed, skin, role), course.batch.serial
            known = self._batches.get((skin, role))
            if known is None or known[0] != key:
                known = self._batches[skin, role] = key, self.many(posed, skin, course.batch.drives, role)
            return known[1][course.row : course.row + len(course.units)]
        # An unchanged emission is computed once
        changes = np.logical_or.reduce(course.units[1:] != course.units[:-1], axis=1)
        if np.logical_and.reduce(changes):
            return self.many(posed, skin, course.units, role)
        first = np.concatenate((ALWAYS, changes))
        computed = self.many(posed, skin, course.units[first], role)
        return np.asarray(computed[np.add.accumulate(first, dtype=np.intp) - 1])

    def _places(self, posed: PosedScene, skin: int, role: Role) -> "Key":
        """Key: equal while the points of a skin for a role and all bodies in the path of the sound are in place."""
        return posed.sound_keys[skin] if role != "load" else (*posed.sound_keys[skin], self._chosen[skin].serial)

    def many(self, posed: PosedScene, skin: int, drives: Complex, role: Role = "quadrature") -> Float32:
        """ARP as `on` gives it for several drives, shape (m, N): shape (m, n)."""
        bent = self._bent[skin]
        if self.model.skins[skin].spec.config.body_sound != "none" and not bent:
            return np.stack([self.on(posed, skin, role, drive).arp for drive in drives])
        points, normals = self.points(posed, skin, role)
        evaluator = self._evaluator(posed, skin, role, len(points))
        shades = self._shades(posed, skin, role, points, normals) if bent else None
        return evaluator.evaluate_many(points, normals, drives, shades=shades)

    def sounds(self, posed: PosedScene, skin: int, drives: Complex, role: Role = "quadrature") -> SurfaceSound:
        """ARP as `many` gives it, and the pressures' peak amplitudes, shapes (m, n)."""
        bent = self._bent[skin]
        if self.model.skins[skin].spec.config.body_sound != "none" and not bent:
            each = [self.on(posed, skin, role, drive) for drive in drives]
            return SurfaceSound(np.stack([one.arp for one in each]), np.stack([one.amplitude for one in each]))
        points, normals = self.points(posed, skin, role)
        evaluator = self._evaluator(posed, skin, role, len(points))
        shades = self._shades(posed, skin, role, points, normals) if bent else None
        amplitudes = np.empty((len(drives), len(points)), np.float32)
        return SurfaceSound(
            evaluator.evaluate_many(points, normals, drives, shades=shades, amplitudes=amplitudes), amplitudes
        )

    def sums(self, posed: PosedScene, skin: int, units: Complex, levels: Complex, role: Role = "quadrature") -> Float32:
        """ARP as from `many` for levels (m, k) @ units (k, N), of which there are few, shape (m, n)."""
        if self.model.skins[skin].spec.config.body_sound != "none":
            return self.many(posed, skin, levels @ units, role)
        points, normals = self.points(posed, skin, role)
        return self._evaluator(posed, skin, role, len(points)).evaluate_sums(points, normals, units, levels)

    def at(
        self, posed: PosedScene, skin: int, role: Role, points: Float, normals: Float, drive: Complex
    ) -> SurfaceSound:
        """ARP at any points of the body of a skin with outward normals, array frame, shapes (n, 3)."""
        kind = self.model.skins[skin].spec.config.body_sound
        if kind == "scattering":
            own = posed.skins[skin].body.frame.inverse_points(points)
            return self._scattered_field(posed, skin, drive).at(own)
        evaluator = self._evaluator(posed, skin, role, len(points))
        if self._bent[skin]:
            shades = self._shades(posed, skin, role, points, normals)
            sound = evaluator.evaluate(points, normals, drive, shades=shades)
            return SurfaceSound(sound.arp.copy(), sound.amplitude.copy())
        sound = evaluator.evaluate(points, normals, drive, flux=kind == "shadows")
        arp = sound.arp.copy()
        if kind == "shadows":
            assert sound.flux is not None
            # Points without pressure need no ray: these would be half of the rays, and the more expensive half
            sound.flux[arp == 0.0] = 0.0
            reach = distance_to_arrays(points, sound.flux, posed.arrays)
            arp[~self._occlusion(posed, skin).lit(points, sound.flux, reach)] = 0.0
        return SurfaceSound(arp, sound.amplitude.copy())

    def scattered_fields(self) -> dict[int, tuple[PosedScene, Complex, RigidScatteredField]]:
        """The last solutions by boundary elements, by skin, with their pose and drive."""
        return self._scattered

    def adopt(self, scattered: dict[int, tuple[PosedScene, Complex, RigidScatteredField]]) -> None:
        """Begin with solutions that another Radiation of the same bodies has found."""
        self._scattered = dict(scattered)

    def continue_from(self, other: "Radiation") -> None:
        """Take over what another one has computed ahead, for a copy of its state in the same PosedScenes."""
        self._batches, self._choices = dict(other._batches), dict(other._choices)

    def points(self, posed: PosedScene, skin: int, role: Role) -> tuple[Float, Float]:
        """Points [m] and outward normals, array frame, shapes (n, 3), of a skin or its body."""
        part = posed.skins[skin]
        if role == "load":
            return self._chosen[skin].at(part)
        if role == "samples":
            return self.samples(posed, skin)[:2]
        return part.nodes if role == "nodes" else part.quadrature

    def samples(self, posed: PosedScene, skin: int) -> SeenSamples:
        """Points for the force on the body: those that the arrays see, and all where sound goes round the body."""
        body, arrays = posed.skins[skin].body, posed.arrays
        known, key = self._seen.get(skin), (arrays.serial, body.serial)
        if known is None or known[0] != key:
            around = self.model.skins[skin].spec.config.body_sound == "scattering"
            made = (
                (*body.samples, np.arange(len(body.samples[2]), dtype=np.int32))
                if around
                else seen_samples(body, arrays)
            )
            known = self._seen[skin] = key, made
        return known[1]

    def _holds(self, known: PosedScene, posed: PosedScene, skin: int) -> bool:
        """Whether the sound on a skin is the same in both poses."""
        return known.sound_keys[skin] == posed.sound_keys[skin]

    def _evaluator(self, posed: PosedScene, skin: int, role: str, count: int) -> SurfaceArp:
        key = skin, role, count
        known = self._evaluators.get(key)
        if known is None or known[0] != posed.arrays.serial:
            law = self.model.skins[skin].spec.arp_law
            known = self._evaluators[key] = posed.arrays.serial, SurfaceArp(posed.arrays.field, count, law)
        return known[1]

    def _shades(self, posed: PosedScene, skin: int, role: Role, points: Float, normals: Float) -> Shades | None:
        """Shares of the sound of each transducer at the points of a skin behind bodies; None without obstacles."""
        key = skin, role, len(points)
        chosen = self._numbers(posed, skin, role)
        known = self._shadings.get(key)
        if known is not None and known.of(chosen, points) and self._holds(known.posed, posed, skin):
            return known.shades
        occlusion, emitters = self._occlusion(posed, skin), self._emitters_at(posed.arrays)
        if known is None or not known.stays:
            known = self._shading(posed, skin, role, points, normals, partial(KnifeEdges, occlusion.outline, emitters))
        edges = known.edges
        if chosen is not None:
            edges.choose(chosen)
        there = edges.evaluate(*self._node_places(posed, skin, role, points, normals, known))
        shades = edges.shades if there else None
        self._shadings[key] = known._replace(posed=posed, chosen=chosen, points=points, shades=shades)
        return shades

    def _shading(
        self,
        posed: PosedScene,
        skin: int,
        role: Role,
        points: Float,
        normals: Float,
        edges_of: Callable[[ShadowNodes, int], KnifeEdges],
    ) -> "_Shading":
        """Nodes among the points of a role, and the shadows computed there."""
        if not self._reference:
            self._reference.append(reference_scene(self.model))
        rest, stays, bound = self._reference[0].skins[skin], True, None
        if role in ("quadrature", "load"):
            nodes = load_nodes(rest)
            if role == "load":
                bound = _ChosenPoints(self.model.skins[skin], nodes.numbers)
        elif role == "nodes":
            nodes = shadow_nodes(*rest.nodes, SKIN_SPACING_m)
        elif role == "samples":
            nodes = sample_nodes(rest.body)
        else:
            # In their present places, so that the result does not depend on earlier ones
            nodes, stays = shadow_nodes(points, normals, BODY_SPACING_m), len(points) == 1
        return _Shading(posed, edges_of(nodes, len(points)), stays, bound)

    def _node_places(
        self, posed: PosedScene, skin: int, role: Role, points: Float, normals: Float, shading: "_Shading"
    ) -> tuple[Float, Float]:
        """Positions of the nodes [m] and the normals there, array frame, shapes (m, 3)."""
        if shading.bound is not None:
            return shading.bound.at(posed.skins[skin])
        numbers = shading.edges.nodes.numbers
        if role == "samples":
            points, normals = posed.skins[skin].body.samples[:2]
        return points[numbers], normals[numbers]

    def _emitters_at(self, arrays: PhasedArray) -> Emitters:
        """The transducers where they are."""
        if not self._emitters:
            self._emitters.append((arrays.serial, Emitters(arrays, rows_of(arrays.field), arrays.field.device)))
        known, emitters = self._emitters[0]
        if known != arrays.serial:
            emitters.move(arrays, rows_of(arrays.field))
            self._emitters[0] = arrays.serial, emitters
        return emitters

    def _numbers(self, posed: PosedScene, skin: int, role: Role) -> Int | None:
        """Numbers of a role's points among the points fixed on a body; None for any points."""
        if role == "load":
            return self._chosen[skin].numbers
        if role == "samples":
            return self.samples(posed, skin)[3]
        return None

    def _occlusion(self, posed: PosedScene, skin: int) -> Occlusion:
        """The obstacles of a skin: its own body, the bodies of the other skins, and its listed obstacles."""
        known = self._occlusions.get(skin)
        if known is not None and self._holds(known[0], posed, skin):
            return known[1]
        vertices = occluding_vertices(posed, skin)
        if known is None:
            occlusion = Occlusion(
                vertices, occluding_faces(posed, skin), self.model.spec.device, counts=occluding_counts(posed, skin)
            )
        else:
            occlusion = known[1]
            occlusion.move(vertices)
        self._occlusions[skin] = posed, occlusion
        return occlusion

    def _scattered_field(self, posed: PosedScene, skin: int, drive: Complex) -> RigidScatteredField:
        """Total sound on a rigid body, in the body's frame; the last one is stored."""
        known = self._scattered.get(skin)
        if known is not None and self._holds(known[0], posed, skin) and _equal(known[1], drive):
            return known[2]
        arrays, part = posed.arrays, posed.skins[skin]
        wavenumber = 2.0 * np.pi * arrays.array.frequency_Hz / sound_speed(arrays.air)

        def incident(points: Float) -> Complex:
            return arrays.field.pressure(part.body.frame.points(points), drive).pressure.astype(np.complex128)

        mesh = boundary_mesh(part.body.vertices, part.body.faces, 2.0 * np.pi / wavenumber)
        solved = RigidScatteredField.of(mesh, incident, wavenumber, arrays.air, self.model.spec.device)
        self._scattered[skin] = posed, drive, solved
        return solved


class _Shading(NamedTuple):
    """The shadow data of some points in a pose. edges: computes them. stays: whether the nodes are equal in all poses.

    bound: the nodes, where they are not among the points themselves. chosen: numbers of the points, None where all are
    given. points: their positions [m]. shades: the last result.
    """

    posed: PosedScene
    edges: KnifeEdges
    stays: bool
    bound: "_ChosenPoints | None"
    chosen: Int | None = None
    points: Float | None = None
    shades: Shades | None = None

    def of(self, chosen: Int | None, points: Float) -> bool:
        """Whether the last result was for these points."""
        return self.chosen is chosen if chosen is not None else self.points is points


class _ChosenPoints:
    """Some of the quadrature points of a skin. numbers: shape (p,)"""

    def __init__(self, skin: SkinModel, numbers: Int):
        quadrature = skin.layer.quadrature
        self.numbers, self.serial = numbers, next_serial()
        self._points, self._normals = quadrature.points[numbers], quadrature.normals[numbers]
        self._binding = skin.carrier.bind(self._points)
        self._last: tuple[int, tuple[Float, Float]] | None = None

    def at(self, posed: PosedSkin) -> tuple[Float, Float]:
        """Positions [m] and outward normals in a pose, array frame, shapes (p, 3)."""
        if self._last is None or self._last[0] != posed.serial:
            self._last = posed.serial, posed.body.moved(self._points, self._normals, self._binding)
        return self._last[1]


def bends(skin: SkinModel) -> bool:
    """Whether sound bends round what casts shadows on a skin."""
    config = skin.spec.config
    return config.body_sound == "shadows" and config.shadow_edges == "knife_edge"


def load_nodes(skin: PosedSkin) -> ShadowNodes:
    """Nodes among the quadrature points of a skin, in the reference scene."""
    return shadow_nodes(*skin.quadrature, SKIN_SPACING_m)


def sample_nodes(body: PosedSurface) -> ShadowNodes:
    """Nodes among the samples for the force on a body, in the reference scene."""
    return shadow_nodes(*body.samples[:2], BODY_SPACING_m)


def occluding_vertices(posed: PosedScene, skin: int) -> Float:
    """Vertices of all that casts shadows on a skin, array frame [m], shape (v, 3)."""
    parts = []
    for body in posed.bodies:
        parts.append(body.vertices_in_array)
    obstacles = posed.skins[skin].obstacles
    if obstacles is not None:
        parts.append(obstacles[0])
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def occluding_counts(posed: PosedScene, skin: int) -> list[int]:
    """Number of vertices of each body that casts shadows on a skin."""
    obstacles = posed.skins[skin].obstacles
    counts = [len(body.vertices) for body in posed.bodies]
    return counts if obstacles is None else [*counts, len(obstacles[0])]


def occluding_faces(posed: PosedScene, skin: int) -> Int:
    """Their faces, shape (f, 3)."""
    meshes = [(len(body.vertices), body.faces) for body in posed.bodies]
    obstacles = posed.skins[skin].obstacles
    if obstacles is not None:
        meshes.append((len(obstacles[0]), obstacles[1]))
    starts = np.cumsum([0, *(count for count, _ in meshes)])
    return np.concatenate([faces + start for (_, faces), start in zip(meshes, starts, strict=False)]).astype(np.int32)


def _equal(one: Complex, other: Complex) -> bool:
    """Whether two drives, both of shape (N,), are the same to the bit."""
    return not np.logical_or.reduce(one != other)
