"""What a scene's sound does in one MuJoCo step, on a device: one captured graph from poses to ARP and forces.

Poses, drives and the numbers of skins with small models go in by one copy; forces, the sensors' ARP and what the skins'
numbers will be when the step ends come out by another. The skins' state lies where the caller has it, and the device
keeps none of it from step to step. A DeviceSound belongs to one state and is used by one thread at a time.
"""

import cmath
import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from scipy import sparse

from palmfield.acoustics import check
from palmfield.acoustics.body_scattering import Occlusion
from palmfield.acoustics.knife_edge import KnifeEdges
from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.point_sound import DriveTable, Surface, Transducers, fill_table, sound_calls
from palmfield.acoustics.shadow_nodes import ShadowNodes, shadow_nodes
from palmfield.device import (
    Branches,
    SharedArray,
    SharedBlock,
    check_room,
    filled,
    launch,
    launching,
    nbytes,
    replayed,
    resolve,
    vectors,
    whole_numbers,
)
from palmfield.drive.path_drives import PathDrives, PathMemory, PathStep, foci_made, push_rows
from palmfield.drive.transducer_response import EmittedCourse, of_drives, present_drive
from palmfield.errors import PalmfieldError
from palmfield.hand.posed_surface import SkinBinding
from palmfield.hand.rigged import strongest
from palmfield.hand.skinning import SkinnedSurface
from palmfield.simulation.emission import Emission, MeanDrives
from palmfield.simulation.model import HapticModel, SkinModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import (
    BODY_SPACING_m,
    bends,
    load_nodes,
    occluding_counts,
    occluding_faces,
    occluding_vertices,
    sample_nodes,
)
from palmfield.simulation.sensors import SensorPlace
from palmfield.skin.reduction import device_models
from palmfield.skin.stepper import DeviceModel, Outside, SkinStepper, StepMemory
from palmfield.stimulus.schedule import Moments
from palmfield.types import Complex, Float, Float32, Int
from warp_kernels import carried_points as carrying
from warp_kernels import resultants as summing
from warp_kernels import skin_steps

CLOCK_S = 1e-12
"""Times nearer to each other than this are one and the same."""
NO_SKINS: Mapping[int, Any] = {}
RUN = 16
"""Force samples that one thread adds up."""
LOAD, FORCE, NOW = "load", "force", "now"
"""What drives are for: the skins' load over the step, the mean force over it, and the sensors at its beginning."""
FOCI = "foci"
"""Where they come from, if kernels make them."""
PATH = "counts", "group", "foci", "wanted", "aims", "ring", "pushes", "begun", "end", "totals"
"""Parts of a PathMemory that a step's inputs and results hold."""
GOING = "load_counts", "force_counts", "now_counts", "path_counts", "path_wanted", "weights"
COMING = "forces", "probes", "path_totals"
"""What goes to a device in each step of several worlds, and comes from there."""
Parts = Mapping[str, tuple[tuple[int, ...], Any]]


class Sounding(NamedTuple):
    """Drives whose sums sound. units: shape (k, N); levels: of each sum, shape (m, k), None for each drive by itself;
    serial: equal for the same sums; weights: of the sums in a mean, shape (m,)"""

    units: Complex
    levels: Complex | None
    serial: int
    weights: Float | None = None

    @property
    def sums(self) -> int:
        """How many sums there are."""
        return len(self.units if self.levels is None else self.levels)


class SkinStart(NamedTuple):
    """A skin at a step's beginning: what steps it, and its numbers, shape (state_size,)."""

    stepper: SkinStepper
    numbers: Float


class SkinEnd(NamedTuple):
    """A skin at a step's end: its numbers, shape (state_size,), a view that the next step overwrites, and what of the
    load was outside the class that its modes serve, None where it has none."""

    numbers: Float
    outside: Outside | None


class _SkinStep(NamedTuple):
    """What a step of a skin was computed from. pose, load: serial numbers of the scene and the course; weights: of its
    patterns"""

    pose: int
    load: int
    stepper: SkinStepper
    numbers: Float
    weights: Float


class _PathKnown(NamedTuple):
    """What was computed of a focus that moves. begun: what was emitted when the step began at t0 [s], shape (N,)"""

    posed: PosedScene
    t0: float
    begun: Complex
    moments: Moments
    course: EmittedCourse


def serves(model: HapticModel) -> bool:
    """Whether a model's sound is computed here: on a GPU, but for echoes, boundary elements and 'accurate'."""
    fast = model.arrays.precision == "fast" and model.arrays.wall_m is None
    solved = any(skin.spec.config.body_sound == "scattering" for skin in model.skins)
    return resolve(model.spec.device) != "cpu" and fast and not solved


