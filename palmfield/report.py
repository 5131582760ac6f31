"""What a run says at its end: error estimate, felt level, and the short table."""

import io
import math
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from palmfield.chain import Chain, Sound, Wall
from palmfield.errors import PalmfieldError, SceneError
from palmfield.perception.observers import OBSERVERS, level_dB_SL, line_amplitude
from palmfield.rig import Rig
from palmfield.scene import Scene
from palmfield.skin.approximation.estimate import ORDER, mesh_error
from palmfield.skin.fem.solver import harmonic, harmonic_discrete, static
from palmfield.skin.reduction.stepping import ReducedSkin
from palmfield.stimulus.schedule import main_frequencies
from palmfield.types import Float

RATIO = 1.25
# Above this a finer mesh costs minutes and gigabytes. A coarser one must keep two layers: one alone is off by 20 %.
FINER_BELOW = 15_000
LAYERS = 3
PUBLISHED_P0_Pa_m = (1.27, 8.02)  # of transducers of 10 mm at 40 kHz, see palmfield.acoustics.placement


def numbers(scene: Scene, ds: xr.Dataset, loudest: Sound | None, factor: float) -> dict[str, Any]:
    """Drive level, error estimate and felt level of a finished run, units in the names.

    ds: the run's result; loudest: the sound at the highest level, None for a silent run; factor: its ARP factor
    An error estimate that fails leaves its reason in `displacement_error_missing`; the results stand without it.
    """
    rig = scene.skin.rig
    out: dict[str, Any] = {"drive_level": 0.0 if loudest is None else loudest.level, "dofs": rig.system.ndof}
    out["skin_solver"] = solver_in_words(rig)
    out["accuracy_wanted_relative"] = rig.skin.accuracy
    motion = ds["normal_displacement"].values
    vertex = int(np.abs(motion).max(axis=0).argmax())
    peak = float(np.abs(motion).max())
    if loudest is not None:
        chain = Chain(rig, scene.skin.chain.wall)
        out["total_force_peak_N"] = factor * float(np.linalg.norm(chain.resultant(loudest)[0]))
        band = p0_band(rig) if p0_given(rig) else None
        if band is not None:
            out |= {"peak_displacement_low_m": peak * band[0], "peak_displacement_high_m": peak * band[1]}
    if loudest is not None and peak > 0:
        try:
            lifted = bool(scene.skin.world.state(scene.skin.instance)[rig.skin_room])
            errors = error_estimate(rig, loudest, scene.skin.chain.wall, lifted)
            out |= errors | {"displacement_error_m": errors["displacement_error_relative"] * peak}
        except (PalmfieldError, MemoryError) as error:
            out["displacement_error_missing"] = f"{error}"
    frequencies = main_frequencies(rig.stimulus)
    if frequencies:
        out |= _levels(ds["time"].values, motion[:, vertex].astype(np.float64), frequencies)
    return out


def solver_in_words(rig: Rig) -> str:
    """What stepped the skin."""
    if isinstance(rig.stepper, ReducedSkin):
        return f"reduced, {rig.stepper.model.order} vectors"
    return "full"


def compares_with_finer(rig: Rig, dofs: int) -> bool:
    """Whether the error estimate of a scene with `dofs` unknowns takes a finer mesh, rather than a coarser one."""
    return dofs < FINER_BELOW or len(rig.sizes[3]) - 1 < LAYERS


def error_estimate(rig: Rig, sound: Sound, wall: Wall | None = None, lifted: bool = False) -> dict[str, float]:
    """Relative error of the displacement at the skin point nearest to the focus, by source.

    wall: see Chain; it saves solving for the same sound again
    lifted: whether the run has gone on from a small model to the whole layer (palmfield/engine/skin.py)
    mesh: static and harmonic response on the scene's mesh and on one RATIO finer (or coarser, for more than
        FINER_BELOW unknowns and at least LAYERS layers), by Richardson's rule; the larger of the two. Frequency: the
        stimulus's main one; half of the highest that mesh and step are made for where there is none, as the spectrum
        of a load that only starts and stops falls with frequency
    step: the discrete scheme's exact steady state against the continuous one, on the coarser mesh, where it costs less.
        A small model is exact in time; what it is given is the load's chords, of which a sine has sinc^2 of itself
    reduction: of a small model: its own estimate, or, where it is made for any course of the load, the difference to
        the whole layer's static and harmonic response on the scene's mesh, if that is larger; 0 without one
    edge: half the difference that fixed or free cut faces make to the harmonic response, also there: a layer on a hand
        ends where the body goes on; 0 for a disc, whose side is its own
    The model's other errors (law, material, linearity) are not in these; the plan names them.
    Raises SceneError where neither a finer nor a coarser mesh of the layer can be made.
    """
    point = _under_focus(rig, sound)
    finer = compares_with_finer(rig, rig.system.ndof)
    try:
        return _error_estimate(rig, sound, point, finer, wall, lifted)
    except SceneError:
        return _error_estimate(rig, sound, point, not finer, wall, lifted)


