"""Run a scene, and write its results or keep them in memory."""

import json
import logging
import platform
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib import import_module
from importlib.metadata import version
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from rich.progress import Progress

from palmfield.device import absent, load_ahead, resolve
from palmfield.errors import MeasurementError, OutputError
from palmfield.interrupts import interrupts_delayed
from palmfield.outputs.schema import MUJOCO_SCENE, group
from palmfield.outputs.store import MemoryStore, Store, finished_result, open_result, refuse_occupied, write_json
from palmfield.outputs.store import recover as assemble
from palmfield.outputs.summary import summary
from palmfield.phases import phase, running
from palmfield.profile import count_arrays, peak_bytes
from palmfield.session.duration import check_duration, step_count
from palmfield.session.mujoco_scene import body_poses
from palmfield.session.open_scene import Source
from palmfield.session.recorder import TOGETHER, Block, Recorder, Sink, static_arrays, world_with
from palmfield.session.second_process import SecondProcess, possible
from palmfield.session.simulation import Simulation
from palmfield.terminal import bars

LOG = logging.getLogger("palmfield.session")


def _drawn_by(module: str, function: str, *args: Any, **more: Any) -> Any:
    """Return a function that calls a function of `palmfield.outputs`.

    Matplotlib and OpenUSD are then loaded after the steps.
    """
    with interrupts_delayed():  # OpenUSD would swallow Ctrl-C while it is loaded, and be incomplete
        drawing = getattr(import_module(f"palmfield.outputs.{module}"), function)
    return drawing(*args, **more)


def _scene_image(tree: xr.DataTree) -> Any:
    with phase("scene.png"):
        return _drawn_by("render", "scene_image", tree)


PICTURES: tuple[tuple[str, Callable[..., None]], ...] = (
    ("pressure.png", partial(_drawn_by, "plots", "plot_pressure")),
    ("displacement.png", partial(_drawn_by, "plots", "plot_displacement")),
    ("scene.png", partial(_drawn_by, "render", "render_scene")),
    ("scene.usdc", partial(_drawn_by, "usd.write", "write_usd")),
)
"""Functions of a result and a path. Functions whose name is in IN_PARALLEL also have the argument `image`."""
IN_PARALLEL: dict[str, Callable[[Any], Any]] = {"scene.png": _scene_image}
"""Images that a thread makes while other pictures are drawn. This is useful because ray casting releases the GIL."""
DRAWING = ("matplotlib", "pxr", *(f"palmfield.outputs.{name}" for name in ("plots", "render", "usd.write")))
"""Modules for these functions, which take half a second to load."""
CONVENTIONS = {
    "time_factor": "e^{-i w t}: a delay is +phase",
    "pressure": "complex peak amplitude of the incident field [Pa]",
    "arp_sign": "positive values push into the surface",
    "normal_displacement": "along the outward normal: a push is negative",
    "pose": "position [m] and quaternion (w, x, y, z)",
}


@dataclass(frozen=True)
class Result:
    """Result of a run.

    out: folder, None for a run in memory
    files: written files by name
    summary: the numbers of summary.json
    """

    out: Path | None
    files: dict[str, Path]
    summary: dict[str, Any]
    _cached: xr.DataTree | None = field(default=None, repr=False)
    _opened: list[xr.DataTree] = field(default_factory=list, repr=False)

    @property
    def dataset(self) -> xr.DataTree:
        """Groups of the result (palmfield.outputs.schema). The file is opened at the first use and read lazily."""
        if self._cached is not None:
            return self._cached
        if not self._opened:
            self._opened.append(open_result(self.files["result.nc"]))
        return self._opened[0]


class Estimates(NamedTuple):
    """Functions that compute the estimates of a complete run.

    budgets: returns the error budget of the motion of each skin, or why there is none
    summary: returns all numbers, from the recording, the budgets, the result, and other numbers of the whole run
    """

    budgets: Callable[[Simulation, Recorder, Progress], dict[str, Any]]
    summary: Callable[[Simulation, Recorder, dict[str, Any], xr.DataTree, dict[str, Any]], dict[str, Any]]


