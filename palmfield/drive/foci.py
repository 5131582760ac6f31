"""Drives for several simultaneous foci, each with a target loudness relative to the others.

A drive a makes the pressures p = H a at the foci, with transfer matrix H. All methods search phases of p for which the
array produces all foci well. They differ in the search, and in whether transducers may be driven below full. The result
is determined up to a common phase of all transducers; `in_gauge` fixes it, so that the drive moves with the foci.
"""

import dataclasses
from collections.abc import Callable
from functools import partial
from typing import Literal, get_args

import numpy as np
import scipy  # loads its submodules at first use
from numpy.typing import ArrayLike
from scipy.special import logsumexp, softmax

from palmfield.acoustics import check
from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.reference import directivity
from palmfield.blas import one_blas_thread
from palmfield.errors import SceneError
from palmfield.types import Air, Array, Complex, Float

Method = Literal["naive", "gs", "gsw", "lbfgs", "tikhonov"]
ITERATIONS: dict[Method, int] = {"naive": 0, "gs": 2, "gsw": 80, "lbfgs": 300, "tikhonov": 0}
"""Default limit of iterations of each method; the first and last method are direct."""

MOST_ITERATIONS = 100_000
COINCIDENT_WAVELENGTHS = 0.01
"""Distance of foci below which they cannot be separated, because their rows of the transfer matrix are parallel."""

REGULARISATION = 0.01
"""Tikhonov parameter of method "tikhonov", relative to the mean squared row norm of the transfer matrix."""

FAINT = 0.01
"""Pressure of a focus, relative to the loudest focus, below which it does not set the common phase of a drive."""

RELAXATION = 0.4
"""Power of the correction of the weights in "gsw".

At 1, as published, the louder focus alternated for ever for half of all pairs of foci of 256 transducers; at 0.6 for
one pair in fifty, at 0.4 for none of 400. More than two foci converge at all these values, slightly faster at 1.
"""

FREE = 2
"""Number of iterations of "gsw" that may change the phases of foci; the rest change only weights. "gs" ends then.

If all iterations change phases, close poses may end at different optima, and the drive jumps. Jumps (relative changes
above 0.15) in 5,712 steps of 20 um of 2 to 5 foci: "gs" 52 with 50 iterations (largest 1.5), 22 with 2 iterations
(0.28). The 2 iterations cost up to 0.6 % of the mean pressure (7 % of the quietest of 16 foci). "gsw": 0 in the half of
the steps used for this choice (before: 45), 14 in the other half (0.27); its initial phases without iterations: 12
(0.2). "naive", "tikhonov": 0 of 4,284. "lbfgs": 14 of 720 (0.58). Two of 256 transducers that change by pi give 0.18.
"""

SHARPNESS = (10.0, 40.0, 160.0, 640.0)
"""Sharpness of the soft minimum that "lbfgs" maximises, by stage; the last differs from the minimum by ln(m)/640."""


@dataclasses.dataclass(frozen=True)
class Foci:
    """A drive for m foci and its pressures.

    drive: complex amplitudes, |a| <= 1, shape (n,); 0 where a transducer is dead
    pressure: complex peak pressure at the foci [Pa], shape (m,)
    targets: target |pressure|, relative, shape (m,)
    bound_Pa: |pressure| of a single focus at each place, an upper bound at |a| <= 1, shape (m,)
    iterations: number of iterations
    residual: `misfit` before the first and after each iteration, shape (iterations + 1,); the last is that of `drive`
    """

    drive: Complex
    pressure: Complex
    targets: Float
    bound_Pa: Float
    iterations: int
    residual: Float

    @property
    def magnitude_Pa(self) -> Float:
        """Peak pressure at the foci [Pa], shape (m,)."""
        return np.abs(self.pressure)

    @property
    def uniformity(self) -> float:
        """Smallest over largest |p|/target; it is 1 if every focus has its relative target loudness."""
        ratio = self.magnitude_Pa / self.targets
        return float(ratio.min() / ratio.max())

    @property
    def level(self) -> float:
        """Mean of |p| over that of a single focus; at most about 1/sqrt(m) for m equal foci that do not overlap."""
        return float(np.mean(self.magnitude_Pa / self.bound_Pa))

    @property
    def power(self) -> float:
        """Mean |a|^2 over the transducers; 1 if all are driven fully."""
        return float(np.mean(np.abs(self.drive) ** 2))