class DeviceSound:
    """ARP on skins, forces on bodies and what sensors read, for one step after another.

    model: of the scene; reference: its scene in the reference configuration
    work: memory and graphs, None before the first step; launches: how many graphs have been launched
    """

    def __init__(self, model: HapticModel, reference: PosedScene):
        self.model, self._reference = model, reference
        self.device = resolve(model.spec.device)
        self.launches = 0
        self._arrays = model.arrays
        self._probes: list[tuple[int, SensorPlace]] = []
        self._sizes = {LOAD: (1, 1), FORCE: (1, 1), NOW: (1, 1), FOCI: (0, 0)}
        self.work: DeviceWork | None = None
        self._posed: PosedScene | None = None
        self._sounding: dict[str, Sounding | None] = {}
        self._force_scale = 0.0
        self._fetched = False
        self._pushes = False
        # The moving focus: what drives transducers, the arrays for which, and the last step
        self._drives: PathDrives | None = None
        self._driven: PhasedArray = model.arrays
        self._path: _PathKnown | None = None
        self._stepping: dict[int, DeviceModel] = {}
        self._models: dict[tuple[int, SkinStepper], DeviceModel | None] = {}
        self._skins: Mapping[int, _SkinStep] = NO_SKINS

    @cached_property
    def _transducers(self) -> Transducers:
        """Made when they are first needed: of many worlds few take steps by themselves."""
        return Transducers(self.model.arrays, self.device)

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute the ARP at a sensor's place as well, from the next step on."""
        if (skin, place) not in self._probes:
            self._probes.append((skin, place))

    def over(
        self,
        emission: Emission,
        posed: PosedScene,
        emitted: Complex,
        t0: float,
        skins: Mapping[int, SkinStart] | None = None,
        watched: bool = True,
    ) -> list[tuple[Float, Float]]:
        """As `palmfield.simulation.forces.BodyForces.over`; the load on the skins is computed with it.

        skins: by number, those whose motion over the step is wanted as well, see `stepped`
        A focus that moves is left to the device where nobody asks for its drives.
        """
        path = None if watched else emission.path_step(posed, t0, self.model.substeps)
        if path is not None and self._over_path(emission, posed, emitted, t0, path, skins or {}):
            return self.forces(posed)
        # First, as the others take from it what they can
        moments, course = emission.over(posed, emitted, t0, self.model.substeps)
        mean = emission.mean_drives(posed, emitted, t0)
        steps = self._steps(posed, moments, course, skins or {})
        self.update(posed, mean, course, emission.now(posed, emitted, t0), steps)
        return self.forces(posed)

    def _steps(
        self, posed: PosedScene, moments: Moments, course: EmittedCourse, skins: Mapping[int, SkinStart]
    ) -> dict[int, _SkinStep]:
        """Those skins that the device steps, under a course."""
        steps = {}
        for number, start in skins.items():
            model = self._model(number, start.stepper)
            if model is not None:
                weights = model.weights(*course.weights(moments))
                steps[number] = _SkinStep(posed.serial, course.serial, start.stepper, start.numbers.copy(), weights)
        return steps

    def _over_path(
        self,
        emission: Emission,
        posed: PosedScene,
        emitted: Complex,
        t0: float,
        path: PathStep,
        skins: Mapping[int, SkinStart],
    ) -> bool:
        """`over` for a focus that moves; False where the transducers can't make it, which is said elsewhere."""
        drive = emission.placed(posed, t0)[0].drive
        if self._drives is None:
            response = self.model.stimuli[0].response
            self._drives = PathDrives(drive, self._transducers, response.stepper if response.on else None)
            self._driven = posed.arrays
        elif self._driven is not posed.arrays:
            self._drives.move(drive)
            self._driven = posed.arrays
        moments = len(path.moments.times)
        nobody_knows = np.empty((moments, 0), np.complex128)
        course = of_drives(nobody_knows, np.empty(len(emitted), np.complex128))
        self._path = known = _PathKnown(posed, t0, emitted.copy(), path.moments, course)
        steps = self._steps(posed, path.moments, course, skins)
        count = len(path.moments.times)
        pushes = int(np.count_nonzero(path.weights)) if self._drives.rings else 1
        needs = {LOAD: (count, count), FORCE: (pushes, pushes), NOW: (1, 1), FOCI: (len(path.foci), 0)}
        work, moved = self._room(needs, posed, steps)
        self._skins, self._sounding, self._path = NO_SKINS, {}, None  # should the launch fail, nothing is known
        work.lead(path, emitted, self._drives)
        if moved:
            work.place(posed)
        for number, step in steps.items():
            work.begin(number, step.numbers, step.weights)
        work.run(moved, True, tuple(steps), True)
        self.launches += 1
        self._posed, self._fetched = posed, False
        totals = work.forces.hosts["path_totals"][:, : len(path.foci)]
        quiet = path.mean == 0.0 and path.now == 0.0
        if not foci_made(totals, path.levels[None], quiet, self._drives.aim[:1])[0]:
            return False
        np.copyto(course.end, work.forces.hosts["path_end"].view(np.complex128)[0, :, 0])
        self._force_scale = 1.0 if self._drives.rings else path.mean
        self._pushes, self._path, self._skins = self._force_scale > 0.0, known, steps
        return True

    def course(self, posed: PosedScene, begun: Complex, t0: float) -> tuple[Moments, EmittedCourse] | None:
        """What is emitted over the step that begins at t0 [s] with `begun`, where the device has computed it.

        The course has no drives then, but only what is emitted in the end.
        """
        known = self._path
        if known is None or known.posed is not posed or abs(known.t0 - t0) > CLOCK_S or not _same(known.begun, begun):
            return None
        return known.moments, known.course

    def update(
        self,
        posed: PosedScene,
        mean: MeanDrives,
        course: EmittedCourse,
        now: EmittedCourse,
        skins: Mapping[int, "_SkinStep"] = NO_SKINS,
    ) -> None:
        """Compute the sound of a step.

        mean: drives of the mean force over it; course: what is emitted over it; now: what the sensors read, a course of
        one moment; skins: which are stepped, by number, and how
        """
        force, self._force_scale = _of_mean(mean)
        self._pushes = force is not None
        drive, _ = present_drive(now)
        present = None if drive is None else Sounding(drive[None], None, now.serial)
        sounding = {LOAD: _of_course(course), FORCE: force, NOW: present}
        self._launch(posed, sounding, skins)

    def stepped(
        self, skin: int, stepper: SkinStepper, numbers: Float, keys: tuple[int, int], ends: tuple[Float, Float]
    ) -> SkinEnd | None:
        """A skin after a step that begins with numbers (state_size,); None where `over` has computed another.

        keys: serial numbers of scene and course; ends: weights of its patterns at the beginning and the end of each
        substep, shapes (s, p)
        """
        known, work = self._skins.get(skin), self.work
        if known is None or work is None or known.stepper is not stepper or (known.pose, known.load) != keys:
            return None
        model = self._models[skin, stepper]
        if model is None or not _same(model.weights(*ends), known.weights) or not _same(numbers, known.numbers):
            return None
        hosts = work.forces.hosts
        sums = np.add.reduce(hosts[f"squares_{skin}"][0], axis=(1, 2))
        return SkinEnd(hosts[f"after_{skin}"][0], model.outside(sums.tolist()))

    def _model(self, skin: int, stepper: SkinStepper) -> DeviceModel | None:
        """What steps a skin on the device, None where that is left to the CPU; kept."""
        if (skin, stepper) not in self._models:
            points = len(self.model.skins[skin].layer.quadrature.points)
            self._models[skin, stepper] = stepper.device_model(self.model.substeps, points, self.device)
        return self._models[skin, stepper]

    def forces(self, posed: PosedScene) -> list[tuple[Float, Float]]:
        """Mean forces [N] on each body's parts and torques about their origins [N m], array frame, shapes (b, 3)."""
        counts = [body.model.parts for body in posed.bodies]
        rows = np.zeros((sum(counts), 6))
        if self.work is not None and self._pushes:
            np.multiply(self.work.forces.hosts["forces"][0], self._force_scale, out=rows)
        forces, start = [], 0
        for count in counts:
            own = rows[start : start + count]
            forces.append((np.ascontiguousarray(own[:, :3]), np.ascontiguousarray(own[:, 3:])))
            start += count
        return forces

    def patterns(self, posed: PosedScene, skin: int, course: EmittedCourse, points: Int | None = None) -> Float32:
        """ARP [Pa] at a skin's quadrature points: of a course's unit drive, or at each of its moments, shape (m, q).

        points: numbers of those that are wanted, shape (p,), None for all
        It is computed again where the last step's was for another pose or course. A view that the next step overwrites.
        """
        known = self._path
        if known is not None and course.serial == known.course.serial and self._posed is posed:
            sums = len(known.moments.times)
        else:
            wanted = _of_course(course)
            assert wanted is not None
            sums = wanted.sums
            if self._posed is not posed or not _holds(self._sounding.get(LOAD), wanted):
                self._launch(posed, self._sounding | {LOAD: wanted})
        work = self.work
        assert work is not None
        if not self._fetched:
            work.load.download()
            if self.device != "cpu":
                wp.synchronize_stream(self.device)
            self._fetched = True
        result: Float32 = work.load.host[:sums, work.quadrature[skin]]
        return result if points is None else result[:, points]

    def sensed(self, skin: int, place: SensorPlace) -> float | None:
        """ARP [Pa] at a sensor's place where a step begins that `course` tells of; None where it isn't watched."""
        work = self.work
        if work is None or (skin, place) not in work.probes:
            return None
        return float(work.forces.hosts["probes"][0, work.probes.index((skin, place))])

    def probed(self, skin: int, place: SensorPlace, posed: PosedScene, serial: int) -> float | None:
        """ARP [Pa] at a sensor's place for a drive, by its serial number; None where the last step wasn't for that."""
        known, work = self._sounding.get(NOW), self.work
        if work is None or self._posed is not posed or known is None or (skin, place) not in work.probes:
            return None
        if known.serial != serial:
            return None
        return float(work.forces.hosts["probes"][0, work.probes.index((skin, place))])

    def _launch(
        self, posed: PosedScene, sounding: dict[str, Sounding | None], skins: Mapping[int, "_SkinStep"] = NO_SKINS
    ) -> None:
        """Compute all that has changed since the last launch, and the skins' steps."""
        needs = {name: (len(one.units), one.sums) for name, one in sounding.items() if one is not None}
        work, moved = self._room(needs, posed, skins)
        changed = [
            name
            for name, one in sounding.items()
            if one is not None and (moved or not _holds(self._sounding.get(name), one))
        ]
        self._skins, self._path = NO_SKINS, None
        if not changed and not skins:
            self._sounding = sounding
            return
        self._sounding = {}  # should the launch fail, nothing is known
        for name in changed:
            one = sounding[name]
            assert one is not None
            work.tell(name, one, self._transducers)
        for number, step in skins.items():
            work.begin(number, step.numbers, step.weights)
        if not changed:
            work.run(False, False, tuple(skins))
        else:
            if moved:
                work.place(posed)
            work.run(moved, True, tuple(skins))
            self._posed, self._fetched = posed, False
        self._sounding, self._skins = sounding, skins
        self.launches += 1

    def _room(
        self, needs: Mapping[str, tuple[int, int]], posed: PosedScene, skins: Mapping[int, _SkinStep]
    ) -> tuple["DeviceWork", bool]:
        """Work with room for so many drives and sums for each purpose, and whether poses are new to it."""
        work = self.work
        fitting = work is not None and len(work.probes) == len(self._probes) and work.drives is self._drives
        models = {}
        for number, step in skins.items():
            model = self._models[number, step.stepper]
            assert model is not None
            models[number] = model
            fitting = fitting and work is not None and work.models.get(number) is model
        for name, (drives, sums) in needs.items():
            largest = self._sizes[name]
            if drives > largest[0] or sums > largest[1]:
                self._sizes[name] = max(drives, largest[0]), max(sums, largest[1])
                fitting = False
        moved = not fitting or self._posed is not posed
        if moved and posed.arrays is not self._arrays:
            self._transducers.move(posed.arrays)
            self._arrays = posed.arrays
        if work is None or not fitting:
            work = self.work = None  # its memory is free for the next one
            self._stepping |= models
            known = self._transducers, self._probes, self._sizes, self._stepping, self._drives
            work = self.work = DeviceWork(self.model, self._reference, *known)
        return work, moved