def run_recorded(
    scene: Source | Simulation,
    out: str | Path | None,
    estimates: Estimates,
    *,
    duration_s: float | None,
    progress: bool,
    overwrite: bool,
    plots: Sequence[str] | None,
    usd: bool,
) -> Result:
    """Run a scene as `palmfield.run` does. `estimates` has the functions that estimate its errors."""
    started = time.perf_counter()
    if duration_s is not None:
        check_duration(duration_s)
    if plots:
        from palmfield.outputs.pictures.draw import checked_kinds

        checked_kinds(plots)
    if out is not None:
        # Check before any computation; the store checks again
        refuse_occupied(Path(out), overwrite)
    sim = scene if isinstance(scene, Simulation) else Simulation(scene)
    duration = sim.duration_s if duration_s is None else duration_s
    with bars(progress) as bar:
        store, recorder = _prepare(sim, None if out is None else Path(out), overwrite, bar)
        stopped = _simulate(sim, recorder, duration, bar)
        try:
            with phase("recording"):
                store.append(recorder.surfaces())
        except (KeyboardInterrupt, Exception) as error:
            stopped = stopped or error
        budgets: dict[str, Any] = {}
        cut: KeyboardInterrupt | None = None
        if stopped is None:
            try:
                with phase("error estimate"):
                    budgets = estimates.budgets(sim, recorder, bar)
            except KeyboardInterrupt as error:
                cut = error  # only the estimate is missing, and the result is complete
        reason = "completed" if stopped is None else f"{type(stopped).__name__}: {stopped}".rstrip(": ")
        with ExitStack() as opened:
            # Ctrl-C is delayed until there is a result to attach
            delayed = opened.enter_context(ExitStack())
            delayed.enter_context(interrupts_delayed())
            if stopped or cut:
                _end_second_process()  # it draws nothing, and would slow down what is left to do
            about = {"reason": reason} | ({"error_budget": json.dumps(budgets)} if budgets else {})
            with phase("result file"):
                finished = store.finish(about, complete=stopped is None)
            if isinstance(finished, xr.DataTree):
                tree, files = finished, dict[str, Path]()
                result = Result(None, files, _numbers(tree), tree)
            else:
                assert out is not None
                tree, files = opened.enter_context(finished_result(finished)), {"result.nc": finished}
                files["summary.json"] = Path(out) / "summary.json"
                result = Result(Path(out), files, _numbers(tree))
            with _carried_by_errors(result):
                if stopped is None and not tree.attrs["complete"]:
                    stopped = store.lost or OutputError(f"{out} is incomplete: {tree.attrs['reason']}")
                try:
                    if out is not None:
                        # Written before a step that may take long or be interrupted, and again at the end
                        write_json(files["summary.json"], result.summary)
                except OutputError as error:
                    stopped = stopped or error
                delayed.close()
                if ended := stopped or cut:
                    raise ended
                with phase("summary"):
                    whole = estimates.summary(sim, recorder, budgets, tree, ending(tree) | _spent(started))
                if out is not None:
                    # Complete before the pictures, even if drawing fails
                    write_json(files["summary.json"], whole)
                    files |= draw(tree, Path(out), bar, plots, usd)
                    whole |= _spent(started)
                    write_json(files["summary.json"], whole)
    return replace(result, summary=whole)


@phase("summary")
def _numbers(tree: xr.DataTree) -> dict[str, Any]:
    return summary(tree, ending(tree))


def ending(tree: xr.DataTree) -> dict[str, Any]:
    """Return whether a run is complete, and why it ended, from its result."""
    return {"complete": bool(tree.attrs["complete"]), "reason": str(tree.attrs["reason"])}


@contextmanager
def _carried_by_errors(result: Result) -> Iterator[None]:
    """Set the present results as attribute `result` of each error, and of Ctrl-C, that leaves the block."""
    try:
        yield
    except (KeyboardInterrupt, Exception) as error:
        error.result = result  # type: ignore[union-attr]
        where = "attribute `result` of this error" if result.out is None else str(result.out)
        error.add_note(f"The partial results are in {where}.")
        raise


def recover(out: str | Path, *, progress: bool = False) -> dict[str, Path]:
    """Assemble the data of a killed run, or complete a run that was interrupted while it drew its pictures.

    progress: as in `run`
    Files of a killed USD export are reported but not removed, because they may be needed or still be written.
    Returns the files by name. Raises OutputError if there is no data to recover or the disk is full.
    """
    from palmfield.outputs.usd.stage_file import unfinished_scenes

    out = Path(out)
    try:
        return _recovered(out, progress)
    finally:
        for leftover, what in unfinished_scenes(out):
            LOG.warning("%s is %s", leftover, what)


def _recovered(out: Path, progress: bool) -> dict[str, Path]:
    path = out / "result.nc"
    if (out / ".partial").is_dir() or not path.exists():
        path = assemble(out)
    target = out / "summary.json"
    with open_result(path) as tree:
        complete = bool(tree.attrs["complete"])
        if not complete or not target.exists():
            write_json(target, summary(tree, {"complete": complete, "reason": tree.attrs["reason"]}))
        with bars(progress) as bar:
            return {"result.nc": path, "summary.json": target} | draw(tree, out, bar)


