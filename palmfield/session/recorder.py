"""Record a running simulation. Blocks of arrays, each of one or more MuJoCo steps, are written to a store."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from palmfield.acoustics.arp import SurfaceSound
from palmfield.blas import one_blas_thread
from palmfield.drive.transducer_response import EmittedCourse, rows
from palmfield.engine.host import World, world_of
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.hand.triangles import vertex_normals
from palmfield.outputs.netcdf import joined
from palmfield.outputs.schema import MUJOCO_SCENE, Arrays, group, sensor_channels
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.session.mujoco_scene import mujoco_arrays
from palmfield.session.phase_turns import PhaseTurns
from palmfield.simulation.backend import StepTrace
from palmfield.simulation.emission import Emission
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.rates import CHANNELS as RATES
from palmfield.simulation.sensors import CHANNELS, UNITS
from palmfield.simulation.skin_sound import Role
from palmfield.stimulus.schedule import frames_at
from palmfield.threads import cores, share
from palmfield.transforms import quaternion
from palmfield.types import Array, Complex, Float, Float32, Int

if TYPE_CHECKING:  # few scenes have key inertia on
    from palmfield.session.motion_driven import MotionDriven

Block = dict[str, dict[str, NDArray[Any]]]

TOGETHER = 64
"""Largest number of MuJoCo steps whose data are computed together."""
WAITING_BYTES, WAITING_s = 8_000_000, 2.0
"""Largest size of the waiting motion of the skins, and longest waiting time.

A killed process loses the waiting data.
"""
ROWS = 64
"""Number of substeps whose motion is computed in one matrix product."""
FEW = 112
"""Largest number of drives whose fields a CPU computes together.

