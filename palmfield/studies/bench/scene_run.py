"""Measure one scene in a separate process: `python -m palmfield.studies.bench.scene_run JOB`, JOB as JSON.

The last line of its output is the answer, as JSON. The time to prepare depends on the cache, so the caller sets the
cache folder in the environment.
"""

import json
import statistics
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from palmfield import raise_errors
from palmfield.config import SkinConfig, StimulusConfig
from palmfield.errors import SceneError
from palmfield.session.duration import step_count
from palmfield.session.simulation import Simulation
from palmfield.simulation.build import build
from palmfield.simulation.model import HapticModel
from palmfield.simulation.state import stepper_of
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.stepper import Reader
from palmfield.stimulus.schedule import frames_at
from palmfield.studies.bench.consumer_card import predicted_s
from palmfield.studies.bench.worker import memory_MiB
from palmfield.types import Float

Task = Literal["prepare", "measure", "reference"]
Solver = Literal["auto", "modal"]
SKIN = SkinConfig.plugin
FINER = (5.0, 2.0)
"""Ratios between the accuracy of the scene and that of the reference. The first within MOST_UNKNOWNS is used."""
MOST_UNKNOWNS = 40_000
"""Largest number of unknowns of a reference; a larger model takes hours."""
ASIDE_m = 0.003
"""Largest shift of a focus in the plane of its path, and of the arrays along each axis [m]."""
TILT_rad = 0.02
"""Largest rotation of the arrays about each axis [rad]."""
LEVELS = (0.5, 1.0)
"""ARP relative to that of the scene."""
SIZES, SPEEDS = (0.8, 1.0), (0.8, 1.2)
"""Path size and speed relative to those of the scene; larger paths would leave the region of fine elements."""


@dataclass(frozen=True)
class Job:
    """Task of a process.

    task: "prepare" makes the first step only; "measure" steps whole runs; "reference" runs the full wedge model once
    solver: solver requested for all skins
    drawn: whether path, level and pose are drawn at random after the model is built
    seed: seed of the random draws
    steps: smallest number of steps with sound to measure
    motion: file of the motion of the run, written by "measure" and read by "reference"; "" for none
    """

    task: Task
    scene: str
    device: str = "cpu"
    solver: Solver = "auto"
    drawn: bool = True
    seed: int = 0
    steps: int = 2000
    motion: str = ""


class Yardstick:
    """Time of a product of two 600 x 600 matrices and a pass over 64 MB.

    They load processor and memory as a step does.
    """

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        self._factors = generator.random((2, 600, 600))
        self._long = generator.random(4_000_000)
        self._sum = np.empty_like(self._long)

    def ms(self) -> float:
        """Return the median of seven times [ms]."""
        times = []
        for _ in range(7):
            start = time.perf_counter()
            self._factors[0] @ self._factors[1]
            np.add(self._long, 1.0, out=self._sum)
            times.append(time.perf_counter() - start)
        return 1e3 * statistics.median(times)


def answer(job: Job) -> dict[str, Any]:
    """Do a job and return its answer. Errors of the scene are raised unchanged."""
    if job.task == "reference":
        return compared(job)
    start = time.perf_counter()
    sim, remark = opened(job)
    sim.step()
    ready = {"first_step_s": time.perf_counter() - start, "memory_MiB": memory_MiB("VmHWM")}
    return ready if job.task == "prepare" else measured(job, sim) | ready | {"remark": remark}


def opened(job: Job) -> tuple[Simulation, str]:
    """Return the scene with steppers for the drawn load, and why they differ from the requested steppers, or ""."""
    try:
        sim = Simulation(Path(job.scene), device=job.device, keys={f"{SKIN}.solver": job.solver})
        replaced = job.drawn and not all(lazy.value.any_pose for lazy in sim.runtime.model.begin)
        remark = "a reduced model is built for one stimulus" if replaced else ""
    except SceneError as error:
        if job.solver == "auto":
            raise
        replaced, remark = True, str(error).removeprefix(f"{job.scene}: ")
    if replaced:
        sim = Simulation(Path(job.scene), device=job.device, keys={f"{SKIN}.solver": "wedges"})
    return sim, remark


def sounding(model: HapticModel, count: int) -> list[bool]:
    """Return, for each of the first steps, whether a stimulus is active in this step or in the step before."""
    step_s = model.spec.timestep_s
    ends = np.arange(count * model.substeps + 1, dtype=np.float64) * (step_s / model.substeps)
    loud = np.zeros(len(ends), dtype=bool)
    for stimulus in model.stimuli:
        if not stimulus.silent:
            loud |= frames_at(stimulus.config, ends)[1] > 0.0
    alone = [bool(loud[n * model.substeps : (n + 1) * model.substeps + 1].any()) for n in range(count)]
    return [now or before for now, before in zip(alone, [False, *alone[:-1]], strict=True)]


