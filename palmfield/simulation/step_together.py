"""Worlds in which one drive gets louder and softer, as a focus in one place makes it: their steps computed in one go.

What such a world emits is a number times its unit drive, so that pole, levels and means over the step are a few
operations on arrays with an entry for each world. Fields, forces and sensors of the unit drive are computed world by
world, and kept while pose and drive stay. Any other world is stepped by `palmfield.simulation.step`.
"""

from collections.abc import Sequence
from operator import is_
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palmfield.drive.array_drive import UnitDrive
from palmfield.drive.transducer_response import SILENT, ring
from palmfield.simulation.emission import LEAST_MEANS
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.state import BEGUN, HEADER, WHOLE, HapticState, check_arrays, claim, stepper_of
from palmfield.simulation.step import Workspace
from palmfield.simulation.whole_layer import continue_on_whole_layer, leaves_small_model
from palmfield.skin.reduction.reduced_stepper import ReducedStepper
from palmfield.skin.stepper import SkinStepper, SurfaceLoads
from palmfield.stimulus.levels import Levels, goes_smoothly
from palmfield.stimulus.schedule import Moments, first_point, substep_moments
from palmfield.types import Complex, Float, Float32

Bool = NDArray[np.bool_]
Rows = NDArray[np.intp]


class _Sound(NamedTuple):
    """What the unit drive of a world does in a pose.

    pressures: on each skin's quadrature points [Pa], (q,)
    forces: on the parts of each body [N], and torques about their origins [N m], world axes, shapes (b, 3)
    """

    unit: UnitDrive
    pressures: list[Float32]
    forces: list[tuple[Float, Float]]


