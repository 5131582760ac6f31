"""One pose of the MuJoCo bodies, and its data for sound and skin, in the frame of the first array.

A PosedScene is made once per MuJoCo step. Data that depend on the pose are computed at the first use and stored. The
scene and its parts have serial numbers, which are the keys of stored fields.
"""

from collections.abc import Sequence
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.errors import naming
from palmfield.locked import next_serial
from palmfield.simulation.model import BodyModel, HapticModel, SkinModel, StimulusModel, array_instances
from palmfield.stimulus.focal_points import FocalPoints, SurfaceCourse
from palmfield.transforms import IDENTITY, Placement, Transform
from palmfield.types import Float, Int

if TYPE_CHECKING:
    from palmfield.hand.posed_surface import SkinBinding

SERIAL = attrgetter("serial")
NO_FRAMES: tuple[Float, Float] = np.zeros((0, 3)), np.zeros((0, 3, 3))


class PoseLayout:
    """Order of the rows in the list of all world frames on which the sound and the skins of a scene depend.

    The rows are the arrays, the frames of the stimuli, the transducers that are sites, each body with its bones, and
    the obstacles of each skin. transducers: one slice per array; bodies: row and bones of each; obstacles: rows by skin
    movable: whether transducers may move relative to each other: several arrays, or transducers that are sites
    """

    def __init__(self, model: HapticModel):
        spec = model.spec
        self.arrays = row = len(spec.arrays)
        self.frames = slice(row, row + len(spec.stimuli))
        row = self.frames.stop
        self.transducers, self.bodies, self.obstacles = list[slice](), list[tuple[int, slice]](), list[slice]()
        for array in spec.arrays:
            self.transducers.append(slice(row, row + len(array.placement.sites)))
            row = self.transducers[-1].stop
        self.movable = self.arrays > 1 or row > self.frames.stop
        for body in model.bodies:
            self.bodies.append((row, slice(row + 1, row + 1 + len(body.rest_origins))))
            row = self.bodies[-1][1].stop
        for skin in model.skins:
            self.obstacles.append(slice(row, row + len(skin.spec.obstacles)))
            row = self.obstacles[-1].stop


class PosedSurface:
    """One body in one pose. Data are computed at the first use.

    model: the body at rest; skin: the first skin on it; frame: frame of the body relative to that of the first array
    bone_positions, bone_rotations: poses of the bones in the frame of the body, shapes (b, 3) and (b, 3, 3); empty for
        a body in one piece
    serial: unique number; numbers: the pose as bytes; a stored field may be used again only if they are equal
    """

    def __init__(self, model: BodyModel, skin: SkinModel, frame: Transform, bones: tuple[Float, Float]):
        self.model, self.skin, self.frame = model, skin, frame
        self.bone_positions, self.bone_rotations = bones
        self.serial = next_serial()
        place, turn = frame
        self.numbers = place.tobytes() + turn.tobytes() + bones[0].tobytes() + bones[1].tobytes()

    @cached_property
    def vertices(self) -> Float:
        """Return vertices of the closed surface, in the frame of the body [m], shape (v, 3)."""
        if self.model.surface is None:
            return self.skin.closed_surface[0]
        if self.model.hand is None:
            return self.model.surface.vertices
        return self.model.hand.posed(self.bone_positions, self.bone_rotations)

    @cached_property
    def vertices_in_array(self) -> Float:
        """Return vertices of the closed surface, in the array frame [m], shape (v, 3)."""
        return self.frame.points(self.vertices)

    @property
    def hull(self) -> Float:
        """Return corners of boxes whose convex hull contains the surface, array frame [m], shape (8 b, 3)."""
        boxes = self.model.boxes
        if self.model.hand is not None:
            # A skin point is a weighted mean of one position per bone, and each position lies in the box of that bone
            boxes = boxes @ self.bone_rotations.transpose(0, 2, 1) + self.bone_positions[:, None]
        return self.frame.points(boxes.reshape(-1, 3))

    @property
    def faces(self) -> Int:
        """Return faces of the closed surface, shape (m, 3)."""
        return self.skin.closed_surface[1]

    @cached_property
    def samples(self) -> tuple[Float, Float, Float]:
        """Return the samples for the force: points [m] and outward normals, array frame, (n, 3); areas [m^2], (n,)."""
        if self.model.surface is None:
            quadrature = self.skin.layer.quadrature
            points, normals, areas = quadrature.points, quadrature.normals, quadrature.weights
        elif self.model.hand is None:
            points, normals, areas = self.model.rest_samples
        else:
            sampled = self.model.sampled
            bones = self.bone_positions, self.bone_rotations
            moved = self.vertices if sampled is self.model.hand else sampled.posed(*bones)
            return self.model.posed_samples(moved, self.frame)
        return *self.frame.surface(points, normals), areas

    @property
    def sample_parts(self) -> Int:
        """Return for each sample the index in `origins` of the body that it pushes, shape (n,)."""
        if self.model.hand is None:
            return np.zeros(len(self.samples[2]), np.int32)
        return self.model.sample_bones

    @cached_property
    def origins(self) -> Float:
        """Return origins of the bodies that the sound pushes (bones or the body), array frame [m], shape (b, 3)."""
        return self.frame.position[None] if self.model.hand is None else self.frame.points(self.bone_positions)

    def moved(self, points: Float, normals: Float, binding: "SkinBinding | None") -> tuple[Float, Float]:
        """Move points of the resting surface [m] and normals from the body frame to the array frame, shapes (n, 3)."""
        if binding is not None and self.model.hand is not None:
            turns = self.bone_rotations
            points, normals = binding.blend(self.model.hand, self.bone_positions, turns, points, normals)
        return self.frame.surface(points, normals)