class DeviceWork:
    """Memory and launches for tables of fixed sizes, for so many worlds with the same bodies.

    models: what steps skins on the device, by the skin's number; drives: what drives transducers there, if anything
    inputs: what goes in; forces: what comes out, sums by part and the sensors' ARP; load: ARP on the skins, (m, q)
    asked: for what of `calls` the last step has asked
    quadrature: which of the load's columns are a skin's; probes: sensors' places, each with its skin's number
    """

    def __init__(
        self,
        model: HapticModel,
        reference: PosedScene,
        transducers: Transducers,
        probes: Sequence[tuple[int, SensorPlace]],
        sizes: dict[str, tuple[int, int]],
        models: Mapping[int, DeviceModel] | None = None,
        drives: PathDrives | None = None,
        worlds: int = 1,
        more: tuple[Parts, Parts, tuple[str, ...]] | None = None,
    ):
        """worlds: how many

        more: further inputs and results, for worlds that are stepped together, and names: of what is usual, only what
            these, GOING and COMING name goes in and out then, and skins get pressure only where the steppers of
            `models` take it
        """
        chosen, (asked, told, shared) = more is not None, more or ({}, {}, ())
        self.models, self.drives = dict(models or {}), drives
        self.model, self.device, self.probes = model, transducers.device, tuple(probes)
        self._rows = _motion_rows(model)
        parts: dict[str, tuple[tuple[int, ...], Any]] = {
            "turns": ((worlds, self._rows.total), wp.mat33d),
            "shifts": ((worlds, self._rows.total), wp.vec3d),
            "origins": ((worlds, self._rows.parts), wp.vec3d),
            "weights": ((worlds, sizes[FORCE][1]), wp.float64),
        }
        for name in (LOAD, FORCE, NOW):
            for part, what in DriveTable.parts(*sizes[name], transducers.count, worlds).items():
                parts[f"{name}_{part}"] = what
        results: dict[str, tuple[tuple[int, ...], Any]] = {
            "forces": ((worlds, self._rows.parts, 6), wp.float64),
            "probes": ((worlds * sizes[NOW][1], max(len(probes), 1)), wp.float32),
        }
        for number, one in self.models.items():
            parts[f"before_{number}"] = results[f"after_{number}"] = (worlds, one.stepper.state_size), wp.float64
            parts[f"weights_{number}"] = (worlds, one.weight_rows, sizes[LOAD][1]), wp.float64
            of_squares = worlds, device_models.SECTIONS, one.substeps, skin_steps.LANES
            results[f"squares_{number}"] = of_squares, wp.float64
        if drives is not None:
            parts |= PathMemory.inputs(sizes[LOAD][0], sizes[FOCI][0], transducers.count, worlds)
            results |= PathMemory.results(sizes[FOCI][0], transducers.count, worlds)
        kept = {
            name: part for name, part in (parts | results).items() if chosen and name not in GOING + COMING + shared
        }
        steppers = {number: one.stepper for number, one in self.models.items()} if chosen else {}
        samples = sum(len(body.sample_parts) for body in reference.bodies)
        loaded = sum(len(_loaded(skin, steppers.get(number))[0]) for number, skin in enumerate(model.skins))
        # Points and normals; areas and loads of samples; what presses
        points_bytes = 24 * (samples + loaded + len(probes)) + 16 * samples
        points_bytes += 4 * (sizes[FORCE][1] * samples + sizes[LOAD][1] * loaded)
        tables = sum(map(nbytes, (*parts.values(), *results.values(), *asked.values(), *told.values())))
        check_room(worlds * points_bytes + tables, worlds, self.device)
        self.inputs = SharedBlock(
            {name: part for name, part in parts.items() if name not in kept} | dict(asked), self.device
        )
        self.forces = SharedBlock(
            {name: part for name, part in results.items() if name not in kept} | dict(told), self.device
        )
        arrays = self.arrays = self.inputs.arrays | self.forces.arrays
        for name, (shape, dtype) in kept.items():
            arrays[name] = wp.zeros(shape, dtype=dtype, device=self.device)
        motions = filled(carrying.Motions(), turns=arrays["turns"], shifts=arrays["shifts"])
        meshes = self._meshes(reference)
        points = _ScenePoints(model, reference, self._rows, probes, self.device, worlds, steppers)
        self._chosen = chosen
        self.quadrature = points.quadrature
        owners = _Owners(reference, self._rows, points.samples)
        counts = {LOAD: points.loaded.stop, NOW: len(probes), FORCE: points.count - points.sampled.start}
        self.load = SharedArray((worlds * sizes[LOAD][1], counts[LOAD]), wp.float32, self.device)
        pressed: Any = wp.zeros((worlds * sizes[FORCE][1], counts[FORCE]), dtype=wp.float32, device=self.device)
        arps = {LOAD: self.load.array, NOW: arrays["probes"], FORCE: pressed}
        places = {LOAD: points.loaded, NOW: points.probed, FORCE: points.sampled}
        surfaces: dict[str, list[Surface]] = {LOAD: [], NOW: [], FORCE: []}
        weighing: list[Callable[[], object]] = []

        def add(name: str, skin: int, own: slice, nodes: Callable[[], ShadowNodes]) -> None:
            """One more surface; how its shadows are weighed goes with the pose."""
            surface = self._surface(skin, own, meshes)
            if bends(model.skins[skin]):
                mesh = meshes[_mesh_number(model, skin)].outline
                edges = KnifeEdges(mesh, transducers.emitters, nodes(), own.stop - own.start, 1)
                begin = places[name].start + own.start
                stages = edges.stages(points.points[0], points.normals[0], begin + edges.nodes.numbers)
                weighing.extend(call for stage in stages for calls in stage for call in calls)
                surface = surface._replace(mesh=None, shades=edges.shades)
            surfaces[name].append(surface)

        for number, own in enumerate(points.quadrature):
            add(LOAD, number, own, partial(load_nodes, reference.skins[number]))
        for i, (number, place) in enumerate(probes):
            alone = partial(shadow_nodes, place.probe.closest, place.probe.normals, BODY_SPACING_m)
            add(NOW, number, slice(i, i + 1), alone)
        for body, own in points.samples:
            add(FORCE, model.carried(body)[0], own, partial(sample_nodes, reference.bodies[body]))
        self._sound: dict[str, list[Callable[[], object]]] = {}
        for name in (FORCE, LOAD, NOW):
            table = DriveTable(*(arrays[f"{name}_{part}"] for part in ("counts", "drives", "levels")))
            own = places[name]
            here = points.points[:, own], points.normals[:, own]
            self._sound[name] = [*sound_calls(transducers, table, *here, surfaces[name], model.arrays, arps[name])]
        sampled = points.points[:, points.sampled], points.normals[:, points.sampled]
        loads: Any = wp.zeros((worlds, counts[FORCE]), dtype=wp.float64, device=self.device)
        weighed = [
            arrays[f"{FORCE}_counts"],
            arrays["weights"],
            pressed,
            points.areas,
            *sampled,
            transducers.corners,
            loads,
        ]
        self._sound[FORCE] += [
            launch(summing.mean_load, loads.shape, weighed, self.device),
            *owners.calls(loads, *sampled, arrays["origins"], arrays["forces"], self.device),
        ]
        self._pose = points.calls(motions)
        for skin, mesh in meshes.items():
            self._pose += [*_mesh_calls(model, reference, skin, self._rows, mesh.mesh, motions, self.device)]
            if any(bends(one) for one in model.skins):
                self._pose += mesh.outline.calls()
        self._pose += weighing
        self._path = [] if drives is None else drives.calls(self._path_memory())
        self._skins = {number: one.calls(self._memory(number)) for number, one in self.models.items()}
        self.asked: tuple[bool, bool, tuple[int, ...], bool] = (True, True, (), False)
        self._led = False
        self._kept = meshes
        self._captured: dict[tuple[bool, bool, tuple[int, ...], bool], Callable[[], object]] = {}

    def _path_memory(self) -> PathMemory:
        """Where a moving focus's numbers are."""
        here = self.arrays
        own = (here[f"path_{name}"] for name in PATH)
        return PathMemory(*own, *(here[f"{name}_drives"] for name in (LOAD, FORCE, NOW)))

    def lead(self, path: PathStep, emitted: Complex, drives: PathDrives) -> None:
        """Take a step of a focus that moves. Raises PalmfieldError for one that is not finite."""
        hosts, count, moments = self.inputs.hosts, len(path.levels), len(path.moments.times)
        if not math.isfinite(np.add.reduce(path.foci, axis=None)):
            raise PalmfieldError(f"focus at {path.foci.tolist()} m is not finite: mend what moves it")
        hosts["path_counts"][0] = count + 1, count // moments
        hosts["path_group"][0] = 0 if path.group is None else path.group
        hosts["path_foci"][0, : count + 1] = path.foci
        hosts["path_aims"][0] = drives.aim
        wanted = hosts["path_wanted"][0]
        wanted[:count], wanted[count], wanted[count + 1] = path.levels, 1.0, path.now
        ring = drives.ring(path.moments)
        hosts["path_ring"].view(np.complex128)[: len(ring), :, 0] = ring
        hosts["path_begun"].view(np.complex128)[0, :, 0] = emitted
        counted = path.weights[path.weights > 0.0] if drives.rings else np.ones(1)
        pushes = len(counted)
        hosts["path_pushes"][:moments] = push_rows(path.weights)
        hosts["weights"][0, :pushes] = counted
        for name, sums in ((LOAD, moments), (FORCE, pushes), (NOW, 1)):
            if hosts[f"{name}_counts"][0, 0] != sums or hosts[f"{name}_counts"][0, 1] != sums or not self._led:
                hosts[f"{name}_counts"][0] = sums
                hosts[f"{name}_levels"].view(np.complex64)[:sums, :sums, 0] = np.eye(sums)
        self._led = True

    def _memory(self, skin: int) -> StepMemory:
        """Where a skin's step finds its numbers."""
        inputs = results = self.arrays
        pressure = self.load.array[:, self.quadrature[skin]]
        weights, before = inputs[f"weights_{skin}"], inputs[f"before_{skin}"]
        squares = results[f"squares_{skin}"]
        after = results[f"after_{skin}"]
        return StepMemory(inputs[f"{LOAD}_counts"], pressure, weights, before, after, squares, self._chosen)

    def begin(self, skin: int, numbers: Float, weights: Float) -> None:
        """Take a skin's numbers at a step's beginning, shape (state_size,), and the weights of patterns of pressure."""
        hosts = self.inputs.hosts
        hosts[f"before_{skin}"][0] = numbers
        # Of other patterns nothing: in silence the device still has the last ones, and as many
        hosts[f"weights_{skin}"][0] = 0.0
        hosts[f"weights_{skin}"][0, :, : weights.shape[1]] = weights

    def tell(self, name: str, sounding: Sounding, transducers: Transducers) -> None:
        """Take what sounds for one purpose. Raises PalmfieldError for drives that are not finite."""
        if not cmath.isfinite(np.add.reduce(sounding.units, axis=None)):
            bad = check.first_bad(sounding.units.T)
            values = sounding.units[:, bad].tolist()
            raise PalmfieldError(f"drive of transducer {bad} = {values} is not finite: mend what makes the drive")
        hosts, self._led = self.inputs.hosts, False
        table = hosts[f"{name}_counts"][0], hosts[f"{name}_drives"], hosts[f"{name}_levels"]
        fill_table(table, transducers.strengths(sounding.units), sounding.levels)
        if sounding.weights is not None:
            hosts["weights"][0, : sounding.sums] = sounding.weights

    def place(self, posed: PosedScene) -> None:
        """Take a pose. Raises PalmfieldError for one that is not finite."""
        turns, shifts, origins = (self.inputs.hosts[name][0] for name in ("turns", "shifts", "origins"))
        for body, own in zip(posed.bodies, self._rows.bodies, strict=True):
            place, turn = body.frame
            if body.model.hand is None:
                turns[own], shifts[own], origins[own] = turn, place, place
                continue
            of_bones = turn @ body.bone_rotations
            turns[own] = of_bones
            origins[own] = body.origins
            shifts[own] = body.origins
            shifts[own] -= np.matmul(of_bones, body.model.rest_origins[:, :, None])[:, :, 0]
        for skin, own in zip(posed.skins, self._rows.obstacles, strict=True):
            if own.stop > own.start:
                frame = skin.body.frame
                turns[own] = frame.rotation @ skin.obstacle_rotations
                shifts[own] = frame.points(skin.obstacle_positions)
        if not math.isfinite(np.add.reduce(shifts, axis=None) + np.add.reduce(turns, axis=None)):
            names = [body.model.name for body in posed.bodies] + [skin.skin.spec.name for skin in posed.skins]
            for name, own in zip(names, [*self._rows.bodies, *self._rows.obstacles], strict=True):
                if not (np.isfinite(shifts[own]).all() and np.isfinite(turns[own]).all()):
                    raise PalmfieldError(
                        f"pose of '{name}' at {shifts[own].tolist()} is not finite: mend what moves it"
                    )

    def calls(
        self, moved: bool, sounds: bool = True, skins: tuple[int, ...] = (), path: bool = False
    ) -> list[Callable[[], object]]:
        """What is done for a step, in order; what only poses decide is left out where nothing has moved.

        sounds: whether the sound is computed; skins: numbers of those that are stepped; path: whether the drives are
        those of `lead`, and not of `tell`
        """
        calls = [self.inputs.upload, *(self._path if path else []), *(self._pose if moved else [])]
        stepped = [call for number in skins for call in self._skins[number]]
        if sounds:
            calls.append(Branches(([*self._sound[LOAD], *stepped], self._sound[FORCE], self._sound[NOW])))
        else:
            calls += stepped
        return [*calls, self.forces.download]

    def replay(
        self, moved: bool, sounds: bool = True, skins: tuple[int, ...] = (), path: bool = False
    ) -> Callable[[], object]:
        """All of these calls in one: on a GPU a captured graph, made when it is first asked for."""
        key = moved, sounds, skins, path
        replay = self._captured.get(key)
        if replay is None:
            calls = self.calls(*key)
            # Refitting a mesh is not recorded on the CPU, and takes memory from the pool on a GPU
            refits = moved and len(self._kept) > 0
            captures = not refits or (self.device != "cpu" and wp.get_device(self.device).is_mempool_supported)
            replay = replayed(calls, self.device) if captures else partial(_do, calls)
            self._captured[key] = replay
        return replay

    def run(self, moved: bool, sounds: bool = True, skins: tuple[int, ...] = (), path: bool = False) -> None:
        """Compute a step and wait for forces and sensors."""
        self.asked = moved, sounds, skins, path
        replay = self.replay(*self.asked)
        with launching:
            replay()
        if self.device != "cpu":
            wp.synchronize_stream(self.device)

    def _surface(self, skin: int, own: slice, meshes: dict[int, Occlusion]) -> Surface:
        """A skin's surface as its sound is computed."""
        spec = self.model.skins[skin].spec
        if spec.config.body_sound != "shadows":
            return Surface(own, spec.arp_law, None)
        return Surface(own, spec.arp_law, meshes[_mesh_number(self.model, skin)].mesh)

    def _meshes(self, reference: PosedScene) -> dict[int, Occlusion]:
        """What casts shadows, by the number of a skin on which it does; skins without obstacles share one."""
        meshes = {}
        for number, skin in enumerate(self.model.skins):
            key = _mesh_number(self.model, number)
            if skin.spec.config.body_sound == "shadows" and key not in meshes:
                counts = occluding_counts(reference, number)
                faces = occluding_faces(reference, number)
                meshes[key] = Occlusion(occluding_vertices(reference, number), faces, self.device, counts)
        return meshes


