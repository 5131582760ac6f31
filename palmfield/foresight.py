"""Loads that are known ahead while neither body nor arrays move.

A path needs a new field at every step of the skin. What will be emitted is known, and on points that keep still many
drives cost little more than a few: see `palmfield.acoustics.transfer`. And a skin whose load is known needs a small
model only: here is decided whether a scene's skin takes one, and what that model is made for.
"""

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from palmfield.acoustics.field import FieldEvaluator
from palmfield.acoustics.transfer import MATRIX_FROM, arp_frames
from palmfield.config import StimulusConfig
from palmfield.drive.response import pole_step
from palmfield.emission import asked
from palmfield.skin.reduction.krylov import Fade, harmonics, level, periodic
from palmfield.skin.reduction.stepping import MOST_VECTORS, KnownLoad
from palmfield.stimulus.schedule import frame_at, frames_at, is_closed, main_frequencies, repeats, turn_rate_Hz
from palmfield.types import Complex, Float, Float32

if TYPE_CHECKING:
    from palmfield.chain import Chain
    from palmfield.engine.pose import Pose
    from palmfield.rig import Rig

STEPS = 128
"""Steps of the skin that are looked ahead; a move throws away what was computed for them."""
SHARE = 0.1
"""Of the wanted accuracy that reducing the skin may cost."""
STILL = 0.05
"""A body or focus that moves by less than this part of accuracy times spot width counts as still: the load then is off
by less than a tenth of the accuracy (displacement over standard deviation, over sqrt 2)."""
MOST_TURNS = 4
"""Turns of a path in which its modulation must come round."""
BAND = 2.5
"""Of the highest frequency that mesh and step resolve: harmonics of a load that a model is made for."""
TRIAL_S, LONGEST_TRIAL_S = 0.03, 0.1
"""Time of the load under which models are compared [s], and at most for a load that comes round more slowly."""
REST_S = 2.5e-3
"""A focus that rests longer than this at each point of its path is as many loads, and no smooth course [s]."""
MOST_SAMPLES = 1024
SMALLEST = 1e-4
"""Of the largest harmonic of a load: smaller ones are left out of what a model is made for."""
BEGINNING = 48
"""Moments at which the load is looked at while the transducers ring up."""
SETTLED = 12.0
"""Transducers are rung up after this over their damping."""
# Measured on one core of a server CPU (docs/bench/scenes.md): seconds a step and unknown, and of one factorisation
SOLVE_S = 1.7e-6
REDUCED_STEP_S = 1e-3

SAME_DRIVE = 1e-9
"""Of full drive: MuJoCo adds up its time, so that what comes differs from what was foreseen in the last digits."""


class Foresight:
    """ARP for coming drives at the points of a skin at which it is integrated.

    until: simulated time up to which drives were foreseen [s]
    """

    def __init__(self, rig: "Rig"):
        self.rig = rig
        self.until = -math.inf
        self._pose: Pose | None = None
        self._drives: Complex = np.zeros((0, 0), complex)
        self._loads: Float32 = np.zeros((0, len(rig.quadrature.weights)), np.float32)

    def knows(self, pose: "Pose", t: float) -> bool:
        """Whether drives at time t [s] were foreseen for this pose."""
        return self._pose is not None and t < self.until and self._pose.same(pose)

    def fill(self, pose: "Pose", until: float, evaluator: FieldEvaluator, drives: list[Complex]) -> None:
        """Compute what the drives until a time [s] will do; nothing where they are too few for that to pay."""
        self._pose, self.until = pose, until
        unlike = list({drive.tobytes(): drive for drive in drives}.values())
        self._drives = np.array(unlike if len(unlike) >= MATRIX_FROM else [])
        if len(self._drives):
            points, normals = self.rig.posed(pose).quadrature
            law = self.rig.skin.arp_law
            self._loads = arp_frames(evaluator, pose.points(points), normals @ pose.turn.T, self._drives, law=law)

    def take(self, pose: "Pose", drive: Complex) -> Float32 | None:
        """ARP [Pa] for this drive, shape (n,), or None where it was not foreseen."""
        if self._pose is None or len(self._drives) == 0 or not self._pose.same(pose):
            return None
        away = np.abs(self._drives - drive).max(axis=1)
        row = int(away.argmin())
        return self._loads[row] if away[row] < SAME_DRIVE else None


@dataclass(frozen=True)
class Choice:
    """Which solver steps a scene's skin: "full" or "reduced".

    why: in words; full_s, reduced_s: predicted seconds of making and stepping, the latter None where it can't
    """

    name: str
    why: str
    full_s: float
    reduced_s: float | None

    @property
    def seconds(self) -> float:
        """Predicted for the solver that was chosen."""
        return self.full_s if self.name == "full" or self.reduced_s is None else self.reduced_s


