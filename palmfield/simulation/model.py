"""Constant data of a scene in a run: phased arrays, stimuli, surfaces, skin layers and their steppers.

`palmfield.simulation.build.build` makes the model. All mjData of the scene and all threads share it. Parts that take
long to make are made once, at the first use.
"""

import threading
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy  # loads its parts at first use
import warp as wp
from scipy import sparse

from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.config import StimulusConfig
from palmfield.drive.board import Board
from palmfield.drive.transducer_response import TransducerResponse
from palmfield.hand.force_samples import BY_DEFAULT, SampleMesh, sample_count, sample_mesh
from palmfield.hand.meshquery import build_mesh
from palmfield.hand.subdivide import sampling_surface
from palmfield.hand.triangles import face_normals, face_samples
from palmfield.locked import Lazy, locked_cached_property
from palmfield.simulation.spec import SceneSpec, SkinSpec, StimulusSpec
from palmfield.skin.explicit_layer import LayerSolver, layer_solver
from palmfield.skin.fem.probe import surface_vectors
from palmfield.skin.mesh.wedges import closed_boundary, output_triangles
from palmfield.skin.scene_layer import SceneLayer
from palmfield.skin.stepper import SkinStepper
from palmfield.skin.stepper_choice import StepperChoice as StepperChoice
from palmfield.transforms import Transform, corners_of
from palmfield.types import Float, Int, Surface

if TYPE_CHECKING:  # imported at use: many bodies are in one piece, and most stimuli have no path on a surface
    from palmfield.hand.posed_surface import FaceSampler, SkinBinding
    from palmfield.hand.skinning import SkinnedSurface
    from palmfield.simulation.innervation import Innervation
    from palmfield.simulation.rates import RegionRates
    from palmfield.skin.fem.wedge_stepper import WedgeStepper
    from palmfield.stimulus.surface_path import SurfacePath


STILL = 0.05
"""Factor of "still": a body or focus moves less than it times accuracy times spot width. The error of the load is then
below a tenth of the accuracy (displacement over standard deviation, over sqrt 2).
"""


@dataclass(frozen=True)
class StimulusModel:
    """One stimulus with the transducers that it drives.

    config: its keys, with the length of a path through sites; transducers: numbers of the driven transducers, shape
        (k,)
    path: path on the skin, None in space; offsets: offsets of simultaneous foci [m], shape (m, 3), or (0, 3)
    response: ring-up and flight time of its transducers; silent: whether it never sounds
    reference_foci: the first foci in the reference pose, array frame [m], shape (3,) or (m, 3)
    """

    spec: StimulusSpec
    config: StimulusConfig
    transducers: Int
    path: "SurfacePath | None"
    offsets: Float
    response: TransducerResponse
    reference_foci: Float
    silent: bool

    @property
    def first_focus(self) -> Float:
        """Return the focus, or the first of several, in the reference pose, array frame [m], shape (3,)."""
        first: Float = np.atleast_2d(self.reference_foci)[0]
        return first


