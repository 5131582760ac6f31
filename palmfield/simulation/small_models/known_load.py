"""Loads that are predicted before the run: the scenes that have one, and the reduced model of the skin for it.

A periodic stimulus loads a resting skin with only a few patterns. A reduced model is then sufficient.
"""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np

from palmfield import cache
from palmfield.blas import one_blas_thread
from palmfield.config import StimulusConfig
from palmfield.drive.transducer_response import commanded_drive
from palmfield.simulation.emission import array_drives
from palmfield.simulation.model import HapticModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene, reference_scene
from palmfield.simulation.radiation import Radiation
from palmfield.simulation.spec import SkinSpec
from palmfield.skin.reduction.course import Fade, harmonics, level, periodic
from palmfield.skin.reduction.load_shapes import load_shapes
from palmfield.skin.reduction.reduced_stepper import (
    MOST_VECTORS,
    KnownLoad,
    ReducedStepper,
    known_model,
    reduced_stepper,
)
from palmfield.skin.scene_layer import SceneLayer
from palmfield.stimulus.modulation import arp_lines
from palmfield.stimulus.modulation import period_s as am_period_s
from palmfield.stimulus.schedule import (
    first_point,
    frames_at,
    is_closed,
    level_jumps,
    main_frequencies,
    points_a_turn,
    repeats,
    turn_rate_Hz,
)
from palmfield.types import Complex, Float, Float32

SHARE = 0.1
"""Fraction of the target accuracy that is allowed for the error of the reduced model."""
MOST_TURNS = 4
"""Largest number of turns of a path after which path and modulation together must repeat."""
BAND = 2.5
"""Limit of the harmonics of the load of a model, relative to the highest frequency that mesh and step resolve."""
TRIAL_S, LONGEST_TRIAL_S = 0.03, 0.1
"""Duration of the load for which models are compared [s], and its upper limit for a load with a longer period."""
TONES = 16
"""Number of modulation frequencies at which models are compared. They are equally spaced up to the end of the band."""
REST_S = 2.5e-3
"""Longest rest of a focus at each point of its path [s]. With a longer rest, the load is not one smooth course."""
MOST_SAMPLES = 1024
SMALLEST = 1e-4
"""Smallest harmonic of a load that the model includes, relative to the largest one."""
CLOSER, BEGIN_CLOSER = 16, 4
"""Number of examples per sample of a load, in the periodic state and during ring-up."""
MOST_EXAMPLES, LEAST_CLOSER = 2400, 8
"""Number of examples in the periodic state above which there are fewer per sample, and the smallest number per sample.

The time for their shapes is quadratic in the number. On stroke_palm, pressures between 8 examples per sample differ
from sums of these shapes by 4e-4, rms; between 16 by 3e-4.
"""
SPAN_CLOSER = 4
"""Drives per sample of a load. Their linear combinations represent all drives of the load."""
OMITTED = 3e-4
"""Fraction of a predicted load that the load shapes may omit. With these shapes few points suffice to evaluate it."""
DIGITS = 10
"""Number of decimals to which drives are rounded."""
BEGINNING = 48
"""Number of moments at which the load is computed during ring-up."""
SETTLED = 12.0
"""Duration of ring-up, as a multiple of 1 over the damping of the transducers."""

# -- which scenes have one -----------------------------------------------------------------------------------------


def refusal(skin: SkinSpec, layer: SceneLayer, stimuli: tuple[StimulusModel, ...]) -> str | None:
    """Return why a skin cannot have a reduced model for these stimuli, in words; None if it can."""
    if skin.moves:
        return "a script moves a part of the scene"
    sounding = [stimulus for stimulus in stimuli if not stimulus.silent]
    if not sounding:
        return "the stimulus is silent"
    if len(sounding) > 1:
        return f"{len(sounding)} stimuli are active together"
    if one_shape(sounding[0]):
        return None
    config = sounding[0].config
    if not repeats(config):
        return "bursts, a path that runs once, or values from a file are not periodic"
    if level_jumps(config):
        return "the level jumps in each period of the modulation"
    if config.path == "letters" or (config.path_end == "jump" and not is_closed(config)):
        return "the focus jumps from one end of its path to the other"
    if config.path != "point" and config.control_rate_Hz > 0.0:
        return "control_rate_Hz is not synchronous with the path"
    expected = expected_vectors(sounding[0])
    if expected > MOST_VECTORS:
        return f"the focus rests at {points_a_turn(config)} points in turn, which needs about {expected} vectors"
    turn = period_s(config)
    if turn is None:
        return f"path and modulation repeat together only after more than {MOST_TURNS} turns"
    if samples(config, turn, layer.demand.max_frequency_Hz) > MOST_SAMPLES:
        return f"the load repeats only after {turn:.3g} s"
    return None