class _MotionRows(NamedTuple):
    """Which motions are whose. bodies: by body, its bones or itself; obstacles: by skin; total: how many there are"""

    bodies: list[slice]
    obstacles: list[slice]
    total: int

    @property
    def parts(self) -> int:
        """How many of them push: those of the bodies come first."""
        last: int = self.bodies[-1].stop
        return last


def _motion_rows(model: HapticModel) -> _MotionRows:
    row = 0
    bodies, obstacles = [], []
    for body in model.bodies:
        bodies.append(slice(row, row + body.parts))
        row += body.parts
    for skin in model.skins:
        obstacles.append(slice(row, row + len(skin.spec.obstacles)))
        row += len(skin.spec.obstacles)
    return _MotionRows(bodies, obstacles, row)


class _Bound(NamedTuple):
    """Points at rest [m], shape (n, 3), and the motions that carry them with their shares, both of shape (n, 4)."""

    points: Float
    motions: Int
    shares: Float


def _bound(points: Float, binding: SkinBinding | None, first: int) -> _Bound:
    """Points that go with a body whose motions begin at row `first`: with its bones, or with the body itself."""
    if binding is not None:
        return _Bound(points, (binding.bones + first).astype(np.int32), binding.shares)
    motions = np.full((len(points), 4), first, np.int32)
    return _Bound(points, motions, np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1)))