def _under_focus(rig: Rig, sound: Sound) -> Float:
    """The place of the resting skin that is nearest to the focus in the sound's pose, body frame [m], shape (3,)."""
    focus: Float = (sound.first - sound.pose.shift) @ sound.pose.turn
    if rig.hand is None:
        return focus
    nearest = np.linalg.norm(rig.posed(sound.pose).nodes[0] - focus, axis=1).argmin()
    return rig.mesh.nodes[nearest]


def _error_estimate(
    rig: Rig, sound: Sound, point: Float, finer: bool, wall: Wall | None, lifted: bool
) -> dict[str, float]:
    frequency = rig.main_frequency_Hz
    low, high = (rig, rig.resized(1 / RATIO)) if finer else (rig.resized(RATIO), rig)
    coarse, fine = (_Response(which, sound, point, wall) for which in (low, high))
    coarse_static, coarse_wave = coarse.static(), coarse.harmonic(frequency)
    fine_static, fine_wave = fine.static(), fine.harmonic(frequency)
    mesh = mesh_error(np.array([coarse_static, coarse_wave]), np.array([fine_static, fine_wave]), RATIO)
    if finer:
        mesh *= RATIO**ORDER
    small = rig.stepper if isinstance(rig.stepper, ReducedSkin) else None
    step = 1.0 - float(np.sinc(frequency * rig.sizes[4])) ** 2
    if small is None or lifted:
        step = abs(coarse.harmonic_discrete(frequency, rig.sizes[4]) - coarse_wave) / abs(coarse_wave)
    reduction = 0.0
    if small is not None:
        own = coarse if low is rig else fine
        answers = (coarse_static, coarse_wave) if low is rig else (fine_static, fine_wave)
        reduction = small.error
        if small.any_course:
            found = [small.harmonic(own.force, f, own.read)[0] for f in (0.0, frequency)]
            reduction = max(reduction, *(abs(a - b) / abs(b) for a, b in zip(found, answers, strict=True)))
    edge = 0.0
    if rig.skin.shape != "disc":
        other = low.resized(low.resizing, side="free" if rig.skin.side == "fixed" else "fixed")
        edge = 0.5 * abs(_Response(other, sound, point, wall).harmonic(frequency) - coarse_wave) / abs(coarse_wave)
    return {
        "mesh_error_relative": mesh,
        "step_error_relative": float(step),
        "reduction_error_relative": float(reduction),
        "edge_error_relative": float(edge),
        "displacement_error_relative": float(math.hypot(mesh, step, reduction, edge)),
    }


class _Response:
    """Displacement at a point of one mesh under one sound."""

    def __init__(self, rig: Rig, sound: Sound, point: Float, wall: Wall | None) -> None:
        # The boundary of a disc is that of its skin's mesh, any other body's is its own
        chain = Chain(rig, wall if rig.skin.shape != "disc" or rig.resizing == 1.0 else None)
        self.system = rig.system
        self.force = chain.sound(sound.focus, sound.pose).skin_force
        self.read = chain.probe(point).operator

    def static(self) -> float:
        return float((self.read @ static(self.system, self.force))[0])

    def harmonic(self, f_Hz: float) -> complex:
        return complex((self.read @ harmonic(self.system, self.force, f_Hz))[0])

    def harmonic_discrete(self, f_Hz: float, step_s: float) -> complex:
        return complex((self.read @ harmonic_discrete(self.system, self.force, f_Hz, step_s))[0])


def p0_band(rig: Rig) -> tuple[float, float] | None:
    """Factors on the skin's motion at the low and high ends of every array's p0; None where arp_peak_Pa sets the level.

    An array without a range of its own has the published one. The pressures of the arrays add up at the focus, each
    with its own p0, and the motion goes with the square.
    """
    emitter = rig.reference_emitter
    drive, _ = rig.unit_drive(rig.reference_focus)
    ends = np.cumsum([len(part) for part in emitter.parts])
    parts = []
    for part, end in zip(emitter.parts, ends, strict=True):
        alone = np.zeros_like(drive)
        alone[end - len(part) : end] = drive[end - len(part) : end]
        parts.append(emitter.pressure64(rig.reference_focus[None], alone)[0])
    whole = abs(sum(parts)) ** 2
    if rig.stimulus.arp_peak_Pa is not None or whole == 0.0:
        return None
    configs = [board.config for board in rig.boards]
    low = [(c.p0_low_Pa_m or PUBLISHED_P0_Pa_m[0]) / c.p0_Pa_m for c in configs]
    high = [(c.p0_high_Pa_m or PUBLISHED_P0_Pa_m[1]) / c.p0_Pa_m for c in configs]
    return abs(np.dot(low, parts)) ** 2 / whole, abs(np.dot(high, parts)) ** 2 / whole