def transfer64(points: ArrayLike, array: Array, air: Air) -> Complex:
    """Return the complex peak pressure [Pa] at each point from each transducer alone at full drive, in float64.

    transfer64(points, array, air) @ drive is pressure64(points, array, drive, air) to rounding. The formula is the
    same, with gain and directivity of the array and absorption of the air, but without the sum.

    points: [m], array frame, shape (m, 3)
    Returns shape (m, n), complex128, n transducers.
    Raises PalmfieldError for NaN, infinity or a wrong shape in points, SceneError for a bad array or air.
    """
    check.array(array)
    rays = check.points(points, np.float64)[:, None, :] - array.positions
    k = 2.0 * np.pi * array.frequency_Hz / sound_speed(air)
    beta = absorption_Np_m(air, array.frequency_Hz)
    d = np.maximum(np.linalg.norm(rays, axis=2), 1e-9)
    cosine = np.einsum("ijk,jk->ij", rays, array.normals) / d
    strength = array.p0_Pa_m * (np.ones(len(array)) if array.gain is None else array.gain)
    return np.where(cosine > 0.0, strength * directivity(array, k, cosine) / d * np.exp((1j * k - beta) * d), 0.0)


def solve_foci(
    points: ArrayLike,
    array: Array,
    air: Air,
    *,
    amplitudes: ArrayLike | None = None,
    method: Method = "gsw",
    iterations: int | None = None,
    seed: int = 0,
) -> Foci:
    """Return a drive for several foci in front of an array. Dead and inverted transducers (array.gain) are included.

    points: the foci [m], array frame, shape (m, 3)
    amplitudes: relative target |p| of each focus, shape (m,), positive; None: equal
    method: see `solve_transfer`
    iterations: largest number of iterations; None: ITERATIONS[method]
    seed: seed of the random phases of "naive"
    Raises PalmfieldError for points that are not finite or not (m, 3), SceneError for foci behind a transducer,
    coincident foci, more foci than live transducers, bad amplitudes, method or iterations.
    """
    where = check.points(points, np.float64)
    check.array(array)
    for i, point in enumerate(where):
        check.in_front(array, point, f"focus {i} at {point.tolist()}")
    closest = COINCIDENT_WAVELENGTHS * sound_speed(air) / array.frequency_Hz
    for i in range(1, len(where)):
        distances = np.linalg.norm(where[:i] - where[i], axis=1)
        j = int(distances.argmin())
        if distances[j] < closest:
            raise SceneError(
                f"foci {j} and {i} are {distances[j]:.3g} m apart; allowed: at least {closest:.3g} m: remove one "
                "of them"
            )
    return solve_transfer(
        transfer64(where, array, air), amplitudes=amplitudes, method=method, iterations=iterations, seed=seed
    )


def solve_transfer(
    transfer: Complex,
    *,
    amplitudes: ArrayLike | None = None,
    method: Method = "gsw",
    iterations: int | None = None,
    seed: int = 0,
) -> Foci:
    """Return the same as `solve_foci` for a given transfer matrix, in float64 or float32.

    method:
        "naive": the sum of the single foci with random phases, its amplitude set to 1 ("SR" of Di Leonardo)
        "gs": Gerchberg-Saxon between the magnitudes of foci and drive (Di Leonardo et al. 2007); more iterations than
            FREE give slightly more pressure, but drives of moving foci may jump
        "gsw": the same with weights for the target loudness of the foci (the same paper), phases fixed after FREE
        "lbfgs": phases that maximise the quietest focus, by L-BFGS on a soft minimum with its exact gradient;
            not for moving foci: one in fifty steps of 20 um made the drive jump
        "tikhonov": amplitudes and phases, by regularised least squares (after Long et al. 2014), scaled to max |a| = 1
    The first four drive every live transducer fully. All but the first begin with the phases of `reinforcing_phases`.
    The common phase of the drive is that of `in_gauge`.

    transfer: complex pressure from each transducer at full drive [Pa], shape (m, n)
    Raises SceneError for a transfer matrix of another shape or not finite, more foci than live transducers, bad
    amplitudes, method or iterations.
    Sources: R. Di Leonardo, F. Ianni, G. Ruocco, Opt. Express 15, 1913 (2007); B. Long, S. A. Seah, T. Carter,
    S. Subramanian, ACM Trans. Graph. 33(6), 181 (2014).
    """
    matrix = check.numbers(transfer, "transfer").astype(np.complex128)
    if matrix.ndim != 2:
        raise SceneError(f"transfer has shape {matrix.shape}: give (foci, transducers)")
    if not np.isfinite(matrix).all():
        raise SceneError(f"transfer[{check.first_bad(matrix)}] is not finite: correct the pressures of that focus")
    live = np.any(matrix != 0.0, axis=0)
    targets = _targets(amplitudes, len(matrix))
    if len(matrix) == 0:
        raise SceneError("the list of foci is empty: give 1 or more")
    if len(matrix) > live.sum():
        raise SceneError(f"{len(matrix)} foci for {live.sum()} live transducers: give at most {live.sum()} foci")
    if method not in get_args(Method):
        raise SceneError(f"method '{method}' is unknown: use one of {', '.join(get_args(Method))}")
    count = ITERATIONS[method] if iterations is None else iterations
    if not 0 <= count <= MOST_ITERATIONS or count != int(count):
        raise SceneError(f"iterations = {count}; allowed: a whole number from 0 to {MOST_ITERATIONS}")
    count = int(count)
    if method == "naive":
        phases = np.exp(2j * np.pi * np.random.default_rng(seed).random(len(matrix)))
    else:
        phases = reinforcing_phases(matrix, targets)
    part, residual = SOLVERS[method](matrix[:, live], targets, phases, count)
    drive = np.zeros(matrix.shape[1], np.complex128)
    drive[live] = in_gauge(matrix[:, live], part)
    return Foci(drive, matrix @ drive, targets, np.abs(matrix).sum(axis=1), len(residual) - 1, np.array(residual))