def factor_s(dofs: float) -> float:
    """Seconds of one real factorisation, fitted to docs/bench/skin_c0.md; a complex one takes twice as long."""
    return 1.3e-7 * dofs**1.7


def choice(rig: "Rig") -> Choice:
    """Choose by key `solver`, by what can be reduced, and by predicted time. Raises nothing."""
    steps = rig.duration_s / rig.sizes[4]
    full_s = factor_s(rig.dofs) + SOLVE_S * rig.dofs * steps
    reason = refusal(rig)
    if reason is not None:
        return Choice("full", f"no small model: {reason}", full_s, None)
    reduced_s = factor_s(rig.dofs) + 1.5 * SOLVE_S * rig.dofs * expected_vectors(rig) + REDUCED_STEP_S * steps
    asked = rig.skin.solver
    if asked != "auto":
        return Choice(asked, "asked for", full_s, reduced_s)
    name = "reduced" if reduced_s < full_s else "full"
    return Choice(name, f"the load is known ahead; about {reduced_s:.1f} s against {full_s:.1f} s", full_s, reduced_s)


def refusal(rig: "Rig") -> str | None:
    """Why the skin can't be reduced for this stimulus, in words, or None."""
    if rig.skin.solver == "full":
        return "solver 'full' is asked for"
    if rig.setting.moves:
        return "a hand is moved by script"
    if rig.silent:
        return "the stimulus is silent"
    if one_shape(rig):
        return None
    if not repeats(rig.stimulus):
        return "bursts, or a path that runs once, don't come round"
    if rig.stimulus.path == "letters" or (rig.stimulus.path_end == "jump" and not is_closed(rig.stimulus)):
        return "the focus jumps from one end of its path to the other"
    if rig.stimulus.path != "point" and rig.stimulus.control_rate_Hz > 0.0:
        return "control_rate_Hz holds the focus at moments that don't come round with the path"
    expected = expected_vectors(rig)
    if expected > MOST_VECTORS:
        return f"the focus rests at {rig.stimulus.path_points} points in turn, which takes about {expected} vectors"
    turn = period_s(rig.stimulus)
    if turn is None:
        return f"path and modulation come round together after more than {MOST_TURNS} turns"
    if samples(rig, turn) > MOST_SAMPLES:
        return f"the load comes round after {turn:.3g} s only"
    return None


def expected_vectors(rig: "Rig") -> int:
    """About how many vectors the model will have, as seen on the shipped scenes."""
    if one_shape(rig):
        return 60
    stimulus = rig.stimulus
    rate = turn_rate_Hz(stimulus)
    if stimulus.path_points and rate and REST_S * rate * stimulus.path_points < 1.0:
        return 60 * stimulus.path_points
    return 100 if stimulus.stop_s is None else 200


def one_shape(rig: "Rig") -> bool:
    """Whether the load is one field whose level alone changes."""
    response = rig.response
    alike = not response.on or (not response.delays_s.any() and np.ptp(np.abs(response.pole.rate)) == 0.0)
    return rig.stimulus.path == "point" and alike


def period_s(stimulus: StimulusConfig) -> float | None:
    """Time after which focus and level are the same again [s]; None where that takes more than MOST_TURNS turns."""
    path = turn_rate_Hz(stimulus)
    wave = stimulus.am_frequency_Hz if stimulus.modulation == "am" else None
    if path is None or wave is None:
        return 1.0 / (path or wave or 200.0)
    ratio = Fraction(wave / path).limit_denominator(MOST_TURNS)
    return ratio.denominator / path if math.isclose(float(ratio) * path, wave, rel_tol=1e-9) else None


def samples(rig: "Rig", turn_s: float) -> int:
    """Loads to be computed over one period, for harmonics up to BAND, as many to each held point of a path."""
    points = max(rig.stimulus.path_points, 1)
    band = BAND * (2.0 if points > 1 else 1.0) * rig.max_frequency_Hz
    return points * math.ceil(max(32, 4 * math.ceil(band * turn_s)) / points)