For more it would use a formula with other rounding.
"""


class Sink(Protocol):
    """Destination of blocks: `palmfield.outputs.store.Store` or MemoryStore."""

    def append(self, block: Arrays) -> None: ...


class Emitted(NamedTuple):
    """Emission at some moments.

    It is either one drive (N,) with factors of its ARP (m,), or a drive for each moment (m, N).
    serial: serial number of the single drive, 0 for many drives
    """

    drives: Complex
    factors: Float
    serial: int


class Recorded(NamedTuple):
    """One step whose data have not been written yet.

    times: ends of its substeps [s], shape (s,)
    posed: its pose
    emitted: emission at `times`
    motions: recorded quantities of each skin after each substep (`SkinModel.recorded`) and their rates, shape
        (s, 2, m); or their coordinates, shape (s, 2, r), with the matrix (r, m)
    pressed: numbers of the force samples of each skin, and the mean ARP at them [Pa]; None in silence
    start_s: start of the step, MuJoCo time
    forces: forces on the parts of each body [N], and torques [N m], shape (2, b, 3)
    bodies: poses of all MuJoCo bodies, shape (bodies, 7)
    sensors: values of each sensor
    """

    times: Float
    posed: PosedScene
    emitted: Emitted
    motions: list[tuple[Float | Float32, Float | None]]
    pressed: "list[tuple[Int, Float] | None]"
    start_s: float
    forces: list[Float]
    bodies: Float
    sensors: list[Float]

    def goes_on(self, last: "Recorded") -> bool:
        """Return whether pose, kind of emission and coordinates are those of the last step."""
        same = all(one[1] is other[1] for one, other in zip(self.motions, last.motions, strict=True))
        return same and self.posed is last.posed and self.emitted.serial == last.emitted.serial


def emitted_at(course: EmittedCourse, moments: NDArray[np.int_]) -> Emitted:
    """Return the emission at some moments of a course. moments: indices, shape (m,)"""
    if len(course.units) != 1:
        return Emitted(rows(course)[moments], np.ones(len(moments)), 0)
    return Emitted(course.units[0], np.abs(course.levels[moments, 0]) ** 2, course.serial)


def emitted_at_ends(emission: Emission, trace: StepTrace, step_s: float) -> Emitted:
    """Return the emission at the ends of the substeps of a step, for one world. step_s: length of a substep [s]"""
    moments, course = trace.moments, trace.course(0)
    if not any(moments.held_s):
        return emitted_at(course, np.argmax(moments.last, axis=1))
    emitted, drives = trace.begun(0), []
    for end in trace.times:
        emitted = emission.over(trace.posed[0], emitted, float(end) - step_s, 1)[1].end
        drives.append(rows(emission.now(trace.posed[0], emitted, float(end)))[0])
    return Emitted(np.array(drives), np.ones(len(drives)), 0)


class Recorder:
    """Records the steps of a scene and writes their data.

    loudest: for each skin the moment of highest ARP so far, None without sound
    peak_drive: largest commanded amplitude of each transducer so far, relative to full drive, shape (N,)
    begun_s: MuJoCo time at the start [s]
    turns: for each stimulus, the times at which the phases between its foci jumped
    driven: motion that the bones drive, for each skin with key inertia on, by its number
    """

    def __init__(
        self, runtime: SceneRuntime, world: World, sink: Sink, body_poses: Callable[[], Float], together: int = 1
    ):
        """body_poses: function that returns poses of all MuJoCo bodies in the world, shape (bodies, 7)

        together: largest number of steps in a block; the last block is written by `stop`
        """
        self._body_poses = body_poses
        self.runtime, self.model, self.world, self.sink = runtime, runtime.model, world, sink
        self.loudest: list[LoudestMoment | None] = [None] * len(self.model.skins)
        self._loudest_Pa = [0.0] * len(self.model.skins)
        self.peak_drive: Float = np.zeros(len(self.model.arrays))
        self.turns = [PhaseTurns() for _ in self.model.stimuli]
        self._drive: Complex | None = None
        self._trace: StepTrace | None = None
        size = sum(24 * self.model.substeps * len(skin.nodes[0]) for skin in self.model.skins)
        # The next tick changes held points, with which waiting steps are computed
        self._together = 1 if runtime.work.emission.holds else min(together, 1 + WAITING_BYTES // size)
        self._waiting: list[Recorded] = []
        self._written_at = time.monotonic()
        self.begun_s = 0.0
        self.driven: dict[int, MotionDriven] = {}
        skins = [skin.instance for skin in runtime.binding.skins]
        sensed = [*skins, *runtime.binding.region_instances]
        self._sensors = [(sensor.name, sensor.data) for instance in sensed for sensor in world.sensors(instance)]

    def start(self) -> None:
        """Record the state before the first step, and begin to observe steps."""
        work, posed = self.runtime.work, self.runtime.posed
        now_s = self.begun_s = self.world.time
        for number, skin in enumerate(self.model.skins):
            if skin.spec.config.inertia == "on":
                from palmfield.session.motion_driven import MotionDriven

                self.driven[number] = MotionDriven(self.world, number)
        work.observe = work.watching(*(skin.recorded for skin in self.model.skins))
        motions = []
        for number, (stepper, numbers) in enumerate(self.runtime.skin_states()):
            reader = work.reader(number, stepper)
            assert reader is not None
            motions.append(_motion([(stepper.read(numbers, reader), None)]))
        work.in_coordinates = True
        course = work.emission.now(posed, self.runtime.amplitudes, now_s)
        block = self._block(np.array([now_s]), posed, emitted_at(course, np.array([0])), motions)
        self.sink.append(block)
        self.runtime.steps.observer = self._observe

    def stop(self) -> None:
        """Write the last steps, and end the observation."""
        self.runtime.steps.observer = None
        self.runtime.work.observe, self.runtime.work.in_coordinates = self.runtime.work.watching(), False
        self._write()

    def _observe(self, trace: StepTrace) -> None:
        self._trace = trace

    def step(self) -> None:
        """Record the data of one completed MuJoCo step. If the block is full, write it."""
        trace, self._trace = self._trace, None
        if trace is None:
            return
        [posed] = trace.posed
        motions: list[tuple[Float | Float32, Float | None]] = []
        for number, (stepper, _) in enumerate(self.runtime.skin_states()):
            [(_, [values])] = trace.motion[number]
            matrix = self.runtime.work.coordinates(number, stepper)
            motions.append((values.astype(np.float32) if matrix is None else values.copy(), matrix))
        emitted = emitted_at_ends(self.runtime.work.emission, trace, self.model.step_s)
        start_s = self.world.time - self.model.spec.timestep_s
        forces = [np.array(parts) for parts in self.runtime.applied_parts]
        sensors = [data.copy() for _, data in self._sensors]
        pressed, bodies = self._pressed(posed), self._body_poses()
        self._waiting.append(Recorded(trace.times, posed, emitted, motions, pressed, start_s, forces, bodies, sensors))
        if len(self._waiting) >= self._together or time.monotonic() - self._written_at > WAITING_s:
            self._write()

    def _pressed(self, posed: PosedScene) -> "list[tuple[Int, Float] | None]":
        """Return `Recorded.pressed`. On a GPU it is empty, because a GPU computes forces without these values."""
        if self.runtime.steps.in_graph:
            return []
        result: list[tuple[Int, Float] | None] = []
        for number in self.model.first_skins:
            body = self.model.skins[number].body
            pressure = self.runtime.steps.host.pressed(0, body)
            samples = self.runtime.work.radiation.samples(posed, number)
            result.append(None if pressure is None else (samples[3], pressure))
        return result

    def _write(self) -> None:
        """Write the waiting steps in one block."""
        steps, self._waiting, self._written_at = self._waiting, [], time.monotonic()
        if not steps:
            return
        blocks, begin = list[Block](), 0
        for end in range(1, len(steps) + 1):
            if end == len(steps) or not steps[end].goes_on(steps[end - 1]):
                blocks.append(self._in_one_pose(steps[begin:end]))
                begin = end
        for i, number in enumerate(self.model.first_skins if steps[0].pressed else ()):
            skin = self.model.skins[number]
            pressure = np.zeros((skin.sample_faces.shape[1], len(steps)))
            for column, one in enumerate(steps):
                if (pressed := one.pressed[i]) is not None:
                    pressure[pressed[0], column] = pressed[1]
            face_arp = np.ascontiguousarray((skin.sample_faces @ pressure).T, np.float32)
            blocks.append({group("surface", skin.spec.name): {"face_arp": face_arp}})
        block = joined(blocks)
        for variables in block.values():
            for array in variables.values():
                array.flags.writeable = False  # so that the store need not copy it
        self.sink.append(block)

    def _in_one_pose(self, steps: Sequence[Recorded]) -> Block:
        """Return the data along `time` of steps that have one pose and one kind of emission."""
        times = np.concatenate([one.times for one in steps])
        motions = [_motion(parts) for parts in zip(*[one.motions for one in steps], strict=True)]
        drives, factors, serial = steps[0].emitted
        if serial == 0:
            drives = np.concatenate([one.emitted.drives for one in steps])
        factors = np.concatenate([one.emitted.factors for one in steps])
        block = self._block(times, steps[0].posed, Emitted(drives, factors, serial), motions)
        self._add_steps(block, steps)
        return block

    def _add_steps(self, block: Block, steps: Sequence[Recorded]) -> None:
        """Add the data along `step_time` of steps in one pose."""
        posed, count, starts = steps[0].posed, len(steps), np.array([one.start_s for one in steps])
        block["/"]["step_time"] = starts - self.begun_s
        for number, part in self.driven.items():
            block[group("skin", self.model.skins[number].spec.name)]["motion_displacement"] = part.at(starts)
        frame = posed.array_frame
        for array, placement in zip(self.model.spec.arrays, posed.arrays.placements, strict=True):
            own = placement.transform
            pose = pose7(frame.points(own.position), frame.rotation @ own.rotation)
            block.setdefault(group("array", array.name), {})["pose"] = np.tile(pose, (count, 1))
        for skin in self.model.skins:
            forces = np.array([one.forces[skin.body] for one in steps])
            self._add_body(block, skin.spec.name, posed, skin.body, forces[:, 0], forces[:, 1])
        block[group("mujoco", MUJOCO_SCENE)] = {"pose": np.array([one.bodies for one in steps])}
        for i, (name, _) in enumerate(self._sensors):
            block[group("sensors", name)] = {"value": np.array([one.sensors[i] for one in steps])}

    def _add_body(self, block: Block, name: str, posed: PosedScene, number: int, forces: Float, torques: Float) -> None:
        """Add the poses of a body, and the forces and torques on its parts in each step, shapes (steps, b, 3)."""
        frame, body, count = posed.array_frame, posed.bodies[number], len(forces)
        rotation = frame.rotation @ body.frame.rotation
        poses = {"pose": np.tile(pose7(frame.points(body.frame.position), rotation), (count, 1))}
        of_body = {"force": forces.sum(axis=1)}
        arms = np.zeros((1, 3))
        if len(body.bone_positions):
            places = zip(body.bone_positions, body.bone_rotations, strict=True)
            poses["bone_pose"] = np.tile([pose7(position, turn) for position, turn in places], (count, 1, 1))
            arms = body.bone_positions @ rotation.T
            of_body |= {"bone_force": forces, "bone_torque": torques}
        of_body["torque"] = (torques + np.cross(arms, forces)).sum(axis=1)
        block[group("body", name)], block[group("forces", name)] = poses, of_body

    # -- data of a block -----------------------------------------------------------------------------

    def _block(self, times: Float, posed: PosedScene, emitted: Emitted, motions: list[Float32]) -> Block:
        block: Block = {"/": {"time": times - self.begun_s}}
        for number, skin in enumerate(self.model.skins):
            nodes = len(skin.nodes[0])
            motion = motions[number][:, :, : 3 * nodes].reshape(2, len(times), nodes, 3)
            sound = self._sound(posed, number, emitted, times)
            normal = _along(motion[0], skin.nodes[1].astype(np.float32))
            block[group("skin", skin.spec.name)] = {
                "displacement": motion[0], "normal_displacement": normal, "velocity": motion[1],
                "arp": sound.arp, "pressure": sound.amplitude,
            }  # fmt: skip
            if skin.innervation is not None:
                units = slice(3 * nodes, skin.recorded.shape[0])
                block[group("skin", skin.spec.name)]["afferent_motion"] = motions[number][0, :, units].copy()
        self._add_stimuli(block, times, posed)
        self._add_drive(block, times, posed)
        return block

    def _sound(self, posed: PosedScene, number: int, emitted: Emitted, times: Float) -> SurfaceSound:
        """Return ARP and amplitude at the surface nodes of a skin, shapes (t, S), and update the loudest moment."""
        radiation = self.runtime.work.radiation
        if emitted.drives.ndim == 1:
            unit, factors = (
                radiation.on(posed, number, "nodes", emitted.drives, emitted.serial),
                emitted.factors[:, None],
            )
            sound = SurfaceSound(
                (factors * unit.arp).astype(np.float32), (np.sqrt(factors) * unit.amplitude).astype(np.float32)
            )
        else:
            most = len(times) if self.runtime.steps.in_graph else FEW
            parts = range(0, len(times), most)
            few = [radiation.sounds(posed, number, emitted.drives[i : i + most], "nodes") for i in parts]
            sound = SurfaceSound(*map(np.concatenate, zip(*(one[:2] for one in few), strict=True)))
        arp = sound.arp
        peaks = arp.max(axis=1)
        first = int(peaks.argmax())
        if peaks[first] > self._loudest_Pa[number]:
            self._loudest_Pa[number] = float(peaks[first])
            drive = emitted.drives if emitted.drives.ndim == 1 else emitted.drives[first].copy()
            self.loudest[number] = LoudestMoment(float(times[first]), posed, drive, float(emitted.factors[first]))
        return sound

    def _add_stimuli(self, block: Block, times: Float, posed: PosedScene) -> None:
        emission = self.runtime.work.emission
        placed, foci = emission.placed(posed, float(times[0])), emission.foci(posed, times)
        for (part, drive, now), places, turns in zip(placed, foci, self.turns, strict=True):
            points, factors = frames_at(part.config, times)
            world = posed.array_frame.points(places.reshape(-1, 3)).reshape(places.shape)
            sounding = (factors > 0.0) & (not part.silent)
            for i in np.flatnonzero(sounding) if places.shape[1] > 1 else ():
                turns.see(float(times[i] - self.begun_s), drive, places[i], now.loudness(points[i]))
            block[group("stimulus", part.spec.name)] = {"foci": world, "sounding": sounding}

    def _add_drive(self, block: Block, times: Float, posed: PosedScene) -> None:
        """Add a drive frame wherever the commanded drive changes."""
        commanded = self.runtime.work.emission.commanded(posed, times)
        last = np.full_like(commanded[:1], np.nan) if self._drive is None else self._drive
        before = np.concatenate([last, commanded[:-1]])
        frames = np.logical_or.reduce(commanded != before, axis=1).nonzero()[0]
        self._drive = commanded[-1:].copy()
        if len(frames) == 0:
            return
        block["/"]["frame_time"] = times[frames] - self.begun_s
        chosen = commanded[frames]
        self.peak_drive = np.maximum(self.peak_drive, np.abs(chosen).max(axis=0))
        for array, part in zip(self.model.spec.arrays, posed.arrays.slices, strict=True):
            block.setdefault(group("array", array.name), {}).update(
                drive_amplitude=np.abs(chosen[:, part]).astype(np.float32),
                drive_phase=np.angle(chosen[:, part]).astype(np.float32),
            )

    # -- at the end ----------------------------------------------------------------------------------------------

    def surfaces(self) -> Block:
        """Return ARP and pressure at the loudest moment of each skin.

        They are given on the skin and on the whole surface of its body.
        """
        block: Block = {}
        radiation = self.runtime.work.radiation
        for number, (skin, moment) in enumerate(zip(self.model.skins, self.loudest, strict=True)):
            posed = self.runtime.work.reference if moment is None else moment.posed
            body = posed.bodies[skin.body]
            normals = body.frame.vectors(vertex_normals(body.vertices, body.faces))
            nodes, outwards = posed.skins[number].nodes
            places: tuple[tuple[str, Role, Float, Float], ...] = (
                ("skin", "nodes", nodes, outwards),
                ("surface", "vertices", body.vertices_in_array, normals),
            )
            for kind, role, points, outward in places:
                arp, amplitude = np.zeros(len(points), np.float32), np.zeros(len(points), np.float32)
                if moment is not None:
                    sound = radiation.at(posed, number, role, points, outward, moment.drive)
                    arp = np.float32(moment.factor) * sound.arp
                    amplitude = np.float32(np.sqrt(moment.factor)) * sound.amplitude
                block[group(kind, skin.spec.name)] = {
                    "loudest_time": np.array(0.0 if moment is None else moment.time_s - self.begun_s),
                    "loudest_arp": arp,
                    "loudest_pressure": amplitude,
                }
            obstacles = posed.skins[number].obstacles
            if obstacles is not None:
                block[group("surface", skin.spec.name)] |= {
                    "obstacle_position": posed.array_frame.points(obstacles[0]), "obstacle_face": obstacles[1],
                }  # fmt: skip
        return block


def _motion(parts: Sequence[tuple[Float | Float32, Float | None]]) -> Float32:
    """Return the recorded quantities of a skin after each substep of some steps, shape (2, t, m).

    parts: as in Recorded
    """
    numbers, matrix = np.concatenate([values for values, _ in parts]).swapaxes(0, 1), parts[0][1]
    times, count = numbers.shape[1], numbers.shape[2] if matrix is None else matrix.shape[1]
    result = np.empty((2, times, count), np.float32)
    if matrix is None:
        result[:] = numbers
        return result

    def read(kind: int, own: slice) -> None:
        result[kind, own] = numbers[kind, own] @ matrix

    blocks = [(partial(read, kind, slice(i, i + ROWS)),) for kind in range(2) for i in range(0, times, ROWS)]
    with one_blas_thread:
        share(blocks, cores())
    return result


def _along(vectors: Float32, normals: Float32) -> Float32:
    """Return the components of vectors (t, S, 3) along normals (S, 3), shape (t, S)."""
    result = np.empty(vectors.shape[:2], np.float32)

    def some(own: slice) -> None:
        np.einsum("tsk,sk->ts", vectors[own], normals, out=result[own])

    share([(partial(some, slice(i, i + ROWS)),) for i in range(0, len(vectors), ROWS)], cores())
    return result


def static_arrays(model: HapticModel, world: World, runtime: SceneRuntime, compiled: mujoco.MjModel) -> Block:
    """Return the data that exist before the first step. compiled: MuJoCo model of the scene"""
    block: Block = {group("mujoco", MUJOCO_SCENE): mujoco_arrays(compiled)}
    for array, part in zip(model.spec.arrays, model.arrays.parts, strict=True):
        block[group("array", array.name)] = _transducers(part)
    for skin in model.skins:
        nodes, normals = skin.nodes
        vertices, faces = skin.closed_surface
        own: dict[str, NDArray[Any]] = {
            "rest_position": nodes, "rest_normal": normals, "face": skin.faces, "depth": skin.depth,
        }  # fmt: skip
        if skin.innervation is not None:
            own |= {"afferent_class": skin.innervation.names, "afferent_position": skin.innervation.positions}
        whole: dict[str, NDArray[Any]] = {"rest_position": vertices, "face": faces}
        if skin.carrier.hand is not None:
            for arrays, points in ((own, nodes), (whole, vertices)):
                binding = skin.carrier.bind(points)
                assert binding is not None
                arrays["bone_index"] = np.asarray(binding.bones, dtype=np.int32)
                arrays["bone_weight"] = np.asarray(binding.shares, dtype=np.float32)
            names = np.array([bone.name for bone in skin.carrier.hand.bones])
            block[group("body", skin.spec.name)] = {"bone": names, "bone_rest": skin.carrier.rest_origins}
            block[group("forces", skin.spec.name)] = {"bone": names}
        block[group("skin", skin.spec.name)], block[group("surface", skin.spec.name)] = own, whole
    for bound in runtime.binding.skins:
        for sensor in world.sensors(bound.instance):
            block[group("sensors", sensor.name)] = sensor_channels(list(CHANNELS), list(UNITS))
    for instance in runtime.binding.region_instances:
        for sensor in world.sensors(instance):
            block[group("sensors", sensor.name)] = sensor_channels(RATES, ["s-1"] * len(RATES))
    return block


def _transducers(array: Array) -> dict[str, NDArray[Any]]:
    """Return all inputs of the sound of an array except drive, pose and air."""
    gain = np.ones(len(array), np.complex128) if array.gain is None else array.gain
    inputs = {
        "transducer_position": array.positions,
        "transducer_direction": array.normals,
        "transducer_p0": array.p0_Pa_m * np.abs(gain),
        "transducer_phase": np.angle(gain),
        "piston_radius": np.array(array.piston_radius_m),
    }
    if array.directivity_table is not None:
        angles, levels = array.directivity_table.T
        inputs |= {"off_axis_angle": angles, "off_axis_level": levels}
    return inputs


def world_with(data: mujoco.MjData) -> World:
    """Return the plugin modules of the scene in an mjData."""
    world = world_of(data)
    assert world is not None
    return world


def pose7(position: Float, rotation: Float) -> Float:
    """Return position [m] and unit quaternion (w, x, y, z) in one array, shape (7,)."""
    return np.concatenate([position, quaternion(rotation)])
