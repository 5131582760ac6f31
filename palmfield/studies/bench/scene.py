"""Speed and error of whole scenes, as a table: wall milliseconds per simulated millisecond in plain mj_step."""

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

from palmfield.data import folder
from palmfield.device import resolve
from palmfield.errors import PalmfieldError
from palmfield.studies.bench.consumer_card import CARD
from palmfield.studies.bench.field import check_writable, device_name, git_commit, written
from palmfield.studies.bench.scene_run import LEVELS, SIZES, SPEEDS, ASIDE_m, Job, Task, TILT_rad
from palmfield.studies.bench.table import processor
from palmfield.terminal import bars

STEPS, MOST_STEPS = 2000, 1_000_000


class Goal(NamedTuple):
    """Target for wall ms per simulated ms of a scene.

    It has the median on two CPU cores (the 99th percentile may be twice that), and median and 99th percentile on an
    H200.
    """

    cores: float
    gpu: float
    gpu_p99: float


GOALS = {
    **dict.fromkeys(("palm_am200", "phantom_am200", "phantom_stm70", "palm_circle"), Goal(1.5, 0.3, 0.5)),
    **dict.fromkeys(("approach_withdraw", "follow_fingertip", "stroke_palm"), Goal(4.0, 0.5, 1.0)),
    **dict.fromkeys(("two_hands", "two_hands_both_feel", "trace_shape", "hover_explore"), Goal(8.0, 0.5, 1.0)),
}
"""Targets of the shipped scenes. These scenes are measured by default."""


def main(
    scenes: list[str] | None = None,
    out: Path | None = None,
    device: str = "cpu",
    steps: int = STEPS,
    known: bool = False,
    error: bool = False,
    seed: int = 0,
    commit: str = "",
) -> str:
    """Measure and return the report; options of `palmfield bench scene`.

    scenes: files, or names of shipped scenes [default: those with a goal]; out: markdown file [default: none]
    device: where the scene is computed; steps: least number of steps with sound for each scene
    known: whether scenes are unchanged; skins then use a reduced model where the load is predicted. Otherwise path,
        level and pose are drawn at random after the model is built, and skins use modes for every load
    error: whether to compare the measured run with the whole layer; seed: seed of the random draws
    commit: commit to print in the report if git is not available [default: that of git]
    Raises PalmfieldError for invalid options. Raises OutputError for a file that cannot be written. If possible, this
    is raised before any measurement, and otherwise after the report is printed.
    """
    if not 1 <= steps <= MOST_STEPS:
        raise PalmfieldError(f"--steps has value {steps}; allowed: 1 to {MOST_STEPS}")
    if seed < 0:
        raise PalmfieldError(f"--seed has value {seed}; allowed: whole numbers >= 0")
    files = [scene_file(name) for name in scenes or GOALS]
    device = resolve(device)
    check_writable({"--out": out})
    load = os.getloadavg()[0]
    first = Job("measure", "", device, "auto" if known else "modal", not known, seed, steps)
    results: list[tuple[str, dict[str, Any]]] = []
    with bars() as progress:
        task = progress.add_task("scenes", total=len(files) * (3 if error else 2))
        for file in files:
            with tempfile.TemporaryDirectory() as place:
                job = replace(first, scene=str(file), motion=f"{place}/motion.npz" if error else "")
                tasks: tuple[Task, ...] = ("prepare", "measure", "reference") if error else ("prepare", "measure")
                answers: dict[str, dict[str, Any]] = {}
                for name in tasks:
                    progress.update(task, description=f"{file.stem}: {name}")
                    answers[name] = run_job(replace(job, task=name), Path(place) / "cache")
                    progress.advance(task)
                results.append((file.stem, answers))
    options = {
        "--device": "" if device == "cpu" else device,
        "--steps": "" if steps == STEPS else str(steps),
        "--known": " " if known else "",
        "--error": " " if error else "",
        "--seed": "" if seed == 0 else str(seed),
    }
    command = ["palmfield bench scene", *(scenes or [])]
    command += [f"{key} {value}".rstrip() for key, value in options.items() if value]
    return written(as_markdown(results, " ".join(command), first, load, commit or git_commit()), out)


def scene_file(name: str) -> Path:
    """Return the file of a scene. name: path, or name of a shipped scene. Raises PalmfieldError for a missing scene."""
    shipped = folder("mjcf") / "scenes"
    for path in (Path(name), shipped / f"{name}.xml"):
        if path.is_file():
            return path.resolve()
    names = sorted(path.stem for path in shipped.glob("*.xml") if not path.name.startswith("plain_"))
    raise PalmfieldError(f"scene {name} does not exist; allowed: a file, or one of {', '.join(names)}")


def run_job(job: Job, cache: Path) -> dict[str, Any]:
    """Run a job in a separate process and return its answer. Raises PalmfieldError with its last lines."""
    done = subprocess.run(
        [sys.executable, "-m", "palmfield.studies.bench.scene_run", json.dumps(asdict(job))],
        capture_output=True,
        text=True,
        env={**os.environ, "PALMFIELD_CACHE": str(cache)},
    )
    if done.returncode:
        words = done.stderr.strip().splitlines()
        raise PalmfieldError(f"benchmark of {job.scene} failed at '{job.task}': {words[-1] if words else 'no message'}")
    result: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return result


