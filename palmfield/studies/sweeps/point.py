"""Results that a sweep stores for one point: numbers of a run, and a few time series."""

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from palmfield.estimate.sensation_levels import felt_levels
from palmfield.estimate.summary import drive_levels, estimated_errors
from palmfield.perception.registry import ALL_OBSERVERS
from palmfield.session.duration import step_count
from palmfield.session.loudest_moment import LoudestMoment
from palmfield.session.preview import Preview
from palmfield.session.recorder import Emitted, emitted_at, emitted_at_ends, world_with
from palmfield.session.simulation import Simulation
from palmfield.simulation.backend import StepTrace
from palmfield.simulation.posed_scene import PosedScene
from palmfield.simulation.sensors import CHANNELS
from palmfield.simulation.state import at_rest
from palmfield.types import Float, Float32

NORMAL = list(CHANNELS).index("normal_displacement_m")
Numbers = dict[str, NDArray[Any]]
"""Values by variable (`palmfield.studies.sweeps.store`), without the dimensions of the design."""


class Watched:
    """Records the worlds of a simulation from its start.

    simulation: simulation in any state; steps: number of MuJoCo steps that follow
    times: ends of the substeps, from the start of the run [s], shape (t,)
    motion: for each skin, normal displacement [m] and velocity [m/s] in each world, shape (w, t, 2, S)
    arp: highest ARP at these times [Pa], shape (w, skins, t); peak_arp: maximum over time, shape (w, skins)
    loudest: the moments of highest ARP by world and skin, None in silence
    forces: mean force of the sound on the body of each skin in each step [N], world axes, shape (steps, w, skins, 3)
    sensors: normal displacement at all skins' sensors at the beginning of each step [m], shape (steps, w, sensors)
    """

    def __init__(self, simulation: Simulation, steps: int) -> None:
        self.simulation = simulation
        self.runtimes = simulation.runtimes
        simulation.steps.observer = self._observe
        model, world = self.runtimes[0].model, self.runtimes[0].view
        self._bodies = [skin.body for skin in model.skins]
        names = [sensor.name for skin in self.runtimes[0].binding.skins for sensor in world.sensors(skin.instance)]
        self._places = [int(simulation.model.sensor(name).adr[0]) + NORMAL for name in names]
        count, records = len(self.runtimes), 1 + steps * model.substeps
        self.times: Float = np.zeros(records)
        shapes = [(count, records, 2, skin.layer.mesh.surface_nodes) for skin in model.skins]
        self.motion: list[Float32] = [np.zeros(shape, np.float32) for shape in shapes]
        self.arp: Float = np.zeros((count, len(model.skins), records))
        self.peak_arp: Float = np.zeros((count, len(model.skins)))
        self.loudest: list[list[LoudestMoment | None]] = [[None] * len(model.skins) for _ in self.runtimes]
        self.forces: Float = np.zeros((steps, count, len(model.skins), 3))
        self.sensors: Float = np.zeros((steps, count, len(names)))
        # Highest ARP of the unit drive of a world on a skin, with the numbers of its pose and drive
        self._units: dict[tuple[int, int], tuple[tuple[int, int], float]] = {}
        self._steps, self.begun_s = 0, simulation.time
        operators = self.runtimes[0].work.watching(*(skin.layer.surface_operator for skin in model.skins))
        for number, runtime in enumerate(self.runtimes):
            runtime.work.observe = operators
            self._begin(number)

    def step(self) -> None:
        """Record one step of MuJoCo."""
        forces = np.reshape(self.simulation.forces, (len(self.runtimes), -1, 3))
        self.forces[self._steps] = forces[:, self._bodies]
        self.sensors[self._steps] = np.reshape(self.simulation.sensors, (len(self.runtimes), -1))[:, self._places]
        self._steps += 1

    def _begin(self, world: int) -> None:
        """Record motion and sound before the first step."""
        runtime = self.runtimes[world]
        for skin, (stepper, numbers) in enumerate(runtime.skin_states()):
            if at_rest(runtime.state, skin):
                continue
            reader = runtime.work.reader(skin, stepper)
            assert reader is not None
            self.motion[skin][world, 0] = stepper.read(numbers, reader)[0][..., : self.motion[skin].shape[3]]
        posed, course = runtime.now()
        self._add_sound(world, posed, emitted_at(course, np.array([0])), np.array([self.begun_s]), slice(0, 1))

    def _rows(self, count: int) -> slice:
        """Return the row numbers of the substeps of the present step in the arrays over time."""
        return slice(1 + self._steps * count, 1 + (self._steps + 1) * count)

    def _observe(self, trace: StepTrace) -> None:
        rows = self._rows(len(trace.times))
        self.times[rows] = trace.times - self.begun_s
        for motion, watched in zip(self.motion, trace.motion, strict=True):
            for worlds, records in watched:
                # Whole rows, world by world, because NumPy is slow with index arrays
                for world, own in zip(worlds.tolist(), records, strict=True):
                    motion[world, rows] = own[..., : motion.shape[3]]
        if len(trace.worlds) == 1 or trace.levels.shape[2] != 1:
            [world] = trace.worlds.tolist()
            runtime = self.runtimes[world]
            emitted = emitted_at_ends(runtime.work.emission, trace, runtime.model.step_s)
            self._add_sound(world, trace.posed[0], emitted, trace.times, rows)
            return
        at_ends = trace.levels[:, np.argmax(trace.moments.last, axis=1), 0]
        factors = at_ends.real**2 + at_ends.imag**2
        last = factors.argmax(axis=1)
        highest = factors[np.arange(len(last)), last]
        for skin in range(len(self.motion)):
            units = np.array([self._unit(trace, i, skin) for i in range(len(last))])
            self.arp[trace.worlds, skin, rows] = factors * units[:, None]
            arp = highest * units
            louder = np.flatnonzero(arp > self.peak_arp[trace.worlds, skin])
            self.peak_arp[trace.worlds[louder], skin] = arp[louder]
            for i in louder.tolist():
                self._note(trace, i, skin, trace.times[last[i]], highest[i])

    def _unit(self, trace: StepTrace, i: int, skin: int) -> float:
        """Return the highest ARP on a skin for the unit drive of the i-th stepped world [Pa]; 0 in silence."""
        world, posed, course = int(trace.worlds[i]), trace.posed[i], trace.course(i)
        if len(course.units) == 0:
            return 0.0
        cached, key = self._units.get((world, skin)), (posed.serial, course.serial)
        if cached is None or cached[0] != key:
            radiation = self.runtimes[world].work.radiation
            arp = radiation.on(posed, skin, "nodes", course.units[0], course.serial).arp
            cached = self._units[world, skin] = key, float(arp.max())
        return cached[1]

    def _note(self, trace: StepTrace, i: int, skin: int, time_s: float, factor: float) -> None:
        moment = LoudestMoment(float(time_s), trace.posed[i], trace.course(i).units[0], float(factor))
        self.loudest[int(trace.worlds[i])][skin] = moment

    def _add_sound(self, world: int, posed: PosedScene, emitted: Emitted, times: Float, rows: slice) -> None:
        """Record the sound of one world at some times [s]. rows: their indices along time"""
        radiation, one = self.runtimes[world].work.radiation, emitted.drives.ndim == 1
        for skin in range(len(self.motion)):
            peaks: NDArray[np.floating]
            if one:
                peaks = emitted.factors * radiation.on(posed, skin, "nodes", emitted.drives, emitted.serial).arp.max()
            else:
                peaks = radiation.many(posed, skin, emitted.drives, "nodes").max(axis=1)
            self.arp[world, skin, rows] = peaks
            first = int(peaks.argmax())
            if peaks[first] > self.peak_arp[world, skin]:
                self.peak_arp[world, skin] = peaks[first]
                drive = emitted.drives if one else emitted.drives[first].copy()
                factor = float(emitted.factors[first])
                self.loudest[world][skin] = LoudestMoment(float(times[first]), posed, drive, factor)