class BodyModel:
    """A body that carries skin: its surface, and the bones that move it, in the frame of the body.

    name: name of the MuJoCo body; hand: the surface with its bones; None for a body in one piece
    surface: the whole closed surface; None for a disc, whose lit face is the skin
    depth_to_bone_m: depth at each vertex of the surface, shape (v,), or one depth for all
    """

    force_accuracy: float = BY_DEFAULT
    """Relative accuracy of the force of the sound that is computed from the samples."""

    def __init__(
        self, name: str, surface: Surface | None, hand: "SkinnedSurface | None", depth_to_bone_m: Float | float
    ):
        self.name, self.surface, self.hand, self.depth_to_bone_m = name, surface, hand, depth_to_bone_m
        self.lock = threading.RLock()
        origins = [] if hand is None else [bone.origin for bone in hand.bones]
        self.rest_origins: Float = np.array(origins).reshape(-1, 3)
        """Origins of the bones at rest [m], shape (b, 3). b is 0 for a body in one piece."""

    @property
    def parts(self) -> int:
        """Return the number of MuJoCo bodies that the sound pushes: the bones, or 1."""
        return max(1, len(self.rest_origins))

    @locked_cached_property
    def query_mesh(self) -> wp.Mesh:
        """Return the resting surface for queries of nearest faces. A disc has none."""
        assert self.surface is not None
        return build_mesh(self.surface.vertices, self.surface.faces)

    @locked_cached_property
    def sample_mesh(self) -> SampleMesh:
        """Return the triangles at rest whose centres are the samples for the force."""
        vertices, faces, parents = self._short_edged
        made = sample_mesh(vertices, faces, self.force_accuracy)
        return made if parents is None else made._replace(faces=parents[made.faces])

    @locked_cached_property
    def sample_count(self) -> int:
        """Return the approximate number of samples of `sample_mesh`, without making them."""
        vertices, faces, _ = self._short_edged
        return sample_count(face_normals(vertices, faces)[1], self.force_accuracy)

    @locked_cached_property
    def _short_edged(self) -> tuple[Float, Int, Int | None]:
        """Return vertices [m] and faces of the resting surface, subdivided for samples, and the original face of each.

        Edges of hands are already short, so their faces are unchanged.
        """
        if self.hand is not None:
            return self.hand.surface.vertices, self.hand.surface.faces, None
        assert self.surface is not None
        return sampling_surface(self.surface.vertices, self.surface.faces)

    @locked_cached_property
    def sampled(self) -> "SkinnedSurface":
        """Return the triangles of the samples with their bones, or the hand itself if each face is a sample."""
        assert self.hand is not None
        mesh = self.sample_mesh
        if mesh.corners is self.hand.surface.faces:
            return self.hand
        from palmfield.hand.posed_surface import SkinBinding
        from palmfield.hand.skinning import SkinnedSurface

        surface = Surface(mesh.points, mesh.corners, np.zeros_like(mesh.points))
        return SkinnedSurface(self.hand.bones, surface, SkinBinding.to(self.hand, mesh.points).weights.T)

    @locked_cached_property
    def sample_bones(self) -> Int:
        """Return the bone that each sample pushes, shape (n,): the bone with the largest weight in the sample."""
        weights = np.asarray(self.sampled.weights)[self.sampled.surface.faces].mean(axis=1)
        largest: Int = np.argmax(np.round(weights, 9), axis=1).astype(np.int32)
        return largest

    @locked_cached_property
    def rest_samples(self) -> tuple[Float, Float, Float]:
        """Return points [m], outward normals, shapes (n, 3), and areas [m^2], (n,), for a body in one piece."""
        return face_samples(self.sample_mesh.points, self.sample_mesh.corners)

    def posed_samples(self, vertices: Float, frame: Transform) -> tuple[Float, Float, Float]:
        """Return `sampled` in a pose: points [m] and outward normals, outer frame, shapes (n, 3); areas [m^2], (n,)."""
        with self.lock:
            samples = self._sampler.at(vertices)
            return *frame.surface(samples.centroids, samples.normals), samples.areas.copy()

    @locked_cached_property
    def _sampler(self) -> "FaceSampler":
        from palmfield.hand.posed_surface import FaceSampler

        surface = self.sampled.surface
        return FaceSampler(surface.faces, len(surface.vertices))

    @locked_cached_property
    def boxes(self) -> Float:
        """Return the corners of a box around the part of the resting surface on each bone, (b, 8, 3) [m].

        They are relative to the origin of the bone. For a body in one piece, the box is around its whole surface.
        """
        assert self.surface is not None
        if self.hand is None:
            return corners_of(self.surface.vertices)[None]
        carried = [self.hand.surface.vertices[column > 0.0] for column in self.hand.weights.T]
        return np.array(
            [
                corners_of(part - origin) if len(part) else np.zeros((8, 3))
                for part, origin in zip(carried, self.rest_origins, strict=True)
            ]
        )

    def bind(self, points: Float) -> "SkinBinding | None":
        """Return the bones that carry points of the resting skin [m], shape (n, 3). None for a body in one piece."""
        if self.hand is None:
            return None
        from palmfield.hand.posed_surface import SkinBinding

        return SkinBinding.to(self.hand, points)