# -- the report ----------------------------------------------------------------------------------------------------


def as_markdown(results: list[tuple[str, dict[str, Any]]], command: str, job: Job, load: float, commit: str) -> str:
    """Return the tables, with results, machine and method. load: load average of the machine before the first run"""
    lines = [
        "# Scenes in real time",
        "",
        f"`{command}`; {processor()}, {os.cpu_count()} cores, load average {load:.1f} before; scenes on "
        f"{device_name(job.device)}; commit {commit}.",
        "",
        f"Wall time per simulated time [ms/ms], with plain `mj_step` from reset until {job.steps} steps with "
        "sound; silent steps are not counted. Sensors and forces are on, and skins are computed in every substep. "
        f"{about(job)} First step: from opening the scene to the end of the first step, with an empty cache and "
        "with the cache of that run. Memory: peak of the process. Yardstick: a product of 600 x 600 matrices and "
        "a pass through 64 MB, during the runs; compare times only at similar yardsticks.",
        "",
        "| scene | stepper | unknowns | modes or vectors | steps | p50 [ms/ms] | p90 | p99 | max | goal p50, p99 "
        "| first step, cold [s] | from the cache [s] | memory [MiB] | yardstick [ms] | 12 GB GPU, predicted [ms/ms] |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|",
        *(speed_row(name, answers, job.device) for name, answers in results),
        "",
        f"The last column is a prediction, not a measurement: sound and skins of one step on a {CARD.name}, from "
        "bytes and operations (`palmfield.studies.bench.consumer_card`), without the host work of MuJoCo and "
        "Python and without shadows. There is none for the full wedge model, because its sparse solves are "
        "sequential.",
        "",
    ]
    if any("reference" in answers for _, answers in results):
        lines += [
            "## Error of these runs",
            "",
            "Error of the measured run against the full wedge model under the same sound: L2 of the normal motion "
            "over the skin surface and all times, at the same points. Stated: the estimate of the modes for "
            "omitted modes and for loads outside their class. Different meshes also discretise the load "
            "differently; a reference on the same mesh shows only the error of the stepper.",
            "",
            "| scene | stepper | displacement | velocity | stated: displacement | velocity | reference |",
            "|---|---|---|---|---|---|---|",
            *(error_row(name, answers) for name, answers in results),
            "",
        ]
    remarks = dict.fromkeys(
        f"{name} uses the full wedge model: {answers['measure']['remark']}."
        for name, answers in results
        if answers["measure"]["remark"]
    )
    return "\n".join([*lines, *(line for remark in remarks for line in (remark, ""))])


def about(job: Job) -> str:
    """Describe the runs of a job in one sentence."""
    if not job.drawn:
        return "Scenes are unchanged, and their loads are predicted before the run."
    return (
        f"After the model was built, random numbers (seed {job.seed}) moved each focus by up to {1e3 * ASIDE_m:g} "
        f"mm in x and y, scaled its ARP by {LEVELS[0]:g} to {LEVELS[1]:g}, the size of its path by {SIZES[0]:g} to "
        f"{SIZES[1]:g} and its speed by {SPEEDS[0]:g} to {SPEEDS[1]:g}, and moved the arrays by up to "
        f"{1e3 * ASIDE_m:g} mm along and {TILT_rad:g} rad about each axis."
    )


def speed_row(name: str, answers: dict[str, dict[str, Any]], device: str) -> str:
    one = answers["measure"]
    p50, p90, p99, most = one["ms"]
    goal = GOALS.get(name)
    aim = ""
    if goal is not None:
        aim = f"{goal.cores:g}, {2 * goal.cores:g}" if device == "cpu" else f"{goal.gpu:g}, {goal.gpu_p99:g}"
    predicted = "" if one["predicted_ms"] is None else f"{one['predicted_ms']:.2f}"
    vectors = " + ".join("" if count is None else str(count) for count in one["vectors"]).strip(" +")
    memory = max(one["memory_after_MiB"], answers["prepare"]["memory_MiB"])
    return (
        f"| {name} | {' + '.join(one['steppers'])} | {' + '.join(map(str, one['unknowns']))} | {vectors} "
        f"| {one['steps']} | {p50:.2f} | {p90:.2f} | {p99:.2f} | {most:.1f} | {aim} "
        f"| {answers['prepare']['first_step_s']:.1f} | {one['first_step_s']:.1f} | {memory:.0f} "
        f"| {one['yardstick_ms']:.1f} | {predicted} |"
    )


def error_row(name: str, answers: dict[str, dict[str, Any]]) -> str:
    one, compared = answers["measure"], answers["reference"]
    stated = ["" if value is None else f"{100 * value:.2g} %" for value in one["stated"] or (None, None)]
    return (
        f"| {name} | {' + '.join(one['steppers'])} | {100 * compared['displacement']:.2g} % "
        f"| {100 * compared['velocity']:.2g} % | {stated[0]} | {stated[1]} | {compared['reference']} |"
    )
