"""Run a scene, estimate the errors of its results, and add the levels of populations of afferents."""

import logging
import math
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np
import xarray as xr
from rich.progress import Progress

from palmfield.config import StimulusConfig
from palmfield.errors import SceneError
from palmfield.estimate.array_inputs import stimulus_of
from palmfield.estimate.cost import estimate_s
from palmfield.estimate.sensation_levels import CLOCK_S
from palmfield.estimate.summary import array_numbers, estimated_budget, scene_numbers, skin_numbers, stimulus_numbers
from palmfield.outputs.motion import normal_component, pieces
from palmfield.outputs.schema import has_records, instances
from palmfield.outputs.summary import summary
from palmfield.perception.afferents import AFFERENTS
from palmfield.perception.populations import POPULATIONS, class_level_dB, spread_of, unit_levels
from palmfield.session.open_scene import Source
from palmfield.session.recorded_run import Estimates, Result, run_recorded
from palmfield.session.recorder import Recorder
from palmfield.session.simulation import Simulation
from palmfield.stimulus.schedule import steady_stretch_s
from palmfield.types import Float

LOG = logging.getLogger("palmfield.estimate")
EstimateKind = Literal["quick", "full", "none"]
NONE = "estimate is none"
"""Reason for a missing error budget."""


def run(
    scene: Source | Simulation,
    out: str | Path | None = None,
    *,
    duration_s: float | None = None,
    progress: bool = False,
    overwrite: bool = False,
    plots: Sequence[str] | None = None,
    usd: bool = True,
    estimate: EstimateKind = "quick",
) -> Result:
    """Simulate a scene from its present state and write result.nc, summary.json, pictures and scene.usdc.

    scene: a file, an MjSpec, or a Simulation. out: folder, created if missing; None keeps the result in memory.
    duration_s: simulated time [s], default that of the scene. progress: whether to show bars on a terminal's standard
        error. overwrite: whether the folder may contain the results of another run.
    plots: kinds of pictures (`palmfield.outputs.pictures.kinds.KINDS`) to draw in OUT/plots instead of the usual ones;
        an empty list draws none. usd: whether to write scene.usdc.
    estimate: estimate of the error: "quick" compares the mesh with coarser ones where that is reliable and uses the
    reduced
        model of the run; "full" compares with a finer mesh and with a reduced model of its own, which takes several
        times as long; "none" leaves the results without error and without bands of inputs.
    Ctrl-C, a full disk or an error in a module end the run early. The results so far are then written and marked
    incomplete, and the error (or KeyboardInterrupt) is raised. It has the Result as attribute `result`, so that a
    result in memory is not lost (in an interactive session: `sys.last_value.result`).
    Raises SceneError for another estimate, and OutputError if `out` cannot be written, contains an unfinished run or,
    without `overwrite`, another run.
    """
    estimates = Estimates(partial(_budgets, checked_kind(estimate)), _whole_summary)
    return run_recorded(
        scene, out, estimates, duration_s=duration_s, progress=progress, overwrite=overwrite, plots=plots, usd=usd
    )


def checked_kind(estimate: str) -> EstimateKind:
    """Return a kind of error estimate. Raises SceneError for another word."""
    for kind in get_args(EstimateKind):
        if kind == estimate:
            return cast(EstimateKind, kind)
    raise SceneError(f"error estimate is '{estimate}'; allowed: {', '.join(get_args(EstimateKind))}")


def _budgets(kind: EstimateKind, sim: Simulation, recorder: Recorder, bar: Progress) -> dict[str, Any]:
    """Return the error budget of the motion of each skin, or why there is none."""
    if kind == "none":
        return {name: None if recorder.loudest[number] is None else NONE for number, name in enumerate(sim.skins)}
    expected_s = sum(estimate_s(skin) for skin in sim.runtime.model.skins)
    task = bar.add_task("estimating the error", total=None, expected_s=expected_s)
    before = time.perf_counter()
    try:
        return {
            name: estimated_budget(sim, number, recorder.loudest[number], kind == "full")
            for number, name in enumerate(sim.skins)
        }
    finally:
        LOG.debug("the error estimate took %.2f s", time.perf_counter() - before)
        bar.remove_task(task)


def _whole_summary(
    sim: Simulation, recorder: Recorder, budgets: dict[str, Any], tree: xr.DataTree, extra: dict[str, Any]
) -> dict[str, Any]:
    """Return the numbers of a complete run. budgets: budgets of its skins"""
    skins = {}
    times: Float = np.asarray(tree["time"])
    for name, ds in instances(tree, "skin").items():
        loudest, normal = recorder.loudest[sim.skins.index(name)], np.asarray(normal_component(ds))
        arp_peaks = np.concatenate([values.max(axis=1) for _, values in pieces(ds, "arp")])
        begun_s, model = recorder.begun_s, sim.runtime.model
        config = model.stimuli[stimulus_of(model, sim.skins.index(name))].config
        populations = population_levels(ds, config, times, begun_s)
        skins[name] = skin_numbers(
            sim, name, loudest, budgets[name], times, normal, arp_peaks, begun_s=begun_s, populations=populations
        )
        driven = recorder.driven.get(sim.skins.index(name))
        if driven is not None:
            skins[name]["motion_reduction_error_relative"] = 0.0 if driven.model is None else driven.model.error
            if budgets[name] != NONE:
                skins[name]["motion_edge_error_relative"] = driven.edge_error()
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


def population_levels(skin: xr.Dataset, config: StimulusConfig, times: Float, begun_s: float = 0.0) -> dict[str, Any]:
    """Return the levels of a skin by the observers that read afferents; empty for a skin without them.

    skin: as returned by `palmfield.outputs.schema.instances`. times: times from the start of the run [s], shape (t,),
    evenly spaced; begun_s: MuJoCo time at the start of the run [s]. Levels are those between ramp and silence.
    By class: number of units, how many of them fire, and the largest level of a unit over its threshold.
    """
    if not has_records(skin, "afferent_motion") or len(times) < 2:
        return {}
    steady = steady_stretch_s(config)
    begin, end = np.searchsorted(begun_s + times, [steady[0] - CLOCK_S, steady[1] + CLOCK_S])
    step_s, classes = float(times[1] - times[0]), skin["afferent_class"].values
    levels, numbers = dict[str, Float](), dict[str, Any]()
    for name, afferent in AFFERENTS.items():
        motion = skin["afferent_motion"].values[:, classes == name]
        if motion.shape[1] and end > begin:
            own = levels[name] = unit_levels(afferent, motion, step_s, slice(int(begin), int(end)))
            numbers |= {f"afferents_{name}": len(own), f"afferents_{name}_firing": int((own >= 1.0).sum())}
            numbers[f"afferents_{name}_highest_level"] = float(own.max())
    for name, population in POPULATIONS.items():
        by_class = {one: class_level_dB(one, levels[one]) for one in population.classes if one in levels}
        decides = max(by_class, key=lambda one: by_class[one], default=None)
        level = -math.inf if decides is None else by_class[decides]
        numbers[f"level_{name}_dB_SL"] = level if math.isfinite(level) else None
        numbers[f"level_{name}_spread_dB"], numbers[f"level_{name}_spread_of"] = spread_of(decides or "pc")
        numbers[f"level_{name}_class"] = decides
        why = f"applies: {population.why}" if math.isfinite(level) else "refused: no afferent of its classes moves"
        numbers[f"level_{name}_why"] = why
    return numbers