class SkinModel:
    """One skin layer on its body.

    body: number of the body that carries it; carrier: that body; layer: mesh and matrices; choice: choice of its
        stepper
    still_m: largest movement that counts as still [m]; settles: whether a body that is still is put at its reference
        pose (by default if a reduced model steps the layer)
    """

    def __init__(
        self,
        spec: SkinSpec,
        body: int,
        carrier: BodyModel,
        layer: SceneLayer,
        choice: StepperChoice,
        settles: bool | None = None,
    ):
        self.spec, self.body, self.carrier, self.layer = spec, body, carrier, layer
        self.choice, self.still_m = choice, STILL * spec.config.accuracy * layer.demand.spot_fwhm_m
        self.settles = not choice.solver.any_pose if settles is None else settles
        self.lock = threading.RLock()

    @property
    def solver(self) -> LayerSolver:
        """Return the layer in the form that its solver needs."""
        return layer_solver(self.layer, self.choice.name)

    @locked_cached_property
    def nodes(self) -> tuple[Float, Float]:
        """Return rest positions [m] and outward normals of the surface nodes, body frame, shapes (S, 3)."""
        mesh = self.layer.mesh
        return mesh.nodes[: mesh.surface_nodes], mesh.surface_normals()

    @locked_cached_property
    def nodes_binding(self) -> "SkinBinding | None":
        """Return the bones of the surface nodes."""
        return self.carrier.bind(self.nodes[0])

    @locked_cached_property
    def quadrature_binding(self) -> "SkinBinding | None":
        """Return the bones of the points at which the ARP is integrated."""
        return self.carrier.bind(self.layer.quadrature.points)

    @locked_cached_property
    def obstacles(self) -> list[tuple[Float, Int]]:
        """Return meshes [m] of the obstacles other than bodies with skins, each in the frame of its own body."""
        return [obstacle.shape.mesh() for obstacle in self.spec.obstacles]

    @locked_cached_property
    def obstacles_in_one(self) -> tuple[list[Float], list[slice], Int]:
        """Return the vertices of each obstacle, their slices in the list of all, and the faces of all, shape (f, 3)."""
        shapes: list[Float] = []
        slices: list[slice] = []
        faces: list[Int] = []
        start = 0
        for points, corners in self.obstacles:
            shapes.append(points)
            slices.append(slice(start, start + len(points)))
            faces.append(corners + start)
            start += len(points)
        return shapes, slices, np.concatenate(faces).astype(np.int32)

    @locked_cached_property
    def obstacle_boxes(self) -> Float:
        """Return corners of a box around each obstacle, in its own frame [m], shape (k, 8, 3)."""
        return np.array([corners_of(points) for points, _ in self.obstacles]).reshape(-1, 8, 3)

    @locked_cached_property
    def corners(self) -> Float:
        """Return corners of a box around the surface of the layer, body frame [m], shape (8, 3)."""
        return corners_of(self.nodes[0])

    @locked_cached_property
    def faces(self) -> Int:
        """Return triangles over the surface nodes, counter-clockwise from outside, shape (f, 3)."""
        return output_triangles(self.layer.mesh).astype(np.int32)

    @locked_cached_property
    def depth(self) -> Float:
        """Return the thickness of the layer under each surface node [m], shape (S,)."""
        nodes = self.nodes[0]
        return np.asarray(np.linalg.norm(nodes - self.layer.mesh.nodes[-len(nodes) :], axis=1))

    @locked_cached_property
    def surface_vectors(self) -> sparse.csr_matrix:
        """Return the operator from unknowns to displacements of the surface nodes, shape (3 S, ndof)."""
        return surface_vectors(self.layer.mesh, self.layer.system)

    @locked_cached_property
    def innervation(self) -> "Innervation | None":
        """Return the afferents of the layer. None if key `receptors` is off."""
        if self.spec.config.receptors == "off":
            return None
        from palmfield.simulation.innervation import innervation_of

        return innervation_of(self.layer)

    @locked_cached_property
    def recorded(self) -> sparse.csr_matrix:
        """Return the operator to what a run records: `surface_vectors`, then the motion at the afferents."""
        units = self.innervation
        return self.surface_vectors if units is None else sparse.vstack([self.surface_vectors, units.operator], "csr")

    @locked_cached_property
    def closed_surface(self) -> tuple[Float, Int]:
        """Return vertices [m] and faces of the closed surface of the body that scatters sound, at rest."""
        surface = self.carrier.surface
        return closed_boundary(self.layer.mesh) if surface is None else (surface.vertices, surface.faces)

    @locked_cached_property
    def sample_faces(self) -> sparse.csr_matrix:
        """Return the matrix from ARP at force samples to means on faces of `closed_surface`, (faces, samples)."""
        vertices, faces = self.closed_surface
        centroids, _, face_areas = face_samples(vertices, faces)
        if self.carrier.surface is not None:
            mesh = self.carrier.sample_mesh
            owners, samples, count = mesh.faces, mesh.samples, len(mesh.corners)
            shares = mesh.areas / np.maximum(face_areas[owners], 1e-30)
        else:
            # The face of the skin itself comes first
            quadrature = self.layer.quadrature
            lit = centroids[: len(output_triangles(self.layer.mesh))]
            owners = scipy.spatial.cKDTree(lit).query(quadrature.points)[1].astype(np.int32)
            count, shares = len(owners), quadrature.weights / face_areas[owners]
            samples = np.arange(count, dtype=np.int32)
        return sparse.csr_matrix((shares, (owners, samples)), (len(faces), count))