def together(transfer: Complex, pressures: Float | None = None) -> Complex:
    """Return the drive by "gsw" for simultaneous foci, shape (n,), as `solve_transfer` without its checks.

    transfer: complex pressure from each transducer at full drive [Pa], shape (m, n), already checked
    pressures: targets relative to the others, above 0, shape (m,); None for equally loud foci
    """
    targets = np.ones(len(transfer)) if pressures is None else pressures
    live = np.logical_or.reduce(transfer != 0.0, axis=0)
    matrix = transfer[:, live]
    drive = np.zeros(transfer.shape[1], np.complex128)
    phases = reinforcing_phases(matrix, targets)
    matched, _ = _gerchberg_saxon(matrix, targets, phases, ITERATIONS["gsw"], weighted=True)
    drive[live] = in_gauge(matrix, matched)
    return drive


def in_gauge(matrix: Complex, drive: Complex) -> Complex:
    """Return a drive, (n,), with the common phase for which the pressure at the first focus is real and positive.

    If the first focus is FAINT, the first focus that is not FAINT replaces it. Magnitudes do not depend on this phase.
    But with ring-up the phase must depend only on the present foci, and the phase of an eigenvector depends on
    rounding.
    matrix: complex pressure at the foci from each transducer at full drive [Pa], shape (m, n)
    """
    pressure = matrix @ drive
    magnitude = np.abs(pressure)
    first = int(np.argmax(magnitude >= FAINT * np.maximum.reduce(magnitude)))
    return drive * np.exp(-1j * np.arctan2(pressure[first].imag, pressure[first].real))


def _targets(amplitudes: ArrayLike | None, count: int) -> Float:
    targets = np.ones(count) if amplitudes is None else np.asarray(amplitudes, np.float64)
    if targets.shape != (count,):
        raise SceneError(f"amplitudes have shape {targets.shape} for {count} foci: give ({count},)")
    if not np.all((targets > 0.0) & np.isfinite(targets)):
        i = int(np.argmin((targets > 0.0) & np.isfinite(targets)))
        raise SceneError(f"amplitudes[{i}] = {targets[i]} is not positive and finite: give a relative pressure above 0")
    return targets


def misfit(pressure: Complex, targets: Float) -> float:
    """Return the standard deviation of |p|/target over the foci, relative to the mean."""
    ratio = np.abs(pressure) / targets
    mean = np.add.reduce(ratio) / len(ratio)
    deviation = ratio - mean
    return float(np.sqrt(np.add.reduce(deviation * deviation) / len(ratio)) / mean)


def unit(values: Complex) -> Complex:
    """Return the phase factors of complex values; 1 for 0."""
    return np.exp(1j * np.arctan2(values.imag, values.real))


def reinforcing_phases(matrix: Complex, targets: Float) -> Complex:
    """Return the phase factors for which single foci add most to each other, shape (m,) (Long et al. 2014).

    G = H H* and W = diag(target_k/G_kk). Row i, column k of G W is the pressure at focus i of a single focus at k with
    target k. The dominant eigenvector comes from the Hermitian form of this problem. From these phases, "gsw" ends
    about as loud as from the best of ten random starts (docs/bench/foci.md).
    """
    leading = leading_vector(matrix, targets)
    return np.exp(1j * np.arctan2(leading.imag, leading.real))


