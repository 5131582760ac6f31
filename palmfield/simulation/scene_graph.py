"""Step of one world in a captured graph on a device, for scenes that `MovingWorlds` cannot compute.

These scenes have shadows, several stimuli or foci, flight times, predicted paths, or boards that round. The state is
copied to and from the device in each step. The host computes the drives; for one moving focus, kernels compute them.
Skins that the device cannot step are stepped on the host, under the load from the device.
"""

import cmath
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import warp as wp

from palmfield.acoustics import check
from palmfield.acoustics.point_sound import Transducers, fill_table
from palmfield.device import resolve
from palmfield.drive.path_drives import PathDrives, foci_made, push_rows
from palmfield.drive.transducer_response import EmittedCourse, of_drives, present_drive
from palmfield.errors import PalmfieldError
from palmfield.simulation.backend import Frames, StepTrace
from palmfield.simulation.cached import Bool, Cached, Rows, Serials
from palmfield.simulation.emission import MeanDrives, PathStep
from palmfield.simulation.graph_work import PURPOSES, GraphOf, GraphSizes, GraphWork
from palmfield.simulation.host_backend import ONE, HostBackend, Loaded
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PoseLayout
from palmfield.simulation.scene_points import MotionRows, motions_of
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.state import HEADER, HapticState, at_rest, stepper_of
from palmfield.simulation.workspace import Workspace
from palmfield.skin.stepper import DeviceModel, Outside, SkinStepper, SurfaceLoads
from palmfield.stimulus.schedule import Moments
from palmfield.types import Complex, Float, Float32, Int

NO_LOADS = SurfaceLoads(np.zeros(0), ONE, ONE)
"""Empty loads, for a skin that the graph has stepped."""


class Sounding(NamedTuple):
    """Sums of drives.

    units: drives, shape (k, N)
    levels: levels of each sum, shape (m, k); None if each drive is one sum
    serial: equal for equal sums
    weights: weights of the sums in a mean, shape (m,)
    """

    units: Complex
    levels: Complex | None
    serial: int
    weights: Float | None = None

    @property
    def sums(self) -> int:
        """Number of sums."""
        return len(self.units if self.levels is None else self.levels)


