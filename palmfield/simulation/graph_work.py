"""Memory and kernel launches of a step on a device. One captured graph computes forces, sensors and skins from frames.

One copy sends the frames, the foci or drives, and the part of the state that the device does not keep. Another copy
returns forces, sensor readings, and the skin states at the end of the step. Two modules fill the inputs and read the
results: `palmfield.simulation.moving_worlds` (moving bodies) and `palmfield.simulation.scene_graph` (one world).
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from palmfield.acoustics.knife_edge import KnifeEdges, ShadowNodes, shadow_nodes
from palmfield.acoustics.point_sound import DriveTable, Surface, Transducers, sound_calls
from palmfield.config.base import naming_keys
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
    vectors,
    whole_numbers,
)
from palmfield.drive.path_drives import PathDrives, PathMemory
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene, PoseLayout
from palmfield.simulation.radiation import bends
from palmfield.simulation.scene_points import (
    ScenePoints,
    bring_mesh,
    force_calls,
    mesh_number,
    meshes_of,
    motions_of,
)
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.shadows import BODY_SPACING_m, load_nodes, sample_nodes
from palmfield.skin.reduction.device_models import SECTIONS
from palmfield.skin.stepper import DeviceModel, StepMemory
from palmfield.types import Float
from warp_kernels import carried_points as carrying
from warp_kernels import resultants as summing
from warp_kernels import skin_steps
from warp_kernels import world_steps as kernels

LOAD, FORCE, NOW = "load", "force", "now"
"""Purposes of drives: load of the skins over the step, mean force over the step, sensors at its beginning."""
Launches = list[Callable[[], object]]
PURPOSES = LOAD, FORCE, NOW
PATH = "counts", "group", "foci", "targets", "aims", "ring", "pushes", "begun", "end", "totals"
"""Parts of a PathMemory that hold the inputs and results of a step."""


class GraphSizes(NamedTuple):
    """Largest sizes for which memory is allocated.

    drives, sums: numbers for each of PURPOSES
    foci: number of foci of a path, including the first; 0 if drives are the input
    """

    drives: tuple[int, ...]
    sums: tuple[int, ...]
    foci: int

    def joined(self, other: "GraphSizes") -> "GraphSizes":
        """Return the larger of each pair of sizes."""
        drives, sums = map(max, self.drives, other.drives), map(max, self.sums, other.sums)
        return GraphSizes(tuple(drives), tuple(sums), max(self.foci, other.foci))


class GraphOf(NamedTuple):
    """Settings of a graph: content of the scene, and what is computed on the device.

    worlds: number of worlds, which have the same bodies
    probes: places of sensors, each with the number of its skin
    skins: steppers by skin number
    drives: makes the drives of a path; None if drives are the input
    room_for: total number of worlds for which the device must have memory, including other graphs
    free: whether frames come from MuJoCo and all worlds step in the same way. Pressure is then computed only at points
        of steppers, and constant data are not copied again
    resident: whether the state stays on the device
    """

    worlds: int
    probes: tuple[tuple[int, SensorPlace], ...]
    skins: Mapping[int, DeviceModel]
    drives: PathDrives | None
    room_for: int
    free: bool = False
    resident: bool = False


class GraphWork:
    """Memory and kernel launches for a number of worlds and the largest sizes.

    computes: whether a launch is in progress, so that inputs must not be written
    inputs: arrays that are copied to the device
    results: arrays that are copied back
    arrays: inputs, results, and the arrays that stay on the device, by name
    load: ARP on the skins, (w m, q); `quadrature` gives the columns of each skin
    """

    computes = False

    def __init__(
        self, model: HapticModel, reference: PosedScene, transducers: Transducers, of: GraphOf, sizes: GraphSizes
    ):
        """Allocate memory and prepare launches. Raises DeviceError if the device has too little memory."""
        self.of, self.sizes, self.model = of, sizes, model
        device = self.device = transducers.device
        layout = PoseLayout(model)
        self._motions = motions_of(model, layout)
        motions, worlds = self._motions.total, of.worlds
        frames = layout.obstacles[-1].stop
        parts, results = self._shapes(transducers.count, frames)
        inside = self._inside()
        steppers = {number: one.stepper for number, one in of.skins.items()} if of.free else {}
        points = ScenePoints(model, reference, self._motions, of.probes, device, worlds, steppers, of.free)
        tables = sum(map(nbytes, (parts | results).values()))
        with naming_keys("plugin 'palmfield.skin'"):
            needed = worlds * points.nbytes(sizes.sums[0], sizes.sums[1]) + tables
            check_room(needed * of.room_for // worlds, of.room_for, device)
        points.make()
        self.inputs = SharedBlock({name: part for name, part in parts.items() if name not in inside}, device)
        self.results = SharedBlock({name: part for name, part in results.items() if name not in inside}, device)
        arrays = self.arrays = self.inputs.arrays | self.results.arrays
        for name in inside:
            shape, dtype = (parts | results)[name]
            arrays[name] = wp.zeros(shape, dtype=dtype, device=device)
        self.quadrature = points.quadrature
        counts = points.loaded.stop, points.count - points.sampled.start, len(of.probes)
        self.load = SharedArray((worlds * sizes.sums[0], counts[0]), wp.float32, device)
        pressed: Any = wp.zeros((worlds * sizes.sums[1], counts[1]), dtype=wp.float32, device=device)
        self._pose: Launches = self._placing(layout, motions)
        self._sound = self._sounds(reference, transducers, points, (self.load.array, pressed, arrays["probes"]))
        self._sound[FORCE] += self._pushing(reference, points, pressed, transducers)
        self._focus: Launches = []
        if of.drives is not None:
            parts_of_path = (arrays[f"path_{name}"] for name in PATH)
            memory = PathMemory(*parts_of_path, *(arrays[f"{name}_drives"] for name in PURPOSES))
            here = [arrays["places"], arrays["axes"], layout.frames.start, arrays["own_foci"], arrays["path_foci"]]
            self._focus = [
                launch(kernels.place_foci, (worlds, sizes.foci), here, device),
                *of.drives.calls(memory),
                launch(kernels.largest, worlds, [arrays["path_end"], arrays["most"]], device),
            ]
            arrays["path_aims"].assign(np.tile(of.drives.aim, (worlds, 1)))
            for name, sums in zip(PURPOSES, sizes.sums, strict=True):
                levels = arrays[f"{name}_levels"]
                unit = np.zeros((sums, levels.shape[1], 2), np.float32)
                unit[..., 0] = np.eye(sums, levels.shape[1])
                levels.assign(np.tile(unit, (worlds, 1, 1)))
        self._skins: dict[int, Launches] = {}
        self._reading, self._taking = Launches(), Launches()
        self._active = SharedArray((worlds, 1), wp.int32, device)
        for number, one in of.skins.items():
            self._skins[number] = self._stepping(number, one)
        if of.resident:
            begun, end = (_numbers(arrays[f"path_{name}"]) for name in ("begun", "end"))
            self._taking.append(launch(kernels.take_over, begun.shape, [self._active.array, end, begun], device))
        self._replays: dict[tuple[bool, bool, tuple[int, ...]], Callable[[], object]] = {}
        self._takeover: Callable[[], object] | None = None
        self._done: Any = None if device == "cpu" else wp.Event(device)

    def _shapes(self, transducers: int, frames: int) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return shapes and types of all possible inputs and results."""
        of, sizes, worlds = self.of, self.sizes, self.of.worlds
        parts: dict[str, tuple[tuple[int, ...], Any]] = {
            "places": ((worlds, frames), wp.vec3d),
            "axes": ((worlds, frames), wp.mat33d),
            "turns": ((worlds, self._motions.total), wp.mat33d),
            "shifts": ((worlds, self._motions.total), wp.vec3d),
            "origins": ((worlds, self._motions.total), wp.vec3d),
            "weights": ((worlds, sizes.sums[1]), wp.float64),
        }
        results: dict[str, tuple[tuple[int, ...], Any]] = {
            "forces": ((worlds, self._motions.parts, 6), wp.float64),
            "probes": ((worlds * sizes.sums[2], max(len(of.probes), 1)), wp.float32),
            "heights": ((worlds, self._motions.parts), wp.float64),
        }
        for name, drives, sums in zip(PURPOSES, sizes.drives, sizes.sums, strict=True):
            for part, what in DriveTable.parts(drives, sums, transducers, worlds).items():
                parts[f"{name}_{part}"] = what
        for number, one in of.skins.items():
            probes = sum(skin == number for skin, _ in of.probes)
            parts[f"before_{number}"] = results[f"after_{number}"] = (worlds, one.stepper.state_size), wp.float64
            parts[f"weights_{number}"] = (worlds, one.weight_rows, sizes.sums[0]), wp.float64
            results[f"squares_{number}"] = (worlds, SECTIONS, one.substeps, skin_steps.LANES), wp.float64
            results[f"sums_{number}"] = (worlds, SECTIONS), wp.float64
            results[f"read_{number}"] = (worlds, 2, max(1, probes)), wp.float64
        if of.drives is not None:
            parts["own_foci"] = (worlds, sizes.foci), wp.vec3d
            parts |= PathMemory.inputs(sizes.drives[0], sizes.foci, transducers, worlds)
            results |= PathMemory.results(sizes.foci, transducers, worlds) | {"most": ((worlds,), wp.float64)}
        return parts, results

    def _inside(self) -> list[str]:
        """Return the names of the arrays that stay on the device."""
        of = self.of
        names = ["turns", "shifts", "origins", *(f"squares_{number}" for number in of.skins)]
        if of.drives is not None:
            names += [
                "path_foci",
                "path_aims",
                *(f"{name}_{part}" for name in PURPOSES for part in ("drives", "levels")),
            ]
        if of.free:
            names += ["path_group", "path_ring", "path_pushes", *(f"weights_{number}" for number in of.skins)]
        if of.resident:
            names += ["path_begun", "path_end"]
            names += [f"{name}_{number}" for number in of.skins for name in ("before", "after")]
        return names

    def _placing(self, layout: PoseLayout, motions: int) -> Launches:
        """Return launches that compute motions from frames."""
        arrays, device, worlds, of = self.arrays, self.device, self.of.worlds, self._motions
        moved = [arrays["turns"], arrays["shifts"], arrays["origins"]]
        inputs = [arrays["places"], arrays["axes"], whole_numbers(of.frames, device), vectors(of.rest, device)]
        calls: Launches = [launch(kernels.place_parts, (worlds, motions), [*inputs, *moved], device)]
        if self.of.free:
            centres, halves = _boxes(self.model)
            boards: Any = wp.array(_boards(self.model), dtype=wp.vec4d, device=device)
            inputs = [moved[0], moved[2], vectors(centres, device), vectors(halves, device), boards, arrays["heights"]]
            calls.append(launch(kernels.heights, (worlds, of.parts), inputs, device))
        return calls

    def _sounds(
        self, reference: PosedScene, transducers: Transducers, points: ScenePoints, arps: tuple[Any, Any, Any]
    ) -> dict[str, Launches]:
        """Return launches of the ARP of each purpose. Launches that place points and shadows belong to the pose."""
        model, arrays, device = self.model, self.arrays, self.device
        meshes = self._meshes = meshes_of(model, reference, device)
        surfaces: dict[str, list[Surface]] = {name: [] for name in PURPOSES}
        places = dict(zip(PURPOSES, (points.loaded, points.sampled, points.probed), strict=True))
        weighing: Launches = []

        def add(name: str, skin: int, own: slice, nodes: Callable[[], ShadowNodes]) -> None:
            """Add a surface. The weights of its shadows belong to the pose."""
            spec = model.skins[skin].spec
            mesh = meshes[mesh_number(model, skin)] if spec.config.body_sound == "shadows" else None
            surface = Surface(own, spec.arp_law, mesh.mesh if mesh is not None else None)
            if mesh is not None and bends(model.skins[skin]):
                edges = KnifeEdges(mesh.outline, transducers.emitters, nodes(), own.stop - own.start, 1)
                begin = places[name].start + own.start
                stages = edges.stages(points.points[0], points.normals[0], begin + edges.nodes.numbers)
                weighing.extend(call for stage in stages for calls in stage for call in calls)
                surface = surface._replace(mesh=None, shades=edges.shades)
            surfaces[name].append(surface)

        for number, own in enumerate(points.quadrature):
            add(LOAD, number, own, partial(load_nodes, reference.skins[number]))
        for i, (number, place) in enumerate(self.of.probes):
            alone = partial(shadow_nodes, place.probe.closest, place.probe.normals, BODY_SPACING_m)
            add(NOW, number, slice(i, i + 1), alone)
        for body, own in points.samples:
            add(FORCE, model.first_skins[body], own, partial(sample_nodes, reference.bodies[body]))
        sound: dict[str, Launches] = {}
        for name, arp in zip(PURPOSES, arps, strict=True):
            table = DriveTable(*(arrays[f"{name}_{part}"] for part in ("counts", "drives", "levels")))
            here = points.points[:, places[name]], points.normals[:, places[name]]
            sound[name] = [*sound_calls(transducers, table, *here, surfaces[name], model.arrays, arp)]
        motions = filled(carrying.Motions(), turns=arrays["turns"], shifts=arrays["shifts"])
        self._pose += points.calls(motions)
        for skin, mesh in meshes.items():
            self._pose += bring_mesh(model, reference, skin, self._motions, mesh.mesh, motions, device)
            if any(bends(one) for one in model.skins):
                self._pose += mesh.outline.calls()
        self._pose += weighing
        return sound

    def _pushing(self, reference: PosedScene, points: ScenePoints, pressed: Any, transducers: Transducers) -> Launches:
        """Return launches that compute forces from the ARP at the samples."""
        arrays, device = self.arrays, self.device
        sampled = points.points[:, points.sampled], points.normals[:, points.sampled]
        loads: Any = wp.zeros((self.of.worlds, pressed.shape[1]), dtype=wp.float64, device=device)
        weighed = [arrays[f"{FORCE}_counts"], arrays["weights"], pressed, points.areas, *sampled, transducers.corners]
        made = loads, *sampled, arrays["origins"], arrays["forces"], device
        return [
            launch(summing.mean_load, loads.shape, [*weighed, loads], device),
            *force_calls(reference, self._motions, points, *made),
        ]

    def _stepping(self, skin: int, model: DeviceModel) -> Launches:
        """Return launches of the step of a skin.

        Those that read its sensors and store its final state are not included.
        """
        arrays, device, worlds = self.arrays, self.device, self.of.worlds
        counts, pressure = arrays[f"{LOAD}_counts"], self.load.array[:, self.quadrature[skin]]
        names = "weights", "before", "after", "squares"
        weights, before, after, squares = (arrays[f"{name}_{skin}"] for name in names)
        memory = StepMemory(counts, pressure, weights, before, after, squares, self.of.free)
        readers = [place.reader(model.stepper).matrix for number, place in self.of.probes if number == skin]
        if readers and self.of.free:
            read = arrays[f"read_{skin}"]
            matrix: Any = wp.array(np.hstack(readers), dtype=wp.float64, device=device)
            states = before.reshape((worlds, before.shape[1] // len(matrix), len(matrix)))
            self._reading.append(launch(kernels.read_modes, read.shape, [states, matrix, read], device))
        if self.of.resident:
            self._taking.append(launch(kernels.take_over, before.shape, [self._active.array, after, before], device))
        sums = arrays[f"sums_{skin}"]
        return [*model.calls(memory), launch(kernels.sums_of_squares, sums.shape, [squares, sums], device)]

    def calls(self, moved: bool, sounds: bool, skins: tuple[int, ...]) -> Launches:
        """Return the launches of a step, in order.

        moved: whether poses are new; sounds: whether sound is computed; skins: numbers of the skins to step
        """
        stepped = [call for number in skins for call in self._skins[number]]
        placed = Branches((self._pose if moved else [], self._focus if sounds else []))
        calls: Launches = [self.inputs.upload, placed]
        if sounds:
            now = [*self._sound[NOW], *self._reading]
            calls.append(Branches(([*self._sound[LOAD], *stepped], self._sound[FORCE], now)))
        else:
            calls += stepped
        return [*calls, self.results.download]

    def replay(self, moved: bool, sounds: bool, skins: tuple[int, ...]) -> Callable[[], object]:
        """Return one function that makes all these calls. On a GPU it is a captured graph."""
        calls = self.calls(moved, sounds, skins)
        # Refitting a mesh is not recorded on the CPU, and takes memory from the pool on a GPU
        refits = moved and len(self._meshes) > 0
        captures = not refits or (self.device != "cpu" and wp.get_device(self.device).is_mempool_supported)
        made = self._replays[moved, sounds, skins] = replayed(calls, self.device) if captures else partial(_do, calls)
        return made

    def launch(self, moved: bool, sounds: bool, skins: tuple[int, ...]) -> None:
        """Start to compute a step; arguments as in `calls`."""
        replay = self._replays.get((moved, sounds, skins)) or self.replay(moved, sounds, skins)
        self.computes = True
        with launching:
            replay()
            if self._done is not None:
                wp.get_stream(self.device).record_event(self._done)

    def wait(self) -> None:
        """Wait for the results of the last launch."""
        if self._done is not None:
            wp.synchronize_event(self._done)
        self.computes = False

    def take_over(self, rows: Any) -> None:
        """Set the state of some worlds on the device to the result of the last step."""
        if self._takeover is None:
            self._takeover = replayed([self._active.upload, *self._taking], self.device)
        if self.device != "cpu":
            wp.synchronize_stream(self.device)
        self._active.host[:] = 0
        self._active.host[rows] = 1
        with launching:
            self._takeover()


def _boxes(model: HapticModel) -> tuple[Float, Float]:
    """Return centres and half sizes of the bounding boxes of all parts that the sound pushes [m], shapes (p, 3)."""
    low = np.concatenate([body.boxes.min(axis=1) for body in model.bodies])
    high = np.concatenate([body.boxes.max(axis=1) for body in model.bodies])
    return 0.5 * (low + high), 0.5 * (high - low)


def _boards(model: HapticModel) -> Float:
    """Return normals of the boards of the arrays, and their heights along them [m], array frame, shape (boards, 4)."""
    result = []
    for board, (place, turn) in zip(model.arrays.boards, model.arrays.frames, strict=True):
        normal = turn[:, 2]
        result.append([*normal, normal @ place + board.height])
    return np.array(result)


def _numbers(pairs: Any) -> Any:
    """Return the memory of pairs (w, n) as an array of numbers, shape (w, 2 n), without a copy."""
    worlds, count = pairs.shape
    numbers: Any = wp.array(ptr=pairs.ptr, dtype=wp.float64, shape=(worlds, 2 * count), device=pairs.device)
    numbers.owner = pairs  # keeps the memory alive
    return numbers


def _do(calls: Sequence[Callable[[], object]]) -> None:
    for call in calls:
        call()
