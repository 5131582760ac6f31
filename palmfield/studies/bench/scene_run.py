"""One scene measured in a process of its own: `python -m palmfield.studies.bench.scene_run JOB`, JOB as JSON.

Its last line is the answer, as JSON. What it takes to get ready depends on what the cache holds, so that the caller
names a folder for it in the environment.
"""

import json
import statistics
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np

from palmfield import raise_errors
from palmfield.config import SkinConfig
from palmfield.errors import SceneError
from palmfield.session.duration import step_count
from palmfield.session.simulation import Simulation
from palmfield.simulation.model import HapticModel
from palmfield.simulation.state import stepper_of
from palmfield.skin.fem.probe import SurfaceProbe
from palmfield.skin.stepper import Reader
from palmfield.stimulus.schedule import frames_at
from palmfield.studies.bench.consumer_card import predicted_s
from palmfield.studies.bench.drawn import draw_again
from palmfield.studies.bench.worker import memory_MiB
from palmfield.types import Float

Task = Literal["prepare", "measure", "reference"]
Solver = Literal["auto", "modal", "wedges", "reduced"]
SKIN = SkinConfig.plugin
FINER = (5.0, 2.0)
"""By which the reference's accuracy is stricter than the scene's: the first that is affordable."""
MOST_UNKNOWNS = 40_000
"""Of a reference: the whole layer of more takes hours."""


@dataclass(frozen=True)
class Job:
    """What a process is to do.

    task: "prepare" makes the first step only; "measure" steps whole runs; "reference" runs the whole layer once
    solver: asked for of all skins; drawn: whether path, level and pose are drawn after the model is built
    seed: of what is drawn; steps: that sound, at least, to be measured
    motion: file of the run's motion, which "measure" writes and "reference" compares with; none where it is ""
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
    """A product of two 600 x 600 matrices, and a walk through 64 MB: what a step waits for, processor and memory."""

    def __init__(self) -> None:
        generator = np.random.default_rng(0)
        self._factors = generator.random((2, 600, 600))
        self._long = generator.random(4_000_000)
        self._sum = np.empty_like(self._long)

    def ms(self) -> float:
        """Median of seven times [ms]."""
        times = []
        for _ in range(7):
            start = time.perf_counter()
            self._factors[0] @ self._factors[1]
            np.add(self._long, 1.0, out=self._sum)
            times.append(time.perf_counter() - start)
        return 1e3 * statistics.median(times)


def answer(job: Job) -> dict[str, Any]:
    """Do a job. Raises what the scene raises."""
    if job.task == "reference":
        return compared(job)
    start = time.perf_counter()
    sim, remark = opened(job)
    sim.step()
    ready = {"first_step_s": time.perf_counter() - start, "memory_MiB": memory_MiB("VmHWM")}
    return ready if job.task == "prepare" else measured(job, sim) | ready | {"remark": remark}


def opened(job: Job) -> tuple[Simulation, str]:
    """The scene with steppers that serve what will be drawn, made; and why they are not those asked for, or ""."""
    try:
        sim = Simulation(Path(job.scene), device=job.device, keys={f"{SKIN}.solver": job.solver})
        names = [lazy.value.name for lazy in sim.runtime.model.begin]
        known = job.drawn and "reduced" in names
        remark = "a small model is made for one stimulus" if known else ""
    except SceneError as error:
        if job.solver != "modal":
            raise
        known, remark = True, str(error).removeprefix(f"{job.scene}: ")
    if known:
        sim = Simulation(Path(job.scene), device=job.device, keys={f"{SKIN}.solver": "wedges"})
    return sim, remark


def sounding(model: HapticModel, count: int) -> list[bool]:
    """Of each of a run's first steps, whether a stimulus sounds in it or in the one before, which rings on."""
    step_s = model.spec.timestep_s
    ends = np.arange(count * model.substeps + 1, dtype=np.float64) * (step_s / model.substeps)
    loud = np.zeros(len(ends), dtype=bool)
    for stimulus in model.stimuli:
        if not stimulus.silent:
            loud |= frames_at(stimulus.config, ends)[1] > 0.0
    alone = [bool(loud[n * model.substeps : (n + 1) * model.substeps + 1].any()) for n in range(count)]
    return [now or before for now, before in zip(alone, [False, *alone[:-1]], strict=True)]


