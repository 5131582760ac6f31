"""Modes of a viscoelastic body for every course of given shapes of load: block Lanczos and Ritz vectors.

With A = E + (1 + 1/2 sum_i g_i) K + w^2 M at one real rate w, factorised once, the space is that of A^-1 B,
(A^-1 M) A^-1 B, and so on, orthonormal in the mass (load-dependent Ritz vectors: Wilson, Yuan & Dickens, Earthq. Eng.
Struct. Dyn. 10, 1982; Nour-Omid & Clough, ibid. 12, 1984). Turned to the eigenvectors of E + c K in it, with c of the
material at a middle frequency, mass and that sum are diagonal. Of soft matter that hardly changes its volume E holds
next to no energy, so that it is all but diagonal as well, and each mode moves by itself.

Waves of 1 kHz run long in skin, so that the space needs far more vectors than the motion has: what the loads of the
class move at all frequencies is known by then, and the sums of modes that hold most of its energy (proper orthogonal
decomposition in the frequency domain: Willcox & Peraire, AIAA J. 40, 2002) are turned to modes once more.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy import sparse

from palmfield.errors import SceneError
from palmfield.skin.fem.assembly import SkinSystem
from palmfield.skin.fem.factor import AnyFactor
from palmfield.skin.materials.material import Material, stiffening
from palmfield.types import Complex, Float, Float32

RATE_Hz = 400.0
"""w / 2 pi. A lower one does not settle short waves, a higher one does not reach out into the skin."""
PARALLEL = 0.01
"""Part of a block below which what is new in a direction, for loads of the class's sizes, is left out."""
COUPLED, COUPLED_SHARE, COUPLED_Hz = 0.01, 0.5, 200.0
"""What the modes' coupling by the elastic stiffness may change in the harmonic motion at one frequency, at least, and
where more is left out with weak modes, of that."""
UNCOUPLED_Hz = 100.0
"""At which it couples none: between a stimulus's start or end and its modulation."""
CHUNK = 256
"""Columns or rows of a product that are held at a time."""
FREQUENCIES_Hz: Float = np.concatenate([[0.0], np.geomspace(20.0, 4000.0, 32)])
"""At which models are compared."""
HIGHEST_Hz = 4000.0
"""Modes above it, that would be stiff and coupled pressure waves, are left out."""
SAFETY = 1.25
"""Times that change."""
LINES_Hz: Float = np.linspace(0.0, 2500.0, 251)
"""At which the motion is summed up that tells strong modes from weak ones."""
CORNER_Hz = 500.0
"""Above which the loads' spectrum falls there as 1/f."""
TRIALS = 16
"""Random sums of the shapes under which two models are compared."""


@dataclass(frozen=True)
class RitzModes:
    """Modes V of a body, orthonormal in the mass.

    vectors: V in single precision, shape (n, r); elastic, stiffness: diagonals of V^T E V and V^T K V, shapes (r,)
    motion, change: the surface's harmonic motion under random sums of the shapes, and what the last block of vectors,
        the modes left out and the coupling change in it, rms [m], at FREQUENCIES_Hz, shapes (f,)
    """

    vectors: Float32
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
    left_out: float,
    surface: sparse.csr_matrix,
) -> RitzModes:
    """Modes of a body for forces [N], shape (n, m), of which a load has shares of some rms sizes, shape (m,).

    factor: of `shifted(system)`; blocks: how many the space has, at least 2
    left_out: of the motion's energy norm, what the weakest modes take with them that are left out
    surface: reads the displacement that must be right, csr, shape (S, n)
    Raises SceneError where E couples the modes, or `refusal` gives a reason.
    """
    reason = refusal(system)
    if reason is not None:
        raise SceneError(f"no modes of this skin: {reason}")
    (part,) = system.parts
    # As stiff as the material is at a middle frequency: there E couples no modes
    mean = complex(stiffening(part.material, -2j * np.pi * UNCOUPLED_Hz)).real
    space, ends = _lanczos(system.mass, factor, forces * sizes, blocks)
    elastic = _projected(system.elastic, space)
    both = elastic + mean * _projected(part.stiffness, space)
    trials = np.random.default_rng(0).standard_normal((forces.shape[1], TRIALS))
    pushed = np.asarray(space.T @ (forces * sizes).astype(np.float32), dtype=np.float64)
    seen = surface @ space
    answers: list[Complex] = []
    for order in ends[-2:]:
        values, turn = np.linalg.eigh(both[:order, :order])
        kept = values < (2.0 * np.pi * HIGHEST_Hz) ** 2
        values, turn = values[kept], turn[:, kept]
        diagonal = np.einsum("ik,ik->k", turn, elastic[:order, :order] @ turn)
        rigidities = diagonal, (values - diagonal) / mean
        loaded = turn.T @ pushed[:order]
        answers.append(_answers(part.material, *rigidities, loaded @ trials, seen[:, :order] @ turn, FREQUENCIES_Hz))
    turn = turn @ _strongest(part.material, *rigidities, loaded, left_out)
    values, inner = np.linalg.eigh(turn.T @ both @ turn)
    turn = turn @ inner
    turned = turn.T @ elastic @ turn
    diagonal = np.diagonal(turned).copy()
    rigidities = diagonal, (values - diagonal) / mean
    force, watched = turn.T @ pushed @ trials, seen @ turn
    answers.append(_answers(part.material, *rigidities, force, watched, FREQUENCIES_Hz))
    rate = -2j * np.pi * COUPLED_Hz
    relaxing = stiffening(part.material, rate) / mean
    coupled = (1.0 - relaxing) * turned + np.diag(rate**2 + relaxing * values)
    together = watched @ np.linalg.solve(coupled, force)
    alone = _answers(part.material, *rigidities, force, watched, np.array([COUPLED_Hz]))[0]
    coupling = float(np.linalg.norm(together - alone) / np.linalg.norm(together))
    allowed = max(COUPLED, COUPLED_SHARE * left_out)
    if not coupling <= allowed:
        raise SceneError(
            f"no modes of this skin: its elastic part couples them, by {100 * coupling:.2g} % of the motion; allowed: "
            f"{100 * allowed:g} %"
        )
    scale = np.sqrt(TRIALS * seen.shape[0])
    motion = np.linalg.norm(answers[2], axis=(1, 2)) / scale
    changes = [np.linalg.norm(after - before, axis=(1, 2)) / scale for before, after in pairwise(answers)]
    change = np.sqrt(changes[0] ** 2 + changes[1] ** 2 + (coupling * motion) ** 2)
    turning = turn.astype(np.float32)
    for start in range(0, len(space), CHUNK):
        rows = slice(start, start + CHUNK)
        space[rows, : len(values)] = space[rows] @ turning
    return RitzModes(np.ascontiguousarray(space[:, : len(values)]), *rigidities, motion, change)