def known_load(chain: "Chain", pose: "Pose") -> KnownLoad:
    """What the stimulus does to the skin of a body in a pose that it keeps."""
    rig = chain.rig
    start, step = rig.stimulus.start_s, rig.sizes[4]
    turn = period_s(rig.stimulus) or 0.0
    trial: Float = step * np.arange(round(min(max(TRIAL_S, turn), LONGEST_TRIAL_S) / step) + 1)
    if one_shape(rig):
        first = frame_at(rig.stimulus, rig.stimulus.start_s).focus
        shape = chain.sound(rig.reference_aim(first), pose).skin_force[:, None]
        lines = [0.0, rig.main_frequency_Hz, *main_frequencies(rig.stimulus)]
        found: list[tuple[float, Complex]] = [(f, np.ones(1, complex)) for f in dict.fromkeys(lines)]
        return KnownLoad(shape, shape, [frames_at(rig.stimulus, start + trial)[1][:, None]], found)
    count = samples(rig, turn)
    skip = math.ceil(_settling_s(rig) * count / turn)
    loads = _loads(chain, pose, rehearse(rig, pose, turn / count, skip, count))
    waves = np.conj(np.fft.rfft(loads, axis=0)[: count // 4 + 1].T) / count
    waves[:, 1:] *= 2.0
    frequencies = np.arange(waves.shape[1]) / turn
    size = np.linalg.norm(waves, axis=0)
    kept = size > SMALLEST * size.max()
    # Sampled from `skip` on, wanted from the start of the sound
    late = np.exp(2j * np.pi * frequencies * skip * turn / count)
    frequencies, waves = frequencies[kept], (waves * late)[:, kept]
    # The ARP goes with the square of what the transducers emit.
    g = float(rig.response.pole.damping.min()) if rig.response.on else math.inf
    begin: Fade = ((0.0, 1.0), (g, -2.0), (2.0 * g, 1.0)) if rig.response.on else ((0.0, 1.0),)
    end: Fade = ((0.0, -1.0), (2.0 * g, 1.0)) if rig.response.on else ((0.0, -1.0),)
    events = [(0.0, begin)]
    if rig.stimulus.stop_s is not None:
        events.append((rig.stimulus.stop_s - start, end))
    course = periodic(waves, frequencies, events)
    trials: list[Float] = [level(fade, trial)[:, None] * harmonics(frequencies, time + trial) for time, fade in events]
    pair = np.array([1.0, -1j])
    found = [(float(f), np.kron(np.eye(len(frequencies) + 1)[k], pair)[:-1]) for k, f in enumerate(frequencies)]
    # What the beginning differs from the course, as one impulse spread over the trial.
    span = _settling_s(rig)
    impulse = np.zeros(len(course.shapes))
    if rig.response.on:
        width = span / BEGINNING
        apart = _loads(chain, pose, rehearse(rig, pose, width, 0, BEGINNING))
        moments: Float = width * np.arange(BEGINNING, dtype=np.float64)
        apart -= (level(begin, moments)[:, None] * harmonics(frequencies, moments)) @ course.shapes.T
        impulse = width / trial[-1] * apart.sum(axis=0)
        found += [(float(f), np.eye(2 * len(frequencies) + 1)[-1].astype(complex)) for f in frequencies]
    shapes = np.column_stack([course.shapes, impulse])
    return KnownLoad(course, shapes, [np.column_stack([shares, np.zeros(len(trial))]) for shares in trials], found)


def _settling_s(rig: "Rig") -> float:
    """Time after which the transducers are rung up [s]; 0 where they do so at once."""
    response = rig.response
    return float(SETTLED / response.pole.damping.min() + 2.0 * np.abs(response.delays_s).max()) if response.on else 0.0


def rehearse(rig: "Rig", pose: "Pose", step_s: float, skip: int, count: int) -> Complex:
    """What is emitted at `count` times after the first `skip`, from the start of the sound on, (count, n).

    The stimulus is that without ramp and end: what comes round.
    """
    steady = rig.stimulus.model_copy(update={"ramp_s": 0.0, "stop_s": None})
    emitter, response = rig.emitter(pose.arrays), rig.response
    drives = (
        asked(steady, emitter, response.delays_s, steady.start_s + k * step_s, rig.reference_aim)
        for k in range(skip + count)
    )
    if not response.on:
        return np.array(list(drives)[skip:])
    before = next(drives)
    found = [np.zeros(len(rig.array), complex)]
    for after in drives:
        found.append(pole_step(found[-1], before, after, response.pole, step_s))
        before = after
    return np.array(found[skip:])


def _loads(chain: "Chain", pose: "Pose", drives: Complex) -> Float:
    """Consistent nodal forces on the skin [N] of drives (f, n), shape (f, ndof)."""
    rig = chain.rig
    points, normals = rig.posed(pose).quadrature
    if rig.skin.body_sound == "none" and chain.one_fast_kernel:
        evaluator = rig.emitter(pose.arrays).evaluator.evaluators[0]
        pressures = arp_frames(evaluator, pose.points(points), normals @ pose.turn.T, drives, law=rig.skin.arp_law)
    else:
        pressures = np.array([chain.arp_at(points, normals, pose, drive)[0] for drive in drives])
    return np.array([rig.quadrature.assemble(row) for row in pressures])
