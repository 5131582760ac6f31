"""Compute before a run the data that it stores on disk: compiled kernels, meshes, modes, reduced models."""

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import filelock
import warp as wp
import warp.geometry  # defines its kernels

from palmfield import cache
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.point_sound import ROWS
from palmfield.device import load_ahead, load_kernels, resolve
from palmfield.outputs.summary import summary
from palmfield.session.open_scene import Options
from palmfield.session.recorded_run import Estimates, run_recorded
from palmfield.session.simulation import Simulation
from palmfield.types import Air
from warp_kernels import (
    EXACT,
    arp,
    block_solves,
    carried_points,
    elimination,
    mesh_query,
    modes,
    path_drives,
    point_sound,
    products,
    raycast,
    resultants,
    sdf,
    selfcross,
    shadow,
    skin_steps,
    skinning,
    supernodes,
    transfer,
    wedge,
    world_steps,
)  # fmt: skip
from warp_kernels.pressure import emitted

ON_CPU = (
    sdf, mesh_query, skinning, selfcross, arp, shadow, wedge, elimination, supernodes, block_solves, modes, transfer,
    raycast,
)  # fmt: skip
ON_GPU = (
    point_sound, world_steps, skin_steps, arp, carried_points, resultants, path_drives, transfer, products, raycast,
)  # fmt: skip
STATE_ROWS = 4
"""Numbers of the state of a mode of the palm: displacement, velocity, acceleration, one relaxing branch."""
COMPILED = (".o", ".cubin", ".ptx")


class Prepared(NamedTuple):
    """Result of `prepare`. kernels: number of compiled modules; answers: names of new entries in the cache"""

    kernels: int
    answers: tuple[str, ...]
    seconds: float


def prepare(scene: Path | None, *, only_kernels: bool = False, **options: Unpack[Options]) -> Prepared:
    """Compile the kernels of shipped scenes, and compute the data that a run stores, except its error estimate.

    The estimate depends on the loudest moment of the run. The scene does one step, whose result is not stored.
    scene: None for kernels alone; only_kernels: whether to omit meshes and models; options: as in
    `palmfield.Simulation`. A second process waits until the data are in the cache. Raises the errors of
    `palmfield.run`.
    """
    began, device = time.perf_counter(), options.get("device") or "auto"
    with _alone():
        kernels, answers = _compiled(), {entry.path for entry in cache.entries()}
        modules = kernel_modules()
        load_ahead(modules, "cpu")
        if (where := resolve(device)) != "cpu":
            of_gpu = gpu_modules(where)
            load_ahead(of_gpu, where)
            for module in of_gpu:
                load_kernels(module, where)
        if scene is not None and not only_kernels:
            sim = Simulation(scene, **options)
            estimates = Estimates(lambda *_: {}, lambda sim, recorder, budgets, tree, extra: summary(tree, extra))
            step_s = float(sim.model.opt.timestep)
            run_recorded(
                sim, None, estimates, duration_s=step_s, progress=False, overwrite=False, plots=[], usd=False
            )  # fmt: skip
        for module in modules:
            load_kernels(module, "cpu")
        new = sorted(entry.path.stem for entry in cache.entries() if entry.path not in answers)
        return Prepared(len(_compiled() - kernels), tuple(new), time.perf_counter() - began)


def kernel_modules() -> list[Any]:
    """Return the modules of kernels that runs of shipped scenes launch on the CPU, in any order."""
    cubes = wp.get_module("warp.geometry.marching_cubes")
    cubes.options |= EXACT  # as in `palmfield.hand.surface`
    array = layout("sonicsurface")
    fast, accurate = (FieldEvaluator(array, Air(), "cpu", mode=mode) for mode in ("fast", "accurate"))
    of_sound = [
        emitted(False), fast.kernel("quadratic", False), fast.kernel("quadratic", True, faced=True),
        accurate.kernel("quadratic", True, faced=True),
    ]  # fmt: skip
    return [*ON_CPU, cubes, *(kernel.module for kernel in of_sound)]


def gpu_modules(device: str) -> list[Any]:
    """Return the modules of kernels that runs of shipped scenes launch on a GPU, the slowest to compile first."""
    field = FieldEvaluator(layout("sonicsurface"), Air(), device)
    kernels = [point_sound.fields(rows, gpu=True) for rows in (ROWS, 1)]
    kernels += [field.kernel("quadratic", True, faced=True), skin_steps.lone_modes(STATE_ROWS)]
    return [*(kernel.module for kernel in kernels), *ON_GPU]


def _folder() -> Path:
    """Return the folder in which Warp keeps compiled kernels."""
    return Path(wp.config.kernel_cache_dir or ".")


def _compiled() -> set[Path]:
    return {path for path in _folder().rglob("*") if path.suffix in COMPILED}


@contextmanager
def _alone() -> Iterator[None]:
    """Wait for another process that uses this folder of kernels for `prepare`."""
    lock = filelock.FileLock(_folder() / "palmfield-prepare.lock", timeout=cache.WAIT_S)
    with suppress(OSError, NotImplementedError, filelock.Timeout):  # then both processes compute the data
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