def draw(
    tree: xr.DataTree, out: Path, bar: Progress, plots: Sequence[str] | None = None, usd: bool = True
) -> dict[str, Path]:
    """Write the requested or default pictures and, if `usd`, the USD scene, as far as the data allow.

    Pictures that cannot be drawn are reported and skipped.
    """
    files: dict[str, Path] = {}
    task = bar.add_task("drawing", total=len(PICTURES))
    for kind in plots or ():
        bar.update(task, description=f"drawing {kind}")
        try:
            from palmfield.outputs.pictures.draw import draw_pictures

            with phase("plots"):
                drawn, _ = draw_pictures(tree, out / "plots", [kind])
            files |= {f"plots/{path.name}": path for path in drawn.values()}
        except (OutputError, MeasurementError) as error:
            LOG.warning("no picture %s: %s", kind, error)
    requested = [name for name, _ in PICTURES if (plots is None if name.endswith(".png") else usd)]
    order, made = sorted(requested, key=lambda name: name in IN_PARALLEL), set[str]()
    with closing((_drawn_in_second_process if _second else _drawn)(tree, out, order)) as pictures:
        for name, failure in pictures:
            if failure is None:
                made.add(name)
            elif isinstance(failure, OutputError):
                LOG.warning("no %s: %s", name, failure)
            else:
                raise failure
            bar.update(task, advance=1, description=f"wrote {name}")
    return files | {name: out / name for name in requested if name in made}


Drawn = Generator[tuple[str, Exception | None], None, None]
"""Names of pictures, each with the error that prevented it or None."""


def _drawn(tree: xr.DataTree, out: Path, names: Sequence[str]) -> Drawn:
    """Draw pictures, and in a thread the images of those in IN_PARALLEL."""
    make = dict(PICTURES)
    with ThreadPoolExecutor(1, "palmfield-picture") as thread:
        started = {name: thread.submit(begin, tree) for name, begin in IN_PARALLEL.items() if name in names}
        for name in names:
            try:
                with phase("plots" if name.endswith(".png") else "USD"), phase(name):
                    make[name](tree, out / name, **({"image": started[name].result()} if name in started else {}))
                yield name, None
            except Exception as error:
                yield name, error


def _drawn_in_second_process(tree: xr.DataTree, out: Path, names: Sequence[str]) -> Drawn:
    """Draw pictures in the second process. This process then draws those that the second process could not draw."""
    remaining, second = list(names), _second.pop()
    try:
        second.talk.send((out, remaining))
        while remaining:
            with phase("second process"):
                name, failure = second.receive()
            remaining.remove(name)
            yield name, failure and OutputError(failure)
        _second_bytes[0], phases = second.receive()
        for profile in running[-1:]:
            profile.add_process(phases)
    except TimeoutError as error:
        LOG.warning("%s; this process draws them", error)
    except (EOFError, OSError):
        pass
    finally:
        second.end(working=bool(remaining))
    yield from _drawn(tree, out, remaining)


def _draw_for_first(talk: Connection) -> None:
    """Draw what the first process requests over a connection. It ends at an error that is not an OutputError."""
    out, names = talk.recv()
    with finished_result(out / "result.nc") as tree, closing(_drawn(tree, out, names)) as pictures:
        for name, error in pictures:
            if error is not None and not isinstance(error, OutputError):
                raise error  # ends this process; the other one meets the same error, which need not be sent
            talk.send((name, error and str(error)))


_second: list[SecondProcess] = []
"""The process that will draw the next pictures; None if there is no such process."""
_second_bytes = [0]
"""Memory that the last second process used [bytes]."""


@contextmanager
def second_process_draws() -> Iterator[None]:
    """In the block, let a second process load Matplotlib and OpenUSD during a run, and draw the pictures of the run.

    This is for programs that own their process. It has no effect if the process cannot be copied or has loaded these
    modules already.
    """
    with suppress(OSError):
        # CUDA does not support copies of a process that has initialised it
        if resolve() == "cpu" and possible(DRAWING):
            _second.append(SecondProcess(DRAWING, _draw_for_first))
    try:
        yield
    finally:
        _end_second_process()


def _end_second_process() -> None:
    while _second:
        _second.pop().end()


@phase("preparing")
def _prepare(sim: Simulation, out: Path | None, overwrite: bool, bar: Progress) -> tuple[Store | MemoryStore, Recorder]:
    """Do everything that can fail before the first step."""
    started = time.perf_counter()
    sim.runtime.prepare(bar)
    if _second and absent:
        from warp_kernels import raycast

        # For the second process, which would begin with its picture, and compile Warp's headers again
        load_ahead((raycast,), "cpu")
    static, attributes = initial_block(sim), result_attributes(sim)
    store = MemoryStore(static, attributes) if out is None else Store(out, static, attributes, overwrite)
    LOG.debug("prepared the skin layers in %.2f s", time.perf_counter() - started)
    return store, recorder_of(sim, store, TOGETHER)


