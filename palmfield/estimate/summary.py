"""Compute numbers of a finished run that its result lacks: drive level, error estimate, sensation level.

They are written to summary.json with those of `palmfield.outputs.summary`, by skin and by stimulus.
"""

from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.errors import PalmfieldError
from palmfield.estimate.array_inputs import p0_band_at
from palmfield.estimate.error_budget import error_budget
from palmfield.estimate.numerical_error import SteppedRun, error_estimate
from palmfield.estimate.sensation_levels import felt_levels
from palmfield.outputs.budget_text import combined, input_parts
from palmfield.outputs.verdict import verdict
from palmfield.session.loudest_moment import LoudestMoment, loudest_place
from palmfield.session.phase_turns import PhaseTurns
from palmfield.session.simulation import Simulation
from palmfield.simulation.model import HapticModel, array_instances
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.state import WHOLE
from palmfield.types import Float

T = TypeVar("T")


def skin_numbers(
    simulation: Simulation,
    skin_name: str,
    loudest: LoudestMoment | None,
    budget: dict[str, Any] | str | None,
    times: Float,
    normal: Float,
    arp_peaks: Float,
    *,
    begun_s: float = 0.0,
    populations: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """Return for one skin: solver, error estimate, p0 band and sensation level, units in the names.

    loudest: the moment of the highest ARP on the skin, None if no sound reached it.
    budget: as returned by `estimated_budget`.
    times: times of the records [s], shape (t,). normal: displacement along the outward normal [m], shape (t, S).
    arp_peaks: highest ARP on the skin at these times [Pa], shape (t,); begun_s: MuJoCo time at the start of the run
    [s]. populations: levels by `population_levels`, if any.
    velocity_error_relative, and SOURCE_velocity_error_relative of its sources, are missing for solvers with their own
    mesh. Without an estimate, modes still have `reduction_velocity_error_relative`.
    input_band_low, _high: factors of the motion over all inputs with a known range (`combined`); input_band_parts: of
    each input; peak_displacement_low_m, _high_m: ends of its band; verdict: as returned by
    `palmfield.outputs.verdict.verdict`.
    accuracy_reached: whether the error is within the target accuracy, None if there is no estimate.
    If the error estimate fails, `displacement_error_missing` gives the reason; the results remain valid without it.
    """
    runtime = simulation.runtime
    model, number = runtime.model, simulation.skins.index(skin_name)
    peak, radiation = float(max(normal.max(), -normal.min())), _radiation(runtime)
    skin = model.skins[number]
    left_small_model = _left_small_model(runtime, number)
    result: dict[str, Any] = {
        "dofs": model.begin[number].value.unknowns,
        "solver": model.begin[number].value.describe() + ("; then wedges" if left_small_model else ""),
        "solver_why": _why(model, number),
        "accuracy_wanted_relative": skin.spec.config.accuracy,
    }
    if loudest is not None:
        highest, _ = loudest_place(loudest.posed, number, radiation, loudest.drive)
        band = p0_band_at(model, loudest.posed.arrays, loudest.drive, highest)
        if band is not None:
            result |= {"p0_band_low": band[0], "p0_band_high": band[1]}
    if isinstance(budget, str):
        result |= {"displacement_error_missing": budget, "accuracy_reached": None}
    elif budget is not None:
        errors = budget["numerical"]
        result |= errors | {"displacement_error_m": errors["displacement_error_relative"] * peak}
        result["error_budget"] = budget
        result["accuracy_reached"] = errors["displacement_error_relative"] <= skin.spec.config.accuracy
    if parts := input_parts(result):
        low, high = combined(parts)
        result |= {"input_band_low": low, "input_band_high": high}
        result["input_band_parts"] = [dict(zip(("what", "low", "high"), part, strict=True)) for part in parts]
        result |= {"peak_displacement_low_m": peak * low, "peak_displacement_high_m": peak * high}
    stepper = model.begin[number].value
    if stepper.adds_error is not None and not left_small_model:
        velocity_error = runtime.work.outside[number].errors(stepper.adds_error)[1]
        result |= {} if velocity_error is None else {"reduction_velocity_error_relative": velocity_error}
    reference = runtime.work.reference
    result |= felt_levels(model, number, loudest, radiation, reference, times, normal, arp_peaks, begun_s=begun_s)
    result |= populations or {}
    return result | {"verdict": verdict(result)}


def estimated_budget(
    simulation: Simulation, skin: int, loudest: LoudestMoment | None, thorough: bool = False
) -> dict[str, Any] | str | None:
    """Return the budget of the motion of a skin (`palmfield.estimate.error_budget.error_budget`), or why there is none.

    None if the run was silent. loudest: see `skin_numbers`. thorough: see `error_estimate`.
    """
    if loudest is None:
        return None
    runtime, moment = simulation.runtime, loudest
    return _or_reason(
        lambda: error_budget(
            runtime.model, skin, moment, _radiation(runtime), _course(runtime, skin), thorough=thorough
        )
    )


def estimated_errors(runtime: SceneRuntime, skin: int, loudest: LoudestMoment) -> dict[str, float] | str:
    """Return the relative numerical errors of the displacement of a skin by source, or why there is no estimate."""
    return _or_reason(
        lambda: error_estimate(
            runtime.model, skin, loudest, _radiation(runtime), _course(runtime, skin), materials=False
        )
    )


def _course(runtime: SceneRuntime, skin: int) -> SteppedRun:
    outside, adds = runtime.work.outside[skin], runtime.model.begin[skin].value.adds_error
    velocity = None if adds is None else outside.errors(adds)[1]
    return SteppedRun(_left_small_model(runtime, skin), outside.energy_share, runtime.view.raw.time, velocity)


def _or_reason(estimate: Callable[[], T]) -> T | str:
    """Return the result of an estimate, or the reason of its failure; the results of the run remain valid."""
    try:
        return estimate()
    except (PalmfieldError, MemoryError) as error:
        return f"{error}" or type(error).__name__


def stimulus_numbers(
    simulation: Simulation,
    loudest: Iterable[LoudestMoment | None],
    peak_drive: Float | None = None,
    turns: Iterable[PhaseTurns] = (),
) -> dict[str, dict[str, Any]]:
    """Return the numbers of each stimulus, by its name.

    `drive_level` is the largest amplitude of its transducers, relative to full drive, at the moment when the ARP on a
    skin is largest. If all transducers follow one time course, it is the level at full modulation, without ramp and
    bursts. Otherwise (several stimuli, a moving focus with ring-up) it is the emitted amplitude. If no sound reached
    any skin, it is the commanded drive, since the sound may have missed the skins.

    peak_drive: largest commanded amplitude of each transducer in the run, shape (N,); 0 by default.
    turns: times of the phase jumps of each stimulus [s]. For a stimulus with several foci, the result also has their
    number, `phase_turns`, and their times, `phase_turn_times_s` [s].
    """
    model = simulation.runtime.model
    moments = list(loudest)
    levels = drive_levels(model, moments)
    if peak_drive is not None and not any(moments):
        levels = [float(peak_drive[stimulus.transducers].max()) for stimulus in model.stimuli]
    result: dict[str, dict[str, Any]] = {
        part.spec.name: {"drive_level": level} for part, level in zip(model.stimuli, levels, strict=True)
    }
    for part, turned in zip(model.stimuli, turns, strict=False):
        if len(part.offsets):
            result[part.spec.name] |= {"phase_turns": len(turned.times), "phase_turn_times_s": turned.times}
    return result


def array_numbers(model: HapticModel) -> dict[str, dict[str, Any]]:
    """Return for each array, by name: p0 [Pa m] and quality with range, kind, source, and whether it is calibrated."""
    result = {}
    for spec, array in zip(model.spec.arrays, array_instances(model.spec), strict=True):
        p0, quality = array.p0, array.quality
        result[spec.name] = {
            "calibrated": array.p0.kind == "measured",
            "p0_Pa_m": p0.value,
            "p0_low_Pa_m": p0.low,
            "p0_high_Pa_m": p0.high,
            "p0_kind": p0.kind,
            "p0_source": p0.source,
            "quality": quality.value,
            "quality_low": quality.low,
            "quality_high": quality.high,
            "quality_kind": quality.kind,
        }
    return result


def drive_levels(model: HapticModel, loudest: Iterable[LoudestMoment | None]) -> list[float]:
    """Return the `drive_level` of each stimulus, see `stimulus_numbers`."""
    moments = [moment for moment in loudest if moment is not None]
    parts = [stimulus.transducers for stimulus in model.stimuli]
    return [max((float(np.abs(moment.drive[own]).max()) for moment in moments), default=0.0) for own in parts]


def scene_numbers(
    simulation: Simulation, loudest: Iterable[LoudestMoment | None], peak_drive: Float | None = None
) -> dict[str, Any]:
    """Return for the whole scene: device of the fields, board, and highest level of the drive.

    loudest: loudest moment of each skin; peak_drive: as in `stimulus_numbers`
    """
    model = simulation.runtime.model
    levels = [one["drive_level"] for one in stimulus_numbers(simulation, loudest, peak_drive).values()]
    return {"palmfield_device": model.arrays.field.device, "board": model.board.name, "drive_level": max(levels)}


def _radiation(runtime: SceneRuntime) -> Radiation:
    """Return the fields of the model of a scene, with the boundary-element solutions of its run."""
    radiation = Radiation(runtime.model)
    radiation.continue_from(runtime.work.radiation)
    return radiation


def _left_small_model(runtime: SceneRuntime, skin: int) -> bool:
    """Return whether a run changed from a reduced model of a skin to the full wedge model."""
    begun = runtime.model.begin[skin].value.adds_error is not None
    return begun and bool(runtime.state.skins[skin][0, 0] == WHOLE)


def _why(model: HapticModel, skin: int) -> str:
    """Return why this solver stepped a skin."""
    choice = model.skins[skin].choice
    if choice.name != model.begin[skin].value.name:
        return f"{choice.why}; but no reduced model reached its accuracy, so the full wedge model was used"
    return choice.why
