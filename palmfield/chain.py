"""From a moment of the stimulus to forces on the body and motion of the skin. Holds caches only; state is passed in."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.arp import arp
from palmfield.acoustics.shadow import REACH_m, lit
from palmfield.aim import Aim
from palmfield.drive.response import pole_step
from palmfield.emission import asked, delays_to
from palmfield.emitter import Emitter
from palmfield.engine.pose import Pose
from palmfield.engine.skin import SceneSkin
from palmfield.errors import SceneError
from palmfield.foresight import STEPS, Foresight
from palmfield.obstacle import WallSound, energy_flux
from palmfield.rig import Rig
from palmfield.skin.fem.probe import SurfaceProbe, surface_motion
from palmfield.stimulus.schedule import frame_at, held_frames, mean_arp_factor
from palmfield.types import Array, Complex, Float, Float32

CLEARANCE_M = 2e-3
HOUSING_M = 5e-3
SILENT = 1e-9  # of full drive


Wall = tuple[Pose, Complex, WallSound]


@dataclass(frozen=True)
class Sound:
    """ARP for one focus and pose at the loudest moment; it scales with the frame's arp_factor.

    focus: array frame [m], shape (3,), or (m, 3) for several at once
    drive: complex amplitude per transducer, shape (n,); level: amplitude asked for
    skin_force: consistent nodal forces on the skin [N], shape (ndof,)
    """

    focus: Float
    pose: Pose
    drive: Complex
    level: float
    skin_force: Float

    @property
    def first(self) -> Float:
        """The focus, or the first of several, in the array frame [m], shape (3,)."""
        return np.atleast_2d(self.focus)[0]


def clearance(array: Array, points: Float) -> float:
    """Least distance of points (array frame [m], shape (n, 3)) from an array's board, negative behind it.

    The board is the rectangle around transducers that lie in one plane of constant z and face along z. Any other array
    has none: there it is the distance from the face of the nearest transducer.
    """
    positions = array.positions
    if np.ptp(positions[:, 2]) > 1e-6 or array.normals[:, 2].min() < 0.5:
        away, _ = cKDTree(positions).query(points)
        return float(away.min()) - HOUSING_M
    low, high = positions[:, :2].min(axis=0) - HOUSING_M, positions[:, :2].max(axis=0) + HOUSING_M
    over = np.all((points[:, :2] >= low) & (points[:, :2] <= high), axis=1)
    return float(points[over, 2].min() - positions[:, 2].mean()) if over.any() else np.inf


def to_boards(points: Float, flux: Float, emitter: Emitter) -> Float:
    """How far back along the sound each point's ray can meet something before an array's board [m], shape (n,).

    points: frame of the first array [m], shape (n, 3); flux: where the sound goes there, shape (n, 3)
    A board is the plane through an array's middle across its mean direction; of several the farthest counts.
    """
    back = -flux / np.maximum(np.linalg.norm(flux, axis=1, keepdims=True), 1e-30)
    farthest = np.zeros(len(points))
    for place, part in zip(emitter.placements, emitter.parts, strict=True):
        turn = np.reshape(place.rotation, (3, 3))
        normal = turn @ part.normals.mean(axis=0)
        middle = turn @ part.positions.mean(axis=0) + np.array(place.position)
        towards = back @ normal
        meets = towards < -1e-6
        way = np.where(meets, ((middle - points) @ normal) / np.where(meets, towards, -1.0), REACH_m)
        farthest = np.maximum(farthest, way)
    return np.clip(farthest, 0.0, REACH_m)


Observer = Callable[[float, Float, "Sound | None", float, Complex], None]
"""Told of the time [s], the surface's normal displacement and velocity (2, S), sound, ARP factor, drive."""