def recorder_of(sim: Simulation, sink: Sink, together: int = 1) -> Recorder:
    """Return the recorder that writes the steps of a simulation to a sink, from `start` to `stop`.

    together: see Recorder
    """
    return Recorder(sim.runtime, world_with(sim.data), sink, lambda: body_poses(sim.data), together)


def initial_block(sim: Simulation) -> Block:
    """Return the parts of a result that exist before the first step."""
    return static_arrays(sim.runtime.model, world_with(sim.data), sim.runtime, sim.model)


@phase("stepping")
def _simulate(sim: Simulation, recorder: Recorder, duration_s: float, bar: Progress) -> BaseException | None:
    """Step to the end. Return the error that ended the run early, or None."""
    started = time.perf_counter()
    steps = step_count(duration_s, sim.model.opt.timestep)
    task = bar.add_task(f"simulating {1e3 * duration_s:g} ms", total=steps)
    try:
        with interrupts_delayed() as check:
            try:
                recorder.start()
                for _ in range(steps):
                    sim.step()
                    with phase("recording"):
                        recorder.step()
                    bar.advance(task)
                    check()
            finally:
                with phase("recording"):
                    recorder.stop()
                count_arrays("fields and loads", sim.runtime.work)
    except (KeyboardInterrupt, Exception) as error:
        return error
    LOG.debug("%d steps took %.2f s", steps, time.perf_counter() - started)
    return None


def _spent(started: float) -> dict[str, Any]:
    return {"wall_time_s": time.perf_counter() - started, "peak_memory_MiB": (peak_bytes() + _second_bytes[0]) / 2**20}


def _shown_better(sim: Simulation) -> list[str]:
    """Return the MuJoCo bodies that the result describes by more than geoms: bodies with skin, and boards of arrays."""
    binding = sim.runtime.binding
    numbers = [number for skin in binding.skins for number in (skin.body, *skin.bones)]
    numbers += [int(sim.model.site_bodyid[site]) for site in binding.array_sites]
    return list(dict.fromkeys(sim.model.body(number).name for number in numbers))


def result_attributes(sim: Simulation) -> dict[str, dict[str, Any]]:
    """Return all settings, conventions and versions as attributes of the result and its groups."""
    model = sim.runtime.model
    packages = ("palmfield", "warp-lang", "mujoco", "numpy", "scipy", "trimesh", "usd-core", "xarray")
    attributes: dict[str, dict[str, Any]] = {
        "/": {
            "scene": sim.name,
            "driver": model.spec.driver.model_dump_json(),
            "skin_step_s": model.step_s,
            "timestep_s": model.spec.timestep_s,
            "device": model.spec.device,
            "conventions": json.dumps(CONVENTIONS),
            "versions": json.dumps({name: version(name) for name in packages} | {"python": platform.python_version()}),
        }
    }
    for array in model.spec.arrays:
        attributes[group("array", array.name)] = {"config": array.config.model_dump_json()}
    for part in model.stimuli:
        arrays = [model.spec.arrays[number].name for number in part.spec.arrays]
        # Thousands of numbers from a file would exceed the size limit of an attribute
        keys = part.config.model_dump_json(exclude={"am_table", "focus_table"})
        attributes[group("stimulus", part.spec.name)] = {"config": keys, "arrays": arrays}
    attributes[group("mujoco", MUJOCO_SCENE)] = {
        "gravity": json.dumps(sim.model.opt.gravity.tolist()),
        "shown_better": json.dumps(_shown_better(sim)),
    }
    for skin in model.skins:
        layer, name = skin.layer, skin.spec.name
        sizes = {key: np.asarray(value).tolist() for key, value in asdict(layer.sizes).items()}
        mesh = sizes | {"dofs": layer.system.ndof, "elements": len(layer.mesh.elements), **layer.patch.report}
        attributes[group("skin", name)] = {
            "config": skin.spec.config.model_dump_json(),
            "material": json.dumps([asdict(sheet.material) for sheet in layer.sheets]),
            "mesh": json.dumps(mesh),
            "arp_law": skin.spec.config.arp_law,
        }
        if skin.spec.config.arp_law == "alpha":
            # p_rms^2 is |p|^2/2 of the peak amplitude, to which the weight of the law applies
            attributes[group("skin", name)]["arp_alpha"] = 2.0 * skin.spec.arp_law.pressure
        attributes[group("body", name)] = {"body": skin.carrier.name}
        attributes[group("surface", name)] = {"body": skin.carrier.name}
    return attributes