class TogetherStep:
    """The steps of several worlds, with what they keep from one to the next. Belongs to one state.

    models, works: of each world; state: of all
    rows: numbers of the worlds that may be stepped together, shape (g,); all arrays by world here are in this order
    """

    def __init__(self, models: Sequence[HapticModel], works: Sequence[Workspace], state: HapticState):
        self.models, self.works, self.state = models, works, state
        rows = [number for number, model in enumerate(models) if _may_join(model)]
        self.rows: Rows = np.array(rows, dtype=np.intp)
        self._place = {world: g for g, world in enumerate(rows)}
        self._ringing: Bool = np.array([models[world].response_on for world in rows], dtype=bool)
        self._levels = Levels([models[world].stimuli[0].config for world in rows]) if rows else None
        transducers = len(models[0].arrays)
        self._units: Complex = np.zeros((len(rows), transducers), np.complex128)
        self._conjugates: Complex = self._units.copy()
        self._powers: Float = np.zeros(len(rows))
        self._peaks: Float = np.zeros(len(rows))
        self._posed: list[PosedScene | None] = [None] * len(rows)
        self._sounds: list[_Sound | None] = [None] * len(rows)
        # The pose in which a small model was last found to serve, by skin and world
        self._serves: list[list[PosedScene | None]] = [[None] * len(rows) for _ in models[0].skins]
        self._stacks: dict[tuple[int, bytes], tuple[list[Float32], Float32]] = {}
        self._emitted: Complex = np.zeros((len(rows), transducers), np.complex128)
        self._now: Complex = np.zeros(len(rows), np.complex128)
        self.joined: Bool = np.zeros(len(rows), dtype=bool)
        """Which of `rows` take the present step together."""

    def forget(self) -> None:
        """Begin again: after a reset nothing is known of any pose."""
        self._posed = [None] * len(self.rows)
        self._serves = [[None] * len(self.rows) for _ in self._serves]

    def adopt(self, other: "TogetherStep") -> None:
        """Take over what is known of the poses, for a copy of the other's state in the same PosedScenes."""
        self._posed, self._sounds = list(other._posed), list(other._sounds)
        self._serves = [list(of_skin) for of_skin in other._serves]
        self._units, self._conjugates = other._units.copy(), other._conjugates.copy()
        self._powers, self._peaks = other._powers.copy(), other._peaks.copy()

    def sound(self, world: int) -> _Sound:
        """What the unit drive of a world among `rows` does in its present pose."""
        sound = self._sounds[self._place[world]]
        assert sound is not None
        return sound

    # -- the beginning of a step ---------------------------------------------------------------------------------------

    def begin(self, posed: Sequence[PosedScene], t0: float) -> None:
        """Take the poses of all worlds where a step begins at t0 [s], and find out who takes it together."""
        if self._levels is None:
            return
        for g, world in enumerate(self.rows):
            if self._posed[g] is not posed[world]:
                self._meet(g, posed[world], t0)
        start = 0
        for part in self.state.emitted:
            self._emitted[:, start : start + part.shape[1]] = part[self.rows]
            start += part.shape[1]
        products = np.einsum("gn,gn->g", self._conjugates, self._emitted)
        self._now = np.divide(products, self._powers, out=np.zeros_like(products), where=self._powers > 0.0)
        rest = self._emitted - self._now[:, None] * self._units
        largest = np.maximum.reduce(rest.real**2 + rest.imag**2, axis=1)
        alike = ~self._ringing | (largest < SILENT**2)
        self.joined = alike & ~self._levels.jump(t0, t0 + self.models[0].spec.timestep_s)

    def _meet(self, g: int, posed: PosedScene, t0: float) -> None:
        """What the unit drive of one world does in a new pose."""
        world = self.rows[g]
        model, work = self.models[world], self.works[world]
        part, drive, points = work.emission.placed(posed, t0)[0]
        unit = drive.unit_drive_at(points, first_point(part.config))
        turn = posed.array_frame.rotation.T
        forces = []
        for body in range(len(model.bodies)):
            force, torque = work.forces.under(posed, body, unit.amplitudes)
            forces.append((force @ turn, torque @ turn))
        skins = range(len(model.skins))
        pressures = [work.radiation.on(posed, skin, "quadrature", unit.amplitudes).arp for skin in skins]
        self._sounds[g], self._posed[g] = _Sound(unit, pressures, forces), posed
        self._units[g], self._conjugates[g] = unit.amplitudes, unit.conjugate
        self._powers[g], self._peaks[g] = unit.power, unit.peak

    def present_factors(self, t0: float) -> Float:
        """ARP at t0 [s] relative to that of the unit drives, shape (g,)."""
        assert self._levels is not None
        sounding = np.abs(self._now) * self._peaks >= SILENT
        return np.where(self._ringing, np.abs(self._now) ** 2 * sounding, self._levels.at(np.array([t0]))[:, 0])

    def mean_factors(self, t0: float) -> Float:
        """The mean ARP over the step that begins at t0 [s], relative to that of the unit drives, shape (g,)."""
        model = self.models[0]
        count = max(LEAST_MEANS, model.substeps)
        moments = substep_moments((), t0, model.spec.timestep_s / count, count, hold=True)
        factors, _ = self._over(moments)
        return np.asarray(np.add.reduce(moments.first @ factors.T, axis=0) / count)

    def _over(self, moments: Moments) -> tuple[Float, Complex]:
        """ARP relative to the unit drives at some moments, (g, m), and the level that is emitted at their end, (g,)."""
        assert self._levels is not None
        commanded = self._levels.at(moments.times)
        if not np.logical_or.reduce(self._ringing):
            return commanded, self._now
        levels = np.sqrt(commanded)
        stepper = self.models[self.rows[int(self._ringing.argmax())]].stimuli[0].response.stepper
        rung, end = ring(self._now, levels.T.astype(np.complex128), moments, stepper)
        factors = rung.real**2 + rung.imag**2
        factors *= factors * self._peaks**2 >= SILENT**2
        silent = ~np.logical_or.reduce(levels, axis=1) & (np.abs(self._now) * self._peaks < SILENT)
        end = np.where(silent, 0.0, end)
        return np.where(self._ringing[:, None], factors.T, commanded), end

    # -- its end -------------------------------------------------------------------------------------------------------

    def advance(self, t0: float, t1: float) -> None:
        """Carry transducers and skins of the worlds that have joined from t0 to t1 [s], in place.

        Raises SceneError as `palmfield.simulation.step.step`.
        """
        rows = self.rows[self.joined]
        if len(rows) == 0:
            return
        for world in rows[self.state.arrays[0][rows, 0] != BEGUN]:
            check_arrays(self.models[world], self.state.world(world))
        model = self.models[0]
        moments = substep_moments((), t0, model.step_s, model.substeps)
        factors, end = self._over(moments)
        first, last = (factors @ weights.T for weights in (moments.first, moments.last))
        for skin in range(len(model.skins)):
            self._leave_small_models(skin, rows, t0)
            for stepper, own in self.groups(skin, rows):
                at = [self._place[world] for world in own]
                loads = SurfaceLoads(self._stack(skin, own), first[at][..., None], last[at][..., None], fixed=True)
                self._step(skin, stepper, own, loads, t0, t1)
        ringing = self.joined & self._ringing
        start = 0
        for part in self.state.emitted:
            units = self._units[:, start : start + part.shape[1]]
            part[self.rows[ringing]] = (end[:, None] * units)[ringing]
            start += part.shape[1]

    def _leave_small_models(self, skin: int, rows: Rows, t0: float) -> None:
        """Turn small models into whole layers where something has moved."""
        serves = self._serves[skin]
        for world in rows[self.state.skins[skin][rows, 0] != WHOLE]:
            g = self._place[world]
            posed = self._posed[g]
            assert posed is not None
            if serves[g] is posed:
                continue
            model, work, state = self.models[world], self.works[world], self.state.world(world)
            if leaves_small_model(model, state, skin, posed, work.reference, work.emission, t0):
                continue_on_whole_layer(model, state, skin, posed, work.emission, work.radiation, self._emitted[g], t0)
                continue
            stepper = model.begin[skin].value
            # One that serves only from the beginning of the sound on must be asked again
            if not isinstance(stepper, ReducedStepper) or stepper.any_course:
                serves[g] = posed

    def groups(self, skin: int, rows: Rows) -> list[tuple[SkinStepper, Rows]]:
        """Some worlds by what steps a skin in them."""
        steppers: dict[int, tuple[SkinStepper, list[int]]] = {}
        whole = self.state.skins[skin][rows, 0] == WHOLE
        for world, left in zip(rows.tolist(), whole.tolist(), strict=True):
            model = self.models[world]
            stepper: SkinStepper = (model.whole if left else model.begin)[skin].value
            steppers.setdefault(id(stepper), (stepper, []))[1].append(world)
        return [(stepper, np.array(own, dtype=np.intp)) for stepper, own in steppers.values()]

    def _step(self, skin: int, stepper: SkinStepper, rows: Rows, loads: SurfaceLoads, t0: float, t1: float) -> None:
        """Step a skin in some worlds by one stepper."""
        part = self.state.skins[skin]
        for world in rows[part[rows, 0] == 0.0]:
            # Refuses a state that is not at rest though nobody has written it
            model, own = self.models[world], self.state.world(world)
            stepper_of(model, own, skin)
            claim(model, own, skin, stepper)
        numbers = slice(HEADER, HEADER + stepper.state_size)
        if len(rows) == len(part):
            stepper.step(part[:, numbers], loads, t0, t1)
            return
        states = part[rows, numbers]
        stepper.step(states, loads, t0, t1)
        part[rows, numbers] = states

    def _stack(self, skin: int, rows: Rows) -> Float32:
        """Pressures of the unit drives on a skin in some worlds, shape (w, 1, q): the same array while all stay."""
        pressures = [self.sound(world).pressures[skin] for world in rows]
        known = self._stacks.get((skin, rows.tobytes()))
        if known is None or not all(map(is_, known[0], pressures)):
            known = pressures, np.stack(pressures)[:, None]
            if len(self._stacks) > 4 * len(self.models[0].skins):
                self._stacks.clear()
            self._stacks[skin, rows.tobytes()] = known
        return known[1]


def _may_join(model: HapticModel) -> bool:
    """Whether what a world emits is as a rule a number times one drive."""
    if len(model.stimuli) != 1:
        return False
    stimulus = model.stimuli[0]
    response = stimulus.response
    alike = not response.on or (not response.delayed and response.stepper.alike)
    return goes_smoothly(stimulus.config) and alike