def expected_vectors(stimulus: StimulusModel) -> int:
    """Return the expected number of vectors of the model. The estimate comes from the shipped scenes."""
    if one_shape(stimulus):
        return 60
    config = stimulus.config
    rate = turn_rate_Hz(config)
    points = points_a_turn(config)
    if points and rate and REST_S * rate * points < 1.0:
        return 60 * points
    return 100 if config.stop_s is None else 200


def one_shape(stimulus: StimulusModel) -> bool:
    """Return whether the load is one field in which only the level changes."""
    response = stimulus.response
    alike = not response.on or (not response.delayed and np.ptp(np.abs(response.pole.rate)) == 0.0)
    return stimulus.config.path == "point" and alike


def has_path(model: HapticModel) -> bool:
    """Return whether one stimulus moves along a predicted path while bodies are expected to stay at rest."""
    reduced = not all(skin.choice.solver.any_pose for skin in model.skins)
    if not reduced or one_shape(model.stimuli[model.sounding]):
        return False
    return model.free and model.arrays.field.device == "cpu"


def period_s(config: StimulusConfig) -> float | None:
    """Return the period after which focus and level repeat together [s]. None if it is longer than MOST_TURNS turns."""
    path = turn_rate_Hz(config)
    modulated = am_period_s(config)
    wave = None if modulated is None else 1.0 / modulated
    if path is None or wave is None:
        return 1.0 / (path or wave or 200.0)
    ratio = Fraction(wave / path).limit_denominator(MOST_TURNS)
    return ratio.denominator / path if math.isclose(float(ratio) * path, wave, rel_tol=1e-9) else None


def samples(config: StimulusConfig, turn_s: float, max_frequency_Hz: float) -> int:
    """Return the number of load samples per period for harmonics up to BAND, equal for all fixed points of a path."""
    points = max(points_a_turn(config), 1)
    band = BAND * (2.0 if points > 1 else 1.0) * max_frequency_Hz
    return points * math.ceil(max(32, 4 * math.ceil(band * turn_s)) / points)


# -- the load and its model ----------------------------------------------------------------------------------------


def known_stepper(model: HapticModel, skin: int) -> ReducedStepper:
    """Return the reduced model for the predicted load.

    Its parts are cached under the inputs of the load, so a later run need not compute the load. Its vectors are cached
    under the load itself, for use at any level. Raises SceneError like `reduced_stepper`.
    """
    part = model.skins[skin]
    layer, posed = part.layer, reference_scene(model)
    focus = posed.skins[skin].body.frame.inverse_points(model.stimuli[model.sounding].first_focus)
    step_s, inputs = layer.sizes.step_s, layer.quadrature.operator
    reads = layer.surface_operator, layer.probe(focus).operator
    targets = step_s, layer.demand.max_frequency_Hz, SHARE * part.spec.config.accuracy
    fresh: list[ReducedStepper] = []

    def make() -> cache.Arrays:
        load, examples = known_load(model, skin, posed)
        with one_blas_thread:
            shapes = load_shapes(examples, layer.quadrature.weights, OMITTED)
        del examples  # a third of a gigabyte
        fresh.append(reduced_stepper(layer.system, load, *reads, inputs, *targets, shapes))
        marks = {"load": np.array(cache.digest(load)), "vectors": np.array(cache.digest(fresh[0].vectors))}
        return marks | {"points": shapes.points, "shares": fresh[0].shares}

    arrays = posed.arrays
    depends_on = (
        *(replace(model.spec, duration_s=0.0), skin, model.response_on, layer.demand, layer.sizes, focus),
        *(arrays.array, arrays.air, arrays.placements, layer.system.made_of, inputs),
        *(layer.quadrature.weights, [(body.vertices_in_array, body.faces) for body in posed.bodies], *reads, *targets),
    )
    stored = cache.kept("known-load", depends_on, make)
    if fresh:
        return fresh[0]
    small, vectors, error, any_course = known_model(
        layer.system, str(stored["load"]), lambda: known_load(model, skin, posed)[0], *reads, *targets
    )
    if cache.digest(vectors) != str(stored["vectors"]):
        # The vectors were recomputed, perhaps on another machine, so the stored shares do not belong to them
        make()
        return fresh[0]
    return ReducedStepper(small, vectors, stored["shares"], stored["points"], step_s, error, any_course)


