"""Emission of many worlds, each with one drive of variable level, for example a focus at a fixed point.

Such a world emits a number times its unit drive. Response, levels and means over a step are then a few operations on
arrays with one entry per world. For other worlds see `palmfield.simulation.emission`.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from palmfield.drive.array_drive import UnitDrive
from palmfield.drive.transducer_response import SILENT, EmittedCourse, of_unit, ring, silence
from palmfield.errors import PalmfieldError
from palmfield.simulation.cached import Bool, Rows, Serials
from palmfield.simulation.emission import LEAST_MEANS, Emission, array_drives
from palmfield.simulation.model import HapticModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.state import LEVEL, HapticState
from palmfield.stimulus.levels import Levels, goes_smoothly
from palmfield.stimulus.schedule import Moments, first_point, substep_moments
from palmfield.types import Complex, Float

AHEAD = 16
"""Number of steps for which the commanded drive is computed together."""
SHARED_FROM = 32
"""Number of worlds with different levels from which they share one field. Its float32 rounding changes the ARP by about
1e-6; the error of the field is 2e-5. With fewer worlds, the results are exactly those of a single world.
"""
ALIKE, LEAST = 1e-14, 1e-300
"""Rounding error of a drive relative to its largest amplitude, and the smallest power that counts as sound."""


class SmoothSound:
    """Levels of the unit drives of the worlds. It belongs to one state.

    joined: numbers of the worlds whose sound has one level in the present step, ascending, shape (g,)
    serials: serial numbers of the unit drives of all worlds; now: their present emitted levels, complex, (worlds,) each
    """

    def __init__(
        self,
        models: Sequence[HapticModel],
        emissions: Sequence[Emission],
        state: HapticState,
        able: Sequence[bool],
        alone: bool,
    ):
        """able: worlds that may ever join; alone: whether no other code writes the state, so that levels may be kept"""
        self.models, self.emissions, self.state, self._alone = models, emissions, state, alone
        self._may_join: Bool = np.array([can and _may_join(model) for can, model in zip(able, models, strict=True)])
        self._ringing: Bool = self._may_join & [model.response_on for model in models]
        self._levels = Levels([model.stimuli[0].config for model in models])
        worlds, first = len(models), models[0]
        count = max(LEAST_MEANS, first.substeps)
        self._timestep_s = first.spec.timestep_s
        # Moments for the mean in a step that begins at 0, and all moments with a command in it
        self._means = substep_moments((), 0.0, self._timestep_s / count, count, hold=True)
        loads = substep_moments((), 0.0, first.step_s, first.substeps)
        self._offsets: Float = np.concatenate([self._means.times, loads.times, np.zeros(1)])
        self._shares: Float = np.add.reduce(self._means.first, axis=0) / count
        self._commanded: Float = np.zeros((worlds, 0))
        self._ahead: dict[float, Float] = {}
        self._poses: Serials = np.zeros(worlds, np.int64)
        self._of: dict[int, UnitDrive] = {}
        self._first: dict[tuple[float, ...], UnitDrive] = {}  # by pose and point
        self._scales: Float = np.ones(worlds)  # drive of a world over its unit drive
        self._units: Complex = np.zeros((worlds, len(first.arrays)), np.complex128)
        self._powers, self._peaks = np.zeros(worlds), np.zeros(worlds)
        self.serials: Serials = np.zeros(worlds, np.int64)
        # Factor on the unit drive when this object last wrote the state, and now
        self._stored: Complex = state.arrays[0][:, LEVEL].view(np.complex128)[:, 0]
        self.now: Complex = np.zeros(worlds, np.complex128)
        self._level_known: Bool = np.zeros(worlds, dtype=bool)
        self._late: Bool = np.zeros(worlds, dtype=bool)  # worlds whose emission is not yet written into the state
        self.joined: Rows = np.zeros(0, dtype=np.intp)

    def forget(self) -> None:
        """Drop all emissions, after a reset."""
        self._level_known[:] = self._late[:] = False

    def leave_out(self, world: int) -> None:
        """Stop computing the sound of a world. Other code does it from now on."""
        self._may_join[world] = self._ringing[world] = False

    def adopt(self, other: "SmoothSound") -> None:
        """Continue from another SmoothSound, for a copy of its state in the same PosedScenes."""
        self._poses, self.serials, self._of = other._poses.copy(), other.serials.copy(), dict(other._of)
        self._units, self._powers, self._peaks = other._units.copy(), other._powers.copy(), other._peaks.copy()
        self._first, self._scales = dict(other._first), other._scales.copy()
        self.now, self._level_known = other.now.copy(), other._level_known.copy()

    def begin(self, posed: Mapping[int, PosedScene], t0: float) -> list[int]:
        """Find the worlds whose sound has one level in the step from t0 [s] on. Return the numbers of the others."""
        here = np.zeros(len(self.models), dtype=bool)
        here[list(posed)] = True
        joins = self._may_join & here
        if not np.logical_or.reduce(joins):
            self.joined = self.joined[:0]
            return list(posed)
        joins &= ~self._levels.jump(t0, t0 + self.models[0].spec.timestep_s)
        for world, now in posed.items():
            if joins[world] and self._poses[world] != now.serial:
                joins[world] = self._meet(world, now, t0)
        joins &= self._levels_alike(joins)
        if np.logical_or.reduce(self._late & ~joins):
            self.fetch()
        self._level_known = joins & self._alone
        self.joined = joins.nonzero()[0]
        self._command(t0)
        return (here & ~joins).nonzero()[0].tolist()

    def _meet(self, world: int, posed: PosedScene, t0: float) -> bool:
        """Set the unit drive of a world in a new pose. Return whether it has one."""
        if self._late[world]:
            self.fetch()
        part, drive, points = self.emissions[world].placed(posed, t0)[0]
        point = first_point(part.config)
        try:
            unit = drive.unit_drive_at(points, point)
        except PalmfieldError:
            return False  # the world may be silent now; if not, its own step raises this error again
        if len(self.models) >= SHARED_FROM:
            unit, self._scales[world] = self._shared(unit, (posed.serial, *point))
        self._of[world], self.serials[world], self._poses[world] = unit, unit.serial, posed.serial
        self._units[world], self._powers[world], self._peaks[world] = unit.amplitudes, unit.power, unit.peak
        self._level_known[world] = False
        return True

    def _shared(self, unit: UnitDrive, key: tuple[float, ...]) -> tuple[UnitDrive, float]:
        """Return a stored drive for this pose and point, with the factor to the drive of this world.

        If there is none, the drive itself is returned. So worlds whose drives differ only in level share one field.
        """
        if len(self._first) > len(self.models):
            self._first.clear()
        first = self._first.setdefault(key, unit)
        scale = float(abs(np.vdot(first.amplitudes, unit.amplitudes))) / max(first.power, LEAST)
        alike = np.abs(unit.amplitudes - scale * first.amplitudes).max() <= ALIKE * unit.peak
        return (first, scale) if alike else (unit, 1.0)

    def _levels_alike(self, joins: Bool) -> Bool:
        """Find the worlds whose emission is a number times the unit drive, shape (worlds,), and set these numbers."""
        alike = joins.copy()
        unknown = (joins & self._ringing & ~self._level_known).nonzero()[0]
        if len(unknown) == 0:
            return alike
        emitted = self.state.emission(unknown)
        units, levels = self._units[unknown], self._stored[unknown]
        new = ~_are(emitted, levels, units)
        if np.logical_or.reduce(new):
            products, powers = np.add.reduce(units.conj() * emitted, axis=1), self._powers[unknown]
            found = np.divide(products, powers, out=np.zeros(len(products), np.complex128), where=powers > 0.0)
            levels = np.where(new, found, levels)
            alike[unknown] = _are(emitted, levels, units)
        self.now[unknown] = levels
        return alike

    def unit(self, world: int) -> Complex:
        """Return the unit drive of a world that has joined, shape (N,)."""
        return self._of[world].amplitudes

    def present_factors(self) -> Float:
        """Return the ARP at the start of the step relative to that of the unit drives, in joined worlds, shape (g,)."""
        level = np.abs(self.now)
        emitted = level**2 * (level * self._peaks >= SILENT)
        if not np.logical_and.reduce(self._ringing):
            at_once = ~self._ringing
            emitted[at_once] = self._commanded[at_once, -1]
        return np.asarray(emitted[self.joined])

    def mean_factors(self) -> Float:
        """Return the mean ARP over the present step relative to that of the unit drives, shape (g,)."""
        moments = self._means
        factors = self._commanded[:, : len(moments.times)]
        if np.logical_or.reduce(self._ringing):
            levels, _ = self._over(moments, factors)
            factors = levels.real**2 + levels.imag**2
        return np.asarray(np.add.reduce(factors * self._shares, axis=1)[self.joined])

    def over(self, moments: Moments) -> tuple[Complex, Complex]:
        """Return levels of the unit drives of joined worlds at the moments of the step, (g, m), and its end, (g,)."""
        levels, end = self._over(moments, self._commanded[:, len(self._means.times) : -1])
        return levels[self.joined], end[self.joined]

    def _command(self, t0: float) -> None:
        """Compute the commanded levels over the step that begins at t0 [s], for AHEAD steps together."""
        if t0 not in self._ahead:
            starts = [t0]
            while len(starts) < AHEAD:
                starts.append(starts[-1] + self._timestep_s)
            times = (np.array(starts)[:, None] + self._offsets).ravel()
            commanded = self._levels.at(times).reshape(len(self.models), AHEAD, -1)
            self._ahead = {start: commanded[:, i] for i, start in enumerate(starts)}
        self._commanded = self._ahead[t0] * self._scales[:, None] ** 2

    def _over(self, moments: Moments, commanded: Float) -> tuple[Complex, Complex]:
        """Return levels at some moments, shape (worlds, m), and at the end, (worlds,), from the commanded levels."""
        levels: Complex = np.sqrt(commanded).astype(np.complex128)
        ringing = self._ringing.nonzero()[0]
        if len(ringing) == 0:
            return levels, self.now
        # All worlds have the same arrays and so the same transducers
        stepper = self.models[ringing[0]].stimuli[0].response.stepper
        if len(levels) > 1 or not stepper.tuned:
            rung, end = ring(self.now, levels.T, moments, stepper)
        else:
            one, last = ring(complex(self.now[0]), levels[0], moments, stepper)
            rung, end = one[:, None], np.array([last])
        silent = ~np.logical_or.reduce(levels, axis=1) & (np.abs(self.now) * self._peaks < SILENT)
        rung *= np.abs(rung) * self._peaks >= SILENT
        levels[ringing] = rung.T[ringing]
        return levels, np.asarray(end * ~silent)

    def course(self, world: int, levels: Complex, end: complex) -> EmittedCourse:
        """Return the result of `over` for one joined world as a course. levels: shape (m,); end: level at the end"""
        unit = self._of[world]
        last = end * unit.amplitudes
        return of_unit(unit, levels, last) if np.logical_or.reduce(levels) else silence(len(levels), last)

    def advance(self, end: Complex) -> None:
        """Write the emission of the joined worlds at the end of the step into the state. end: levels, shape (g,)"""
        rings = self._ringing[self.joined]
        worlds, levels = self.joined[rings], end[rings]
        self.now[worlds] = self._stored[worlds] = levels
        if self._alone:
            self._late[worlds] = True
        else:
            self.state.set_emission(worlds, levels[:, None] * self._units[worlds])

    def fetch(self) -> None:
        """Write the pending emissions into the state. They may be pending while no other code uses the state."""
        worlds = self._late.nonzero()[0]
        self._late[:] = False
        self.state.set_emission(worlds, self._stored[worlds, None] * self._units[worlds])


def _are(emitted: Complex, levels: Complex, units: Complex) -> Bool:
    """Return whether the emission, shape (g, N), is a number times a unit drive, for each world, shape (g,)."""
    rest = emitted - levels[:, None] * units
    return np.asarray(np.maximum.reduce(rest.real**2 + rest.imag**2, axis=1) < SILENT**2)


def _may_join(model: HapticModel) -> bool:
    """Return whether the emission of a world is usually a number times one drive."""
    if len(model.stimuli) != 1:
        return False
    stimulus = model.stimuli[0]
    rounds = array_drives(model, model.arrays)[0].rounds_levels
    return goes_smoothly(stimulus.config) and stimulus.response.alike and not rounds