def _strongest(material: Material, elastic: Float, stiffness: Float, pushed: Float, left_out: float) -> Float:
    """Sums of modes that take most part in the motion: orthonormal, shape (r, k).

    pushed: forces of loads on the modes, (r, m); left_out: of the motion in the energy norm, over loads and spectrum
    """
    s = np.asarray(-2j * np.pi * LINES_Hz[:, None], dtype=complex)
    answers = 1.0 / (s**2 + elastic + stiffening(material, s) * stiffness)
    answers *= 1.0 / np.hypot(1.0, LINES_Hz[:, None] / CORNER_Hz)
    parts = np.concatenate([answers.real, answers.imag])
    size = np.sqrt(elastic + stiffness + (2.0 * np.pi * RATE_Hz) ** 2)
    # As modes move by themselves, products of motions over all loads and lines are those of pushes times of answers
    gram = (pushed @ pushed.T) * (parts.T @ parts) * np.outer(size, size)
    values, vectors = np.linalg.eigh(gram)
    kept = np.cumsum(values) > left_out**2 * values.sum()
    return np.linalg.qr(vectors[:, kept] / size[:, None])[0]


def _lanczos(mass: sparse.csr_matrix, factor: AnyFactor, forces: Float, blocks: int) -> tuple[Float32, list[int]]:
    """The space, orthonormal in the mass, shape (n, r), and how many vectors it has after each block.

    Directions of a block keep the size that the forces give them, so that those of small ones are left out.
    """
    space = np.empty((forces.shape[0], blocks * forces.shape[1]), dtype=np.float32, order="F")
    ends, count, right = [], 0, forces
    for _ in range(blocks):
        new = factor.solve(np.ascontiguousarray(right))
        known = space[:, :count]
        for _ in range(2):
            new -= known @ (known.T @ (mass @ new).astype(np.float32))
        squares, turn = np.linalg.eigh(new.T @ (mass @ new))
        kept = squares > PARALLEL**2 * squares.max()
        sizes = np.sqrt(squares[kept])
        new = new @ (turn[:, kept] / sizes)
        new -= known @ (known.T @ (mass @ new).astype(np.float32))
        space[:, count : count + new.shape[1]] = new
        count += new.shape[1]
        ends.append(count)
        right = mass @ (new * (sizes / sizes.max()))
    return space[:, :count], ends


def _projected(matrix: sparse.csr_matrix, space: Float32) -> Float:
    """space^T matrix space, symmetric, shape (r, r)."""
    order = space.shape[1]
    result = np.empty((order, order))
    for start in range(0, order, CHUNK):
        columns = slice(start, min(start + CHUNK, order))
        result[:, columns] = space.T @ (matrix @ space[:, columns]).astype(np.float32)
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
