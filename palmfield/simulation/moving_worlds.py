"""Worlds whose bodies move, on a device: sound, forces and modes of all of them in one captured graph.

Poses and foci go in by one copy, and forces, sensors and what lies outside the modes' class come out by another. What
transducers emit and the skins' numbers stay on the device from step to step, and are fetched when somebody reads them.
Nothing here is done world by world but what is computed for many steps ahead. Any other world is stepped by
`palmfield.simulation.step`.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import warp as wp

from palmfield.acoustics.point_sound import Transducers
from palmfield.acoustics.surface_load import CLEARANCE_M
from palmfield.device import Branches, SharedArray, launch, launching, replayed, resolve, vectors, whole_numbers
from palmfield.drive.path_drives import PathDrives, aim_of, foci_made, push_rows
from palmfield.drive.transducer_response import SILENT
from palmfield.simulation.device_sound import FOCI, FORCE, LOAD, NOW, DeviceWork, serves
from palmfield.simulation.emission import LEAST_MEANS, array_drives, mean_weights
from palmfield.simulation.kept import Bool, Rows
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PoseLayout
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.small_models.leaving import leaves_class, loudest_load
from palmfield.simulation.state import HEADER, WHOLE, HapticState, check_arrays, claim, stepper_of
from palmfield.simulation.workspace import Workspace, scatter
from palmfield.skin.reduction.device_models import SECTIONS
from palmfield.skin.stepper import DeviceModel, Outside
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import TICK_S, edges_of, frames_at, mean_arp_factor, substep_moments
from palmfield.transforms import IDENTITY
from palmfield.types import Float
from warp_kernels import world_steps as kernels

NOTHING = 1e-300
AHEAD = 32
"""Steps for which foci and levels are computed in one go."""


class _Ahead(NamedTuple):
    """What stimuli do in coming steps, by kind. starts: times at which these begin [s], shape (s,)

    foci: at the moments and at the beginning, in the stimulus's frame [m], shape (kinds, s, m + 1, 3)
    levels: the pressure's there, shape (kinds, s, m + 1); means: of the ARP over each step, shape (kinds, s)
    """

    starts: list[float]
    foci: Float
    levels: Float
    means: Float


class MovingWorlds:
    """The steps of several worlds, with what they keep from one to the next. Belongs to one state.

    some: whether any world can ever take its step here; joined: numbers of those that take the present one, shape (g,)
    """

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState, alone: bool):
        """alone: whether nobody else writes the state, so that it stays on the device from step to step"""
        self.models, self.works, self.state, self._alone = models, works, state, alone
        self._layout = PoseLayout.of(models[0])
        able = [may_join(model, self._layout) for model in models]
        self.some = any(able)
        self.joined: Rows = np.zeros(0, dtype=np.intp)
        self._probes: list[tuple[int, SensorPlace]] = []
        self._columns: list[int] = []  # of each among those of its skin
        self._work: WorldsWork | None = None
        self._ahead: _Ahead | None = None
        self._numbers: list[Float] = []
        self._seen: dict[int, Outside] = {}  # what lies outside the modes' class in this step, by skin, shape (w,) each
        if not self.some:
            return
        self._rings = models[able.index(True)].response_on
        self._may: Bool = np.array(able) & [model.response_on == self._rings for model in models]
        self._here: Bool = np.zeros(len(models), dtype=bool)
        self._fetched = True
        stimuli = [model.stimuli[0] for model in models]
        kinds: dict[str, int] = {}
        self._kinds = np.array([kinds.setdefault(part.config.model_dump_json(), len(kinds)) for part in stimuli])
        self._leading = [int(np.argmax(self._kinds == kind)) for kind in range(len(kinds))]
        edges = [edges_of(part.config) or () for part in stimuli]
        self._edges: Float = np.full((len(models), max(map(len, edges))), -np.inf)
        for row, own in zip(self._edges, edges, strict=True):
            row[: len(own)] = own
        self._loudest: Float = np.zeros((len(models[0].skins), len(models)))
        self._sums: Float = np.zeros((len(models[0].skins), SECTIONS, len(models)))

    def watch(self, skin: int, place: SensorPlace) -> None:
        """Compute what a sensor reads there as well."""
        if (skin, place) not in self._probes:
            self.fetch()
            self._columns.append(sum(other == skin for other, _ in self._probes))
            self._probes.append((skin, place))
            self._work = None

    def forget(self) -> None:
        """What is in the state now has not come from here: after a reset, or in a copy."""
        if self.some:
            self._here[:] = False
            self._fetched = True

    def fetch(self) -> None:
        """Bring the state up to what the device has."""
        work = self._work
        if not self.some or self._fetched or work is None:
            return
        rows = self._here.nonzero()[0]
        begun = work.arrays["path_begun"].numpy().view(np.complex128)[..., 0]
        start = 0
        for part in self.state.emitted:
            part[rows] = begun[rows, start : start + part.shape[1]]
            start += part.shape[1]
        for number, model in work.models.items():
            size = model.stepper.state_size
            own = slice(HEADER, HEADER + size)
            self.state.skins[number][rows, own] = work.arrays[f"before_{number}"].numpy()[rows]
            for world in rows.tolist():
                outside = self.works[world].outside[number]
                outside.sums = Outside(*self._sums[number, :, world].tolist())
                outside.loudest = float(self._loudest[number, world])
        self._fetched = True

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def begin(self, places: Float, axes: Float, t0: float, watched: bool) -> None:
        """Take the frames of all worlds where a step begins at t0 [s], and compute it in those that can join.

        places [m], axes: of the layout's rows, shapes (worlds, rows, 3) and (worlds, rows, 9); watched: whether
        somebody looks at every substep, which is not done here
        """
        if not self.some:
            return
        joins = self._may & (not watched)
        end = t0 + self.models[0].spec.timestep_s + TICK_S
        joins &= ~np.logical_or.reduce((self._edges > t0 + TICK_S) & (self._edges <= end), axis=1)
        for part in self.state.skins:
            joins &= part[:, 0] != WHOLE
        if np.logical_or.reduce(joins):
            work = self._work or self._made()
            if work is None:  # what steps a skin is not what was chosen for it
                self.some, self.joined = False, self.joined[:0]
                return
            if self._alone:
                self._bring(work, joins)
            else:
                self._take(work)
            sounds = self._fill(work, places, axes, t0, joins)
            work.step()
            joins &= self._good(work, sounds)
        if np.logical_or.reduce(self._here & ~joins):
            self.fetch()
            self._here &= joins
        self.joined = joins.nonzero()[0]

    def _made(self) -> "WorldsWork | None":
        """Memory and graph for what is watched now; None where a skin has no stepper for it. Raises DeviceError where
        the device has no room."""
        first = self.models[0]
        steppers: dict[int, DeviceModel] = {}
        for number, skin in enumerate(first.skins):
            count, device = len(skin.layer.quadrature.points), resolve(first.spec.device)
            model = first.begin[number].value.device_model(first.substeps, count, device)
            if model is None:
                return None
            steppers[number] = model
        aims = [aim_of(array_drives(self.models[world], first.arrays)[0]) for world in self._leading]
        of_worlds = np.array(aims)[self._kinds]
        self._work = WorldsWork(
            self.models, self.works[0], self._layout, self._probes, steppers, of_worlds, self._alone
        )
        return self._work

    def _take(self, work: "WorldsWork") -> None:
        """Give the device the state as it is in this step. Raises SceneError for another's."""
        hosts = work.inputs.hosts
        emitted = np.concatenate(self.state.emitted, axis=1)
        hosts["path_begun"][:] = emitted.view(np.float64).reshape(hosts["path_begun"].shape)
        self._most = np.maximum.reduce(np.abs(emitted), axis=1)
        for number in work.models:
            hosts[f"before_{number}"][:] = stepper_of(self.models[0], self.state, number)[1]
        self._begin_class(work.models)

    def _begin_class(self, steppers: dict[int, DeviceModel]) -> None:
        """Against which load that of each world is little."""
        for number, model in steppers.items():
            known: dict[int, float] = {}
            for world, kind in enumerate(self._kinds.tolist()):
                work = self.works[world]
                outside = work.outside[number]
                if outside.loudest is None:
                    if kind not in known:
                        own = self.models[world], number, model.stepper, work.reference, work.radiation
                        known[kind] = loudest_load(*own)
                    outside.loudest = known[kind]
                self._loudest[number, world] = outside.loudest
                self._sums[number, :, world] = outside.sums

    def _bring(self, work: "WorldsWork", joins: Bool) -> None:
        """Give the device the state of worlds that join and are not there."""
        if not (joins & ~self._here).any():
            return
        self.fetch()
        for world in (joins & ~self._here).nonzero()[0].tolist():
            own = self.state.world(world)
            if check_arrays(self.models[world], own):
                self.works[world].begin_run()
            for number in work.models:
                stepper, _ = stepper_of(self.models[world], own, number)
                claim(self.models[world], own, number, stepper)
        self._begin_class(work.models)
        emitted = np.concatenate(self.state.emitted, axis=1)
        self._most = np.maximum.reduce(np.abs(emitted), axis=1)
        work.arrays["path_begun"].assign(emitted.view(np.float64).reshape(*emitted.shape, 2))
        for number, model in work.models.items():
            numbers = self.state.skins[number][:, HEADER : HEADER + model.stepper.state_size]
            work.arrays[f"before_{number}"].assign(np.ascontiguousarray(numbers))
        self._here = joins.copy()

    def _fill(self, work: "WorldsWork", places: Float, axes: Float, t0: float, joins: Bool) -> Bool:
        """Take frames, foci and levels of a step that begins at t0 [s]; in which of these worlds something sounds."""
        ahead, step = self._ahead, -1
        if ahead is not None and t0 in ahead.starts:
            step = ahead.starts.index(t0)
        else:
            ahead, step = self._look_ahead(t0), 0
            self._ahead = ahead
        hosts, kinds = work.inputs.hosts, self._kinds
        hosts["places"][:] = places
        hosts["axes"][:] = axes.reshape(hosts["axes"].shape)
        hosts["own_foci"][:] = ahead.foci[:, step][kinds]
        levels, means = ahead.levels[:, step], ahead.means[:, step]
        moments = levels.shape[1] - 1
        wanted = hosts["path_wanted"]
        wanted[:, :moments] = levels[kinds, :moments]
        wanted[:, moments], wanted[:, moments + 1] = 1.0, levels[kinds, moments]
        sounds = np.logical_or.reduce(levels > 0.0, axis=1)[kinds]
        if self._rings:
            sounds |= self._most >= SILENT
        else:
            hosts["weights"][:, 0] = means[kinds]
        sounds &= joins
        pushes = hosts["weights"].shape[1]
        for name, count in ((LOAD, moments), (FORCE, pushes), (NOW, 1)):
            hosts[f"{name}_counts"][:] = (count * sounds)[:, None]
        hosts["path_counts"][:, 0], hosts["path_counts"][:, 1] = (moments + 1) * sounds, sounds
        self._levels, self._means = levels, means
        return np.asarray(sounds)

    def _look_ahead(self, t0: float) -> _Ahead:
        """Foci and levels of AHEAD steps from t0 [s] on."""
        first = self.models[0]
        timestep_s = first.spec.timestep_s
        starts = [t0]
        while len(starts) < AHEAD:
            starts.append(starts[-1] + timestep_s)
        moments = [substep_moments((), start, first.step_s, first.substeps).times for start in starts]
        times = np.concatenate([np.append(own, start) for own, start in zip(moments, starts, strict=True)])
        shape = len(starts), len(moments[0]) + 1
        foci, levels, means = [], [], list[list[float]]()
        for world in self._leading:
            config = self.models[world].stimuli[0].config
            table = FocalPoints(IDENTITY, table=self.models[world].spec.stimuli[0].focus_table)
            points, factors = frames_at(config, times)
            foci.append(table.along(points).reshape(*shape, 3))
            levels.append(np.sqrt(factors).reshape(shape))
            if self._rings:
                means.append([1.0] * len(starts))
                continue
            count = max(LEAST_MEANS, first.substeps)
            means.append([mean_arp_factor(config, start, start + timestep_s, count) for start in starts])
        return _Ahead(starts, np.array(foci), np.array(levels), np.array(means))

    def _good(self, work: "WorldsWork", sounds: Bool) -> Bool:
        """In which worlds what came out holds: nothing near a board, foci that can be made, loads of the class."""
        hosts = work.forces.hosts
        good = np.logical_and.reduce(hosts["heights"] >= CLEARANCE_M, axis=1)
        levels = self._levels[self._kinds]
        quiet = (self._means[self._kinds] == 0.0) & (levels[:, -1] == 0.0)
        good &= foci_made(hosts["path_totals"], levels[:, :-1], quiet, work.aims[:, 0]) | ~sounds
        good &= np.isfinite(np.add.reduce(hosts["forces"], axis=(1, 2)))
        for number in work.models:
            seen = self._seen[number] = _outside(work, number)
            loudest = np.maximum(np.maximum(self._loudest[number], seen.energy_of_all), NOTHING)
            good &= ~np.asarray(leaves_class(self.models[0], number, np.sqrt(seen.energy / loudest)))
        return np.asarray(good)

    def mean_forces(self) -> list[Float]:
        """Forces [N] on the parts of each body and torques about their origins [N m], world axes, shape (g, 2, b, 3).

        In the worlds that have joined: the mean over the step that begins.
        """
        work, rows = self._work, self.joined
        if work is None or len(rows) == 0:
            return []
        turn = work.inputs.hosts["axes"][rows, 0].swapaxes(1, 2)
        result, start = [], 0
        for body in self.models[0].bodies:
            own = work.forces.hosts["forces"][rows, start : start + body.parts]
            # Forces and torques
            result.append(own.reshape(*own.shape[:2], 2, 3).swapaxes(1, 2) @ turn[:, None])
            start += body.parts
        return result

    def sensed(self, skin: int, place: SensorPlace) -> tuple[Float, Float]:
        """ARP [Pa], shape (g,), displacement [m] and velocity [m/s], (g, 2), at a sensor's place that is watched."""
        work, rows = self._work, self.joined
        assert work is not None
        number = self._probes.index((skin, place))
        column = self._columns[number]
        sounding = work.inputs.hosts["now_counts"][rows, 0] > 0
        arp = np.zeros(len(rows))
        arp[sounding] = work.forces.hosts["probes"][rows, number][sounding]
        return arp, work.forces.hosts[f"read_{skin}"][rows, :, column]

    # -- its end -------------------------------------------------------------------------------------------------------

    def advance(self, skins: bool = True) -> None:
        """Let what the worlds that have joined emit, and their skins, be as the step ends.

        skins: False leaves them as they are
        """
        work, rows = self._work, self.joined
        if work is None or len(rows) == 0:
            return
        if not self._alone:
            self._give(work, skins)
            return
        hosts = work.forces.hosts
        self._most = np.where(self._here, hosts["most"], 0.0)
        for number in work.models:
            seen = self._seen[number]
            self._sums[number][:, rows] += np.array(seen)[:, rows]
            most = np.maximum(self._loudest[number], np.asarray(seen.energy_of_all))
            self._loudest[number, rows] = most[rows]
        work.take_over(rows)
        self._fetched = False

    def numbers(self) -> list[Float]:
        """Of the skins' states, those that steps here begin with; none where no world has joined."""
        return self._numbers if len(self.joined) else []

    def _give(self, work: "WorldsWork", skins: bool) -> None:
        """Write the only world's state as the step ends."""
        model, hosts, keeper = self.models[0], work.forces.hosts, self.works[0]
        if check_arrays(model, self.state):
            keeper.begin_run()
            self._begin_class(work.models)
        if self._rings:
            scatter(self.state, hosts["path_end"].view(np.complex128)[0, :, 0])
        for number, of in work.models.items() if skins else ():
            keeper.outside[number].add(Outside(*np.concatenate(self._seen[number]).tolist()))
            self.state.skins[number][:, HEADER : HEADER + of.stepper.state_size] = hosts[f"after_{number}"]
            claim(model, self.state, number, of.stepper)


