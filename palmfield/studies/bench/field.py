"""`palmfield bench field`: speed and error of palmfield's field. A caller may add other programs to compare."""

import functools
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from palmfield.acoustics import polynomials
from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.directivities import directivity_coefficients
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.device import resolve
from palmfield.errors import OutputError, PalmfieldError
from palmfield.studies.bench import own
from palmfield.studies.bench.chart import draw
from palmfield.studies.bench.problem import MOST_RUNS, Problem
from palmfield.studies.bench.processes import ROOT, Measured, PeerMethods, measure
from palmfield.studies.bench.table import FieldRow, Head, as_markdown, processor
from palmfield.terminal import bars
from palmfield.types import Air, Complex

AIR = Air(temperature_C=273.15 * ((340.0 / 331.3) ** 2 - 1.0))
"""Air with a sound speed of 340 m/s, which every program can represent."""
MODELS = {
    "piston": "piston, with absorption",
    "piston, lossless": "piston, without absorption",
    "sphere": "point source, without absorption",
}
"""Radiation model of one transducer, by `Method.model`. Errors are relative to float64 of the same model."""
LAYOUT = "autd3_2x2"
RANGES_M = ((0.05, 0.4), (0.4, 1.2))
"""Distances from the plane of the array."""
WIDTH_M = 0.2
"""Width of the box of points along x and y, centred on the array."""
FOCUS_M = (0.02, 0.01, 0.2)
POINTS, RUNS = 20_000, 5
CHECKED = 20_000
"""Largest number of points that are compared with float64. They are evenly spaced among all points."""
OWN = "palmfield.studies.bench.own"
COMMAND = "palmfield bench field"


def main(
    out: Path | None = None,
    picture: Path | None = None,
    device: str = "cpu",
    points: int = POINTS,
    runs: int = RUNS,
    only: str = "",
    commit: str = "",
    *,
    peers: PeerMethods | None = None,
) -> str:
    """Measure, draw and return the report; options of `palmfield bench field`.

    out: markdown file to write [default: none]; picture: PNG [default: none]
    device: where palmfield's own methods run: cpu or cuda:N
    points: approximate number of points in a range
    runs: number of runs of each method; the methods take turns, and medians are reported
    only: run only methods whose names contain this text
    commit: commit to print in the report if git is not available [default: that of git]
    peers: other programs to measure too [default: none]
    Raises PalmfieldError for invalid options and for a method that fails. Raises OutputError for a file that cannot be
    written. If possible, this is raised before any measurement, and otherwise after the report is printed.
    """
    if not 1 <= runs <= MOST_RUNS:
        raise PalmfieldError(f"--runs has value {runs}; allowed: 1 to {MOST_RUNS}")
    if not 64 <= points <= 10_000_000:
        raise PalmfieldError(f"--points has value {points}; allowed: 64 to 10000000")
    methods = [(OWN, method) for method in own.METHODS]
    if peers is not None:
        methods += [(peers.module, method) for method in peers.methods]
    chosen = [(module, method) for module, method in methods if only in method.name]
    if not chosen:
        names = ", ".join(method.name for _, method in methods)
        raise PalmfieldError(f"--only '{only}' matches no method; use part of {names}")
    device = resolve(device)
    check_writable({"--out": out, "--picture": picture})
    if device != "cpu":
        chosen = [(module, method) for module, method in chosen if method.name != own.ALL_CORES]
    rows: list[FieldRow] = []
    references: list[tuple[float, float]] = []
    with bars() as progress, threadpool_limits(1):
        task = progress.add_task("field", total=len(RANGES_M) * len(chosen) * (runs + 1))
        for low, high in RANGES_M:
            text = f"{low:g} to {high:g} m"

            def tick(name: str, text: str = text) -> None:
                progress.update(task, advance=1, description=f"{text}: {name}")

            measured = [Measured(method, module) for module, method in chosen]
            with tempfile.TemporaryDirectory() as folder:
                references += run_range(measured, low, high, points, device, peers, runs, Path(folder), tick)
            rows += [row(one, text, problem_of(one.method.model, low, high, points, device)) for one in measured]
    options = {
        "--device": "" if device == "cpu" else device,
        "--points": "" if points == POINTS else str(points),
        "--runs": "" if runs == RUNS else str(runs),
        "--only": only and f"'{only}'",
        "--out": "FILE" if out else "",
        "--picture": "FILE" if picture else "",
    }
    command = COMMAND if peers is None else peers.command
    head = Head(
        command=" ".join([command, *(f"{key} {value}" for key, value in options.items() if value)]),
        commit=commit or git_commit(),
        processor=processor(),
        device=device_name(device),
        yardstick_s=statistics.median(seconds for seconds, _ in references),
        cores=statistics.median(ratio for _, ratio in references),
        runs=runs,
        transducers=len(layout(LAYOUT)),
        points=tuple(int(np.prod(grid(low, high, points)[1])) for low, high in RANGES_M),
        picture=os.path.relpath(picture, out.parent) if picture is not None and out is not None else "",
    )
    report = as_markdown(rows, head, MODELS)
    drawn = None
    if picture is not None and not all(row.missing for row in rows):
        drawn = functools.partial(draw, rows, MODELS, picture)
    return written(report, out, drawn)


