"""Modes of a viscoelastic body for every course of given shapes of load: block Lanczos and Ritz vectors.

With A = E + (1 + 1/2 sum_i g_i) K + w^2 M at one real rate w, factorised once, the space is that of A^-1 B,
(A^-1 M) A^-1 B, and so on, orthonormal in the mass (load-dependent Ritz vectors: Wilson, Yuan & Dickens, Earthq. Eng.
Struct. Dyn. 10, 1982; Nour-Omid & Clough, ibid. 12, 1984). Turned to the eigenvectors of E + K in it, mass and
stiffness are diagonal. Of soft matter that hardly changes its volume E holds next to no energy, so that it is diagonal
as well, and each mode moves by itself.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.factor import AnyFactor
from palmfield.skin.materials.material import Material, stiffening
from palmfield.types import Complex, Float

RATE_Hz = 200.0
"""w / 2 pi. A lower one does not settle short waves, a higher one does not reach out into the skin."""
PARALLEL = 1e-3
"""Part of a block below which what is new in a direction is left out."""
COUPLED = 0.01
"""What the modes' coupling by the elastic stiffness may change in the harmonic motion at RATE_Hz."""
CHUNK = 256
"""Columns or rows of a product that are held at a time."""
FREQUENCIES_Hz: Float = np.concatenate([[0.0], np.geomspace(20.0, 4000.0, 32)])
"""At which models are compared."""
HIGHEST_Hz = 4000.0
"""Modes above it, that would be stiff and coupled pressure waves, are left out."""
SAFETY = 1.25
"""Times the last block's change: on the palm a velocity after a sudden start errs up to 1.15 times that."""
TRIALS = 16
"""Random sums of the shapes under which two models are compared."""


@dataclass(frozen=True)
class RitzModes:
    """Modes V of a body, orthonormal in the mass.

    vectors: V, shape (n, r); elastic, stiffness: diagonals of V^T E V and V^T K V, shapes (r,)
    motion, change: the surface's harmonic motion under random sums of the shapes, and what the last block of vectors
        changes in it, rms [m], at FREQUENCIES_Hz, shapes (f,)
    """

    vectors: Float
    elastic: Float
    stiffness: Float
    motion: Float
    change: Float

    def errors(self, corner_Hz: float) -> tuple[float, float]:
        """Relative error of displacement and velocity, estimated, under loads whose spectrum falls as 1/f above a
        corner frequency, as that of sudden changes; rms over the surface and the spectrum."""
        spectrum = 1.0 / (1.0 + (FREQUENCIES_Hz / corner_Hz) ** 2)
        rates = spectrum * FREQUENCIES_Hz**2

        def error(power: Float) -> float:
            changed, moved = (np.trapezoid(power * size**2, FREQUENCIES_Hz) for size in (self.change, self.motion))
            return float(SAFETY * np.sqrt(changed / moved))

        return error(spectrum), error(rates)


def refusal(system: SkinSystem) -> str | None:
    """Why a body can't be turned to modes that move by themselves, in words, or None."""
    if len(system.parts) != 1:
        return f"its materials relax by {len(system.parts)} laws, and modes move by themselves under one"
    if system.damping.nnz:
        return "absorbing sides or dashpots couple the modes"
    return None


def shifted(system: SkinSystem) -> sparse.csr_matrix:
    """A, symmetric positive definite, shape (n, n) [N/m]."""
    (part,) = system.parts
    stiff = (1.0 + 0.5 * sum(part.material.ratios)) * part.stiffness
    return sparse.csr_matrix(system.elastic + stiff + (2.0 * np.pi * RATE_Hz) ** 2 * system.mass)