def sensor_names(scene: Simulation | Preview) -> list[str]:
    """Return the names of the sensors on all skins, in the order of their skins."""
    world = world_with(scene.data)
    return [sensor.name for skin in scene.runtime.binding.skins for sensor in world.sensors(skin.instance)]


def measured(simulation: Simulation, duration_s: float, times: Float, errors: bool) -> list[Numbers]:
    """Run a simulation and return the numbers of its worlds. Each world is a point.

    duration_s: simulated time [s]
    times: times of the time series, from the start of the run [s], shape (t,)
    errors: whether the error of the displacement is estimated, which takes longer than most runs
    Raises SceneError and DeviceError of the run.
    """
    started = time.perf_counter()
    model = simulation.runtimes[0].model
    steps = step_count(duration_s, model.spec.timestep_s)
    watched = Watched(simulation, steps)
    for _ in range(steps):
        simulation.step()
        watched.step()
    points = [_point(watched, world, times, errors) for world in range(len(watched.runtimes))]
    spent = time.perf_counter() - started
    return [point | {"wall_time": np.array(spent / len(points))} for point in points]


def _point(watched: Watched, world: int, times: Float, errors: bool) -> Numbers:
    """Return the numbers of one world."""
    model = watched.runtimes[world].model
    rows = [_skin(watched, world, number, times) for number in range(len(model.skins))]
    result: Numbers = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    result["sensor_displacement"] = watched.sensors[:, world].T.astype(np.float32)
    result["drive_level"] = np.array(drive_levels(model, watched.loudest[world]))
    if errors:
        estimates = [_estimate(watched, world, number) for number in range(len(model.skins))]
        result["displacement_error"] = np.array([error for error, _ in estimates])
        result["displacement_error_missing"] = np.array([reason for _, reason in estimates], dtype=object)
    result["substep"] = np.array(model.step_s)
    return result