class PosedSkin:
    """One skin layer in one pose. Positions are in the array frame.

    obstacle_positions, obstacle_rotations: poses, in the frame of the body, of obstacles that are not bodies with skins
    numbers: numbers of these poses, as bytes
    """

    def __init__(self, skin: SkinModel, body: PosedSurface, obstacles: tuple[Float, Float]):
        self.skin, self.body, self.serial = skin, body, next_serial()
        self.obstacle_positions, self.obstacle_rotations = obstacles
        self.numbers = obstacles[0].tobytes() + obstacles[1].tobytes()

    @cached_property
    def nodes(self) -> tuple[Float, Float]:
        """Return the surface nodes of the skin layer [m] and their outward normals, shapes (S, 3)."""
        points, normals = self.skin.nodes
        return self.body.moved(points, normals, self.skin.nodes_binding)

    @cached_property
    def quadrature(self) -> tuple[Float, Float]:
        """Return the integration points of the ARP on the skin [m] and their outward normals, shapes (q, 3)."""
        quadrature = self.skin.layer.quadrature
        return self.body.moved(quadrature.points, quadrature.normals, self.skin.quadrature_binding)

    @property
    def obstacle_hull(self) -> Float:
        """Return corners of boxes that contain all obstacles, array frame [m], shape (8 k, 3)."""
        boxes = self.skin.obstacle_boxes @ self.obstacle_rotations.transpose(0, 2, 1) + self.obstacle_positions[:, None]
        return self.body.frame.points(boxes.reshape(-1, 3))

    @cached_property
    def obstacles(self) -> tuple[Float, Int] | None:
        """Return vertices [m] and faces of the obstacles that key `obstacles` names. None without obstacles."""
        if not self.skin.obstacles:
            return None
        shapes, slices, faces = self.skin.obstacles_in_one
        vertices = np.empty((slices[-1].stop, 3))
        for points, own, position, rotation in zip(
            shapes, slices, self.obstacle_positions, self.obstacle_rotations, strict=True
        ):
            np.add(points @ rotation.T, position, out=vertices[own])
        return self.body.frame.points(vertices), faces


