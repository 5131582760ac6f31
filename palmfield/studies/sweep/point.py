"""What a sweep keeps of one point: numbers of a simulation's run, and a few courses over time."""

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from palmfield.outputs.schema import Arrays, group
from palmfield.perception.observers import OBSERVERS
from palmfield.session.error_budget import stimulus_of
from palmfield.session.preview import Preview
from palmfield.session.recorder import Recorder, world_with
from palmfield.session.simulation import Simulation
from palmfield.session.summary import felt_levels, skin_numbers, stimulus_numbers
from palmfield.simulation.sensors import CHANNELS
from palmfield.stimulus.schedule import main_frequencies
from palmfield.types import Float, Float32

Numbers = dict[str, NDArray[Any]]
"""By variable (`palmfield.studies.sweep.variables`), without the design's dimensions."""
NORMAL = list(CHANNELS).index("normal_displacement_m")


class Kept:
    """Takes a recorder's blocks and keeps what the numbers of a point need.

    times: ends of the substeps, from the run's start [s], shape (t,)
    motion: normal displacement [m] and velocity [m/s] of each skin, shape (2, t, S)
    peak_arp: of each skin [Pa]; forces: on each skin's body [N], shape (s, 3); sensors: their channels, shape (s, c)
    """

    def __init__(self, simulation: Simulation, records: int) -> None:
        self.skins = simulation.runtime.model.skins
        self.names = [skin.spec.name for skin in self.skins]
        self.normals = [skin.nodes[1].astype(np.float32) for skin in self.skins]
        self.times: Float = np.zeros(records)
        self.motion: list[Float32] = [np.zeros((2, records, len(normals)), np.float32) for normals in self.normals]
        self.peak_arp = [0.0] * len(self.skins)
        self.forces: list[list[Float]] = [[] for _ in self.skins]
        self.sensors: dict[str, list[Float]] = {name: [] for name in sensor_names(simulation)}
        self._count = 0

    def append(self, block: Arrays) -> None:
        """See `palmfield.session.recorder.Sink`."""
        times = np.asarray(block["/"]["time"])
        here = slice(self._count, self._count + len(times))
        self.times[here] = times
        for number, name in enumerate(self.names):
            skin = block[group("skin", name)]
            for row, quantity in enumerate(("displacement", "velocity")):
                np.einsum(
                    "tsi,si->ts", np.asarray(skin[quantity]), self.normals[number], out=self.motion[number][row, here]
                )
            self.peak_arp[number] = max(self.peak_arp[number], float(np.max(skin["arp"])))
            if "step_time" in block["/"]:
                self.forces[number].append(np.array(block[group("forces", name)]["force"]))
        if "step_time" in block["/"]:
            for name, values in self.sensors.items():
                values.append(np.array(block[group("sensors", name)]["value"]))
        self._count += len(times)


def sensor_names(scene: Simulation | Preview) -> list[str]:
    """Names of the sensors on all skins, in the order of their skins."""
    world = world_with(scene.data)
    return [sensor.name for skin in scene.runtime.binding.skins for sensor in world.sensors(skin.instance)]


def measured(simulation: Simulation, duration_s: float, times: Float, errors: bool) -> Numbers:
    """Run a simulation and give the numbers of a point.

    duration_s: simulated time [s]; times: at which courses are wanted, from the run's start [s], shape (t,)
    errors: whether the error of the displacement is estimated, which takes longer than most runs
    Raises what the run raises (SceneError, DeviceError).
    """
    started = time.perf_counter()
    model = simulation.runtime.model
    steps = max(1, round(duration_s / model.spec.timestep_s))
    kept = Kept(simulation, 1 + steps * model.substeps)
    recorder = Recorder(simulation.runtime, world_with(simulation.data), kept)
    for lazy in model.begin:
        _ = lazy.value
    recorder.start()
    try:
        for _ in range(steps):
            simulation.step()
            recorder.step()
    finally:
        recorder.stop()
    rows = [_skin(simulation, kept, number, times) for number in range(len(kept.names))]
    result: Numbers = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    sensors = [np.concatenate(values)[:, NORMAL] for values in kept.sensors.values()]
    result["sensor_displacement"] = np.array(sensors, np.float32).reshape(len(sensors), steps)
    levels = stimulus_numbers(simulation, recorder.loudest)
    result["drive_level"] = np.array([one["drive_level"] for one in levels.values()])
    if errors:
        estimates = [_estimate(simulation, kept, recorder, number) for number in range(len(kept.names))]
        result["displacement_error"] = np.array([error for error, _ in estimates])
        result["displacement_error_missing"] = np.array([reason for _, reason in estimates], dtype=object)
    result["substep"] = np.array(model.step_s)
    result["wall_time"] = np.array(time.perf_counter() - started)
    return result


