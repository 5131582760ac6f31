"""Worlds in which one drive gets louder and softer, as a focus in one place makes it: their steps computed in one go.

What such a world emits is a number times its unit drive, so that pole, levels and means over the step are a few
operations on arrays with an entry for each world. Fields, forces and sensors of the unit drive are computed world by
world, and kept while pose and drive stay. Any other world is stepped by `palmfield.simulation.step`.
"""

from collections.abc import Callable, Mapping, Sequence
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.device import resolve
from palmfield.drive.transducer_response import SILENT, ring
from palmfield.errors import PalmfieldError, naming_world
from palmfield.simulation.emission import LEAST_MEANS
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.radiation import Role
from palmfield.simulation.small_models.leaving import continue_on_whole_layer, leaves_class, leaves_small_model
from palmfield.simulation.state import BEGUN, HEADER, WHOLE, HapticState, check_arrays, claim, stepper_of
from palmfield.simulation.step import Workspace
from palmfield.skin.stepper import DeviceStep, Outside, SkinStepper, SurfaceLoads
from palmfield.stimulus.levels import Levels, goes_smoothly
from palmfield.stimulus.schedule import Moments, first_point, substep_moments
from palmfield.types import Complex, Float, Float32, Int

Bool = NDArray[np.bool_]
Rows = NDArray[np.intp]
KEPT = 64
"""Ways in which worlds were shared out among steppers."""


class _Pressure(NamedTuple):
    """The ARP of a unit drive on a skin in a pose [Pa], shape (p,), at all quadrature points or at those of numbers
    `points`; outside: of it at the level 1 in one substep, the class of modes, where modes step the skin"""

    posed: PosedScene
    points: Int | None
    arp: Float32
    outside: Outside | None


class TogetherTrace(NamedTuple):
    """What happened in a step of the worlds that took it together, for those who watch.

    times: ends of the substeps [s], shape (s,); worlds: their numbers, shape (g,)
    factors: ARP relative to that of their unit drives at these times, shape (g, s)
    motion: of each skin by stepper, numbers of the worlds (w,) and what is watched there, displacement [m] and velocity
        [m/s] after each substep, (w, s, 2, m); the worlds watch the same
    """

    times: Float
    worlds: Rows
    factors: Float
    motion: tuple[tuple[tuple[Rows, Float | Float32], ...], ...]