class PosedScene:
    """Arrays, frames of the stimuli, bodies and skins in one pose.

    array_frame: frame of the first array in the world; arrays: all arrays in their relative pose
    frames: frame of each stimulus relative to that of the first array; serial: unique number
    sources: numbers from which `arrays` was made, if arrays or transducers may move
    sound_keys: key of each skin, which is equal for poses in which a drive gives the same sound on the skin
    """

    def __init__(
        self,
        array_frame: Transform,
        arrays: PhasedArray,
        frames: Sequence[Transform],
        bodies: Sequence[PosedSurface],
        skins: Sequence[PosedSkin],
        sources: bytes = b"",
    ):
        self.array_frame, self.arrays, self.sources, self.serial = array_frame, arrays, sources, next_serial()
        self.frames, self.bodies, self.skins = tuple(frames), tuple(bodies), tuple(skins)
        of_all: tuple[int, ...] = (arrays.serial,)
        for skin in self.skins:
            of_all += (skin.serial,)
        self.sound_keys: tuple[tuple[int, ...], ...] = ()
        for skin in self.skins:
            free = skin.skin.spec.config.body_sound == "none"
            self.sound_keys += ((arrays.serial, skin.serial) if free else of_all,)
        self.numbers = b""
        for position, rotation in (array_frame, *self.frames):
            self.numbers += position.tobytes() + rotation.tobytes()

    def focal_points(self, stimulus: StimulusModel, number: int) -> FocalPoints:
        """Return the points of a stimulus, by its number, in this pose."""
        course = None
        if stimulus.path is not None:
            assert stimulus.spec.on_skin is not None
            body = self.skins[stimulus.spec.on_skin].body
            course = SurfaceCourse(stimulus.path, body.vertices, body.faces, body.frame)
        table, arp = stimulus.spec.focus_table, stimulus.config.foci_arp
        return FocalPoints(self.frames[number], stimulus.offsets, course, table, arp)


def reference_scene(model: HapticModel) -> PosedScene:
    """Return the scene in the reference configuration of MuJoCo."""
    bodies, skins = [], []
    for number, body in enumerate(model.bodies):
        first = model.skins[model.first_skins[number]]
        upright = np.tile(np.eye(3), (len(body.rest_origins), 1, 1))
        bodies.append(PosedSurface(body, first, first.spec.body.transform, (body.rest_origins, upright)))
    for skin in model.skins:
        frames = [obstacle.placement.transform for obstacle in skin.spec.obstacles]
        obstacles = (
            np.array([frame.position for frame in frames]).reshape(-1, 3),
            np.array([frame.rotation for frame in frames]).reshape(-1, 3, 3),
        )
        skins.append(PosedSkin(skin, bodies[skin.body], obstacles))
    stimuli = [stimulus.frame.transform for stimulus in model.spec.stimuli]
    return PosedScene(IDENTITY, model.arrays, stimuli, bodies, skins)


def posed_scene(
    model: HapticModel,
    layout: PoseLayout,
    world_positions: Float,
    world_rotations: Float,
    previous: PosedScene,
    reference: PosedScene,
) -> PosedScene:
    """Return the scene in a pose.

    world_positions [m], shape (m, 3), world_rotations, shape (m, 3, 3): poses in the rows of the layout
    previous: the last pose, or the reference. Unmoved parts are used again; if no part has moved, it is returned
    reference: result of `reference_scene`, the pose of reduced models. A body and the obstacles of its skins are put in
        this pose if they are within STILL of it (for its strictest skin) and the arrays are in it
    """
    origin, turn = world_positions[0].copy(), world_rotations[0].copy()
    positions, rotations = (world_positions - origin) @ turn, turn.T @ world_rotations
    arrays, sources = model.arrays, b""
    if layout.movable:
        among = slice(layout.transducers[0].start, layout.transducers[-1].stop)
        for rows in (slice(0, layout.arrays), among):
            sources += positions[rows].tobytes() + rotations[rows].tobytes()
        same = sources == previous.sources
        arrays = previous.arrays if same else _arrays(model, layout, positions, rotations, previous)
    frames = []
    for row in range(layout.frames.start, layout.frames.stop):
        frames.append(Transform(positions[row], rotations[row]))
    # Actual place of each body, and the place where it is put. All skins of a body have one pose.
    placed, bodies = [], []
    for number, (row, bones) in enumerate(layout.bodies):
        first = reference.bodies[number]
        frame = Transform(positions[row], rotations[row])
        of_bones = NO_FRAMES if first.model.hand is None else _frames_in(world_positions, world_rotations, row, bones)
        body = PosedSurface(model.bodies[number], first.skin, frame, of_bones)
        placed.append(body)
        if previous.bodies[number].numbers == body.numbers:
            bodies.append(previous.bodies[number])
        elif (
            model.still_m[number] > 0.0
            and arrays.serial == model.arrays.serial
            and _settled(body, first, model.corners[number], model.still_m[number])
        ):
            bodies.append(first)
        else:
            bodies.append(body)
    skins = []
    for number, skin in enumerate(model.skins):
        body, row = bodies[skin.body], layout.bodies[skin.body][0]
        others, obstacles = layout.obstacles[number], NO_FRAMES
        if others.start < others.stop:
            obstacles = _frames_in(world_positions, world_rotations, row, others)
        posed_skin = PosedSkin(skin, body, obstacles)
        last, first_pose = previous.skins[number], reference.skins[number]
        if last.body is body and last.numbers == posed_skin.numbers:
            posed_skin = last
        elif (
            skin.settles
            and arrays.serial == model.arrays.serial
            and body.serial == first_pose.body.serial
            and _obstacles_settled(PosedSkin(skin, placed[skin.body], obstacles), first_pose)
        ):
            posed_skin = first_pose
        skins.append(posed_skin)
    posed = PosedScene(Transform(origin, turn), arrays, frames, bodies, skins, sources)
    # Parts that do not move keep their serial numbers
    mine, its = (arrays, *bodies, *skins), (previous.arrays, *previous.bodies, *previous.skins)
    same = posed.numbers == previous.numbers and list(map(SERIAL, mine)) == list(map(SERIAL, its))
    return previous if same else posed