def measured(job: Job, sim: Simulation) -> dict[str, Any]:
    """Return the wall time of each step with sound, over whole runs from reset.

    Raises SceneError for a silent scene.
    """
    if job.drawn:
        draw_again(sim, job.seed)
        # The first step with a new sound allocates buffers
        sim.step()
    model, data, runtime = sim.model, sim.data, sim.runtime
    began = [lazy.value.name for lazy in runtime.model.begin]
    count = step_count(sim.duration_s, model.opt.timestep)
    counted = sounding(runtime.model, count)
    if not any(counted):
        raise SceneError(f"{sim.name} is silent in all of its {count} steps; choose a scene with sound")
    yardstick = Yardstick()
    yardstick.ms()
    references = [yardstick.ms()]
    times: list[float] = []
    while len(times) < job.steps:
        sim.reset()
        for sounds in counted:
            start = time.perf_counter()
            mujoco.mj_step(model, data)
            spent = time.perf_counter() - start
            if sounds:
                times.append(spent)
        raise_errors(data)
        references.append(yardstick.ms())
    ended = [sim.skin(name).solver for name in sim.skins]
    each = np.array(times) / model.opt.timestep
    p50, p90, p99 = np.quantile(each, [0.5, 0.9, 0.99]).tolist()
    prediction = predicted_s(runtime.model)
    result = {
        "steppers": [a if a == b else f"{a}, then {b}" for a, b in zip(began, ended, strict=True)],
        "unknowns": [skin.layer.system.ndof for skin in runtime.model.skins],
        "vectors": [getattr(lazy.value, "order", None) for lazy in runtime.model.begin],
        "steps": len(times),
        "silent": count - sum(counted),
        "ms": [p50, p90, p99, float(each.max())],
        "stated": stated(sim),
        "yardstick_ms": statistics.median(references),
        "predicted_ms": None if prediction is None else prediction / model.opt.timestep,
        "memory_after_MiB": memory_MiB("VmHWM"),
    }
    if job.motion:
        points = [skin.nodes[0] for skin in runtime.model.skins]
        areas = [node_areas(skin.nodes[0], skin.faces) for skin in runtime.model.skins]
        arrays = {f"points{n}": array for n, array in enumerate(points)}
        arrays |= {f"areas{n}": array for n, array in enumerate(areas)}
        np.savez(job.motion, allow_pickle=False, **arrays, **motion(sim, points, count))
    return result


def stated(sim: Simulation) -> tuple[float, float | None] | None:
    """Return the errors of displacement and velocity that modal and reduced models report, for the worst skin.

    A reduced model reports no error of the velocity. The full wedge model reports no error.
    """
    errors: list[tuple[float, float | None]] = []
    for lazy, outside in zip(sim.runtime.model.begin, sim.runtime.work.outside, strict=True):
        stepper = lazy.value
        if stepper.adds_error is not None:
            errors.append(outside.errors(stepper.adds_error))
    return max(errors, key=lambda error: error[0], default=None)