class TogetherStep:
    """The steps of several worlds, with what they keep from one to the next. Belongs to one state.

    models, works: of each world; state: of all; observer: told of each step that worlds take together
    joined: numbers of the worlds that take the present step together, rising, shape (g,); apart: of all others
    """

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState):
        self.models, self.works, self.state = models, works, state
        self._may_join: Bool = np.array([_may_join(model) for model in models])
        self._some = bool(self._may_join.any())
        self._ringing: Bool = self._may_join & [model.response_on for model in models]
        self._levels = Levels([model.stimuli[0].config for model in models])
        worlds, first = len(models), models[0]
        self._posed: list[PosedScene | None] = [None] * worlds
        # Of the unit drives: amplitudes, sums of their squares, and the largest
        self._units: Complex = np.zeros((worlds, len(first.arrays)), np.complex128)
        self._powers, self._peaks = np.zeros(worlds), np.zeros(worlds)
        # How much of them is emitted, where nothing but this has changed what is emitted
        self._now: Complex = np.zeros(worlds, np.complex128)
        self._known: Bool = np.zeros(worlds, dtype=bool)
        # Forces of the unit drives on each body's parts and torques about their origins, world axes, (worlds, b, 3)
        shapes = [(worlds, body.parts, 3) for body in first.bodies]
        self._forces = [(np.zeros(shape), np.zeros(shape)) for shape in shapes]
        # Their pressures on each skin, by skin and world, and arrays of those that are stepped in one call
        self._pressures: list[list[_Pressure | None]] = [[None] * worlds for _ in first.skins]
        self._stacks: dict[int, tuple[list[Float32], Float32]] = {}
        # The pose in which a small model was last found to serve, by skin and world
        self._serves: list[list[PosedScene | None]] = [[None] * worlds for _ in first.skins]
        self._groups: dict[tuple[int, bytes, bytes], list[tuple[SkinStepper, Rows]]] = {}
        self._device = resolve(first.spec.device)
        self._on_devices: dict[tuple[int, SkinStepper], DeviceStep | None] = {}
        self.observer: Callable[[TogetherTrace], None] | None = None
        self.joined: Rows = np.zeros(0, dtype=np.intp)
        self.apart: list[int] = list(range(worlds))

    def forget(self) -> None:
        """Begin again: after a reset nothing is known of any pose."""
        worlds = len(self.models)
        self._posed, self._known = [None] * worlds, np.zeros(worlds, dtype=bool)
        self._serves = [[None] * worlds for _ in self._serves]

    def adopt(self, other: "TogetherStep") -> None:
        """Take over what is known of the poses, for a copy of the other's state in the same PosedScenes."""
        self._posed = list(other._posed)
        self._units, self._powers, self._peaks = other._units.copy(), other._powers.copy(), other._peaks.copy()
        self._now, self._known = other._now.copy(), other._known.copy()
        self._forces = [(force.copy(), torque.copy()) for force, torque in other._forces]
        self._pressures = [list(of_skin) for of_skin in other._pressures]
        self._serves = [list(of_skin) for of_skin in other._serves]

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def begin(self, posed: Mapping[int, PosedScene], t0: float) -> None:
        """Take the poses of some worlds where a step begins at t0 [s], and find out who of them takes it together."""
        if not self._some:
            self.apart = list(posed)
            return
        here = np.zeros(len(self.models), dtype=bool)
        here[list(posed)] = True
        joins = self._may_join & here
        for world, now in posed.items():
            if self._posed[world] is not now and joins[world]:
                try:
                    self._meet(world, now, t0)
                except PalmfieldError:
                    # It may be silent now; if not, its own step raises this again
                    self._posed[world], joins[world] = None, False
        joins &= self._levels_alike()
        joins &= ~self._levels.jump(t0, t0 + self.models[0].spec.timestep_s)
        self.joined, self.apart = joins.nonzero()[0], (here & ~joins).nonzero()[0].tolist()
        self._known = joins

    def _meet(self, world: int, posed: PosedScene, t0: float) -> None:
        """What the unit drive of one world does in a new pose."""
        work = self.works[world]
        part, drive, points = work.emission.placed(posed, t0)[0]
        unit = drive.unit_drive_at(points, first_point(part.config))
        turn = posed.array_frame.rotation.T
        for body, (forces, torques) in enumerate(self._forces):
            force, torque = work.unit_forces.under(posed, body, unit.amplitudes)
            forces[world], torques[world] = force @ turn, torque @ turn
        self._units[world], self._powers[world], self._peaks[world] = unit.amplitudes, unit.power, unit.peak
        self._posed[world], self._known[world] = posed, False

    def _levels_alike(self) -> Bool:
        """In which worlds a number times the unit drive is emitted, shape (worlds,); finds these numbers."""
        alike = np.ones(len(self.models), dtype=bool)
        asked = (self._may_join & self._ringing & ~self._known).nonzero()[0]
        if len(asked) == 0:
            return alike
        emitted = np.concatenate([part[asked] for part in self.state.emitted], axis=1)
        units, powers = self._units[asked], self._powers[asked]
        products = np.einsum("gn,gn->g", units.conj(), emitted)
        levels = np.divide(products, powers, out=np.zeros_like(products), where=powers > 0.0)
        self._now[asked] = levels
        rest = emitted - levels[:, None] * units
        alike[asked] = np.maximum.reduce(rest.real**2 + rest.imag**2, axis=1) < SILENT**2
        return alike

    def unit(self, world: int) -> Complex:
        """The unit drive of a world that has joined, shape (N,)."""
        unit: Complex = self._units[world]
        return unit

    def posed(self, world: int) -> PosedScene:
        """Where everything is in a world that has joined."""
        posed = self._posed[world]
        assert posed is not None
        return posed

    def present_factors(self, t0: float) -> Float:
        """ARP at t0 [s] relative to that of the unit drives, in the worlds that have joined, shape (g,)."""
        level = np.abs(self._now)
        emitted = level**2 * (level * self._peaks >= SILENT)
        commanded = self._levels.at(np.array([t0]))[:, 0]
        return np.where(self._ringing, emitted, commanded)[self.joined]

    def mean_forces(self, t0: float) -> list[tuple[Float, Float]]:
        """Forces [N] on the parts of each body and torques about their origins [N m], world axes, shapes (g, b, 3).

        In the worlds that have joined: the mean over the step that begins at t0 [s].
        """
        if len(self.joined) == 0:
            return []
        model = self.models[0]
        count = max(LEAST_MEANS, model.substeps)
        moments = substep_moments((), t0, model.spec.timestep_s / count, count, hold=True)
        factors, _ = self._over(moments)
        means = (np.add.reduce(factors @ moments.first.T, axis=1) / count)[self.joined, None, None]
        return [(means * force[self.joined], means * torque[self.joined]) for force, torque in self._forces]

    def _over(self, moments: Moments) -> tuple[Float, Complex]:
        """ARP relative to the unit drives at some moments, (worlds, m), and how much is emitted at the end."""
        commanded = self._levels.at(moments.times)
        ringing = self._ringing.nonzero()[0]
        if len(ringing) == 0:
            return commanded, self._now
        levels = np.sqrt(commanded)
        # The arrays, and so their transducers, are those of all worlds
        stepper = self.models[ringing[0]].stimuli[0].response.stepper
        rung, end = ring(self._now, levels.T.astype(np.complex128), moments, stepper)
        factors = rung.real**2 + rung.imag**2
        factors *= factors * self._peaks**2 >= SILENT**2
        silent = ~np.logical_or.reduce(levels, axis=1) & (np.abs(self._now) * self._peaks < SILENT)
        return np.where(self._ringing[:, None], factors.T, commanded), np.where(silent, 0.0, end)

    # -- its end -------------------------------------------------------------------------------------------------------

    def advance(self, t0: float, t1: float) -> None:
        """Carry transducers and skins of the worlds that have joined from t0 to t1 [s], in place.

        Raises SceneError as `palmfield.simulation.step.step`.
        """
        worlds = self.joined
        if len(worlds) == 0:
            return
        for world in worlds[self.state.arrays[0][worlds, 0] != BEGUN].tolist():
            if check_arrays(self.models[world], self.state.world(world)):
                self.works[world].begin_run()
        model = self.models[0]
        moments = substep_moments((), t0, model.step_s, model.substeps)
        factors, end = self._over(moments)
        first, last = factors @ moments.first.T, factors @ moments.last.T
        motion = []
        for skin in range(len(model.skins)):
            self._leave_small_models(skin, t0)
            self._leave_class(skin, first, last, t0)
            watched = []
            for stepper, own in self.groups(skin, worlds):
                pressure = self._stack(skin, stepper, own)
                loads = SurfaceLoads(pressure, first[own][..., None], last[own][..., None], fixed=True)
                seen = self._step(skin, stepper, own, loads, t0, t1)
                if seen is not None:
                    watched.append((own, seen))
            motion.append(tuple(watched))
        ringing = worlds[self._ringing[worlds]]
        self._now[ringing] = end[ringing]
        start = 0
        for part in self.state.emitted:
            part[ringing] = end[ringing, None] * self._units[ringing, start : start + part.shape[1]]
            start += part.shape[1]
        if self.observer is not None:
            times = t0 + model.step_s * np.arange(1, model.substeps + 1, dtype=np.float64)
            at_ends = factors[worlds][:, np.argmax(moments.last, axis=1)]
            self.observer(TogetherTrace(times, worlds, at_ends, tuple(motion)))

    def _leave_small_models(self, skin: int, t0: float) -> None:
        """Turn small models into whole layers where something has moved."""
        serves = self._serves[skin]
        for world in self.joined[self.state.skins[skin][self.joined, 0] != WHOLE].tolist():
            posed = self.posed(world)
            if serves[world] is posed:
                continue
            model, work, state = self.models[world], self.works[world], self.state.world(world)
            with naming_world(world):
                leaves = leaves_small_model(model, state, skin, posed, work.reference, work.emission, t0)
            if leaves:
                self._continue_whole(skin, world, t0)
                continue
            stepper = model.begin[skin].value
            # One that serves only from the beginning of the sound on must be asked again
            if stepper.any_course:
                serves[world] = posed

    def _leave_class(self, skin: int, first: Float, last: Float, t0: float) -> None:
        """Measure what of the loads lies outside the class of a skin's modes; the whole layer goes on where it is much.

        first, last: ARP relative to the unit drives at the ends of the substeps, shape (worlds, s)
        """
        for stepper, own in self.groups(skin, self.joined):
            if not stepper.of_class:
                continue
            ends = first[own][..., None], last[own][..., None]
            mixed = stepper.mixed(SurfaceLoads(np.zeros(0), *ends))
            squares = np.add.reduce(mixed**2, axis=(1, 2)).tolist()
            for world, square in zip(own.tolist(), squares, strict=True):
                model, work = self.models[world], self.works[world]
                unit = self._pressure(skin, stepper, world).outside
                assert unit is not None
                seen = Outside(*(square * part for part in unit))
                if leaves_class(model, skin, work.outside_share(model, skin, stepper, seen)):
                    self._continue_whole(skin, world, t0)

    def _continue_whole(self, skin: int, world: int, t0: float) -> None:
        """Let the whole layer go on with the motion of a skin in one world."""
        model, work, posed = self.models[world], self.works[world], self.posed(world)
        begun = self._now[world] * self._units[world]
        state = self.state.world(world)
        continue_on_whole_layer(model, state, skin, posed, work.emission, work.radiation, begun, t0)

    def groups(self, skin: int, worlds: Rows) -> list[tuple[SkinStepper, Rows]]:
        """Some worlds by what steps a skin in them."""
        whole = self.state.skins[skin][worlds, 0] == WHOLE
        key = skin, worlds.tobytes(), whole.tobytes()
        known = self._groups.get(key)
        if known is not None:
            return known
        steppers: dict[int, tuple[SkinStepper, list[int]]] = {}
        for world, left in zip(worlds.tolist(), whole.tolist(), strict=True):
            model = self.models[world]
            stepper: SkinStepper = (model.whole if left else model.begin)[skin].value
            steppers.setdefault(id(stepper), (stepper, []))[1].append(world)
        if len(self._groups) >= KEPT:
            self._groups.clear()
        found = self._groups[key] = [(one, np.array(own, dtype=np.intp)) for one, own in steppers.values()]
        return found

    def _step(
        self, skin: int, stepper: SkinStepper, worlds: Rows, loads: SurfaceLoads, t0: float, t1: float
    ) -> Float | Float32 | None:
        """Step a skin in some worlds by one stepper; what is watched of it in the first one, in all of them."""
        reader = self.works[worlds[0]].reader(skin, stepper)
        part = self.state.skins[skin]
        for world in worlds[part[worlds, 0] == 0.0].tolist():
            # Refuses a state that is not at rest though nobody has written it
            model, own = self.models[world], self.state.world(world)
            stepper_of(model, own, skin)
            claim(model, own, skin, stepper)
        numbers = slice(HEADER, HEADER + stepper.state_size)
        step = self._on_device(skin, stepper) or stepper.step
        if len(worlds) == len(part):
            return step(part[:, numbers], loads, t0, t1, reader)
        states = part[worlds, numbers]
        seen = step(states, loads, t0, t1, reader)
        part[worlds, numbers] = states
        return seen

    def _on_device(self, skin: int, stepper: SkinStepper) -> DeviceStep | None:
        """What steps a skin in place of its stepper, where the device is a GPU and has it; kept."""
        if (skin, stepper) not in self._on_devices:
            self._on_devices[skin, stepper] = stepper.device_worlds(len(self.models), self._device)
        return self._on_devices[skin, stepper]

    def _pressure(self, skin: int, stepper: SkinStepper, world: int) -> "_Pressure":
        """The pressure of a world's unit drive on a skin, at the points where a stepper takes it; the last is kept."""
        posed, known = self.posed(world), self._pressures[skin][world]
        if known is not None and known.posed is posed and known.points is stepper.points:
            return known
        radiation = self.works[world].radiation
        role: Role = "quadrature"
        if stepper.points is not None:
            radiation.choose(skin, stepper.points)
            role = "load"
        # A copy, as the drive that fields are kept for must not change
        arp = radiation.on(posed, skin, role, self._units[world].copy()).arp
        outside = None
        if stepper.of_class:
            one = np.ones((1, 1, 1))
            outside = stepper.outside(SurfaceLoads(arp[None, None], one, one))
        found = self._pressures[skin][world] = _Pressure(posed, stepper.points, arp, outside)
        return found

    def _stack(self, skin: int, stepper: SkinStepper, worlds: Rows) -> Float32:
        """Pressures of the unit drives on a skin in some worlds, shape (w, 1, p): the same array while all stay."""
        pressures = [self._pressure(skin, stepper, world).arp for world in worlds.tolist()]
        known = self._stacks.get(skin)
        if known is None or len(known[0]) != len(pressures) or not all(map(is_, known[0], pressures)):
            known = self._stacks[skin] = pressures, np.stack(pressures)[:, None]
        return known[1]


def _may_join(model: HapticModel) -> bool:
    """Whether what a world emits is as a rule a number times one drive."""
    if len(model.stimuli) != 1:
        return False
    stimulus = model.stimuli[0]
    response = stimulus.response
    alike = not response.on or (not response.delayed and response.stepper.alike)
    return goes_smoothly(stimulus.config) and alike