def measured(job: Job, sim: Simulation) -> dict[str, Any]:
    """Wall time of each step that sounds, over whole runs from reset; raises SceneError for a scene that is silent."""
    if job.drawn:
        draw_again(sim, job.seed)
        # Buffers for the new sound are made in its first step
        sim.step()
    model, data, runtime = sim.model, sim.data, sim.runtime
    began = [lazy.value.name for lazy in runtime.model.begin]
    count = step_count(sim.duration_s, model.opt.timestep)
    counted = sounding(runtime.model, count)
    if not any(counted):
        raise SceneError(f"{sim.name} is silent in all of its {count} steps; choose one that sounds")
    yardstick = Yardstick()
    yardstick.ms()
    yards = [yardstick.ms()]
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
        yards.append(yardstick.ms())
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
        "yardstick_ms": statistics.median(yards),
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
    """What modes and small models state of their own errors of displacement and velocity, the worst skin's.

    A small model states none of the velocity, a whole layer none at all.
    """
    errors: list[tuple[float, float | None]] = []
    for lazy, outside in zip(sim.runtime.model.begin, sim.runtime.work.outside, strict=True):
        stepper = lazy.value
        if stepper.adds_error is not None:
            errors.append(outside.errors(stepper.adds_error))
    return max(errors, key=lambda error: error[0], default=None)


def node_areas(nodes: Float, faces: Any) -> Float:
    """Area for which each node of a triangulated surface stands [m^2], shape (S,)."""
    a, b, c = (nodes[faces[:, corner]] for corner in range(3))
    third = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6.0
    return np.bincount(faces.ravel(), np.repeat(third, 3), len(nodes)).astype(np.float64)


def motion(sim: Simulation, points: list[Float], count: int) -> dict[str, Float]:
    """Normal displacement [m] and velocity [m/s] of each skin after each step of a run from reset, (count, 2, n).

    points: of each skin where it is read, at rest, body frame [m], shape (n, 3)
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
    """Relative errors of a run's displacement and velocity against the whole layer, L2 over surfaces and times."""
    sim, text = reference(job)
    if job.drawn:
        draw_again(sim, job.seed)
    with np.load(job.motion) as known:
        run = {name: known[name] for name in known.files}
    skins = range(len(sim.skins))
    count = len(run["motion0"])
    expected = motion(sim, [run[f"points{n}"] for n in skins], count)
    displacement, velocity = relative_errors(
        [run[f"motion{n}"] for n in skins], [expected[f"motion{n}"] for n in skins], [run[f"areas{n}"] for n in skins]
    )
    return {"displacement": displacement, "velocity": velocity, "reference": text}


def relative_errors(motions: list[Float], expected: list[Float], areas: list[Float]) -> tuple[float, float]:
    """Of displacement and velocity, L2 over times and surfaces; motions of skins (t, 2, n), areas of nodes (n,)."""
    squares = np.zeros((2, 2))
    for mine, theirs, area in zip(motions, expected, areas, strict=True):
        for row, values in enumerate((mine - theirs, theirs)):
            squares[row] += np.einsum("tks,tks,s->k", values, values, area)
    displacement, velocity = np.sqrt(squares[0] / squares[1]).tolist()
    return displacement, velocity


def reference(job: Job) -> tuple[Simulation, str]:
    """The whole layer at the strictest accuracy that is affordable, and what it is, in words."""
    path = Path(job.scene)
    scene = Simulation(path, device="cpu")
    skins = scene.runtime.model.skins
    whole: dict[str, object] = {f"{SKIN}.solver": "wedges"}
    for factor in FINER:
        finer = {f"{skin.spec.name}.accuracy": skin.spec.config.accuracy / factor for skin in skins}
        sim = Simulation(path, device=job.device, keys=whole | finer)
        layers = [skin.layer for skin in sim.runtime.model.skins]
        # From sizes first: a mesh that is out of reach takes long itself
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


def as_line(job: Job) -> str:
    """A job as this module's command line takes it."""
    return json.dumps(asdict(job))


if __name__ == "__main__":
    main()
