"""Worlds with moving bodies on a device. One captured graph computes sound, forces and modes of all of them.

One copy sends poses and foci. Another copy returns forces, sensor readings, and the part of the loads outside the class
of the modes. Emission and skin states stay on the device from step to step, and are copied back only when they are
read. World by world, only data for many steps ahead are computed. The host computes all other worlds.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from palmfield.acoustics.point_sound import Transducers
from palmfield.acoustics.surface_load import CLEARANCE_M
from palmfield.device import resolve
from palmfield.drive.path_drives import PathDrives, aim_of, foci_made, push_rows
from palmfield.drive.transducer_response import SILENT
from palmfield.simulation.backend import Backend, Frames
from palmfield.simulation.cached import Bool, Rows
from palmfield.simulation.emission import LEAST_MEANS, array_drives, mean_weights
from palmfield.simulation.graph_work import FORCE, LOAD, NOW, GraphOf, GraphSizes, GraphWork
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PoseLayout
from palmfield.simulation.sensors import SensorPlace
from palmfield.simulation.small_models.leaving import leaves_class, loudest_load
from palmfield.simulation.state import HEADER, WHOLE, HapticState, check_arrays, claim, stepper_of
from palmfield.simulation.workspace import Workspace
from palmfield.skin.reduction.device_models import SECTIONS
from palmfield.skin.stepper import DeviceModel, Outside
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.schedule import TICK_S, edges_of, frames_at, mean_arp_factor, substep_moments
from palmfield.transforms import IDENTITY
from palmfield.types import Float

NOTHING = 1e-300
AHEAD = 32
"""Number of steps for which foci and levels are computed together."""


class _Ahead(NamedTuple):
    """Motion and level of stimuli in coming steps, by kind of stimulus.

    starts: start times of the steps [s], shape (s,)
    foci: foci at the moments and at the beginning, in the frame of the stimulus [m], shape (kinds, s, m + 1, 3)
    levels: levels of the pressure at the same times, shape (kinds, s, m + 1)
    means: mean ARP of each step, shape (kinds, s)
    """

    starts: list[float]
    foci: Float
    levels: Float
    means: Float


class MovingWorlds(Backend):
    """Computes the steps of several worlds and keeps their data between steps. It belongs to one state.

    some: whether this backend can step any of the worlds
    """

    in_graph = True

    def __init__(
        self,
        models: Sequence[HapticModel],
        works: Sequence[Workspace],
        state: HapticState,
        alone: bool,
        first: int,
        room_for: int,
    ):
        """first: number of the first of these worlds
        room_for: number of worlds for which the device must have memory
        alone: whether no other code writes the state, which then stays on the device from step to step
        """
        super().__init__(models, works, state)
        self._alone, self._room_for = alone, room_for
        self.own = slice(first, first + len(models))
        able = np.array([may_join(model) for model in models])
        self.some = bool(able.any())
        self._rings = models[int(able.argmax())].response_on
        self._may: Bool = able & [model.response_on == self._rings for model in models]
        self._joins: Bool = np.zeros(len(models), dtype=bool)
        self._here: Bool = np.zeros(len(models), dtype=bool)
        self._fetched = True
        self._probes: list[tuple[int, SensorPlace]] = []
        self._columns: list[int] = []  # index of each sensor among those of its skin
        self._work: GraphWork | None = None
        self._ahead: _Ahead | None = None
        self._outside: dict[int, Outside] = {}  # load outside the class of modes in this step, by skin, shape (w,) each
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
        if (skin, place) not in self._probes:
            self.fetch()
            self._columns.append(sum(other == skin for other, _ in self._probes))
            self._probes.append((skin, place))
            self._work, self._here[:] = None, False

    def forget(self) -> None:
        self._here[:] = False
        self._fetched = True

    def leave_out(self, world: int) -> None:
        if self.own.start <= world < self.own.stop:
            self._may[world - self.own.start] = False

    def fetch(self) -> None:
        work = self._work
        if self._fetched or work is None:
            return
        rows = self._here.nonzero()[0]
        self.state.set_emission(rows, work.arrays["path_begun"].numpy().view(np.complex128)[rows, :, 0])
        for number, model in work.of.skins.items():
            size = model.stepper.state_size
            own = slice(HEADER, HEADER + size)
            self.state.skins[number][rows, own] = work.arrays[f"before_{number}"].numpy()[rows]
            for world in rows.tolist():
                outside = self.works[world].outside[number]
                outside.sums = Outside(*self._sums[number, :, world].tolist())
                outside.loudest = float(self._loudest[number, world])
        self._fetched = True

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def place(self, frames: Frames, free: Bool, t0: float) -> Rows:
        self.stepped = []
        joins = self._joins = self._may & free[self.own] & (not self.watched)
        end = t0 + self.models[0].spec.timestep_s + TICK_S
        joins &= ~np.logical_or.reduce((self._edges > t0 + TICK_S) & (self._edges <= end), axis=1)
        for part in self.state.skins:
            joins &= part[:, 0] != WHOLE
        work = (self._work or self._made()) if np.logical_or.reduce(joins) else None
        if work is None:
            joins[:] = False
            self._release(joins)
            return joins.nonzero()[0]
        if work.computes:
            work.wait()  # an error in another graph has cut off the last step
        if self._alone:
            self._bring(work, joins)
        else:
            self._read_states(work)
        hosts = work.inputs.hosts
        hosts["places"][:] = frames.places[self.own]
        hosts["axes"][:] = frames.axes[self.own].reshape(hosts["axes"].shape)
        return joins.nonzero()[0] + self.own.start

    def _release(self, joins: Bool) -> None:
        """Copy from the device the state of worlds that another backend steps now."""
        if np.logical_or.reduce(self._here & ~joins):
            self.fetch()
            self._here &= joins

    def _made(self) -> GraphWork | None:
        """Return memory and graph for the present sensors.

        If a skin has another stepper than the chosen one, the result is None from then on. Raises DeviceError if the
        device has too little memory.
        """
        first = self.models[0]
        steppers: dict[int, DeviceModel] = {}
        for number, skin in enumerate(first.skins):
            count, device = len(skin.layer.quadrature.points), resolve(first.spec.device)
            model = first.begin[number].value.device_model(first.substeps, count, device)
            if model is None:
                self._may[:] = False
                return None
            steppers[number] = model
        transducers = Transducers(first.arrays, resolve(first.spec.device))
        response = first.stimuli[0].response
        drive = array_drives(first, first.arrays)[0]
        drives = PathDrives(drive, transducers, response.stepper if first.response_on else None)
        straight = substep_moments((), 0.0, first.step_s, first.substeps)
        weights = mean_weights(straight)
        counted = drives.pushed(weights)
        rows = first.substeps + 1, len(counted), 1
        worlds, probes = len(self.models), tuple(self._probes)
        of = GraphOf(worlds, probes, steppers, drives, self._room_for, True, self._alone)
        sizes = GraphSizes(rows, rows, first.substeps + 2)
        work = self._work = GraphWork(first, self.works[0].reference, transducers, of, sizes)
        aims = [aim_of(array_drives(self.models[world], first.arrays)[0]) for world in self._leading]
        self._aims = np.array(aims)[self._kinds]
        work.arrays["path_aims"].assign(self._aims)
        work.arrays["path_pushes"].assign(push_rows(weights))
        work.arrays["path_ring"].assign(drives.ring(straight).view(np.float64).reshape(-1, 5, 2))
        for number, model in steppers.items():
            patterns = model.weights(straight.first, straight.last)
            work.arrays[f"weights_{number}"].assign(np.tile(patterns, (worlds, 1, 1)))
        work.inputs.hosts["weights"][:] = counted
        self._all = tuple(steppers)
        self._sizes = [(number, model.stepper.state_size) for number, model in steppers.items()]
        return work

    def _read_states(self, work: GraphWork) -> None:
        """Copy the state of this step to the device. Raises SceneError for the state of another model."""
        hosts = work.inputs.hosts
        emitted = self.state.emission()
        hosts["path_begun"][:] = emitted.view(np.float64).reshape(hosts["path_begun"].shape)
        self._most = np.maximum.reduce(np.abs(emitted), axis=1)
        for number in work.of.skins:
            hosts[f"before_{number}"][:] = stepper_of(self.models[0], self.state, number)[1]
        self._begin_class(work.of.skins)

    def _begin_class(self, steppers: Mapping[int, DeviceModel]) -> None:
        """Set the reference load in each world, to which the load outside the class is compared."""
        for number, model in steppers.items():
            loudest: dict[int, float] = {}
            for world, kind in enumerate(self._kinds.tolist()):
                work = self.works[world]
                outside = work.outside[number]
                if outside.loudest is None:
                    if kind not in loudest:
                        own = self.models[world], number, model.stepper, work.reference, work.radiation
                        loudest[kind] = loudest_load(*own)
                    outside.loudest = loudest[kind]
                self._loudest[number, world] = outside.loudest
                self._sums[number, :, world] = outside.sums

    def _bring(self, work: GraphWork, joins: Bool) -> None:
        """Copy the state of worlds that join to the device, unless it is already there."""
        if not (joins & ~self._here).any():
            return
        self.fetch()
        for world in (joins & ~self._here).nonzero()[0].tolist():
            own = self.state.world(world)
            if check_arrays(self.models[world], own):
                self.works[world].begin_run()
            for number in work.of.skins:
                stepper, _ = stepper_of(self.models[world], own, number)
                claim(self.models[world], own, number, stepper)
        self._begin_class(work.of.skins)
        emitted = self.state.emission()
        self._most = np.maximum.reduce(np.abs(emitted), axis=1)
        work.arrays["path_begun"].assign(emitted.view(np.float64).reshape(*emitted.shape, 2))
        for number, model in work.of.skins.items():
            numbers = self.state.skins[number][:, HEADER : HEADER + model.stepper.state_size]
            work.arrays[f"before_{number}"].assign(np.ascontiguousarray(numbers))
        self._here = joins.copy()

    def emit(self, t0: float) -> None:
        work = self._work
        assert work is not None
        ahead, step = self._ahead, -1
        if ahead is not None and t0 in ahead.starts:
            step = ahead.starts.index(t0)
        else:
            ahead, step = self._look_ahead(t0), 0
            self._ahead = ahead
        hosts, kinds = work.inputs.hosts, self._kinds
        hosts["own_foci"][:] = ahead.foci[:, step][kinds]
        levels, means = ahead.levels[:, step], ahead.means[:, step]
        moments = levels.shape[1] - 1
        targets = hosts["path_targets"]
        targets[:, :moments] = levels[kinds, :moments]
        targets[:, moments], targets[:, moments + 1] = 1.0, levels[kinds, moments]
        sounds = np.logical_or.reduce(levels > 0.0, axis=1)[kinds]
        if self._rings:
            sounds |= self._most >= SILENT
        else:
            hosts["weights"][:, 0] = means[kinds]
        sounds &= self._joins
        pushes = hosts["weights"].shape[1]
        for name, count in ((LOAD, moments), (FORCE, pushes), (NOW, 1)):
            hosts[f"{name}_counts"][:] = (count * sounds)[:, None]
        hosts["path_counts"][:, 0], hosts["path_counts"][:, 1] = (moments + 1) * sounds, sounds
        self._levels, self._means, self._sounds = levels, means, sounds
        work.launch(True, True, self._all)

    def press(self) -> Rows:
        work = self._work
        assert work is not None
        work.wait()
        self._joins &= self._good(work)
        self._release(self._joins)
        joined = self._joins.nonzero()[0] + self.own.start
        self.stepped = self._sizes if len(joined) else []
        return joined

    def _look_ahead(self, t0: float) -> _Ahead:
        """Compute foci and levels of AHEAD steps from t0 [s] on."""
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

    def _good(self, work: GraphWork) -> Bool:
        """Return the worlds with valid results: no body near a board, possible foci, and loads in the class."""
        hosts = work.results.hosts
        good = np.logical_and.reduce(hosts["heights"] >= CLEARANCE_M, axis=1)
        levels = self._levels[self._kinds]
        quiet = (self._means[self._kinds] == 0.0) & (levels[:, -1] == 0.0)
        good &= foci_made(hosts["path_totals"], levels[:, :-1], quiet, self._aims[:, 0]) | ~self._sounds
        good &= np.isfinite(np.add.reduce(hosts["forces"], axis=(1, 2)))
        for number in work.of.skins:
            outside = work.of.skins[number].outside([*hosts[f"sums_{number}"].T])
            assert outside is not None
            self._outside[number] = outside
            loudest = np.maximum(np.maximum(self._loudest[number], outside.energy_of_all), NOTHING)
            good &= ~np.asarray(leaves_class(self.models[0], number, np.sqrt(outside.energy / loudest)))
        return np.asarray(good)

    def push(self, forces: Sequence[Float]) -> None:
        work, rows = self._work, self._joins.nonzero()[0]
        assert work is not None
        turn = work.inputs.hosts["axes"][rows, 0].swapaxes(1, 2)
        start = 0
        for own in forces:
            computed = work.results.hosts["forces"][rows, start : start + own.shape[2]]
            # Forces and torques
            own[self.joined] = computed.reshape(*computed.shape[:2], 2, 3).swapaxes(1, 2) @ turn[:, None]
            start += own.shape[2]

    def sense(self, skin: int, place: SensorPlace, arp: Float, motion: Float) -> None:
        work, rows = self._work, self._joins.nonzero()[0]
        assert work is not None
        number = self._probes.index((skin, place))
        sounding = work.inputs.hosts["now_counts"][rows, 0] > 0
        arp[self.joined[sounding]] = work.results.hosts["probes"][rows[sounding], number]
        motion[self.joined] = work.results.hosts[f"read_{skin}"][rows, :, self._columns[number]]

    # -- its end -------------------------------------------------------------------------------------------------------

    def step_skins(self, t0: float, t1: float, skins: bool) -> None:
        work, rows = self._work, self._joins.nonzero()[0]
        assert work is not None
        if not self._alone:
            self._give(work, skins)
            return
        hosts = work.results.hosts
        self._most = np.where(self._here, hosts["most"], 0.0)
        for number in work.of.skins:
            outside = self._outside[number]
            self._sums[number][:, rows] += np.array(outside)[:, rows]
            most = np.maximum(self._loudest[number], np.asarray(outside.energy_of_all))
            self._loudest[number, rows] = most[rows]
        work.take_over(rows)
        self._fetched = False

    def _give(self, work: GraphWork, skins: bool) -> None:
        """Write the state of the only world at the end of the step."""
        model, hosts, keeper = self.models[0], work.results.hosts, self.works[0]
        if check_arrays(model, self.state):
            keeper.begin_run()
            self._begin_class(work.of.skins)
        if self._rings:
            self.state.set_emission(slice(None), hosts["path_end"].view(np.complex128)[..., 0])
        for number, of in work.of.skins.items() if skins else ():
            keeper.outside[number].add(Outside(*np.concatenate(self._outside[number]).tolist()))
            claim(model, self.state, number, of.stepper)
            self.state.skins[number][:, HEADER : HEADER + of.stepper.state_size] = hosts[f"after_{number}"]


def may_join(model: HapticModel) -> bool:
    """Return whether sound and skins of a world can be computed here.

    This requires equal transducers that do not move, one focus that moves and changes level without jumps, surfaces
    without shadows, and skins with modes.
    """
    if len(model.stimuli) != 1 or PoseLayout(model).movable or model.substeps < 2:
        return False
    part, drive = model.stimuli[0], array_drives(model, model.arrays)[0]
    exact = drive.everything and drive.board.exact and drive.correction is None
    free = part.path is None and len(part.offsets) == 0 and edges_of(part.config) is not None
    solid = all(body.surface is not None for body in model.bodies) and not any(model.still_m)
    boards = all(board.nearest is None for board in model.arrays.boards)
    bare = model.free and not any(skin.spec.obstacles for skin in model.skins)
    modal = all(skin.choice.solver.of_class for skin in model.skins)
    return part.response.alike and exact and free and solid and boards and bare and modal