def known_load(model: HapticModel, skin: int, posed: PosedScene) -> tuple[KnownLoad, Float32]:
    """Return the load of the single active stimulus on a skin in a constant pose, and the pressures of this load.

    The pressures are at the quadrature points [Pa], shape (t, q).
    """
    number = model.sounding
    stimulus, radiation = model.stimuli[number], Radiation(model)
    config, layer = stimulus.config, model.skins[skin].layer
    operator = layer.quadrature.operator
    start, step = config.start_s, layer.sizes.step_s
    if one_shape(stimulus):
        config = at_end_of_band(config, layer.demand.max_frequency_Hz)
    turn = period_s(config) or 0.0
    trial: Float = step * np.arange(round(min(max(TRIAL_S, turn), LONGEST_TRIAL_S) / step) + 1, dtype=np.float64)
    if one_shape(stimulus):
        loudness = posed.focal_points(stimulus, number).loudness(first_point(config))
        drive = array_drives(model, posed.arrays)[number].unit_drive(stimulus.reference_foci, loudness)
        pressures = radiation.many(posed, skin, at_full_level(drive.amplitudes[None])[0])
        shape: Float = operator @ pressures.T
        lines = [0.0, *(main_frequencies(config) or [layer.demand.main_frequency_Hz])]
        spectrum: list[tuple[float, Complex]] = [(f, np.ones(1, complex)) for f in dict.fromkeys(lines)]
        shares = [frames_at(config, start + trial)[1][:, None]]
        return KnownLoad(shape, shape, shares, spectrum, _tones(config)), pressures
    count = samples(config, turn, layer.demand.max_frequency_Hz)
    skip = math.ceil(_settling_s(stimulus) * count / turn)
    drives, level_of = at_full_level(steady_drives(model, number, posed, turn / count, skip, count))
    pressures = radiation.many(posed, skin, drives)
    # The parts of the load need a finer tolerance than its relevant harmonics
    closer = min(max(MOST_EXAMPLES // count, LEAST_CLOSER), CLOSER)
    close = steady_drives(model, number, posed, turn / (closer * count), closer * skip, closer * count)
    examples = radiation.many(posed, skin, close)
    loads: Float = (operator @ pressures.T).T
    waves = np.conj(np.fft.rfft(loads, axis=0)[: count // 4 + 1].T) / count
    waves[:, 1:] *= 2.0
    frequencies = np.arange(waves.shape[1]) / turn
    size = np.linalg.norm(waves, axis=0)
    strong = size > SMALLEST * size.max()
    # Samples begin at `skip`, but the load is needed from the start of the sound
    shift = np.exp(2j * np.pi * frequencies * skip * turn / count)
    frequencies, waves = frequencies[strong], (waves * shift)[:, strong]
    # The ARP is proportional to the square of the emission.
    g = float(stimulus.response.pole.damping.min()) if model.response_on else math.inf
    begin: Fade = ((0.0, 1.0), (g, -2.0), (2.0 * g, 1.0)) if model.response_on else ((0.0, 1.0),)
    end: Fade = ((0.0, -1.0), (2.0 * g, 1.0)) if model.response_on else ((0.0, -1.0),)
    events = [(0.0, begin)]
    if config.stop_s is not None:
        events.append((config.stop_s - start, end))
    course = periodic(waves, frequencies, events)
    trials: list[Float] = [level(fade, trial)[:, None] * harmonics(frequencies, time + trial) for time, fade in events]
    pair = np.array([1.0, -1j])
    spectrum = [(float(f), np.kron(np.eye(len(frequencies) + 1)[k], pair)[:-1]) for k, f in enumerate(frequencies)]
    # Difference between the start and the periodic course, as one impulse spread over the trial.
    impulse = np.zeros(len(course.shapes))
    if model.response_on:
        width = _settling_s(stimulus) / BEGINNING
        drives, _ = at_full_level(steady_drives(model, number, posed, width, 0, BEGINNING), level_of)
        beginning = radiation.many(posed, skin, drives)
        close = steady_drives(model, number, posed, width / BEGIN_CLOSER, 0, BEGIN_CLOSER * BEGINNING)
        examples = np.concatenate([examples, radiation.many(posed, skin, close)])
        difference: Float = (operator @ beginning.T).T
        moments: Float = width * np.arange(BEGINNING, dtype=np.float64)
        difference -= (level(begin, moments)[:, None] * harmonics(frequencies, moments)) @ course.shapes.T
        impulse = width / trial[-1] * difference.sum(axis=0)
        spectrum += [(float(f), np.eye(2 * len(frequencies) + 1)[-1].astype(complex)) for f in frequencies]
    shapes = np.column_stack([course.shapes, impulse])
    shares = [np.column_stack([part, np.zeros(len(trial))]) for part in trials]
    return KnownLoad(course, shapes, shares, spectrum), examples


def _tones(config: StimulusConfig) -> list[tuple[Float, Complex]]:
    """Return the first two spectral lines of a modulation at TONES frequencies of the stimulus's band."""
    lines, highest_Hz = arp_lines(config), config.am_frequency_Hz
    if lines is None or highest_Hz is None:
        return []
    harmonics_Hz, shares = highest_Hz * np.array([1.0, 2.0]), np.array(lines[1:], dtype=complex)
    return [(k / TONES * harmonics_Hz, shares) for k in range(1, TONES + 1)]


def at_end_of_band(config: StimulusConfig, highest_Hz: float) -> StimulusConfig:
    """Return a stimulus with its modulation at the highest frequency of the band.

    All frequencies of the band then share one model, if the load has a constant shape. highest_Hz: of mesh and step
    """
    if config.modulation == "none" or config.am_frequency_Hz is None or config.am_waveform == "burst":
        return config
    # Key max_frequency_Hz may be lower than the frequencies of the load
    share = max(highest_Hz / max(main_frequencies(config)), 1.0)
    return config.model_copy(update={"am_frequency_Hz": round(share * config.am_frequency_Hz, DIGITS)})


def _settling_s(stimulus: StimulusModel) -> float:
    """Return the duration of ring-up [s]; 0 without ring-up."""
    response = stimulus.response
    if not response.on:
        return 0.0
    return float(SETTLED / response.pole.damping.min() + 2.0 * np.abs(response.delays_s).max())


def steady_drives(model: HapticModel, number: int, posed: PosedScene, step_s: float, skip: int, count: int) -> Complex:
    """Return the emission at `count` times from the start of the sound, after the first `skip` times, shape (count, N).

    Only the periodic part of the stimulus is used, without ramp and end.
    """
    stimulus = model.stimuli[number]
    steady = stimulus.config.model_copy(update={"ramp_s": 0.0, "stop_s": None})
    drive, places = array_drives(model, posed.arrays)[number], posed.focal_points(stimulus, number)
    times: Float = steady.start_s + step_s * np.arange(skip + count, dtype=np.float64)
    delays_s = stimulus.response.delays_s if model.response_on else None
    commanded = commanded_drive(steady, drive, delays_s, times, places)
    if not model.response_on:
        return commanded[skip:]
    emitted = np.zeros_like(commanded)
    decay, before, after = stimulus.response.stepper.weights(step_s)
    for k in range(1, len(times)):
        emitted[k] = decay * emitted[k - 1] + before * commanded[k - 1] + after * commanded[k]
    return emitted[skip:]


def path_drives(model: HapticModel, posed: PosedScene) -> Complex:
    """Return the emission along the path of the active stimulus, which is periodic, shape (m, N).

    These drives span all other drives of the stimulus, including those during ring-up.
    """
    number = model.sounding
    config, settling = model.configs[number], _settling_s(model.stimuli[number])
    turn = period_s(config) or 0.0
    count = SPAN_CLOSER * samples(config, turn, max(skin.layer.demand.max_frequency_Hz for skin in model.skins))
    emitted = steady_drives(model, number, posed, turn / count, math.ceil(settling * count / turn), count)
    if not model.response_on:
        return emitted
    moments = SPAN_CLOSER * BEGINNING
    beginning = steady_drives(model, number, posed, settling / moments, 0, moments)
    return np.concatenate([emitted, beginning])


def at_full_level(drives: Complex, level_of: float | None = None) -> tuple[Complex, float]:
    """Return drives divided by a level, that of the loudest transducer by default, and the level.

    A model is valid for its load at any level. Drives that are divided by the level and rounded give the same cache key
    for all levels.
    """
    level_of = level_of or float(np.abs(drives).max()) or 1.0
    return np.round(drives / level_of, DIGITS), level_of