def written(report: str, out: Path | None, draw: Callable[[], None] | None = None) -> str:
    """Write a report and draw its picture, if requested; return the report.

    Raises OutputError if that fails. The report is printed first, so that minutes of measurements are not lost.
    """
    try:
        if out is not None:
            out.write_text(report)
        if draw is not None:
            draw()
    except (OSError, OutputError) as error:
        print(report, end="")
        raise OutputError(f"the files of the report above could not be written: {error}") from error
    return report


def check_writable(files: Mapping[str, Path | None]) -> None:
    """Create the folders of files. files: option -> file. Raises OutputError for a file that cannot be written."""
    for option, path in files.items():
        if path is None:
            continue
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                raise IsADirectoryError(None, "it is a folder")
            with tempfile.TemporaryFile(dir=path.parent):
                pass
            if path.exists():
                path.open("a").close()
        except OSError as error:
            raise OutputError(f"cannot write {path}: {error.strerror}; choose another {option}") from error


def run_range(
    measured: list[Measured],
    low_m: float,
    high_m: float,
    points: int,
    device: str,
    peers: PeerMethods | None,
    runs: int,
    folder: Path,
    tick: Callable[[str], None],
) -> list[tuple[float, float]]:
    """Fill `measured` for points between two distances. Returns the result of `measure`."""
    files = {model: folder / f"{i}.npz" for i, model in enumerate(MODELS)}
    for model, path in files.items():
        problem_of(model, low_m, high_m, points, device).save(path)

    here = Path(sys.executable)
    places: dict[str, tuple[Path, Sequence[Path]]] = {OWN: (here, [ROOT])}
    if peers is not None:
        # The other environment gets palmfield only, not the libraries installed next to it
        alone = folder / "alone"
        alone.mkdir()
        (alone / "palmfield").symlink_to(ROOT / "palmfield")
        places[peers.module] = (peers.python, [ROOT if peers.python == here else alone, peers.folder])
    return measure(measured, files, places, runs, folder, tick)