def settled_worlds(
    model: HapticModel, layout: PoseLayout, world_positions: Float, world_rotations: Float, reference: PosedScene
) -> NDArray[np.bool_]:
    """Return the worlds in which `posed_scene` puts all bodies at the reference pose, shape (w,).

    Arguments are those of `posed_scene`, with an axis for worlds. Bones or obstacles that need a check give False.
    """
    worlds = len(world_positions)
    for number, skin in enumerate(model.skins):
        obstacles = layout.obstacles[number]
        if obstacles.start < obstacles.stop or model.bodies[skin.body].hand is not None:
            return np.zeros(worlds, dtype=bool)
    origin, turn = world_positions[:, :1], world_rotations[:, 0]
    result = np.ones(worlds, dtype=bool)
    for number, (row, _) in enumerate(layout.bodies):
        position = (world_positions[:, row : row + 1] - origin) @ turn
        rotation = turn.swapaxes(1, 2) @ world_rotations[:, row]
        now = model.corners[number] @ rotation.swapaxes(1, 2) + position
        then = reference.bodies[number].frame.points(model.corners[number])
        result &= np.maximum.reduce(np.abs(now - then), axis=(1, 2)) < model.still_m[number]
    return result


def _settled(body: PosedSurface, reference: PosedSurface, corners: Float, still_m: float) -> bool:
    """Return whether a body counts as in the reference pose, by boxes around its skins, or with bones its surface."""
    if body.model.hand is None:
        now, then = body.frame.points(corners), reference.frame.points(corners)
    else:
        now, then = body.vertices_in_array, reference.vertices_in_array
    return bool(np.maximum.reduce(np.abs(now - then), axis=None) < still_m)


def _obstacles_settled(posed: PosedSkin, reference: PosedSkin) -> bool:
    """Return whether the obstacles count as in the reference pose."""
    if posed.obstacles is None or reference.obstacles is None:
        return True
    moved = np.maximum.reduce(np.abs(posed.obstacles[0] - reference.obstacles[0]), axis=None)
    return bool(moved < posed.skin.still_m)


def _frames_in(positions: Float, rotations: Float, body: int, others: slice) -> tuple[Float, Float]:
    turn = rotations[body]
    return (positions[others] - positions[body]) @ turn, turn.T @ rotations[others]


def _arrays(
    model: HapticModel, layout: PoseLayout, positions: Float, rotations: Float, previous: PosedScene
) -> PhasedArray:
    """Return the arrays in this relative pose. If it has not changed, return the last or the reference object."""
    placements = []
    for number, sites in enumerate(layout.transducers):
        frame = Transform(positions[number], rotations[number])
        where = frame.inverse_points(positions[sites]).tolist()
        facing = frame.inverse_vectors(rotations[sites][:, :, 2]).tolist()
        own = tuple((tuple(place), tuple(direction)) for place, direction in zip(where, facing, strict=True))
        placements.append(Placement.of(frame, own))
    for arrays in (model.arrays, previous.arrays):
        if arrays.same(placements):
            return arrays
    with naming("plugin 'palmfield.array'"):
        return PhasedArray(array_instances(model.spec), placements, model.spec.device)
