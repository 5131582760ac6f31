"""Run a scene and write its results."""

import json
import platform
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import xarray as xr
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from palmfield.engine.host import raise_errors
from palmfield.errors import OutputError, PalmfieldError
from palmfield.outputs.v1_plots import plot_displacement, plot_pressure
from palmfield.outputs.v1_render import render_scene
from palmfield.outputs.v1_store import Store, load, write_json
from palmfield.outputs.v1_store import recover as assemble
from palmfield.outputs.v1_summary import summary
from palmfield.outputs.v1_usd import write_usd
from palmfield.record import Recorder, static_data
from palmfield.report import numbers
from palmfield.scene import Scene

PICTURES: tuple[tuple[str, Callable[[Any, Path], None]], ...] = (
    ("pressure.png", plot_pressure),
    ("displacement.png", plot_displacement),
    ("scene.png", render_scene),
    ("scene.usdc", write_usd),
)
CONVENTIONS = {
    "time_factor": "e^{-i w t}: a delay is +phase",
    "pressure": "complex peak amplitude of the incident field [Pa]",
    "arp_sign": "positive pushes into the surface",
    "normal_displacement": "along the outward normal: a push is negative",
    "pose": "position [m] and quaternion (w, x, y, z)",
}


@dataclass(frozen=True)
class Result:
    """What a run left behind.

    out: folder; files: paths written, by name; summary: the numbers of summary.json
    """

    out: Path
    files: dict[str, Path]
    summary: dict[str, Any]


def run(scene: Scene, out: str | Path, *, duration_s: float | None = None, progress: bool = True) -> Result:
    """Simulate a scene from its present state and write result.nc, summary.json, pictures and scene.usdc.

    out: folder, made where missing; duration_s: simulated time [s], the scene's own by default
    Ctrl-C, a full disk or an error in a module end the run early: what was computed by then is assembled and marked
    incomplete, and the error is raised afterwards (KeyboardInterrupt as such).
    Raises OutputError where `out` cannot be written or holds an unfinished run.
    """
    started = time.perf_counter()
    out = Path(out)
    duration = scene.duration_s if duration_s is None else duration_s
    world = scene.skin.world
    world.quiet = True
    try:
        with _progress(progress) as bar:
            store, recorder = _prepare(scene, out, bar)
            stopped = _simulate(scene, recorder, duration, bar)
            reason = "ran to its end" if stopped is None else f"{type(stopped).__name__}: {stopped}".rstrip(": ")
            try:
                store.append(recorder.surfaces())
            except OutputError as error:
                stopped = stopped or error
            path = store.finish({"reason": reason}, complete=stopped is None)
            ds = load(path)
            files = {"result.nc": path, "summary.json": out / "summary.json"}
            extra: dict[str, Any] = {"complete": stopped is None, "reason": reason}
            # Written before what may take long or be interrupted, and again at the end.
            write_json(files["summary.json"], summary(ds, extra))
            if stopped is not None:
                raise stopped
            task = bar.add_task("estimating the error", total=None)
            extra |= numbers(scene, ds, *recorder.loudest)
            bar.remove_task(task)
            files |= draw(ds, out, bar)
    finally:
        world.quiet = False
    extra |= {"wall_time_s": time.perf_counter() - started, "peak_memory_MiB": _peak_memory_MiB()}
    written = summary(ds, extra)
    write_json(files["summary.json"], written)
    return Result(out, files, written)


def recover(out: str | Path) -> dict[str, Path]:
    """Assemble what a killed run left, or complete the files of one that was cut off while drawing.

    Returns the files by name. Raises OutputError where there is nothing to recover or no room.
    """
    out = Path(out)
    path = out / "result.nc"
    if (out / ".partial").is_dir() or not path.exists():
        path = assemble(out)
    ds = load(path)
    target = out / "summary.json"
    if not ds.attrs["complete"] or not target.exists():
        write_json(target, summary(ds, {"complete": bool(ds.attrs["complete"]), "reason": ds.attrs["reason"]}))
    with _progress(True) as bar:
        return {"result.nc": path, "summary.json": target} | draw(ds, out, bar)


