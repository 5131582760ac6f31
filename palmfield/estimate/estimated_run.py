"""Run a scene, with the errors of its results estimated."""

import logging
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.progress import Progress

from palmfield.estimate.cost import estimate_s
from palmfield.estimate.summary import array_numbers, estimated_budget, scene_numbers, skin_numbers, stimulus_numbers
from palmfield.outputs.motion import normal_component, pieces
from palmfield.outputs.schema import instances
from palmfield.outputs.summary import summary
from palmfield.session.open_scene import Source
from palmfield.session.recorded_run import Estimates, Result, run_recorded
from palmfield.session.recorder import Recorder
from palmfield.session.simulation import Simulation
from palmfield.types import Float

LOG = logging.getLogger("palmfield.estimate")


def run(
    scene: Source | Simulation,
    out: str | Path | None = None,
    *,
    duration_s: float | None = None,
    progress: bool = False,
    overwrite: bool = False,
    plots: Sequence[str] | None = None,
) -> Result:
    """Simulate a scene from its present state and write result.nc, summary.json, pictures and scene.usdc.

    scene: a file, an MjSpec, or a Simulation. out: folder, made where missing; None keeps the result in memory.
    duration_s: simulated time [s], by default that of the scene. progress: whether bars are drawn on standard error
        of a terminal. overwrite: whether the folder may hold the results of another run.
    plots: kinds of pictures (`palmfield.outputs.pictures.kinds.KINDS`) that are drawn to OUT/plots instead of the usual
        ones, none for an empty list.
    Ctrl-C, a full disk or an error in a module end the run early: what was computed by then is assembled and marked
    incomplete, and the error is raised afterwards (KeyboardInterrupt as such). It carries that Result as its attribute
    `result`, so that a run kept in memory is not lost either (in an interactive session: `sys.last_value.result`).
    Raises OutputError where `out` cannot be written, or holds an unfinished run or, without `overwrite`, another one.
    """
    estimates = Estimates(_budgets, _whole_summary)
    return run_recorded(
        scene, out, estimates, duration_s=duration_s, progress=progress, overwrite=overwrite, plots=plots
    )


def _budgets(sim: Simulation, recorder: Recorder, bar: Progress) -> dict[str, Any]:
    """The error budget of the motion of each skin, or why there is none."""
    expected_s = sum(estimate_s(skin) for skin in sim.runtime.model.skins)
    task = bar.add_task("estimating the error", total=None, expected_s=expected_s)
    before = time.perf_counter()
    try:
        return {name: estimated_budget(sim, number, recorder.loudest[number]) for number, name in enumerate(sim.skins)}
    finally:
        LOG.debug("the error estimate took %.2f s", time.perf_counter() - before)
        bar.remove_task(task)


def _whole_summary(
    sim: Simulation, recorder: Recorder, budgets: dict[str, Any], tree: xr.DataTree, extra: dict[str, Any]
) -> dict[str, Any]:
    """The numbers of a run that went to its end. budgets: of its skins"""
    skins = {}
    times: Float = np.asarray(tree["time"])
    for name, ds in instances(tree, "skin").items():
        loudest, normal = recorder.loudest[sim.skins.index(name)], np.asarray(normal_component(ds))
        arp_peaks = np.concatenate([values.max(axis=1) for _, values in pieces(ds, "arp")])
        skins[name] = skin_numbers(
            sim, name, loudest, budgets[name], times, normal, arp_peaks, begun_s=recorder.begun_s
        )
    run = recorder.loudest, recorder.peak_drive
    stimuli = stimulus_numbers(sim, *run, recorder.turns)
    for name, numbers in stimuli.items():
        if turned := numbers.get("phase_turn_times_s"):
            LOG.warning(
                "the phases between the foci of stimulus '%s' jump (count: %d, first at %.6g s) where two "
                "eigenvalues cross: drive and sound may jump there, as on a real board", name, len(turned),
                turned[0],
            )  # fmt: skip
    return summary(tree, extra | scene_numbers(sim, *run), skins, stimuli, array_numbers(sim.runtime.model))