def _skin(watched: Watched, world: int, number: int, times: Float) -> dict[str, Any]:
    """Return the numbers of one skin in one world."""
    displacement, velocity = watched.motion[number][world].swapaxes(0, 1)
    sizes = np.maximum(displacement.max(axis=0), -displacement.min(axis=0))
    vertex = int(sizes.argmax())
    moved, moves = (part[:, vertex].astype(np.float64) for part in (displacement, velocity))
    model, work = watched.runtimes[world].model, watched.runtimes[world].work
    loudest, arp = watched.loudest[world][number], watched.arp[world, number]
    levels = felt_levels(
        *(model, number, loudest, work.radiation, work.reference, watched.times, displacement, arp),
        begun_s=watched.begun_s,
    )
    frequency = levels.get("main_frequency_Hz")
    last = np.zeros(len(watched.times), bool)
    if frequency is not None:  # None if the sound is not periodic
        last = watched.times > watched.times[-1] - 1.0 / frequency + 1e-9
    force = watched.forces[:, world, number]
    return {
        "peak_displacement": float(sizes[vertex]),
        "peak_velocity": float(max(velocity.max(), -velocity.min())),
        "rms_displacement": _rms(moved),
        "rms_displacement_without_mean": float(moved.std()),
        "rms_displacement_last_period": _rms(moved[last]),
        "rms_velocity": _rms(moves),
        "rms_velocity_last_period": _rms(moves[last]),
        "peak_arp": float(watched.peak_arp[world, number]),
        "loudest_position": model.skins[number].nodes[0][vertex],
        "normal_displacement": resampled(watched.times, moved, times).astype(np.float32),
        "peak_force": float(np.linalg.norm(force, axis=1).max()),
        "mean_force": force.mean(axis=0),
        "main_frequency": _number(frequency),
        "level": _by_observer(levels, "level_{}_dB_SL"),
        "level_all_lines": _by_observer(levels, "level_all_lines_{}_dB_SL"),
        "level_with_area": _by_observer(levels, "level_area_{}_dB_SL"),
        "level_why": np.array([levels.get(f"level_{name}_why", "") for name in ALL_OBSERVERS], dtype=object),
    }


def _by_observer(levels: dict[str, Any], key: str) -> Float:
    """Return one number for each observer, NaN if there is none."""
    return np.array([_number(levels.get(key.format(name))) for name in ALL_OBSERVERS])


def _estimate(watched: Watched, world: int, number: int) -> tuple[float, str]:
    """Return the relative error of the displacement of a skin, or why there is none."""
    loudest = watched.loudest[world][number]
    if loudest is None or not np.any(watched.motion[number][world, :, 0]):
        return math.nan, "no sound"
    errors = estimated_errors(watched.runtimes[world], number, loudest)
    return (math.nan, errors) if isinstance(errors, str) else (errors["displacement_error_relative"], "")


def resampled(own: Float, values: Float, times: Float) -> Float:
    """Resample a time series by a cubic spline. At its own times the values are unchanged.

    own, times: rising times, shapes (n,) and (t,)
    values: shape (n,)
    The result is NaN after the last of `own`.
    """
    if len(own) == len(times) and np.allclose(own, times, rtol=0.0, atol=1e-9):
        return values
    if len(own) < 4:
        return np.interp(times, own, values, right=math.nan)
    result: Float = CubicSpline(own, values)(times)
    return np.where(times > own[-1] + 1e-9, math.nan, result)


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