class SceneGraph(HostBackend):
    """Host backend of one world that computes sound and skins in a graph if possible.

    course: the emission over the present step and its moments, if the graph computes it; for a path, without its drives
    launches: number of launched graphs
    """

    in_graph = True
    moves_smoothly = False

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool):
        super().__init__(models, works, state, alone)
        self.course: tuple[Moments, EmittedCourse] | None = None
        model = self.model = models[0]
        self._work, self._reference = works[0], works[0].reference
        device = resolve(model.spec.device)
        self._transducers, self._made = Transducers(model.arrays, device), Cached()
        layout = PoseLayout(model)
        self._motions: MotionRows = motions_of(model, layout)
        # Arrays and stimuli do not move in the frame of the first array
        count = layout.obstacles[-1].stop
        self._frames = np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1))
        self._probes: tuple[tuple[int, SensorPlace], ...] = ()
        self._graphs: dict[bool, GraphWork] = {}  # key: whether kernels compute the drives
        self.launches = 0
        self._now: GraphWork | None = None
        self._computed = 0  # serial number of the pose that the last launch computed
        self._sounding: dict[str, int] = {}  # serial numbers of its sound
        self._fetched = False
        self._force_scale = 0.0
        self._present_factor = 0.0  # factor on the ARP at sensors
        self._stepped: dict[int, SkinStepper] = {}

    def watch(self, skin: int, place: SensorPlace) -> None:
        if (skin, place) not in self._probes:
            self._probes += ((skin, place),)
            self._graphs.clear()

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        self.course, self.stepped = None, []
        return super().place(frames, free, t0)

    def hold(self, posed: PosedScene, t0: float) -> None:
        self.course, self.stepped = None, []
        super().hold(posed, t0)

    def emit(self, t0: float) -> None:
        if not self._apart or not self._compute(self._posed[0], t0):
            super().emit(t0)

    def _compute(self, posed: PosedScene, t0: float) -> bool:
        """Compute the step that begins at t0 [s] in the graph. Returns False if the host must compute it."""
        emission = self._work.emission
        emitted = self._emitted[0] = self.state.emission()[0]
        self._made.of("transducers", posed.arrays.serial, self._transducers.move, posed.arrays)
        path = None if self.watched else emission.path_step(posed, t0, self.model.substeps)
        if path is not None:
            moments, course = path.moments, self._along(posed, path, emitted, t0)
            if course is None:
                return False
        else:
            # Computed first, because the others reuse its results
            moments, course = emission.over(posed, emitted, t0, self.model.substeps)
            mean, now = emission.mean_drives(posed, emitted, t0), emission.now(posed, emitted, t0)
            self._with_drives(posed, moments, course, mean, now)
        self.course = moments, course
        self.stepped = [(skin, one.state_size) for skin, one in self._stepped.items()]
        return True

    def _along(self, posed: PosedScene, path: PathStep, emitted: Complex, t0: float) -> EmittedCourse | None:
        """Compute a step of one moving focus.

        Returns None for an impossible focus, for which the host raises the error.
        """
        if not math.isfinite(np.add.reduce(path.foci, axis=None)):
            raise PalmfieldError(f"focus at {path.foci.tolist()} m is not finite: correct its motion")
        drives = self._path_drives(posed, t0)
        moments, count = len(path.moments.times), len(path.levels)
        counted = drives.pushed(path.weights)
        rows = moments, len(counted), 1
        course = of_drives(np.empty((moments, 0), np.complex128), np.empty(len(emitted), np.complex128))
        graph, models = self._room(GraphSizes(rows, rows, len(path.foci)), drives)
        self._copy_states(graph, models, path.moments, course)
        hosts = graph.inputs.hosts
        hosts["path_counts"][0] = count + 1, count // moments
        hosts["path_group"][0] = 0 if path.group is None else path.group
        hosts["own_foci"][0, : count + 1] = path.foci
        targets = hosts["path_targets"][0]
        targets[:count], targets[count], targets[count + 1] = path.levels, 1.0, path.now
        ring = drives.ring(path.moments)
        hosts["path_ring"].view(np.complex128)[: len(ring), :, 0] = ring
        hosts["path_begun"].view(np.complex128)[0, :, 0] = emitted
        hosts["path_pushes"][:moments] = push_rows(path.weights)
        hosts["weights"][0, : len(counted)] = counted
        for name, sums in zip(PURPOSES, rows, strict=True):
            hosts[f"{name}_counts"][0] = sums
        self._launch(graph, posed, dict.fromkeys(PURPOSES, 0), tuple(models))
        totals, quiet = graph.results.hosts["path_totals"][:, : count + 1], path.mean == 0.0 and path.now == 0.0
        if not foci_made(totals, path.levels[None], quiet, drives.aim[:1])[0]:
            return None
        np.copyto(course.end, graph.results.hosts["path_end"].view(np.complex128)[0, :, 0])
        self._force_scale, self._present_factor = 1.0 if drives.rings else path.mean, 1.0
        return course

    def _path_drives(self, posed: PosedScene, t0: float) -> PathDrives:
        """Return the object that computes drives from a focus, for the present pose of the arrays."""
        drive, response = self._work.emission.placed(posed, t0)[0].drive, self.model.stimuli[0].response
        inputs = drive, self._transducers, response.stepper if response.on else None
        return self._made.of("drives", posed.arrays.serial, PathDrives, *inputs, move=lambda one, *_: one.move(drive))

    def _with_drives(
        self, posed: PosedScene, moments: Moments, course: EmittedCourse, mean: MeanDrives, now: EmittedCourse
    ) -> None:
        """Compute a step with these drives."""
        force, self._force_scale = _of_mean(mean)
        drive, factor = present_drive(now)
        present = None if drive is None else Sounding(drive[None], None, now.serial)
        sounding = dict(zip(PURPOSES, (_of_course(course), force, present), strict=True))
        drives = [1 if one is None else len(one.units) for one in sounding.values()]
        sums = [1 if one is None else one.sums for one in sounding.values()]
        graph, models = self._room(GraphSizes((drives[0], drives[1], 1), (sums[0], sums[1], 1), 0), None)
        self._copy_states(graph, models, moments, course)
        serials, changed = dict[str, int](), graph is not self._now or posed.serial != self._computed
        for name, one in sounding.items():
            # Silence needs no new field; the stored field may be used again later
            serials[name] = self._sounding.get(name, 0) if one is None else one.serial
            if one is not None and (changed or self._sounding.get(name) != one.serial):
                self._copy_drives(graph, name, one)
        sounds = any(one is not None for one in sounding.values()) and (changed or serials != self._sounding)
        self._present_factor = 0.0 if present is None else factor
        if sounds or models:
            self._launch(graph, posed, serials, tuple(models), sounds)
        else:
            self._stepped = {}

    def _room(self, sizes: GraphSizes, drives: PathDrives | None) -> tuple[GraphWork, dict[int, DeviceModel]]:
        """Return a graph with at least these sizes, and the skins that it steps now."""
        models: dict[int, DeviceModel] = {}
        for number, operator in enumerate(self._work.observe):
            # A skin before its first step may have no stepper yet; reading forces must not make one
            if operator is None and (self.model.begin[number].made or not at_rest(self.state, number)):
                model = self._model(number, stepper_of(self.model, self.state, number)[0])
                if model is not None:
                    models[number] = model
        graph = self._graphs.get(drives is not None)
        same = graph is not None and all(graph.of.skins.get(number) is one for number, one in models.items())
        sizes = sizes if graph is None else sizes.joined(graph.sizes)
        if graph is None or not same or graph.sizes != sizes:
            skins = models if graph is None else {**graph.of.skins, **models}
            self._graphs.pop(drives is not None, None)  # frees its memory for the next graph
            self._now = graph = None
            of = GraphOf(1, self._probes, skins, drives, 1)
            graph = self._graphs[drives is not None] = GraphWork(
                self.model, self._reference, self._transducers, of, sizes
            )
        return graph, models

    def _model(self, skin: int, stepper: SkinStepper) -> DeviceModel | None:
        """Return the device model of the stepper of a skin, cached. None if the skin is stepped on the CPU."""
        points = len(self.model.skins[skin].layer.quadrature.points)
        inputs = self.model.substeps, points, self._transducers.device
        return self._made.of((skin, stepper), (), stepper.device_model, *inputs)

    def _copy_states(
        self, graph: GraphWork, models: Mapping[int, DeviceModel], moments: Moments, course: EmittedCourse
    ) -> None:
        """Copy the skin states at the beginning of the step, and the weight of each pressure pattern."""
        hosts = graph.inputs.hosts
        for number, model in models.items():
            weights = model.weights(*course.weights(moments))
            hosts[f"before_{number}"][:] = stepper_of(self.model, self.state, number)[1]
            # Other patterns get weight 0: in silence the device still holds the same number of old patterns
            hosts[f"weights_{number}"][0] = 0.0
            hosts[f"weights_{number}"][0, :, : weights.shape[1]] = weights

    def _copy_drives(self, graph: GraphWork, name: str, sounding: Sounding) -> None:
        """Copy the drives for one purpose. Raises PalmfieldError for drives that are not finite."""
        if not cmath.isfinite(np.add.reduce(sounding.units, axis=None)):
            bad = check.first_bad(sounding.units.T)
            values = sounding.units[:, bad].tolist()
            raise PalmfieldError(f"drive of transducer {bad} = {values} is not finite: correct the source of the drive")
        hosts = graph.inputs.hosts
        table = hosts[f"{name}_counts"][0], hosts[f"{name}_drives"], hosts[f"{name}_levels"]
        fill_table(table, self._transducers.strengths(sounding.units), sounding.levels)
        if sounding.weights is not None:
            hosts["weights"][0, : sounding.sums] = sounding.weights

    def _launch(
        self, graph: GraphWork, posed: PosedScene, serials: dict[str, int], skins: tuple[int, ...], sounds: bool = True
    ) -> None:
        """Compute a step."""
        moved = sounds and (graph is not self._now or posed.serial != self._computed)
        if moved:
            self._place(graph, posed)
        previous = (self._computed, self._sounding) if graph is self._now else (0, dict[str, int]())
        # If it fails, no result is valid
        self._now, self._computed, self._sounding, self._stepped = None, 0, {}, {}
        graph.launch(moved, sounds, skins)
        graph.wait()
        self.launches += 1
        self._now, (self._computed, self._sounding) = graph, ((posed.serial, serials) if sounds else previous)
        self._fetched &= not sounds
        self._stepped = {number: graph.of.skins[number].stepper for number in skins}

    def _place(self, graph: GraphWork, posed: PosedScene) -> None:
        """Copy a pose. Raises PalmfieldError for a pose that is not finite."""
        places, axes = graph.inputs.hosts["places"][0], graph.inputs.hosts["axes"][0]
        rows = self._motions
        places[:], axes[:] = self._frames
        for body, own in zip(posed.bodies, rows.bodies, strict=True):
            turn = body.frame.rotation
            at = slice(rows.frames[own.start], rows.frames[own.stop - 1] + 1)
            places[at] = body.origins
            axes[at] = turn if body.model.hand is None else turn @ body.bone_rotations
        for skin, own in zip(posed.skins, rows.obstacles, strict=True):
            if own.stop > own.start:
                at, frame = slice(rows.frames[own.start], rows.frames[own.stop - 1] + 1), skin.body.frame
                places[at] = frame.points(skin.obstacle_positions)
                axes[at] = frame.rotation @ skin.obstacle_rotations
        if not math.isfinite(np.add.reduce(places, axis=None) + np.add.reduce(axes, axis=None)):
            names = [body.model.name for body in posed.bodies] + [skin.skin.spec.name for skin in posed.skins]
            for name, own in zip(names, [*rows.bodies, *rows.obstacles], strict=True):
                here = rows.frames[own]
                if not (np.isfinite(places[here]).all() and np.isfinite(axes[here]).all()):
                    raise PalmfieldError(
                        f"pose of '{name}' at {places[here].tolist()} is not finite: correct its motion"
                    )

    # -- what came out -------------------------------------------------------------------------------------------------

    def push(self, forces: Sequence[Float]) -> None:
        if self.course is None:
            super().push(forces)
            return
        turn = self._posed[0].array_frame.rotation.T
        for own, force in zip(forces, self.of_bodies(), strict=True):
            own[0] = force @ turn

    def of_bodies(self) -> list[Float]:
        """Return the computed forces on each body, array frame, shape (2, b, 3)."""
        now, scale = self._now, self._force_scale
        if now is None or scale == 0.0:
            return [np.zeros((2, own.stop - own.start, 3)) for own in self._motions.bodies]
        parts = now.results.hosts["forces"][0] * scale
        return [parts[own].reshape(-1, 2, 3).swapaxes(0, 1) for own in self._motions.bodies]

    def _read_arp(self, skin: int, place: SensorPlace, arp: Float) -> None:
        if self.course is None:
            super()._read_arp(skin, place, arp)
        elif self._now is not None and self._present_factor != 0.0:
            arp[0] = self._present_factor * self._now.results.hosts["probes"][0, self._probes.index((skin, place))]

    def _course(self, world: int, begun: Complex, t0: float, count: int) -> tuple[Moments, EmittedCourse]:
        return self.course or super()._course(world, begun, t0, count)

    def _steps_here(self, skin: int, stepper: SkinStepper) -> GraphWork | None:
        """Return the graph that has computed the step of a skin by this stepper."""
        here = self.course is not None and self._stepped.get(skin) is stepper
        return self._now if here else None

    def _loads(self, group: StepTrace, skin: int) -> Loaded:
        [(stepper, own)] = self.steppers(skin, group.worlds)
        if self._steps_here(skin, stepper) is None:
            return super()._loads(group, skin)
        return [(stepper, own, NO_LOADS)]

    def _outside(
        self, skin: int, stepper: SkinStepper, worlds: Rows, keys: Serials, loads: SurfaceLoads
    ) -> list[Outside]:
        now = self._steps_here(skin, stepper)
        outside = None if now is None else now.of.skins[skin].outside(now.results.hosts[f"sums_{skin}"][0].tolist())
        return super()._outside(skin, stepper, worlds, keys, loads) if outside is None else [outside]

    def _step(
        self, skin: int, stepper: SkinStepper, worlds: Rows, loads: SurfaceLoads, times: tuple[float, float]
    ) -> Float | Float32 | None:
        now = self._steps_here(skin, stepper)
        if now is None:
            return super()._step(skin, stepper, worlds, loads, times)
        self._claim(skin, stepper, worlds)
        self.state.skins[skin][:, HEADER : HEADER + stepper.state_size] = now.results.hosts[f"after_{skin}"]
        return None

    def _patterns(self, world: int, skin: int, stepper: SkinStepper, course: EmittedCourse) -> Float32:
        if self.course is None or len(course.units) == 0:
            return super()._patterns(world, skin, stepper, course)
        return self.load(skin, stepper.points)

    def load(self, skin: int, points: Int | None = None) -> Float32:
        """Return the ARP [Pa] of the course at quadrature points of a skin, shape (m, q).

        points: numbers of the selected points
        The result is a view that the next step overwrites.
        """
        assert self._now is not None and self.course is not None
        load = self._now.load
        if not self._fetched:
            load.download()
            if self._now.device != "cpu":
                wp.synchronize_stream(self._now.device)
            self._fetched = True
        course = self.course[1]
        sums = len(course.levels) if len(course.units) > 1 else 1
        result: Float32 = load.host[:sums, self._now.quadrature[skin]]
        return result if points is None else result[:, points]


def _of_course(course: EmittedCourse) -> Sounding | None:
    """Return the drives for the ARP on the skins over a step. None in silence."""
    if len(course.units) == 0:
        return None
    few = 1 < len(course.units) < len(course.levels)
    return Sounding(course.units, course.levels if few else None, course.serial)


def _of_mean(mean: MeanDrives) -> tuple[Sounding | None, float]:
    """Return the drives for the mean ARP on bodies over a step, and a factor on it. None in silence."""
    if len(mean.weights) == 0:
        return None, 0.0
    if len(mean.weights) == 1:
        return Sounding(mean.units, None, mean.serial, np.ones(1)), float(mean.weights[0])
    return Sounding(mean.units, mean.levels, mean.serial, mean.weights), 1.0