@dataclass(frozen=True)
class HapticModel:
    """All data of a scene that are constant in a run.

    arrays: arrays in their relative pose in the reference configuration; board: board that plays the drive
    begin: first stepper of each skin; whole: stepper of the full layer of each skin
    marks: numbers that identify states, see `palmfield.simulation.state`; filled at the first use
    """

    spec: SceneSpec
    arrays: PhasedArray
    board: Board
    stimuli: tuple[StimulusModel, ...]
    bodies: tuple[BodyModel, ...]
    skins: tuple[SkinModel, ...]
    begin: tuple[Lazy[SkinStepper], ...]
    whole: "tuple[Lazy[WedgeStepper], ...]"
    marks: dict[tuple[str, int, str], float] = field(default_factory=dict)

    @cached_property
    def configs(self) -> tuple[StimulusConfig, ...]:
        """Return the keys of the stimuli."""
        return tuple(part.config for part in self.stimuli)

    @cached_property
    def response_on(self) -> bool:
        """Whether ring-up is modelled. This is so for all transducers or for none, because they share one state."""
        return self.stimuli[0].response.on

    @cached_property
    def free(self) -> bool:
        """Whether the sound on all skins is the free field, without effects of bodies."""
        return all(skin.spec.config.body_sound == "none" for skin in self.skins)

    @cached_property
    def sounding(self) -> int:
        """Return the number of the first stimulus that is not silent; 0 in silence."""
        return next((number for number, stimulus in enumerate(self.stimuli) if not stimulus.silent), 0)

    @cached_property
    def substeps(self) -> int:
        """Return the number of substeps in a MuJoCo step. All skins share it, so results have one time axis."""
        return round(self.spec.timestep_s / self.step_s)

    @cached_property
    def step_s(self) -> float:
        """Return the time step of the skins [s]."""
        return self.skins[0].layer.sizes.step_s

    @cached_property
    def rates(self) -> "tuple[RegionRates, ...]":
        """Return the rates of each region that sensors read."""
        if not self.spec.regions:
            return ()
        from palmfield.simulation.rates import RegionRates

        parts = [(one, self.skins[one.skin]) for one in self.spec.regions]
        times = self.step_s, self.spec.timestep_s
        return tuple(RegionRates(one, skin.layer, skin.carrier.bind, *times) for one, skin in parts)

    @cached_property
    def still_m(self) -> tuple[float, ...]:
        """Return, for each body, the largest movement that counts as still for all of its skins [m].

        It is the minimum over its skins; 0 for a body without a reduced model, because other steppers gain nothing.
        """
        carried = [[self.skins[number] for number in self.carried(body)] for body in range(len(self.bodies))]
        return tuple(
            min(skin.still_m for skin in skins) if any(skin.settles for skin in skins) else 0.0 for skins in carried
        )

    @cached_property
    def corners(self) -> tuple[Float, ...]:
        """Return for each body the corners of boxes around its skins, body frame [m], shape (8 k, 3)."""
        return tuple(
            np.concatenate([self.skins[number].corners for number in self.carried(body)])
            for body in range(len(self.bodies))
        )

    @cached_property
    def first_skins(self) -> tuple[int, ...]:
        """Return the number of the first skin of each body. The keys of this skin apply to the force on the body."""
        return tuple(self.carried(body)[0] for body in range(len(self.bodies)))

    def carried(self, body: int) -> list[int]:
        """Return the numbers of the skins on a body."""
        return [number for number, skin in enumerate(self.skins) if skin.body == body]


def about_stimulus(spec: StimulusSpec) -> tuple[str, str]:
    """Return the names of a stimulus and of its foci, for error messages."""
    return spec.element, "key 'focus_m'"


def array_instances(spec: SceneSpec) -> tuple[ArrayInstance, ...]:
    """Return the arrays of a scene in the form of `palmfield.acoustics.phased_array`."""
    return tuple(ArrayInstance(one.config, one.placement, one.calibration, one.table) for one in spec.arrays)