def _bound_vertices(hand: SkinnedSurface | None, vertices: Float, first: int) -> _Bound:
    """The vertices of a surface, with its bones if it has any."""
    if hand is None:
        return _bound(vertices, None, first)
    shares, bones = strongest(sparse.csr_array(hand.weights))
    return _Bound(hand.surface.vertices, (bones + first).astype(np.int32), shares)


def _joined(parts: Sequence[_Bound]) -> _Bound:
    return _Bound(*(np.concatenate(values) for values in zip(*parts, strict=True)))


def _carriers(bound: _Bound, device: str) -> Any:
    """As kernels take them."""
    return filled(
        carrying.Carriers(),
        motions=wp.array(bound.motions, dtype=wp.vec4i, device=device),
        shares=wp.array(bound.shares, dtype=wp.vec4d, device=device),
    )


class _ScenePoints:
    """All points of a scene on a device: of the skins' load, the sensors, and the force on bodies, in this order.

    points, normals: vec3; areas: of the force samples [m2], float64
    quadrature: where each skin's points are; samples: of each body its number and where its force samples are among
        those of all; loaded, probed, sampled: all points of one kind; count: of all
    """

    def __init__(
        self,
        model: HapticModel,
        reference: PosedScene,
        rows: _MotionRows,
        probes: Sequence[tuple[int, SensorPlace]],
        device: str,
        worlds: int = 1,
        steppers: Mapping[int, SkinStepper] | None = None,
    ):
        """steppers: of the skins whose points are only those at which these take pressure"""
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
            vertices.append(_bound_vertices(body.sampled, body.sampled.surface.vertices, rows.bodies[number].start))
            faces.append(own_faces + corners)
            corners += len(vertices[-1].points)
            self.samples.append((number, slice(count - start, count - start + len(own_faces))))
            areas.append(np.zeros(len(own_faces)))
            count += len(own_faces)
        self.sampled, self.count = slice(start, count), count
        self.points: Any = wp.zeros((worlds, count), dtype=wp.vec3, device=device)
        self.normals: Any = wp.zeros((worlds, count), dtype=wp.vec3, device=device)
        self.areas: Any = wp.array(np.tile(np.concatenate(areas), (worlds, 1)), dtype=wp.float64, device=device)
        self._rest = _joined([part for part, _ in bound])
        self._directions = np.concatenate([normals for _, normals in bound])
        self._vertices: _Bound | None = _joined(vertices) if vertices else None
        self._faces: Int | None = np.concatenate(faces) if faces else None

    def calls(self, motions: Any) -> list[Callable[[], object]]:
        """Launches that bring all points where motions take them."""
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


