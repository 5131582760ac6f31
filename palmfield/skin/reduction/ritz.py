"""Modes of a viscoelastic body for any time course of given shapes of load: block Lanczos and Ritz vectors.

A = E + (1 + 1/2 sum_i g_i) K + w^2 M is factorised once, at a real rate w. The space consists of A^-1 B,
(A^-1 M) A^-1 B, and so on, orthonormal in the mass (load-dependent Ritz vectors: Wilson, Yuan & Dickens, Earthq. Eng.
Struct. Dyn. 10, 1982; Nour-Omid & Clough, ibid. 12, 1984). The modes are the eigenvectors of E + c K in this space,
with c of the material at a middle frequency; they make the mass and this sum diagonal. In nearly incompressible soft
matter E has almost no energy. So K is nearly diagonal as well, and the modes are uncoupled.

With several relaxation laws the stiffness is a sum of several matrices. Modes make it diagonal only at one frequency,
and relaxed sheets share a load differently. Then the space also begins with responses of the relaxed body. Strong and
weak modes are separated by the motion of all modes together, and the coupling is kept. The modes are rotated to the
eigenvectors of the matrix of a substep, so that the coupling depends only on the previous state.

Waves of 1 kHz are long in skin, so the space needs far more vectors than the motion. When the space is complete, the
motion under loads of the class is computed at many frequencies. The sums of modes with most of the energy (proper
orthogonal decomposition in the frequency domain: Willcox & Peraire, AIAA J. 40, 2002) are converted to modes again.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, sparse

from palmfield.interrupts import left_by_interrupts
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.materials.material import Material
from palmfield.skin.reduction.load_shapes import in_gap
from palmfield.threads import cores, in_parts, share
from palmfield.types import Complex, Float, Float32

if TYPE_CHECKING:
    from palmfield.skin.fem.factor import AnyFactor

RATE_Hz = 400.0
"""Rate w / 2 pi [Hz]. At a lower rate short waves do not converge; at a higher rate vectors stay near the face."""
RELAXED_Hz = 100.0
"""Rate w / 2 pi for the relaxed body, with several laws [Hz]."""
PARALLEL = 0.01
"""Share of a block below which the new part of a direction is left out, for loads with the sizes of the class."""
COUPLED, COUPLED_SHARE = 0.01, 0.5
"""Allowed change of the harmonic motion by omitted coupling: the larger of the first number, and the second times the
share of the motion in omitted weak modes."""
COUPLED_Hz = 200.0, 50.0, 800.0
"""Frequencies at which this change is computed [Hz]; for one law only the first."""
UNCOUPLED_Hz = 100.0
"""Frequency at which modes are uncoupled [Hz]: between those of the start or end of a stimulus and its modulation."""
CHUNK, LONG = 256, 2048
"""Vectors, and rows of vectors, of a product in one thread at a time; fixed, so that sums do not depend on threads."""
FREQUENCIES_Hz: Float = np.concatenate([[0.0], np.geomspace(20.0, 4000.0, 32)])
"""Frequencies at which models are compared [Hz]."""
HIGHEST_Hz = 4000.0
"""Frequency above which modes are omitted [Hz], because they are stiff, coupled pressure waves."""
SAFETY, TOGETHER = 1.25, 1.4
"""Factor on the change between models; second factor for several laws, whose modes converge more slowly."""
LINES_Hz: Float = np.linspace(0.0, 2500.0, 251)
"""Frequencies of the motion that separates strong modes from weak modes [Hz]."""
CORNER_Hz = 500.0
"""Frequency above which the spectrum of the loads for this motion falls as 1/f [Hz]."""
TRIALS = 16
"""Number of random sums of the shapes under which two models are compared."""


@dataclass(frozen=True)
class RitzModes:
    """Modes V of a body with p relaxation laws, orthonormal in the mass.

    vectors: V in single precision, shape (n, r).
    elastic, stiffness: diagonals of V^T E V and of each V^T K_p V, shapes (r,) and (p, r).
    coupling: c matrices without diagonal that couple the modes, in single precision, (c, r, r); c = 0 for uncoupled
        modes. shares: factors of 1 and of the stiffening of each law in the factor of each coupling matrix in the
        dynamic stiffness, (c, 1 + p).
    motion, change: harmonic motion of the surface under random sums of the shapes, and its change by the last block of
        vectors, omitted modes and omitted coupling, rms [m], at FREQUENCIES_Hz, shapes (f,).
    """

    vectors: Float32
    elastic: Float
    stiffness: Float
    coupling: Float32
    shares: Float
    motion: Float
    change: Float

    def errors(self, corner_Hz: float) -> tuple[float, float]:
        """Return the estimated relative errors of displacement and velocity, rms over surface and spectrum.

        The spectrum of the loads falls as 1/f above a corner frequency, as for sudden changes."""
        spectrum = 1.0 / (1.0 + (FREQUENCIES_Hz / corner_Hz) ** 2)
        rates = spectrum * FREQUENCIES_Hz**2

        def error(power: Float) -> float:
            changed, moved = (np.trapezoid(power * size**2, FREQUENCIES_Hz) for size in (self.change, self.motion))
            return float(SAFETY * np.sqrt(changed / moved))

        return error(spectrum), error(rates)


def refusal(system: SkinSystem) -> str | None:
    """Return the reason why a body cannot have modes, in words, or None."""
    if system.damping.nnz:
        return "absorbing sides or dashpots couple the modes"
    return None


def shifted(system: SkinSystem, *, relaxed: bool = False) -> sparse.csr_matrix:
    """Return A, symmetric positive definite, (n, n) [N/m]; relaxed: for relaxed branches and a lower rate."""
    laws = (part.material.relaxation.branches for part in system.parts)
    weights = [1.0 if relaxed else 1.0 + 0.5 * sum(ratio for ratio, _ in law) for law in laws]
    stiff = sum(weight * part.stiffness for weight, part in zip(weights, system.parts, strict=True))
    rate = 2.0 * np.pi * (RELAXED_Hz if relaxed else RATE_Hz)
    return sparse.csr_matrix(system.elastic + stiff + rate**2 * system.mass)


def ritz_modes(
    system: SkinSystem,
    factor: "AnyFactor",
    forces: Float,
    sizes: Float,
    blocks: int,
    omitted: float,
    surface: sparse.csr_matrix,
    stiffened: Sequence[float],
    relaxed: Float,
) -> RitzModes:
    """Return the modes of a body for loads that are sums of forces.

    forces: [N], shape (n, m). sizes: rms share of each force, shape (m,). factor: factor of `shifted(system)`.
    blocks: number of vectors of the space for each force, at least 2, or 4 with several laws.
    omitted: largest share of the energy norm of the motion in the omitted, weakest modes.
    surface: operator of the displacement that must be accurate, csr, shape (S, n).
    stiffened: for coupled modes, the factor G / G_r of each law in a substep (palmfield.skin.fem.generalised_alpha),
        shape (p,).
    relaxed: for several laws, the solutions with `shifted(system, relaxed=True)` for forces * sizes, (n, m), or (n, 0).
        They are needed because relaxed sheets share a load differently; powers of A^-1 M do not represent this.
    """
    materials = [part.material for part in system.parts]
    # Modes are uncoupled for the stiffness of the materials at a middle frequency
    means = laws_at(materials, -2j * np.pi * UNCOUPLED_Hz).real
    space, ends = _lanczos(system.mass, factor, forces * sizes, blocks, relaxed)
    # The matrix of the first law follows from the sum, so it is not stored
    own = [_projected(matrix, space) for matrix in (system.elastic, *(part.stiffness for part in system.parts[1:]))]
    total = _projected(system.parts[0].stiffness, space)
    total *= means[1]
    for mean, matrix in zip(np.delete(means, 1), own, strict=True):
        total += mean * matrix
    trials = np.random.default_rng(0).standard_normal((forces.shape[1], TRIALS))
    pushed = np.asarray(space.T @ (forces * sizes).astype(np.float32), dtype=np.float64)
    seen = surface @ space
    found: dict[int, tuple[Float, Float, Float, Float, Complex]] = {}

    def solve(order: int) -> None:
        values, turn = np.linalg.eigh(total[:order, :order])
        kept = values < (2.0 * np.pi * HIGHEST_Hz) ** 2
        values, turn = values[kept], turn[:, kept]
        diagonals = [np.einsum("ik,ik->k", turn, matrix[:order, :order] @ turn) for matrix in own]
        rigidities = _rigidities(values, diagonals, means)
        loaded = turn.T @ pushed[:order]
        answers = _answers(materials, rigidities, loaded @ trials, seen[:, :order] @ turn)
        found[order] = values, turn, rigidities, loaded, answers

    left_by_interrupts(lambda: share([(partial(solve, order),) for order in ends[-2:]], cores()))
    less, answers = (found[order][-1] for order in ends[-2:])
    values, turn, rigidities, loaded, _ = found[ends[-1]]
    found.clear()
    if len(materials) == 1:
        gram, before = _motion_alone(materials, rigidities, loaded), answers
    else:
        whole = _Modes(values, [turn.T @ matrix @ turn for matrix in own], means, materials)
        gram, before = _motion_together(whole, loaded, trials, seen @ turn)
        del whole
    turn = turn @ _strongest(gram, rigidities, omitted)
    modes, turn = _turned(turn, total, own, means, materials)
    force, watched = turn.T @ pushed @ trials, seen @ turn
    allowed = max(COUPLED, COUPLED_SHARE * omitted)
    coupled: list[int] = []
    coupling = modes.neglected(coupled, force, watched)
    if not coupling <= allowed:
        # The matrix of a substep is then diagonal, and coupling forces depend on the previous state
        last = np.array([1.0, *stiffened])
        modes, inner = _turned(np.eye(len(modes.values)), modes.of(last), modes.matrices, last, materials)
        turn, force, watched = turn @ inner, inner.T @ force, watched @ inner
        coupled = list(range(1, len(own)))
        coupling = modes.neglected(coupled, force, watched)
        if not coupling <= allowed:
            coupled, coupling = [0, *coupled], 0.0
    after = modes.answers(coupled, force, watched)
    scale = np.sqrt(TRIALS * seen.shape[0])
    motion = np.linalg.norm(after, axis=(1, 2)) / scale
    # The difference to one block less is that of uncoupled modes; coupling changes it little
    changes = [np.linalg.norm(change, axis=(1, 2)) / scale for change in (answers - less, after - before)]
    change = np.sqrt(changes[0] ** 2 + changes[1] ** 2 + (coupling * motion) ** 2)
    change *= TOGETHER if len(materials) > 1 else 1.0
    turning = turn.astype(np.float32)
    vectors = np.empty((len(space), turn.shape[1]), np.float32)
    in_parts(len(space), CHUNK, lambda rows: np.matmul(space[rows], turning, out=vectors[rows]))
    between = np.zeros((len(coupled), turn.shape[1], turn.shape[1]), np.float32)
    for result, number in zip(between, coupled, strict=True):
        result[...] = modes.between(number)
    shares = np.array([modes.share(number) for number in coupled]).reshape(len(coupled), len(means))
    return RitzModes(vectors, modes.rigidities[0], modes.rigidities[1:], between, shares, motion, change)


def laws_at(materials: Sequence[Material], s: complex) -> Complex:
    """Return 1 for the elastic stiffness, then G(s) / G_r of each material at a rate s [1/s], shape (1 + p,)."""
    return np.array([1.0, *(material.relaxation.stiffening(s) for material in materials)], dtype=complex)


class _Modes:
    """Stiffnesses of a body in the eigenvectors of a weighted sum of them.

    values: eigenvalues of the sum, (r,). matrices: elastic stiffness, and that of each law except the first, (r, r).
    means: weights of the elastic stiffness and of each law in the sum, (1 + p,).
    rigidities: diagonals of the elastic stiffness and of the stiffness of each law, (1 + p, r).
    """

    def __init__(self, values: Float, matrices: Sequence[Float], means: Float, materials: Sequence[Material]) -> None:
        self.values, self.matrices, self.means, self._materials = values, matrices, means, materials
        self.rigidities = _rigidities(values, [np.diagonal(matrix) for matrix in matrices], means)

    def share(self, number: int) -> Float:
        """Return the coefficients of `laws_at` in the factor of one matrix in the dynamic stiffness, (1 + p,)."""
        row = 0 if number == 0 else number + 1
        share = np.eye(len(self.means))[row]
        share[1] = -self.means[row] / self.means[1]
        return share

    def between(self, number: int) -> Float:
        """Return one of the matrices without its diagonal, (r, r)."""
        return self.matrices[number] - np.diag(np.diagonal(self.matrices[number]))

    def of(self, means: Float) -> Float:
        """Return the sum with other weights, (r, r)."""
        result = np.diag(means[1] / self.means[1] * self.values)
        for number, matrix in enumerate(self.matrices):
            result += float(self.share(number) @ means) * matrix
        return result

    def at(self, f_Hz: float, coupled: Iterable[int], kind: type = complex) -> Complex:
        """Return the dynamic stiffness under e^{-i w t}, (r, r), from all diagonals and some coupling matrices."""
        s = -2j * np.pi * f_Hz
        laws = laws_at(self._materials, s)
        result: Complex = np.zeros((len(self.values), len(self.values)), kind)
        for number in coupled:
            result += kind(self.share(number) @ laws) * self.matrices[number].astype(kind)
        np.fill_diagonal(result, s**2 + laws @ self.rigidities)
        return result

    def answers(self, coupled: Sequence[int], force: Float, watched: Float) -> Complex:
        """Return the harmonic motion of the surface, shape (f, S, trials), at FREQUENCIES_Hz."""
        if not coupled:
            return _answers(self._materials, self.rigidities, force, watched)
        return np.array([watched @ np.linalg.solve(self.at(f, coupled), force) for f in FREQUENCIES_Hz])

    def neglected(self, coupled: Sequence[int], force: Float, watched: Float) -> float:
        """Return the largest relative change of the harmonic motion at COUPLED_Hz by all other coupling matrices."""
        worst = 0.0
        for f in COUPLED_Hz if len(self.means) > 2 else COUPLED_Hz[:1]:
            stiffnesses = self.at(f, range(len(self.matrices))), self.at(f, coupled)
            together, alone = (watched @ np.linalg.solve(stiffness, force) for stiffness in stiffnesses)
            worst = max(worst, float(np.linalg.norm(together - alone) / np.linalg.norm(together)))
        return worst


def _turned(
    space: Float, total: Float, matrices: Sequence[Float], means: Float, materials: Sequence[Material]
) -> tuple[_Modes, Float]:
    """Return the modes of a sum of stiffnesses in a space (n, r) of orthonormal vectors, and the space of the modes."""
    values, inner = left_by_interrupts(lambda: np.linalg.eigh(space.T @ total @ space))
    turn = space @ inner
    return _Modes(values, [turn.T @ matrix @ turn for matrix in matrices], means, materials), turn


def _rigidities(values: Float, diagonals: Sequence[Float], means: Float) -> Float:
    """Return the diagonals of elastic stiffness and each law, (1 + p, r), from the sum and all except the first law."""
    elastic, *others = diagonals
    first = (values - np.delete(means, 1) @ np.array(diagonals)) / means[1]
    return np.array([elastic, first, *others])


def _motion_alone(materials: Sequence[Material], rigidities: Float, pushed: Float) -> Float:
    """Return the products of the motions of uncoupled modes, summed over loads and LINES_Hz, (r, r).

    rigidities: see `_Modes`; pushed: forces of loads on the modes, (r, m)
    """
    s = np.asarray(-2j * np.pi * LINES_Hz, dtype=complex)
    answers = np.array([1.0 / (rate**2 + laws_at(materials, rate) @ rigidities) for rate in s])
    answers *= 1.0 / np.hypot(1.0, LINES_Hz[:, None] / CORNER_Hz)
    parts = np.concatenate([answers.real, answers.imag])
    # Products of forces and of responses
    return (pushed @ pushed.T) * (parts.T @ parts)


def _motion_together(modes: _Modes, pushed: Float, trials: Float, seen: Float) -> tuple[Float, Complex]:
    """Return the same products for coupled modes, (r, r), and the harmonic motion under trials, (f, S, trials).

    Both at FREQUENCIES_Hz. trials: sums of the loads, (m, trials); seen: surface motion of the modes, (S, r)
    """
    gram = np.zeros((len(pushed), len(pushed)))
    answers = []
    # Single precision is enough, because a relative error of 1e-3 is allowed
    loads = pushed.astype(np.complex64)
    for f, width in zip(FREQUENCIES_Hz, np.gradient(FREQUENCIES_Hz), strict=True):
        stiffness = modes.at(f, range(1, len(modes.matrices)), np.complex64)
        motion = linalg.solve(stiffness, loads, assume_a="gen", overwrite_a=True, check_finite=False)
        answers.append(seen @ (motion @ trials))
        parts = np.concatenate([motion.real, motion.imag], axis=1)
        gram += width / (1.0 + (f / CORNER_Hz) ** 2) * (parts @ parts.T)
    return gram, np.array(answers)


def _strongest(gram: Float, rigidities: Float, omitted: float) -> Float:
    """Return the orthonormal sums of modes with the largest share in the motion, shape (r, k).

    gram: products of the motions of modes, (r, r); rigidities: see `_Modes`
    omitted: share of the motion to omit, in the energy norm, over loads and spectrum
    """
    size = np.sqrt(rigidities.sum(axis=0) + (2.0 * np.pi * RATE_Hz) ** 2)
    values, vectors = left_by_interrupts(lambda: np.linalg.eigh(gram * np.outer(size, size)))
    count = int((np.cumsum(values) > omitted**2 * values.sum()).sum())
    count = in_gap(np.sqrt(np.maximum(values[::-1], 0.0)), count)
    return np.linalg.qr(vectors[:, len(values) - count :] / size[:, None])[0]


def _lanczos(
    mass: sparse.csr_matrix, factor: "AnyFactor", forces: Float, blocks: int, also: Float
) -> tuple[Float32, list[int]]:
    """Return the space, orthonormal in the mass, shape (n, r), and the number of vectors after each block.

    also: motions in the first block in addition to the solutions for the forces, (n, a)
    Directions of a block keep the size that results from the forces, so that small directions are left out.
    """
    space = np.empty((forces.shape[0], blocks * forces.shape[1]), dtype=np.float32, order="F")
    ends, count, right = [], 0, forces
    for number in range(blocks):
        new = factor.solve(np.ascontiguousarray(right))
        if number == 0:
            new = np.hstack([new, also])
        basis = space[:, :count]
        _remove(basis, new, mass @ new)
        heavy = mass @ new
        squares, turn = np.linalg.eigh(new.T @ heavy)
        kept = squares > PARALLEL**2 * squares.max()
        if count + int(kept.sum()) > space.shape[1]:
            break
        sizes = np.sqrt(squares[kept])
        new, heavy = new @ (turn[:, kept] / sizes), heavy @ (turn[:, kept] / sizes)
        # Repeated, because rounding left parts of the basis in small directions
        _remove(basis, new, heavy)
        space[:, count : count + new.shape[1]] = new
        count += new.shape[1]
        ends.append(count)
        right = heavy * (sizes / sizes.max())
    return space[:, :count], ends


def _remove(basis: Float32, vectors: Float, heavy: Float) -> None:
    """Subtract from vectors, (n, m), in place, their part in an orthonormal basis; heavy: mass @ vectors."""
    single = heavy.astype(np.float32)
    shares = np.empty((basis.shape[1], vectors.shape[1]), np.float32)
    in_parts(len(shares), CHUNK, lambda part: np.matmul(basis[:, part].T, single, out=shares[part]))

    def subtract(rows: slice) -> None:
        vectors[rows] -= basis[rows] @ shares

    in_parts(len(vectors), LONG, subtract)


def _projected(matrix: sparse.csr_matrix, space: Float32) -> Float:
    """Return space^T matrix space, symmetric, shape (r, r)."""
    result = np.empty((space.shape[1],) * 2)

    def project(part: slice) -> None:
        # Only the lower triangle
        result[part.start :, part] = space[:, part.start :].T @ (matrix @ space[:, part]).astype(np.float32)
        result[part, part.start :] = result[part.start :, part].T

    in_parts(len(result), CHUNK, project)
    return result


def _answers(materials: Sequence[Material], rigidities: Float, pushed: Float, seen: Float) -> Complex:
    """Return the harmonic motion of the surface at FREQUENCIES_Hz for uncoupled modes, shape (f, S, trials)."""
    result = []
    for f in FREQUENCIES_Hz:
        s = -2j * np.pi * f
        rigidity = s**2 + laws_at(materials, s) @ rigidities
        result.append(seen @ (pushed / rigidity[:, None]))
    return np.array(result)