def node_areas(nodes: Float, faces: Any) -> Float:
    """Return the area assigned to each node of a triangulated surface [m^2], shape (S,)."""
    a, b, c = (nodes[faces[:, corner]] for corner in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.bincount(faces.ravel(), np.repeat(third, 3), len(nodes)).astype(np.float64)


def motion(sim: Simulation, points: list[Float], count: int) -> dict[str, Float]:
    """Return normal displacement [m] and velocity [m/s] of each skin after each step from reset, (count, 2, n).

    points: points at which each skin is read, at rest, body frame [m], shape (n, 3)
    """
    runtime = sim.runtime
    operators = [
        SurfaceProbe(skin.layer.mesh, place, skin.layer.system).operator
        for skin, place in zip(runtime.model.skins, points, strict=True)
    ]
    readers: dict[tuple[int, str], Reader] = {}
    result = {f"motion{n}": np.zeros((count, 2, len(place))) for n, place in enumerate(points)}
    sim.reset()
    for step in range(count):
        sim.step()
        for number, operator in enumerate(operators):
            stepper, numbers = stepper_of(runtime.model, runtime.state, number)
            if (number, stepper.name) not in readers:
                readers[number, stepper.name] = stepper.reader(operator)
            result[f"motion{number}"][step] = stepper.read(numbers, readers[number, stepper.name])[0]
    return result


def compared(job: Job) -> dict[str, Any]:
    """Return the relative errors of displacement and velocity against the full wedge model.

    The norm is L2 over surfaces and times.
    """
    sim, text = reference(job)
    if job.drawn:
        draw_again(sim, job.seed)
    with np.load(job.motion) as saved:
        run = {name: saved[name] for name in saved.files}
    skins = range(len(sim.skins))
    count = len(run["motion0"])
    expected = motion(sim, [run[f"points{n}"] for n in skins], count)
    displacement, velocity = relative_errors(
        [run[f"motion{n}"] for n in skins], [expected[f"motion{n}"] for n in skins], [run[f"areas{n}"] for n in skins]
    )
    return {"displacement": displacement, "velocity": velocity, "reference": text}


def relative_errors(motions: list[Float], expected: list[Float], areas: list[Float]) -> tuple[float, float]:
    """Return the L2 errors of displacement and velocity over times and surfaces. motions: (t, 2, n); areas: (n,)"""
    squares = np.zeros((2, 2))
    for mine, theirs, area in zip(motions, expected, areas, strict=True):
        for row, values in enumerate((mine - theirs, theirs)):
            squares[row] += np.einsum("tks,tks,s->k", values, values, area)
    displacement, velocity = np.sqrt(squares[0] / squares[1]).tolist()
    return displacement, velocity


def reference(job: Job) -> tuple[Simulation, str]:
    """Return the full wedge model at the highest accuracy within MOST_UNKNOWNS, and its description."""
    path = Path(job.scene)
    scene = Simulation(path, device="cpu")
    skins = scene.runtime.model.skins
    whole: dict[str, object] = {f"{SKIN}.solver": "wedges"}
    for factor in FINER:
        finer = {f"{skin.spec.name}.accuracy": skin.spec.config.accuracy / factor for skin in skins}
        sim = Simulation(path, device=job.device, keys=whole | finer)
        layers = [skin.layer for skin in sim.runtime.model.skins]
        # Estimate the size first, because making a mesh that is too large takes long
        if sum(layer.expected_dofs for layer in layers) > 2 * MOST_UNKNOWNS:
            continue
        unknowns = sum(layer.system.ndof for layer in layers)
        if unknowns <= MOST_UNKNOWNS:
            return sim, f"accuracy / {factor:g}, {unknowns} unknowns"
    halved = {f"{skin.spec.name}.step_s": 0.5 * skin.layer.sizes.step_s for skin in skins}
    sim = Simulation(path, device=job.device, keys=whole | halved)
    unknowns = sum(skin.layer.system.ndof for skin in sim.runtime.model.skins)
    return sim, f"same mesh, half the substep, {unknowns} unknowns"


def main() -> None:
    print(json.dumps(answer(Job(**json.loads(sys.argv[1])))))


def draw_again(sim: Simulation, seed: int) -> None:
    """Draw other paths, levels and array places for a simulation, and reset it. The steppers are kept.

    seed: seed of the random numbers; equal seeds give equal draws for scenes that differ only in their skins
    Moving the arrays changes their pose relative to bodies, obstacles and scripted motion.
    """
    rng = np.random.default_rng(seed)
    runtime = sim.runtime
    model = runtime.model
    stimuli = tuple(replace(one, config=drawn_stimulus(one.config, rng)) for one in model.spec.stimuli)
    spec = replace(model.spec, stimuli=stimuli)
    other = build(spec, model)
    runtime.exchange(replace(model, spec=spec, stimuli=other.stimuli, marks={}))
    move_arrays(sim.model, runtime.binding.array_sites, rng)
    sim.reset()


def drawn_stimulus(config: StimulusConfig, rng: np.random.Generator) -> StimulusConfig:
    """Return the keys of a stimulus with another focus, level, path size and speed."""
    offset = rng.uniform(-ASIDE_m, ASIDE_m, 2)
    level, size, speed = (rng.uniform(*limits) for limits in (LEVELS, SIZES, SPEEDS))
    changes: dict[str, Any] = {"focus_m": tuple(np.add(config.focus_m, [*offset, 0.0]).tolist())}
    if config.arp_peak_Pa is not None:
        changes["arp_peak_Pa"] = level * config.arp_peak_Pa
    else:
        # The ARP is quadratic in the drive of the transducers.
        amplitude = 1.0 if config.drive_amplitude is None else config.drive_amplitude
        changes["drive_amplitude"] = float(np.sqrt(level)) * amplitude
    for factor, keys in (
        (size, ("path_diameter_m", "path_width_m", "path_height_m")),
        (speed, ("path_rate_Hz", "path_speed_m_s")),
    ):
        for key in keys:
            value = getattr(config, key)
            if value is not None:
                changes[key] = factor * value
    return type(config).model_validate(config.model_dump(exclude_unset=True) | changes)


def move_arrays(model: mujoco.MjModel, sites: tuple[int, ...], rng: np.random.Generator) -> None:
    """Move and rotate all bodies that carry arrays by the same amount.

    If the arrays are in the world, move their sites.
    """
    offset = rng.uniform(-ASIDE_m, ASIDE_m, 3)
    turn = rng.uniform(-TILT_rad, TILT_rad, 3)
    angle = float(np.linalg.norm(turn))
    quaternion = np.zeros(4)
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle, angle)
    for body in sorted({int(model.site_bodyid[site]) for site in sites}):
        if body > 0:
            places = [(model.body_pos, model.body_quat, body)]
        else:
            places = [(model.site_pos, model.site_quat, n) for n in range(model.nsite) if model.site_bodyid[n] == 0]
        for positions, quaternions, number in places:
            positions[number] += offset
            turned = np.zeros(4)
            mujoco.mju_mulQuat(turned, quaternion, quaternions[number])
            quaternions[number] = turned


if __name__ == "__main__":
    main()