class Chain:
    """The stages array -> field -> ARP -> skin for one simulation.

    wall: the last solution by boundary elements with its pose and drive; a chain of the same body may begin with it
    """

    def __init__(self, rig: Rig, wall: Wall | None = None):
        self.rig = rig
        self._last: Sound | None = None
        self._ringing: Sound | None = None
        self._before: Pose | None = None
        self.wall = wall
        self._resultant: tuple[Sound | None, Float, Float] = (None, np.zeros((1, 3)), np.zeros((1, 3)))
        self.observer: Observer | None = None
        self.skin = SceneSkin(self)

    # -- sound ---------------------------------------------------------------------------------------------------

    def arp_at(self, points: Float, normals: Float, pose: Pose, drive: Complex) -> tuple[Float32, Float32]:
        """ARP [Pa] and peak pressure amplitude [Pa], shapes (n,), at body points with outward normals."""
        rig = self.rig
        if rig.skin.body_sound == "scattering":
            return self._wall_sound(pose, drive).at(points)
        evaluator = rig.emitter(pose.arrays).evaluator
        field = evaluator.pressure(pose.points(points), drive, gradient=True)
        load = arp(
            field, normals @ pose.turn.T, rig.air, rig.array.frequency_Hz,
            law=rig.skin.arp_law, device=evaluator.device,
        )  # fmt: skip
        if rig.skin.body_sound == "shadows":
            flux = energy_flux(field)
            reach = to_boards(pose.points(points), flux, rig.emitter(pose.arrays))
            seen = lit(points, flux @ pose.turn, rig.posed(pose).shadows, reach_m=reach)
            load = np.where(seen, load, np.float32(0.0))
        return load, np.abs(field.pressure)

    def _wall_sound(self, pose: Pose, drive: Complex) -> WallSound:
        """Total sound on the body; the last one is kept."""
        if self.wall is not None and self.wall[0].same(pose) and np.array_equal(self.wall[1], drive):
            return self.wall[2]
        rig = self.rig
        evaluator = rig.emitter(pose.arrays).evaluator

        def incident(points: Float) -> Complex:
            return evaluator.pressure(pose.points(points), drive).pressure.astype(np.complex128)

        wavenumber = 2.0 * np.pi * rig.array.frequency_Hz / sound_speed(rig.air)
        wall = WallSound.of(rig.posed(pose).boundary_mesh, incident, wavenumber, rig.air, evaluator.device)
        self.wall = (pose, drive, wall)
        return wall

    def sound(self, focus: Float, pose: Pose) -> Sound:
        """ARP for a focus (array frame [m], shape (3,)); the last one is kept."""
        last = self._last
        if last is not None and np.array_equal(last.focus, focus) and last.pose.same(pose):
            return last
        rig = self.rig
        self.check_clear(pose)
        drive, level = rig.emitter(pose.arrays).unit_drive(focus)
        self._last = Sound(focus, pose, drive, level, self._skin_force(pose, drive))
        return self._last

    def _skin_force(self, pose: Pose, drive: Complex) -> Float:
        """Consistent nodal forces on the skin [N], shape (ndof,)."""
        load = self._foresight.take(pose, drive)
        if load is None:
            load, _ = self.arp_at(*self.rig.posed(pose).quadrature, pose, drive)
        # Normal to the skin here as there: in the moving frame it pushes along the resting skin's normals.
        return self.rig.quadrature.assemble(load.astype(np.float64))

    def resultant(self, sound: Sound) -> tuple[Float, Float]:
        """Force [N] on the whole body and torque about its origin [N m], in body axes, shapes (3,)."""
        forces, torques = self.resultants(sound)
        origins = self.rig.posed(sound.pose).origins
        return forces.sum(axis=0), (torques + np.cross(origins, forces)).sum(axis=0)

    def resultants(self, sound: Sound) -> tuple[Float, Float]:
        """Force [N] on the body or each of its bones and torque about that one's origin [N m], body axes, (b, 3)."""
        if self._resultant[0] is not sound:
            posed = self.rig.posed(sound.pose)
            points, normals, areas = posed.samples
            load, _ = self.arp_at(points, normals, sound.pose, sound.drive)
            push = -(load * areas)[:, None] * normals
            force, torque = np.zeros_like(posed.origins), np.zeros_like(posed.origins)
            np.add.at(force, posed.owners, push)
            np.add.at(torque, posed.owners, np.cross(points - posed.origins[posed.owners], push))
            self._resultant = (sound, force, torque)
        return self._resultant[1:]

    def check_clear(self, pose: Pose) -> None:
        """SceneError where the surface reaches into the array's board."""
        posed = self.rig.posed(pose)
        body = posed.nodes[0] if self.rig.surface is None else posed.vertices
        self._check_clear(f"body '{self.rig.skin.body}'", body, pose)
        if posed.beside is not None:
            self._check_clear("one of the obstacles", posed.beside[0], pose, behind=True)

    def _check_clear(self, what: str, body: Float, pose: Pose, behind: bool = False) -> None:
        """behind: whether it may lie wholly behind the board."""
        emitter = self.rig.emitter(pose.arrays)
        for part, place in zip(emitter.parts, emitter.placements, strict=True):
            points = (pose.points(body) - np.array(place.position)) @ np.array(place.rotation).reshape(3, 3)
            above = clearance(part, points)
            mirrored = points * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * part.positions[:, 2].mean()]
            if above < CLEARANCE_M and not (behind and clearance(part, mirrored) > HOUSING_M):
                raise SceneError(
                    f"plugin 'palmfield.skin': {what} reaches into the array (lowest point "
                    f"{1e3 * above:.1f} mm above the board, at least {1e3 * CLEARANCE_M:g} mm needed); move it up"
                )

    # -- motion --------------------------------------------------------------------------------------------------

    def advance(self, state: Float, start: float, aim: Aim, pose: Pose) -> None:
        """Carry transducers and skin from `start` [s] over one MuJoCo step, in place.

        state: plugin state, shape (rig.state_size,)
        aim: where the stimulus's points are meanwhile
        """
        rig, step = self.rig, self.rig.sizes[4]
        skin = self.skin.stepper(state, start, aim, pose)
        motion = state[: skin.state_size]
        still = self._before is not None and self._before.same(pose)
        self._before = pose
        for i in range(round(rig.timestep_s / step)):
            t0, t1 = start + i * step, start + (i + 1) * step
            if still and self._can_foresee and not self._foresight.knows(pose, t0):
                self._foresee(state, t0, aim, pose)
            first, last = self._loads(state, t0, t1, aim, pose)
            skin.step(motion, first, last)
            if self.observer is not None:
                seen = self.skin.read(state, self.surface_operator)
                self.observer(t1, seen, *self.now(state, t1, aim, pose), self.drive(t1, aim, pose))

    def drive(self, t: float, aim: Aim, pose: Pose) -> Complex:
        """What the device gives the transducers at time t [s], shape (n,); what they make of it comes later."""
        frame = frame_at(self.rig.stimulus, t)
        if frame.arp_factor == 0.0:
            return np.zeros(len(self.rig.array), complex)
        return math.sqrt(frame.arp_factor) * self.rig.emitter(pose.arrays).unit_drive(aim(frame.focus))[0]

    def now(self, state: Float, t: float, aim: Aim, pose: Pose) -> tuple[Sound | None, float]:
        """The sound at time t [s], which the state must be at, and its ARP factor; (None, 0) while silent."""
        if self.rig.silent:
            return None, 0.0
        frame = frame_at(self.rig.stimulus, t)
        if self.rig.response.on:
            return self._emitted(self.emitted(state), aim(frame.focus), pose)
        if frame.arp_factor == 0.0:
            return None, 0.0
        return self.sound(aim(frame.focus), pose), frame.arp_factor

    def _loads(self, state: Float, t0: float, t1: float, aim: Aim, pose: Pose) -> tuple[Float, Float]:
        """Nodal forces [N] at the ends of a step, equal where something jumps or is held: then their mean.

        Steps the transducers, in place.
        """
        moments = self._moments(state, t0, t1, aim, pose)
        forces = [(share, self.force(state, time, aim, pose)) for time, share in moments]
        if not held_frames(self.rig.stimulus, t0, t1):
            return forces[0][1], forces[1][1]
        total = np.sum([share * force for share, force in forces], axis=0)
        return total, total

    def _moments(self, state: Float, t0: float, t1: float, aim: Aim, pose: Pose) -> Iterator[tuple[float, float]]:
        """The moments of a step at which the skin's load is taken, as (time, share); both ends where nothing is held.

        Transducers are stepped in place: at each moment the state holds what they emit then.
        """
        held = held_frames(self.rig.stimulus, t0, t1)
        if not self.rig.response.on:
            yield from held or [(t0, 0.5), (t1, 0.5)]
            return
        emitted = self.emitted(state)
        if not held:
            yield t0, 0.5
            self._ring(emitted, t0, t1, aim, pose)
            yield t1, 0.5
        for time, share in held:
            half = 0.5 * share * (t1 - t0)
            self._ring(emitted, time, time, aim, pose, half)
            yield time, share
            self._ring(emitted, time, time, aim, pose, half)

    def force(self, state: Float, t: float, aim: Aim, pose: Pose) -> Float:
        """Consistent nodal forces on the skin [N] at time t [s], which the state must be at, shape (ndof,)."""
        sound, factor = self.now(state, t, aim, pose)
        return np.zeros(self.rig.system.ndof) if sound is None else factor * sound.skin_force

    @cached_property
    def _foresight(self) -> Foresight:
        return Foresight(self.rig)

    @cached_property
    def _can_foresee(self) -> bool:
        """Whether the coming drives differ, and a transfer matrix gives their load."""
        rig = self.rig
        changing = rig.stimulus.path != "point" or rig.response.delays_s.any()
        return bool(changing and rig.skin.body_sound == "none" and self.one_fast_kernel)

    @property
    def one_fast_kernel(self) -> bool:
        """Whether a transfer matrix can give the field."""
        kernels = self.rig.reference_emitter.evaluator.evaluators
        return len(kernels) == 1 and kernels[0].mode == "fast"

    def _foresee(self, state: Float, t0: float, aim: Aim, pose: Pose) -> None:
        """Compute the load of the coming steps together, from a rehearsal with a copy of the state."""
        rig, step = self.rig, self.rig.sizes[4]
        emitter, rehearsed = rig.emitter(pose.arrays), state.copy()
        drives = []
        for i in range(STEPS):
            for time, _ in self._moments(rehearsed, t0 + i * step, t0 + (i + 1) * step, aim, pose):
                if rig.response.on:
                    drives.append(self.emitted(rehearsed).copy())
                elif frame_at(rig.stimulus, time).arp_factor > 0.0:
                    drives.append(emitter.unit_drive(aim(frame_at(rig.stimulus, time).focus))[0])
        self._foresight.fill(pose, t0 + (STEPS - 0.5) * step, emitter.evaluator.evaluators[0], drives)

    # -- transducers that ring -------------------------------------------------------------------------------------

    def emitted(self, state: Float) -> Complex:
        """Complex amplitude that each transducer emits, a view into the state, shape (n,)."""
        return state[len(state) - 2 * len(self.rig.array) :].view(np.complex128)

    def _ring(
        self,
        emitted: Complex,
        t0: float,
        t1: float,
        aim: Aim,
        pose: Pose,
        time_s: float | None = None,
    ) -> None:
        """Step the transducers, in place, over t1 - t0 or `time_s` [s], the drive going from that at t0 to t1's."""
        response, emitter, stimulus = self.rig.response, self.rig.emitter(pose.arrays), self.rig.stimulus
        delays = response.delays_s
        if delays.any():
            delays = delays_to(emitter, aim(frame_at(stimulus, stimulus.start_s).focus))
        first = asked(stimulus, emitter, delays, t0, aim)
        last = first if t1 == t0 else asked(stimulus, emitter, delays, t1, aim)
        emitted[:] = pole_step(emitted, first, last, response.pole, t1 - t0 if time_s is None else time_s)

    def _emitted(self, emitted: Complex, focus: Float, pose: Pose) -> tuple[Sound | None, float]:
        """What is emitted as a sound and its ARP factor; one and the same sound while only its level changes."""
        if np.abs(emitted).max() < SILENT:
            return None, 0.0
        if self.rig.stimulus.path == "point":
            unit = self.sound(focus, pose)
            level = np.vdot(unit.drive, emitted) / np.vdot(unit.drive, unit.drive)
            if np.abs(emitted - level * unit.drive).max() < SILENT:
                return unit, float(abs(level) ** 2)
        last = self._ringing
        if last is None or not (np.array_equal(last.drive, emitted) and last.pose.same(pose)):
            force = self._skin_force(pose, emitted)
            last = Sound(focus, pose, emitted.copy(), float(np.abs(emitted).max()), force)
            self._ringing = last
        return last, 1.0

    def mean_factor(self, state: Float, start: float, aim: Aim, pose: Pose) -> float:
        """Mean ARP factor, relative to the sound of `now`, over the MuJoCo step that begins at `start` [s]."""
        rig = self.rig
        if rig.silent:
            return 0.0
        end = start + rig.timestep_s
        count = max(4, round(rig.timestep_s / rig.sizes[4]))
        asked_for = mean_arp_factor(rig.stimulus, start, end, count)
        if not rig.response.on or rig.stimulus.path != "point":
            return asked_for
        emitted = self.emitted(state).copy()
        width = rig.timestep_s / count
        total = 0.0
        for i in range(count):
            for time, share in held_frames(rig.stimulus, start + i * width, start + (i + 1) * width) or [
                (start + (i + 0.5) * width, 1.0)
            ]:
                half = 0.5 * share * width
                self._ring(emitted, time, time, aim, pose, half)
                total += share * float(np.vdot(emitted, emitted).real)
                self._ring(emitted, time, time, aim, pose, half)
        unit, _ = rig.emitter(pose.arrays).unit_drive(aim(frame_at(rig.stimulus, start).focus))
        full = float(np.vdot(unit, unit).real)
        return total / count / full if full > 0.0 else 0.0

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