def ritz_modes(
    system: SkinSystem,
    factor: AnyFactor,
    forces: Float,
    sizes: Float,
    blocks: int,
    surface: sparse.csr_matrix,
) -> RitzModes:
    """Modes of a body for forces [N], shape (n, m), of which a load has shares of some rms sizes, shape (m,).

    factor: of `shifted(system)`; blocks: how many the space has, at least 2
    surface: reads the displacement that must be right, csr, shape (S, n)
    Raises SceneError where E couples the modes, or `refusal` gives a reason.
    """
    reason = refusal(system)
    if reason is not None:
        raise SceneError(f"no modes of this skin: {reason}")
    (part,) = system.parts
    space, ends = _lanczos(system.mass, factor, forces, blocks)
    elastic = _projected(system.elastic, space)
    both = elastic + _projected(part.stiffness, space)
    trials = (forces * sizes) @ np.random.default_rng(0).standard_normal((forces.shape[1], TRIALS))
    pushed, seen = space.T @ trials, surface @ space
    answers: list[Complex] = []
    for order, highest_Hz in ((ends[-2], np.inf), (ends[-1], HIGHEST_Hz)):
        values, turn = np.linalg.eigh(both[:order, :order])
        kept = values < (2.0 * np.pi * highest_Hz) ** 2
        values, turn = values[kept], turn[:, kept]
        turned = turn.T @ elastic[:order, :order] @ turn
        diagonal = np.diagonal(turned).copy()
        rigidities = diagonal, values - diagonal
        loaded = turn.T @ pushed[:order], seen[:, :order] @ turn
        answers.append(_answers(part.material, *rigidities, *loaded, FREQUENCIES_Hz))
    rate = -2j * np.pi * RATE_Hz
    relaxing = stiffening(part.material, rate)
    coupled = (1.0 - relaxing) * turned + np.diag(rate**2 + relaxing * values)
    together = loaded[1] @ np.linalg.solve(coupled, loaded[0])
    alone = _answers(part.material, *rigidities, *loaded, np.array([RATE_Hz]))[0]
    coupling = float(np.linalg.norm(together - alone) / np.linalg.norm(together))
    if not coupling <= COUPLED:
        raise SceneError(
            f"no modes of this skin: its elastic part couples them, by {100 * coupling:.2g} % of the motion; allowed: "
            f"{100 * COUPLED:g} %"
        )
    scale = np.sqrt(TRIALS * seen.shape[0])
    motion = np.linalg.norm(answers[1], axis=(1, 2)) / scale
    change = np.linalg.norm(answers[1] - answers[0], axis=(1, 2)) / scale
    for start in range(0, len(space), CHUNK):
        rows = slice(start, start + CHUNK)
        space[rows, : len(values)] = space[rows] @ turn
    return RitzModes(space[:, : len(values)], *rigidities, motion, change)


def _lanczos(mass: sparse.csr_matrix, factor: AnyFactor, forces: Float, blocks: int) -> tuple[Float, list[int]]:
    """The space, orthonormal in the mass, shape (n, r), and how many vectors it has after each block."""
    space = np.empty((forces.shape[0], blocks * forces.shape[1]), order="F")
    ends, count, right = [], 0, forces
    for _ in range(blocks):
        new = factor.solve(np.ascontiguousarray(right))
        new /= np.sqrt(np.einsum("nk,nk->k", new, mass @ new))
        for _ in range(2):
            known = space[:, :count]
            new -= known @ (known.T @ (mass @ new))
        squares, turn = np.linalg.eigh(new.T @ (mass @ new))
        kept = squares > PARALLEL**2 * squares.max()
        new = new @ (turn[:, kept] / np.sqrt(squares[kept]))
        known = space[:, :count]
        new -= known @ (known.T @ (mass @ new))
        space[:, count : count + new.shape[1]] = new
        count += new.shape[1]
        ends.append(count)
        right = mass @ new
    return space[:, :count], ends


def _projected(matrix: sparse.csr_matrix, space: Float) -> Float:
    """space^T matrix space, symmetric, shape (r, r)."""
    order = space.shape[1]
    result = np.empty((order, order))
    for start in range(0, order, CHUNK):
        columns = slice(start, min(start + CHUNK, order))
        result[:, columns] = space.T @ (matrix @ space[:, columns])
    return 0.5 * (result + result.T)


def _answers(
    material: Material, elastic: Float, stiffness: Float, pushed: Float, seen: Float, frequencies_Hz: Float
) -> Complex:
    """Harmonic motion of what is seen, shape (f, S, trials), under e^{-i w t}."""
    result = []
    for f in frequencies_Hz:
        s = -2j * np.pi * f
        rigidity = s**2 + elastic + stiffening(material, s) * stiffness
        result.append(seen @ (pushed / rigidity[:, None]))
    return np.array(result)