def _loaded(skin: SkinModel, stepper: SkinStepper | None) -> tuple[Float, Float, SkinBinding | None]:
    """Where a skin takes pressure [m], normals there and what carries them: all its points, or those of a stepper."""
    quadrature = skin.layer.quadrature
    if stepper is None or stepper.points is None:
        return quadrature.points, quadrature.normals, skin.quadrature_binding
    points = quadrature.points[stepper.points]
    return points, quadrature.normals[stepper.points], skin.carrier.bind(points)


def _rest_samples(reference: PosedScene, number: int) -> tuple[Float, Float, Float]:
    """Points [m], normals and areas [m2] for the force on a body in one piece, in its frame."""
    body = reference.bodies[number]
    if body.model.surface is None:
        quadrature = body.skin.layer.quadrature
        return quadrature.points, quadrature.normals, quadrature.weights
    return body.model.rest_samples


class _Owners:
    """Force samples by the part of a body that they push."""

    def __init__(self, reference: PosedScene, rows: _MotionRows, samples: Sequence[tuple[int, slice]]):
        owners: Int = np.zeros(samples[-1][1].stop, np.int32)
        self._parts = rows.parts
        for number, own in samples:
            owners[own] = rows.bodies[number].start + reference.bodies[number].sample_parts
        self._order = np.argsort(owners, kind="stable").astype(np.int32)
        counts = np.bincount(owners, minlength=self._parts)
        starts: list[int] = []
        of_parts, at = [0], 0
        for count in counts.tolist():
            starts += range(at, at + count, RUN)
            of_parts.append(len(starts))
            at += count
        self._run_parts = np.repeat(np.arange(self._parts), np.diff(of_parts))
        self._starts, self._of_parts = np.array([*starts, at], np.int32), np.array(of_parts, np.int32)

    def calls(
        self, loads: Any, points: Any, normals: Any, origins: Any, result: Any, device: str
    ) -> list[Callable[[], object]]:
        """Launches that add loads up by part."""
        order, starts, parts, of_parts = (
            whole_numbers(values, device) for values in (self._order, self._starts, self._run_parts, self._of_parts)
        )
        runs = len(self._starts) - 1
        worlds = len(result)
        sums: Any = wp.zeros((worlds, runs, 6), dtype=wp.float64, device=device)
        lanes: Any = wp.zeros((worlds, summing.LANES, self._parts, 6), dtype=wp.float64, device=device)
        return [
            launch(
                summing.sums_of_runs,
                (worlds, runs),
                [loads, points, normals, order, starts, parts, origins, sums],
                device,
            ),
            launch(summing.sums_of_parts, lanes.shape, [sums, of_parts, lanes], device),
            launch(summing.sums_of_lanes, result.shape, [lanes, result], device),
        ]