@functools.cache
def problem_of(model: str, low_m: float, high_m: float, points: int, device: str) -> Problem:
    """Return the problem of the benchmark for one of MODELS, at points in a box between two distances."""
    array = replace(layout(LAYOUT), directivity_table=None)
    if model == "sphere":
        array = replace(array, piston_radius_m=0.0)
    lossy = model == "piston"
    absorption = absorption_Np_m(AIR, array.frequency_Hz) if lossy else 0.0
    # Phases are quantised to 8 bits as on AUTD3, so that every program gets the same drive
    phase = np.round(256.0 * np.angle(focus(array, AIR, FOCUS_M)) / (2.0 * np.pi)) / 256.0
    low, steps, resolution = grid(low_m, high_m, points)
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(AIR)
    return Problem(
        low_m=low,
        steps=steps,
        resolution_m=resolution,
        positions=array.positions,
        normals=array.normals,
        drive=np.exp(2j * np.pi * phase),
        p0_Pa_m=array.p0_Pa_m,
        frequency_Hz=array.frequency_Hz,
        sound_speed_m_s=sound_speed(AIR),
        piston_radius_m=array.piston_radius_m,
        absorption_Np_m=absorption,
        directivity=directivity_coefficients(array, k)[0],
        sine=polynomials.sine_cosine()[0],
        cosine=polynomials.sine_cosine()[1],
        attenuation=polynomials.attenuation(absorption),
        temperature_C=AIR.temperature_C,
        device=device,
    )


def grid(low_m: float, high_m: float, points: int) -> tuple[Any, Any, float]:
    """Return a grid of about `points` points: first point, counts and spacing [m], a multiple of 1/64 mm."""
    pitch_mm = 1e3 * (WIDTH_M**2 * (high_m - low_m) / points) ** (1.0 / 3.0)
    resolution_m = max(round(64.0 * pitch_mm), 1) / 64e3
    steps = np.floor(np.array([WIDTH_M, WIDTH_M, high_m - low_m]) / resolution_m).astype(int) + 1
    half = resolution_m * (steps[:2] - 1) / 2.0
    return np.array([-half[0], -half[1], low_m]), steps, resolution_m


def row(one: Measured, text: str, problem: Problem) -> FieldRow:
    """Return a row with speed and error of a method. If its program is missing, the row names it."""
    result = FieldRow(one.method.name, one.method.model, text, missing=one.missing)
    if one.missing:
        return result
    every = stride(problem)
    computed, slope_error = one.result[::every], None
    pressure, gradient = reference(problem)
    if computed.ndim == 2:
        slope_error = relative(computed[:, 1:], gradient)
        computed = computed[:, 0]
    magnitude = not np.iscomplexobj(computed)
    pairs = float(np.prod(problem.steps)) * len(problem.positions)
    on_cores = one.module != OWN or problem.device == "cpu"
    return replace(
        result,
        version=one.version,
        setup_s=one.setup_s,
        clock_s=one.median_clock_s,
        pairs_per_s=pairs / one.median_clock_s,
        pairs_per_core_s=pairs / one.median_core_s if on_cores else None,
        error=relative(computed, np.abs(pressure) if magnitude else pressure),
        gradient_error=slope_error,
        magnitude=magnitude,
        memory_MiB=one.memory_MiB,
    )


def stride(problem: Problem) -> int:
    return max(1, int(np.prod(problem.steps)) // CHECKED)


@functools.cache
def reference(problem: Problem) -> tuple[Complex, Complex]:
    """Return pressure and gradient in float64 at every stride-th point of the problem."""
    points = problem.points()[:: stride(problem)]
    lost = problem.absorption_Np_m
    pressure, gradient = pressure64(points, problem.array(), problem.drive, AIR, gradient=True, absorption_Np_m=lost)
    assert gradient is not None
    return pressure, gradient


def relative(computed: Any, expected: Any) -> float:
    """Return the relative difference in the L2 norm."""
    return float(np.linalg.norm(computed - expected) / np.linalg.norm(expected))


def device_name(device: str) -> str:
    import warp as wp

    return "CPU" if device == "cpu" else wp.get_device(device).name


def git_commit(*folders: str) -> str:
    """Return the short name of the running commit and whether files are changed; "unknown" without git.

    folders: folders of the clone to check for changes, in addition to those of the packages
    """
    try:
        name, changed = (
            subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()
            for words in (
                ["rev-parse", "--short", "HEAD"],
                ["status", "--porcelain", "--", "palmfield", "warp_kernels", *folders],
            )
        )
    except (OSError, subprocess.CalledProcessError):
        return "unknown (give --commit)"
    return name + (" with uncommitted changes" if changed else "")