def p0_given(rig: Rig) -> bool:
    """Whether every array has a range of p0 of its own."""
    return all(board.config.p0_low_Pa_m is not None for board in rig.boards)


def _levels(time: Float, motion: Float, frequencies: list[float]) -> dict[str, float | None]:
    """Level above threshold by observer: at the main frequency, and of all main frequencies together.

    None where an observer's table does not reach; nothing at all for less than two periods of the main frequency.
    """
    if frequencies[0] * (time[-1] - time[0]) < 2:
        return {}
    step = float(time[1] - time[0])
    frequencies = [f for f in frequencies if f * step <= 1 / 3]
    if not frequencies:
        return {}
    lines = [line_amplitude(time, motion, f) for f in frequencies]
    out: dict[str, float | None] = {"main_frequency_Hz": frequencies[0], "main_line_amplitude_m": lines[0]}
    for name, observer in OBSERVERS.items():
        for key, count in (("level", 1), ("level_all_lines", len(lines))):
            level = float(level_dB_SL(observer, frequencies[:count], lines[:count]))
            out[f"{key}_{name}_dB_SL"] = level if math.isfinite(level) else None
    return out


def mend(summary: dict[str, Any]) -> str:
    """What would lower the largest part of the error."""
    parts = {
        "a smaller --accuracy makes the mesh finer": summary["mesh_error_relative"],
        "a smaller --accuracy or step_s shortens the step": summary["step_error_relative"],
        "solver full leaves out the reduction": summary["reduction_error_relative"],
        "the layer's cut sides matter here: compare side fixed and free, or patch_radius_m": summary[
            "edge_error_relative"
        ],
    }
    return max(parts, key=lambda text: parts[text])


def format_report(summary: dict[str, Any]) -> str:
    """The short table that `palmfield run` prints."""
    error = summary.get("displacement_error_relative")
    band = "" if error is None else f" +- {100 * error:.1f} %"
    level = summary["peak_pressure_dB_SPL"]
    spl = "silence" if level is None else f"{level:.1f} dB SPL"
    rows = [
        ("peak sound pressure", f"{summary['peak_pressure_Pa']:.0f} Pa ({spl})"),
        ("peak ARP", f"{summary['peak_arp_Pa']:.3g} Pa"),
        ("total force", f"{1e3 * summary['total_force_peak_N']:.3g} mN"),
        ("drive", f"{summary['drive_level']:.3f} of full"),
        ("skin", f"{summary['dofs']} unknowns, solver {summary['skin_solver']}"),
        ("peak skin displacement", f"{1e6 * summary['peak_displacement_m']:.3g} um{band}"),
        (
            "rms skin displacement",
            f"{1e6 * summary['rms_displacement_m']:.3g} um{band} "
            f"({1e6 * summary['rms_displacement_without_dc_m']:.3g} um without the mean)",
        ),
    ]  # fmt: skip
    if error is not None:
        rows.append(
            (
                "error estimate",
                f"mesh {100 * summary['mesh_error_relative']:.2f} %, "
                f"time step {100 * summary['step_error_relative']:.2f} %, "
                f"reduction {100 * summary['reduction_error_relative']:.2f} %, "
                f"cut edge {100 * summary['edge_error_relative']:.2f} %; material and p0 not included (see plan)",
            )
        )
        wanted = summary["accuracy_wanted_relative"]
        if error > wanted:
            rows.append(("accuracy", f"NOT reached: {100 * wanted:g} % wanted; {mend(summary)}"))
    if "displacement_error_missing" in summary:
        rows.append(("error estimate", f"none: {summary['displacement_error_missing']}"))
    if "peak_displacement_low_m" in summary:
        low, high = summary["peak_displacement_low_m"], summary["peak_displacement_high_m"]
        rows.append(("peak for the p0 range", f"{1e6 * low:.3g} to {1e6 * high:.3g} um"))
    for number, name in enumerate(OBSERVERS, start=1):
        key = f"level_{name}_dB_SL"
        if key in summary:
            felt = "outside the table of" if summary[key] is None else f"{summary[key]:.1f} dB SL,"
            rows.append((f"level at {summary['main_frequency_Hz']:g} Hz", f"{felt} observer {number} ({name})"))
    rows.append(("wall time, peak memory", f"{summary['wall_time_s']:.1f} s, {summary['peak_memory_MiB']:.0f} MiB"))
    grid = Table(show_header=False)
    for name, text in rows:
        grid.add_row(name, text)
    stream = io.StringIO()
    Console(file=stream, width=110).print(grid)
    return stream.getvalue()
