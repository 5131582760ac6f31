"""From a moment of the stimulus to forces on the body and motion of the skin. Holds caches only; state is passed in."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from trimesh.remesh import subdivide_to_size

from palmfield.acoustics.arp import arp
from palmfield.errors import SceneError
from palmfield.rig import Rig
from palmfield.skin.surface import SurfaceProbe, surface_motion
from palmfield.stimulus import frame_at, held_frames
from palmfield.types import Complex, Float, Float32

CLEARANCE_M = 2e-3
# The resultant takes one sample a face: half of the 8.6 mm wavelength, so that ARP, which goes with p squared, is seen.
FACE_M = 4.3e-3


@dataclass(frozen=True)
class Pose:
    """Frame of the skin's body, seen from the array: x_array = turn @ x_body + shift [m]."""

    shift: Float
    turn: Float

    @staticmethod
    def between(array: tuple[Float, Float], body: tuple[Float, Float]) -> "Pose":
        """From the world poses (position, rotation) of array and body."""
        return Pose(array[1].T @ (body[0] - array[0]), array[1].T @ body[1])

    def points(self, x: Float) -> Float:
        """Body positions in the array frame, shape (n, 3)."""
        return x @ self.turn.T + self.shift

    def same(self, other: "Pose") -> bool:
        """Exactly equal: only then may a field be used again."""
        return np.array_equal(self.shift, other.shift) and np.array_equal(self.turn, other.turn)


@dataclass(frozen=True)
class Sound:
    """ARP for one focus and pose at the loudest moment; it scales with the frame's arp_factor.

    focus: array frame [m], shape (3,); drive: complex amplitude per transducer, shape (n,); level: amplitude asked for
    skin_force: consistent nodal forces on the skin [N], shape (ndof,)
    """

    focus: Float
    pose: Pose
    drive: Complex
    level: float
    skin_force: Float


Observer = Callable[[float, Float, "Sound | None", float], None]