def draw(ds: xr.Dataset, out: Path, bar: Progress) -> dict[str, Path]:
    """Write each picture and the USD scene that the data allow; what can't be drawn is said and left out."""
    files = {}
    task = bar.add_task("drawing", total=len(PICTURES))
    for name, make in PICTURES:
        bar.update(task, description=f"writing {name}")
        try:
            make(ds, out / name)
            files[name] = out / name
        except OutputError as error:
            bar.console.print(f"palmfield: no {name}: {error}", highlight=False, markup=False, soft_wrap=True)
        bar.advance(task)
    return files


def _prepare(scene: Scene, out: Path, bar: Progress) -> tuple[Store, Recorder]:
    """Everything that can fail before the first step."""
    task = bar.add_task("preparing the skin layer", total=None)
    skin = scene.skin
    mujoco.mj_forward(scene.model, scene.data)
    raise_errors(scene.data)
    _ = skin.chain.skin.begin
    bar.remove_task(task)
    store = Store(out, static_data(skin).assign_attrs(_parameters(scene)))
    return store, Recorder(skin, store)


def _simulate(scene: Scene, recorder: Recorder, duration_s: float, bar: Progress) -> BaseException | None:
    """Step to the end; returns what ended it early, or None."""
    steps = max(1, round(duration_s / scene.model.opt.timestep))
    chain = scene.skin.chain
    task = bar.add_task(f"simulating {1e3 * duration_s:g} ms", total=steps)
    try:
        recorder.start()
        chain.observer = recorder.observe
        with _interrupts_between_steps() as check:
            for _ in range(steps):
                mujoco.mj_step(scene.model, scene.data)
                raise_errors(scene.data)
                recorder.step()
                bar.advance(task)
                check()
    except (KeyboardInterrupt, PalmfieldError, MemoryError) as error:
        return error
    finally:
        chain.observer = None
    return None


@contextmanager
def _interrupts_between_steps() -> Iterator[Callable[[], None]]:
    """Ctrl-C waits for the end of a step, so that no half step is recorded. Yields a check that raises it.

    Elsewhere than in the main thread signals can't be caught, and Ctrl-C does not arrive.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    asked: list[int] = []

    def check() -> None:
        if asked:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, lambda number, frame: asked.append(number))
    try:
        yield check
    finally:
        signal.signal(signal.SIGINT, before)


def _progress(show: bool) -> Progress:
    """Bars on standard error, with the time left."""
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    return Progress(*columns, console=Console(stderr=True), disable=not show, transient=True)


def _peak_memory_MiB() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 2**20 if platform.system() == "Darwin" else peak / 2**10


def _parameters(scene: Scene) -> dict[str, Any]:
    """Every setting, convention and version, as attributes of the result."""
    rig = scene.skin.rig
    fine, coarse, fine_radius, fractions, step, radius = rig.sizes
    packages = ("palmfield", "warp-lang", "mujoco", "numpy", "scipy", "trimesh", "usd-core", "xarray")
    return {
        "scene": str(scene.path),
        "array": json.dumps([board.config.model_dump(mode="json") for board in rig.boards]),
        "stimulus": rig.stimulus.model_dump_json(),
        "skin": rig.skin.model_dump_json(),
        "driver": rig.driver.model_dump_json(),
        "material": json.dumps(asdict(rig.material)),
        "mesh": json.dumps(
            {
                "edge_at_focus_m": fine, "edge_at_rim_m": coarse, "fine_radius_m": fine_radius, "radius_m": radius,
                "depth_fractions": [float(x) for x in fractions], "dofs": rig.system.ndof,
                "elements": len(rig.mesh.elements), **rig.patch.report,
            }
        ),
        "skin_step_s": step,
        "timestep_s": rig.timestep_s,
        "compute": rig.reference_emitter.evaluator.device,
        "conventions": json.dumps(CONVENTIONS),
        "versions": json.dumps({name: version(name) for name in packages} | {"python": platform.python_version()}),
    }  # fmt: skip
