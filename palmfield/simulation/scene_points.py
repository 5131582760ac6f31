"""Points of a scene at which sound is computed, on a device. They move with bodies and bones.

There are three kinds: points for the load on skins, sensors, and points for the force on bodies. The meshes of
obstacles move in the same way.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.acoustics.occlusion import Occlusion
from palmfield.device import filled, launch, vectors, whole_numbers
from palmfield.hand.posed_surface import SkinBinding
from palmfield.hand.rigged import strongest
from palmfield.hand.skinning import SkinnedSurface
from palmfield.hand.triangles import face_normals
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene, PoseLayout
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.shadows import occlusion
from palmfield.skin.stepper import SkinStepper
from palmfield.types import Float, Int, Surface
from warp_kernels import carried_points as carrying
from warp_kernels import resultants as summing

SQUARE = 8
"""Number of cells per side of the grid into which directions are sorted, a power of two."""
TINY = 1e-30
RUN = 16
"""Number of force samples that one thread sums."""


class MotionRows(NamedTuple):
    """Objects that move points, one row for each motion. Motions of bodies come first, because sound pushes bodies.

    bodies: rows of each body: its bones or itself
    obstacles: rows of the obstacles, by skin
    total: number of motions
    frames: row of each frame in a PoseLayout
    rest: origin of each in the resting body [m], shape (total, 3)
    """

    bodies: list[slice]
    obstacles: list[slice]
    total: int
    frames: list[int]
    rest: Float

    @property
    def parts(self) -> int:
        """Return the number of motions of bodies, which sound pushes."""
        last: int = self.bodies[-1].stop
        return last


def motions_of(model: HapticModel, layout: PoseLayout) -> MotionRows:
    """Return the motions of the bodies and obstacles of a model."""
    bodies, obstacles, frames = list[slice](), list[slice](), list[int]()
    rest: list[Float] = []
    for body, (row, bones) in zip(model.bodies, layout.bodies, strict=True):
        bodies.append(slice(len(frames), len(frames) + body.parts))
        frames += [row] if body.hand is None else range(bones.start, bones.stop)
        rest.append(np.zeros((1, 3)) if body.hand is None else body.rest_origins)
    for own in layout.obstacles:
        obstacles.append(slice(len(frames), len(frames) + own.stop - own.start))
        frames += range(own.start, own.stop)
        rest.append(np.zeros((own.stop - own.start, 3)))
    return MotionRows(bodies, obstacles, len(frames), frames, np.concatenate(rest))


class _Bound(NamedTuple):
    """Points at rest with the motions that carry them.

    Points [m], shape (n, 3); motions, and their weights, both of shape (n, 4).
    """

    points: Float
    motions: Int
    shares: Float


def _bound(points: Float, binding: SkinBinding | None, first: int) -> _Bound:
    """Bind points to a body whose motions begin at row `first`: to its bones, or to the body itself."""
    if binding is not None:
        return _Bound(points, (binding.bones + first).astype(np.int32), binding.shares)
    motions = np.full((len(points), 4), first, np.int32)
    return _Bound(points, motions, np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)))


def _bound_vertices(hand: SkinnedSurface | None, vertices: Float, first: int) -> _Bound:
    """Bind the vertices of a surface to its bones, or to the body if it has none."""
    if hand is None:
        return _bound(vertices, None, first)
    shares, bones = strongest(sparse.csr_array(hand.weights))
    return _Bound(hand.surface.vertices, (bones + first).astype(np.int32), shares)


def _joined(parts: Sequence[_Bound]) -> _Bound:
    return _Bound(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _carriers(bound: _Bound, device: str) -> Any:
    """Return the bound points in the data type of the kernels."""
    return filled(
        carrying.Carriers(),
        motions=wp.array(bound.motions, dtype=wp.vec4i, device=device),
        shares=wp.array(bound.shares, dtype=wp.vec4d, device=device),
    )


class ScenePoints:
    """All points of a scene on a device, in this order: load of the skins, sensors, force on bodies.

    points, normals: vec3
    areas: areas of the force samples [m2], float64
    quadrature: range of each skin
    samples: for each body its number and the range of its force samples
    orders: for bodies with sorted samples, the number of each sample in the order of the body
    loaded, probed, sampled: all points of one kind
    count: number of all points
    """

    def __init__(
        self,
        model: HapticModel,
        reference: PosedScene,
        rows: MotionRows,
        probes: Sequence[tuple[int, SensorPlace]],
        device: str,
        worlds: int = 1,
        steppers: Mapping[int, SkinStepper] | None = None,
        alike: bool = False,
    ):
        """steppers: steppers of skins for which points are needed only where the stepper takes pressure
        alike: whether force samples are sorted by direction, so that neighbouring threads are in shadow together
        """
        self._device, self._worlds = device, worlds
        bound: list[tuple[_Bound, Float]] = []
        self.quadrature: list[slice] = []
        count = 0
        for skin in model.skins:
            first = rows.bodies[skin.body].start
            points, normals, binding = _loaded(skin, (steppers or {}).get(len(self.quadrature)))
            bound.append((_bound(points, binding, first), normals))
            self.quadrature.append(slice(count, count + len(points)))
            count = self.quadrature[-1].stop
        self.loaded = slice(0, count)
        for number, place in probes:
            first = rows.bodies[model.skins[number].body].start
            bound.append((_bound(place.probe.closest, place.binding, first), place.probe.normals))
            count += 1
        self.probed = slice(self.loaded.stop, count)
        self.samples: list[tuple[int, slice]] = []
        self.orders: dict[int, Int] = {}
        areas: list[Float] = []
        start = count
        whole = [number for number, body in enumerate(model.bodies) if body.hand is None]
        for number in whole:
            points, normals, own = _rest_samples(reference, number)
            bound.append((_bound(points, None, rows.bodies[number].start), normals))
            self.samples.append((number, slice(count - start, count - start + len(points))))
            areas.append(own)
            count += len(points)
        self._carried = count
        vertices: list[_Bound] = []
        faces: list[Int] = []
        corners = 0
        for number, body in enumerate(model.bodies):
            if body.hand is None:
                continue
            own_faces = body.sampled.surface.faces
            if alike:
                order = self.orders[number] = _by_direction(body.sampled.surface, reference.bodies[number].sample_parts)
                own_faces = own_faces[order]
            vertices.append(_bound_vertices(body.sampled, body.sampled.surface.vertices, rows.bodies[number].start))
            faces.append(own_faces + corners)
            corners += len(vertices[-1].points)
            self.samples.append((number, slice(count - start, count - start + len(own_faces))))
            areas.append(np.zeros(len(own_faces)))
            count += len(own_faces)
        self.sampled, self.count = slice(start, count), count
        self._areas = np.concatenate(areas)
        self._rest = _joined([part for part, _ in bound])
        self._directions = np.concatenate([normals for _, normals in bound])
        self._vertices: _Bound | None = _joined(vertices) if vertices else None
        self._faces: Int | None = np.concatenate(faces) if faces else None

    def nbytes(self, loads: int, pushes: int) -> int:
        """Return the memory per world for points, and for their ARP from a number of drives."""
        sampled, loaded = self.sampled.stop - self.sampled.start, self.loaded.stop
        return 24 * self.count + 16 * sampled + 4 * (pushes * sampled + loads * loaded)

    def make(self) -> None:
        """Allocate memory on the device."""
        shape = self._worlds, self.count
        self.points: Any = wp.zeros(shape, dtype=wp.vec3, device=self._device)
        self.normals: Any = wp.zeros(shape, dtype=wp.vec3, device=self._device)
        areas = np.tile(self._areas, (self._worlds, 1))
        self.areas: Any = wp.array(areas, dtype=wp.float64, device=self._device)

    def calls(self, motions: Any) -> list[Callable[[], object]]:
        """Return launches that move all points with the motions."""
        device, carried = self._device, slice(0, self._carried)
        inputs = [vectors(self._rest.points, device), vectors(self._directions, device)]
        inputs += [_carriers(self._rest, device), motions, self.points[:, carried], self.normals[:, carried]]
        calls = [launch(carrying.carry_points, (self._worlds, self._carried), inputs, device)]
        if self._vertices is not None and self._faces is not None:
            faces: Any = wp.array(self._faces.astype(np.int32), dtype=wp.vec3i, device=device)
            results = [self.points[:, self._carried :], self.normals[:, self._carried :]]
            results += [self.areas[:, self._carried - self.sampled.start :]]
            inputs = [vectors(self._vertices.points, device), faces, _carriers(self._vertices, device), motions]
            calls.append(launch(carrying.carry_faces, (self._worlds, len(self._faces)), [*inputs, *results], device))
        return calls


def _by_direction(surface: Surface, owners: Int) -> Int:
    """Sort faces by direction, and within one direction by bone; return the order, shape (n,).

    In 40 % of the groups of 32 consecutive faces of the hand, no face is lit. Without sorting it is 1 to 2 % of the
    groups.
    """
    normals = face_normals(surface.vertices, surface.faces)[0]
    # Directions map to an octahedron unfolded to a square; a space-filling curve orders its cells
    flat = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), TINY)
    folded = np.where(flat[:, 2:] >= 0.0, flat[:, :2], (1.0 - np.abs(flat[:, 1::-1])) * np.copysign(1.0, flat[:, :2]))
    cells = np.minimum((SQUARE / 2 * (folded + 1.0)).astype(np.int64), SQUARE - 1)
    along = sum(((cells[:, i] >> bit) & 1) << (2 * bit + i) for i in range(2) for bit in range(SQUARE.bit_length() - 1))
    return np.lexsort((owners, along)).astype(np.int32)


def _loaded(skin: SkinModel, stepper: SkinStepper | None) -> tuple[Float, Float, SkinBinding | None]:
    """Return the pressure points on a skin [m], their normals and their motions.

    With a stepper, only the points that it needs are returned.
    """
    quadrature = skin.layer.quadrature
    if stepper is None or stepper.points is None:
        return quadrature.points, quadrature.normals, skin.quadrature_binding
    points = quadrature.points[stepper.points]
    return points, quadrature.normals[stepper.points], skin.carrier.bind(points)


def _rest_samples(reference: PosedScene, number: int) -> tuple[Float, Float, Float]:
    """Return points [m], normals and areas [m2] for the force on a body in one piece, in its frame."""
    body = reference.bodies[number]
    if body.model.surface is None:
        quadrature = body.skin.layer.quadrature
        return quadrature.points, quadrature.normals, quadrature.weights
    return body.model.rest_samples


def force_calls(
    reference: PosedScene,
    rows: MotionRows,
    of: ScenePoints,
    loads: Any,
    points: Any,
    normals: Any,
    origins: Any,
    result: Any,
    device: str,
) -> list[Callable[[], object]]:
    """Return launches that sum the loads of force samples for each part of a body."""
    owners: Int = np.zeros(of.samples[-1][1].stop, np.int32)
    for number, own in of.samples:
        parts = reference.bodies[number].sample_parts
        owners[own] = rows.bodies[number].start + parts[of.orders.get(number, slice(None))]
    starts: list[int] = []
    of_parts, at = [0], 0
    for count in np.bincount(owners, minlength=rows.parts).tolist():
        starts += range(at, at + count, RUN)
        of_parts.append(len(starts))
        at += count
    worlds, runs = len(result), len(starts)
    tables = np.argsort(owners, kind="stable"), [*starts, at], np.repeat(np.arange(rows.parts), np.diff(of_parts))
    order, begins, run_parts = (whole_numbers(values, device) for values in tables)
    sums: Any = wp.zeros((worlds, runs, 6), dtype=wp.float64, device=device)
    lanes: Any = wp.zeros((worlds, summing.LANES, rows.parts, 6), dtype=wp.float64, device=device)
    inputs = [loads, points, normals, order, begins, run_parts, origins, sums]
    return [
        launch(summing.sums_of_runs, (worlds, runs), inputs, device),
        launch(summing.sums_of_parts, lanes.shape, [sums, whole_numbers(of_parts, device), lanes], device),
        launch(summing.sums_of_lanes, result.shape, [lanes, result], device),
    ]


def mesh_number(model: HapticModel, skin: int) -> int:
    """Return the number of the first skin with the same obstacles."""
    if model.skins[skin].spec.obstacles:
        return skin
    return next(number for number, other in enumerate(model.skins) if not other.spec.obstacles)


def meshes_of(model: HapticModel, reference: PosedScene, device: str) -> dict[int, Occlusion]:
    """Return the obstacles by the number of the skin that they shade. Skins without obstacles share one entry."""
    meshes: dict[int, Occlusion] = {}
    for number, skin in enumerate(model.skins):
        key = mesh_number(model, number)
        if skin.spec.config.body_sound == "shadows" and key not in meshes:
            meshes[key] = occlusion(reference, number, device)
    return meshes


def bring_mesh(
    model: HapticModel, reference: PosedScene, skin: int, rows: MotionRows, mesh: wp.Mesh, motions: Any, device: str
) -> list[Callable[[], object]]:
    """Return launches that move the mesh of obstacles with the motions."""
    parts = []
    for body, own in zip(reference.bodies, rows.bodies, strict=True):
        parts.append(_bound_vertices(body.model.hand, body.vertices, own.start))
    if model.skins[skin].obstacles:
        for number, shape in enumerate(model.skins[skin].obstacles_in_one[0]):
            parts.append(_bound(shape, None, rows.obstacles[skin].start + number))
    bound = _joined(parts)
    inputs = [vectors(bound.points, device), _carriers(bound, device), motions, mesh.points.reshape((1, -1))]
    return [launch(carrying.carry_vertices, (1, len(bound.points)), inputs, device), mesh.refit]