def leading_vector(matrix: Complex, targets: Float) -> Complex:
    """Return the eigenvector of `reinforcing_phases`, shape (m,), of norm 1; it jumps where two eigenvalues cross."""
    half = np.sqrt(targets / np.add.reduce(np.abs(matrix) ** 2, axis=1))
    scaled = matrix * half[:, None]
    leading: Complex = np.linalg.eigh(scaled @ scaled.conj().T)[1][:, -1]
    return leading


def superposed(matrix: Complex, targets: Float, phases: Complex) -> tuple[Complex, Float]:
    """Return the sum of the single foci with amplitude set to 1, shape (n,), and their weights, shape (m,)."""
    weights = targets / np.add.reduce(np.abs(matrix) ** 2, axis=1)
    return unit(matrix.conj().T @ (weights * phases)), weights


def naive(matrix: Complex, targets: Float, phases: Complex, count: int) -> tuple[Complex, list[float]]:
    drive, _ = superposed(matrix, targets, phases)
    return drive, [misfit(matrix @ drive, targets)]


def _gerchberg_saxon(
    matrix: Complex, targets: Float, phases: Complex, count: int, weighted: bool
) -> tuple[Complex, list[float]]:
    adjoint = matrix.conj().T
    drive, weights = superposed(matrix, targets, phases)
    pressure = matrix @ drive
    residual = [misfit(pressure, targets)]
    number = len(targets)
    # `unit` and `misfit` are inlined: a scene with moving foci needs this in every step
    ratio = np.abs(pressure) / targets
    turned = pressure
    for iteration in range(count):
        if not weighted or iteration < FREE:
            turned = pressure
        if weighted:
            mean = np.add.reduce(ratio) / number
            weights = weights * (mean / np.maximum(ratio, 1e-3 * mean)) ** RELAXATION
        wave = adjoint @ (weights * np.exp(1j * np.arctan2(turned.imag, turned.real)))
        drive = np.exp(1j * np.arctan2(wave.imag, wave.real))
        pressure = matrix @ drive
        ratio = np.abs(pressure) / targets
        mean = np.add.reduce(ratio) / number
        deviation = ratio - mean
        residual.append(float(np.sqrt(np.add.reduce(deviation * deviation) / number) / mean))
    return drive, residual


def soft_minimum(phases: Float, matrix: Complex, sharpness: float) -> tuple[float, Float]:
    """Return minus the soft minimum of |H exp(i phases)| over the foci, and its gradient by the phases, shape (n,).

    softmin(q) = -logsumexp(-s q)/s, with sharpness s. matrix: rows divided by their reference
    """
    waves = matrix * np.exp(1j * phases)
    pressure = waves.sum(axis=1)
    magnitude = np.abs(pressure)
    share = softmax(-sharpness * magnitude)
    slope = -np.imag(np.conj(unit(pressure))[:, None] * waves)
    return float(logsumexp(-sharpness * magnitude) / sharpness), -share @ slope


def lbfgs(matrix: Complex, targets: Float, phases: Complex, count: int) -> tuple[Complex, list[float]]:
    start, residual = naive(matrix, targets, phases, 0)
    angles = np.angle(start)
    scaled = matrix / targets[:, None]
    scaled = scaled / np.abs(scaled).sum(axis=1).mean()

    def note(angles: Float) -> None:
        residual.append(misfit(matrix @ np.exp(1j * angles), targets))

    with one_blas_thread:  # several BLAS threads made these small products 40 times slower
        for stage, sharpness in enumerate(SHARPNESS):
            evaluations = (count - (len(residual) - 1)) // (len(SHARPNESS) - stage)
            if evaluations > 0:
                solution = scipy.optimize.minimize(
                    soft_minimum,
                    angles,
                    (scaled, sharpness),
                    method="L-BFGS-B",
                    jac=True,
                    callback=note,
                    options={"maxiter": evaluations, "ftol": 1e-12, "gtol": 1e-9},
                )
                angles = solution.x
    return np.exp(1j * angles), residual


def tikhonov(matrix: Complex, targets: Float, phases: Complex, count: int) -> tuple[Complex, list[float]]:
    gram = matrix @ matrix.conj().T
    ridge = REGULARISATION * np.trace(gram).real / len(gram) * np.eye(len(gram))
    drive = matrix.conj().T @ np.linalg.solve(gram + ridge, targets * phases)
    drive /= np.abs(drive).max()
    return drive, [misfit(matrix @ drive, targets)]


SOLVERS: dict[Method, Callable[[Complex, Float, Complex, int], tuple[Complex, list[float]]]] = {
    "naive": naive,
    "gs": partial(_gerchberg_saxon, weighted=False),
    "gsw": partial(_gerchberg_saxon, weighted=True),
    "lbfgs": lbfgs,
    "tikhonov": tikhonov,
}