def _mesh_number(model: HapticModel, skin: int) -> int:
    """The first skin on which the same things cast shadows."""
    if model.skins[skin].spec.obstacles:
        return skin
    return next(number for number, other in enumerate(model.skins) if not other.spec.obstacles)


def _mesh_calls(
    model: HapticModel, reference: PosedScene, skin: int, rows: _MotionRows, mesh: wp.Mesh, motions: Any, device: str
) -> list[Callable[[], object]]:
    """Launches that bring what casts shadows where motions take it."""
    parts = []
    for body, own in zip(reference.bodies, rows.bodies, strict=True):
        parts.append(_bound_vertices(body.model.hand, body.vertices, own.start))
    if model.skins[skin].obstacles:
        for number, shape in enumerate(model.skins[skin].obstacles_in_one[0]):
            parts.append(_bound(shape, None, rows.obstacles[skin].start + number))
    bound = _joined(parts)
    inputs = [vectors(bound.points, device), _carriers(bound, device), motions, mesh.points.reshape((1, -1))]
    return [launch(carrying.carry_vertices, (1, len(bound.points)), inputs, device), mesh.refit]


def _do(calls: Sequence[Callable[[], object]]) -> None:
    for call in calls:
        call()


def _same(one: Complex | Float | None, other: Complex | Float | None) -> bool:
    if one is None or other is None or one is other:
        return one is other
    return one.shape == other.shape and not np.logical_or.reduce(one != other, axis=None)


def _holds(known: Sounding | None, wanted: Sounding) -> bool:
    """Whether what sounded last gives what is wanted."""
    return known is not None and known.serial == wanted.serial


def _of_course(course: EmittedCourse) -> Sounding | None:
    """What presses on the skins over a step; None in silence."""
    if len(course.units) == 0:
        return None
    few = 1 < len(course.units) < len(course.levels)
    return Sounding(course.units, course.levels if few else None, course.serial)


def _of_mean(mean: MeanDrives) -> tuple[Sounding | None, float]:
    """What presses on bodies over a step, and a factor of it; None in silence."""
    if len(mean.weights) == 0:
        return None, 0.0
    if len(mean.weights) == 1:
        return Sounding(mean.units, None, mean.serial, np.ones(1)), float(mean.weights[0])
    return Sounding(mean.units, mean.levels, mean.serial, mean.weights), 1.0