class Chain:
    """The stages array -> field -> ARP -> skin for one simulation."""

    def __init__(self, rig: Rig):
        self.rig = rig
        self._last: Sound | None = None
        self._resultant: tuple[Sound | None, Float, Float] = (None, np.zeros(3), np.zeros(3))
        self.observer: Observer | None = None
        surface = rig.surface
        if surface is None:
            points, normals, areas = rig.quadrature.points, rig.quadrature.normals, rig.quadrature.weights
        else:
            vertices, faces = subdivide_to_size(surface.vertices, surface.faces, FACE_M, max_iter=20)
            a, b, c = (vertices[faces[:, i]] for i in range(3))
            cross = np.cross(b - a, c - a)
            areas = 0.5 * np.linalg.norm(cross, axis=1)
            points, normals = (a + b + c) / 3, cross / (2 * areas[:, None])
        self._body_points, self._body_normals, self._body_areas = points, normals, areas

    # -- sound ---------------------------------------------------------------------------------------------------

    def arp_at(self, points: Float, normals: Float, pose: Pose, drive: Complex) -> tuple[Float32, Float32]:
        """ARP [Pa] and peak pressure amplitude [Pa], shapes (n,), at body points with outward normals."""
        field = self.rig.evaluator.pressure(pose.points(points), drive, gradient=True)
        load = arp(
            field, normals @ pose.turn.T, self.rig.air, self.rig.array.frequency_Hz,
            law=self.rig.skin.arp_law, device=self.rig.evaluator.device,
        )  # fmt: skip
        return load, np.abs(field.pressure)

    def sound(self, focus: Float, pose: Pose) -> Sound:
        """ARP for a focus (array frame [m], shape (3,)); the last one is kept."""
        last = self._last
        if last is not None and np.array_equal(last.focus, focus) and last.pose.same(pose):
            return last
        rig = self.rig
        self.check_clear(pose)
        drive, level = rig.unit_drive(focus)
        load, _ = self.arp_at(rig.quadrature.points, rig.quadrature.normals, pose, drive)
        self._last = Sound(focus, pose, drive, level, rig.quadrature.assemble(load.astype(np.float64)))
        return self._last

    def resultant(self, sound: Sound) -> tuple[Float, Float]:
        """Force [N] and torque about the body's origin [N m] on the whole body, in body axes, shapes (3,)."""
        if self._resultant[0] is not sound:
            load, _ = self.arp_at(self._body_points, self._body_normals, sound.pose, sound.drive)
            push = -(load * self._body_areas)[:, None] * self._body_normals
            self._resultant = (sound, push.sum(axis=0), np.cross(self._body_points, push).sum(axis=0))
        return self._resultant[1:]

    def check_clear(self, pose: Pose) -> None:
        """SceneError where the surface reaches into the array's board."""
        surface = self.rig.surface
        points = pose.points(
            self.rig.mesh.nodes[: self.rig.mesh.surface_nodes] if surface is None else surface.vertices
        )
        board = np.abs(self.rig.array.positions[:, :2]).max(axis=0) + 5e-3
        over = np.all(np.abs(points[:, :2]) <= board, axis=1)
        low = points[over, 2].min() if over.any() else np.inf
        if low < CLEARANCE_M:
            raise SceneError(
                f"plugin 'palmfield.skin': body '{self.rig.skin.body}' reaches into the array (lowest point "
                f"{1e3 * low:.1f} mm above the board, at least {1e3 * CLEARANCE_M:g} mm needed); move the body up"
            )

    # -- motion --------------------------------------------------------------------------------------------------

    def advance(self, state: Float, start: float, to_array: Callable[[Float], Float], pose: Pose) -> None:
        """Carry the skin from `start` [s] over one MuJoCo step, in place.

        state: plugin state, shape (rig.state_size,)
        to_array: stimulus frame -> array frame, positions of shape (3,)
        """
        rig = self.rig
        step = rig.solver.step_s
        motion = self.motion(state)
        for i in range(round(rig.timestep_s / step)):
            t0, t1 = start + i * step, start + (i + 1) * step
            held = held_frames(rig.stimulus, t0, t1)
            if held:
                total = sum(share * self._force(time, to_array, pose) for time, share in held)
                rig.solver.step(motion, total, total)
            else:
                first = self._force(t0, to_array, pose)
                rig.solver.step(motion, first, self._force(t1, to_array, pose))
            if self.observer is not None:
                frame = frame_at(rig.stimulus, t1)
                sound = self.sound(to_array(frame.focus), pose) if frame.arp_factor > 0 else None
                self.observer(t1, motion, sound, frame.arp_factor)

    def _force(self, t: float, to_array: Callable[[Float], Float], pose: Pose) -> Float:
        frame = frame_at(self.rig.stimulus, t)
        if frame.arp_factor == 0.0:
            return np.zeros(self.rig.system.ndof)
        return frame.arp_factor * self.sound(to_array(frame.focus), pose).skin_force

    def motion(self, state: Float) -> Float:
        """The part of the plugin state that the solver uses, as a view, shape (4, ndof)."""
        ndof = self.rig.system.ndof
        return state[: 4 * ndof].reshape(4, ndof)

    def surface_nodes(self) -> tuple[Float, Float]:
        """Rest positions [m] and outward normals of the skin's surface nodes, shapes (S, 3)."""
        return self.rig.mesh.nodes[: self.rig.mesh.surface_nodes], self.rig.mesh.surface_normals()

    @cached_property
    def surface_operator(self) -> sparse.csr_matrix:
        """Degrees of freedom -> displacement along the outward normal at the surface nodes, shape (S, ndof)."""
        return surface_motion(self.rig.mesh, self.rig.system)

    def probe(self, point: Float) -> SurfaceProbe:
        """Reads the normal displacement at the skin point nearest to `point` (body frame [m], shape (3,))."""
        return SurfaceProbe(self.rig.mesh, point[None], self.rig.system)