class WorldsWork(DeviceWork):
    """Memory and launches of all worlds. aims: of each world, see `palmfield.drive.path_drives.aim_of`"""

    def __init__(
        self,
        models: Sequence[HapticModel],
        work: Workspace,
        layout: PoseLayout,
        probes: Sequence[tuple[int, SensorPlace]],
        steppers: dict[int, DeviceModel],
        aims: Float,
        alone: bool,
    ):
        first, worlds = models[0], len(models)
        transducers = Transducers(first.arrays, resolve(first.spec.device))
        response = first.stimuli[0].response
        drive = array_drives(first, first.arrays)[0]
        drives = PathDrives(drive, transducers, response.stepper if first.response_on else None)
        moments = first.substeps + 1
        straight = substep_moments((), 0.0, first.step_s, first.substeps)
        weights = mean_weights(straight)
        counted = weights[weights > 0.0] if drives.rings else np.ones(1)
        pushes = len(counted)
        sizes = {LOAD: (moments, moments), FORCE: (pushes, pushes), NOW: (1, 1), FOCI: (moments + 1, 0)}
        frames, parts = layout.bodies[-1][1].stop, sum(body.parts for body in first.bodies)
        asked: dict[str, Any] = {
            "places": ((worlds, frames), wp.vec3d),
            "axes": ((worlds, frames), wp.mat33d),
            "own_foci": ((worlds, moments + 1), wp.vec3d),
        }
        told: dict[str, Any] = {"heights": ((worlds, parts), wp.float64), "most": ((worlds,), wp.float64)}
        for number in steppers:
            told[f"sums_{number}"] = (worlds, SECTIONS), wp.float64
            told[f"read_{number}"] = (worlds, 2, max(1, sum(skin == number for skin, _ in probes))), wp.float64
        states = [f"{name}_{number}" for number in steppers for name in ("before", "after")]
        shared = () if alone else ("path_begun", "path_end", *states)
        super().__init__(
            first, work.reference, transducers, probes, sizes, steppers, drives, worlds, (asked, told, shared)
        )
        self.aims, arrays, device = aims, self.arrays, self.device
        arrays["path_aims"].assign(aims)
        arrays["path_pushes"].assign(push_rows(weights))
        arrays["path_ring"].assign(drives.ring(straight).view(np.float64).reshape(-1, 5, 2))
        self.inputs.hosts["weights"][:] = counted
        for name in (LOAD, FORCE, NOW):
            own = np.zeros((*arrays[f"{name}_levels"].shape, 2), np.float32)
            sums = len(own) // worlds
            own[..., 0] = np.tile(np.eye(sums, own.shape[1]), (worlds, 1))
            arrays[f"{name}_levels"].assign(own)
        for number, model in steppers.items():
            patterns = model.weights(straight.first, straight.last)
            arrays[f"weights_{number}"].assign(np.tile(patterns, (worlds, 1, 1)))
        centres, halves, rest, rows = _parts(first, layout)
        places, axes = arrays["places"], arrays["axes"]
        moved = [arrays["turns"], arrays["shifts"], arrays["origins"]]
        placing = [places, axes, whole_numbers(rows, device), vectors(rest, device), *moved]
        focusing = [places, axes, layout.frames.start, arrays["own_foci"], arrays["path_foci"]]
        boards: Any = wp.array(_boards(first), dtype=wp.vec4d, device=device)
        boxes = [vectors(centres, device), vectors(halves, device), boards]
        stepped, reading, taking = [], [], []
        self._active = SharedArray((worlds, 1), wp.int32, device)
        for number, model in steppers.items():
            squares, sums = arrays[f"squares_{number}"], arrays[f"sums_{number}"]
            stepped += [*self._skins[number], launch(kernels.sums_of_squares, sums.shape, [squares, sums], device)]
            before, after = arrays[f"before_{number}"], arrays[f"after_{number}"]
            readers = [place.reader(model.stepper).matrix for skin, place in probes if skin == number]
            if readers:
                read = arrays[f"read_{number}"]
                matrix: Any = wp.array(np.hstack(readers), dtype=wp.float64, device=device)
                states = before.reshape((worlds, before.shape[1] // len(matrix), len(matrix)))
                reading.append(launch(kernels.read_modes, read.shape, [states, matrix, read], device))
            taking.append(launch(kernels.take_over, before.shape, [self._active.array, after, before], device))
        begun, end = (_numbers(arrays[f"path_{name}"]) for name in ("begun", "end"))
        taking.append(launch(kernels.take_over, begun.shape, [self._active.array, end, begun], device))
        self._calls: list[Callable[[], object]] = [
            self.inputs.upload,
            launch(kernels.place_parts, (worlds, parts), placing, device),
            launch(kernels.place_foci, (worlds, moments + 1), focusing, device),
            launch(kernels.heights, (worlds, parts), [moved[0], moved[2], *boxes, arrays["heights"]], device),
            *self._path,
            launch(kernels.largest, worlds, [arrays["path_end"], arrays["most"]], device),
            *self._pose,
            Branches(([*self._sound[LOAD], *stepped], self._sound[FORCE], [*self._sound[NOW], *reading])),
            self.forces.download,
        ]
        self._taking = [self._active.upload, *taking]
        self._replays: list[Callable[[], object]] = []

    def step(self) -> None:
        """Compute the step of which the inputs tell, and wait for what comes out; states stay as they are."""
        if not self._replays:
            self._replays += [replayed(self._calls, self.device), replayed(self._taking, self.device)]
        with launching:
            self._replays[0]()
        if self.device != "cpu":
            wp.synchronize_stream(self.device)

    def take_over(self, rows: Rows) -> None:
        """Let some worlds be as the last step has left them."""
        if self.device != "cpu":
            wp.synchronize_stream(self.device)
        self._active.host[:] = 0
        self._active.host[rows] = 1
        with launching:
            self._replays[1]()


def _outside(work: WorldsWork, skin: int) -> Outside:
    """What of a skin's load in the last step was outside the modes' class, shape (w,) each."""
    seen = work.models[skin].outside([*work.forces.hosts[f"sums_{skin}"].T])
    assert seen is not None
    return seen


def may_join(model: HapticModel, layout: PoseLayout) -> bool:
    """Whether a world's sound and skins can be computed here: one focus of transducers that keep still and are alike,
    which moves and sounds without jumps, on surfaces without shadows whose skins move by modes."""
    if len(model.stimuli) != 1 or not serves(model) or layout.movable or model.substeps < 2:
        return False
    part, drive = model.stimuli[0], array_drives(model, model.arrays)[0]
    response, config = part.response, part.config
    alike = not response.on or (response.stepper.alike and not response.delayed)
    exact = drive.everything and drive.board.exact and drive.correction is None
    free = part.path is None and len(part.offsets) == 0 and edges_of(config) is not None
    solid = all(body.surface is not None for body in model.bodies) and not any(model.still_m)
    boards = all(board.nearest is None for board in model.arrays.boards)
    bare = all(skin.spec.config.body_sound == "none" and not skin.spec.obstacles for skin in model.skins)
    modal = all(skin.choice.name == "modal" for skin in model.skins)
    return alike and exact and free and solid and boards and bare and modal


def _parts(model: HapticModel, layout: PoseLayout) -> tuple[Float, Float, Float, list[int]]:
    """Of all parts that the sound pushes: middles and half sizes of their boxes, their origins in the resting body [m],
    shapes (p, 3), and rows of their frames."""
    low, high, rest = [], [], []
    rows: list[int] = []
    for body, (row, bones) in zip(model.bodies, layout.bodies, strict=True):
        low.append(body.boxes.min(axis=1))
        high.append(body.boxes.max(axis=1))
        rest.append(np.zeros((1, 3)) if body.hand is None else body.rest_origins)
        rows += [row] if body.hand is None else range(bones.start, bones.stop)
    least, most = np.concatenate(low), np.concatenate(high)
    return 0.5 * (least + most), 0.5 * (most - least), np.concatenate(rest), rows


def _boards(model: HapticModel) -> Float:
    """Normals of the arrays' boards and their heights along them [m], array frame, shape (boards, 4)."""
    result = []
    for board, (place, turn) in zip(model.arrays.boards, model.arrays.frames, strict=True):
        normal = turn[:, 2]
        result.append([*normal, normal @ place + board.height])
    return np.array(result)


def _numbers(pairs: Any) -> Any:
    """The same memory of pairs (w, n) as numbers, shape (w, 2 n)."""
    worlds, count = pairs.shape
    numbers: Any = wp.array(ptr=pairs.ptr, dtype=wp.float64, shape=(worlds, 2 * count), device=pairs.device)
    numbers.owner = pairs  # whose memory it is
    return numbers