def _skin(simulation: Simulation, kept: Kept, number: int, times: Float) -> dict[str, Any]:
    """Numbers of one skin."""
    displacement, velocity = kept.motion[number]
    sizes = np.abs(displacement).max(axis=0)
    vertex = int(sizes.argmax())
    moved, moves = (part[:, vertex].astype(np.float64) for part in (displacement, velocity))
    model = simulation.runtime.model
    frequencies = main_frequencies(model.stimuli[stimulus_of(model, number)].config)
    levels = felt_levels(kept.times, moved, frequencies)
    frequency = levels.get("main_frequency_Hz")
    last = _last_period(kept.times, frequency)
    force = np.concatenate(kept.forces[number])
    return {
        "peak_displacement": float(sizes[vertex]),
        "peak_velocity": float(np.abs(velocity).max()),
        "rms_displacement": _rms(moved),
        "rms_displacement_without_mean": float(moved.std()),
        "rms_displacement_last_period": _rms(moved[last]),
        "rms_velocity": _rms(moves),
        "rms_velocity_last_period": _rms(moves[last]),
        "peak_arp": kept.peak_arp[number],
        "loudest_position": model.skins[number].nodes[0][vertex],
        "normal_displacement": resampled(kept.times, moved, times).astype(np.float32),
        "peak_force": float(np.linalg.norm(force, axis=1).max()),
        "mean_force": force.mean(axis=0),
        "main_frequency": _number(frequency),
        "level": np.array([_number(levels.get(f"level_{name}_dB_SL")) for name in OBSERVERS]),
        "level_all_lines": np.array([_number(levels.get(f"level_all_lines_{name}_dB_SL")) for name in OBSERVERS]),
    }


def _estimate(simulation: Simulation, kept: Kept, recorder: Recorder, number: int) -> tuple[float, str]:
    """Relative error of a skin's displacement, or why there is none."""
    displacement = kept.motion[number][0]
    sizes = np.abs(displacement).max(axis=0)
    vertex = int(sizes.argmax())
    moved = displacement[:, vertex]
    found = skin_numbers(
        simulation, kept.names[number], recorder.loudest[number], kept.times, moved, float(sizes[vertex])
    )
    reason = found.get("displacement_error_missing", "" if "displacement_error_relative" in found else "no sound")
    return _number(found.get("displacement_error_relative")), str(reason)


def resampled(own: Float, values: Float, times: Float) -> Float:
    """A course at other times [s], by a cubic spline; the very values where the times are its own.

    own, times: rising, shapes (n,) and (t,); values: shape (n,). NaN after the course's end.
    """
    if len(own) == len(times) and np.allclose(own, times, rtol=0.0, atol=1e-9):
        return values
    if len(own) < 4:
        return np.interp(times, own, values, right=math.nan)
    result: Float = CubicSpline(own, values)(times)
    return np.where(times > own[-1] + 1e-9, math.nan, result)


def _last_period(times: Float, frequency: float | None) -> NDArray[np.bool_]:
    """Which times lie in the last period; none where nothing repeats."""
    if frequency is None:
        return np.zeros(len(times), bool)
    return times > times[-1] - 1.0 / frequency + 1e-9


def _rms(values: Float) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
