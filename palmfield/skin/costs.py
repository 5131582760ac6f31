"""Predict time (on one core) and memory for a skin, and choose the stepper of a scene from these predictions.

The predictions are right to a factor of about 1.5. They are fitted to layers of shipped scenes on one core of the
2-core machine. Factorisation took 0.05 to 2.8 s for 1.5 k to 28 k unknowns. A substep took 0.27 to 4.9 ms for 1.5 k to
13 k unknowns (discs: docs/bench/skin_c0.md).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from palmfield import cache

PROCESS_BYTES = 335e6
"""Memory of a process that has loaded a scene without a skin."""
RUNS = 20
"""Number of runs over which the cost of cached data is divided."""


def assembly_s(dofs: float) -> float:
    """Return the time for mesh and matrices [s]."""
    return 3e-5 * dofs


def factor_s(dofs: float) -> float:
    """Return the time of one real factorisation [s]; a complex one takes twice as long."""
    return 2e-5 * dofs + 3e-9 * dofs**1.82


def vector_s(dofs: float) -> float:
    """Return the time of one vector of a reduced model [s]: a solve (proportional to dofs^1.5) and matrix products."""
    return 9e-9 * dofs**1.52


def modes_s(dofs: float, modes: float, laws: int = 1) -> float:
    """Return the time to make general modes [s]: orthogonal vectors and two eigenproblems.

    laws: number of relaxation laws; from two on, each needs products of all vectors, and motion at some frequencies
    """
    together = laws * 5e-10 * dofs * modes**2 + 2.5e-8 * modes**3 if laws > 1 else 0.0
    return factor_s(dofs) + modes * vector_s(dofs) + 5e-10 * dofs * modes**2 + 2e-9 * modes**3 + together


def modal_start_s(dofs: float, modes: float) -> float:
    """Return the time to read modes from the cache and make their readers [s]: 1.4 s of a run of `palm_am200`."""
    return 5e-8 * dofs * modes


def modal_step_s(modes: float, laws: int = 1) -> float:
    """Return the time of one substep of modes [s] with load products; several laws add one product each."""
    together = 1e-5 + 6e-11 * (laws - 1) * modes**2 if laws > 1 else 0.0
    return 1e-5 + 7e-8 * modes + together


def wedges_s(dofs: float, steps: float) -> float:
    """Return the time to factorise and step the whole layer [s]; a step is two passes over blocks and some products."""
    return factor_s(dofs) + steps * (7.5e-9 * dofs**1.4)


def reduced_s(dofs: float, steps: float, vectors: float) -> float:
    """Return the time to make and step a reduced model [s]; the matrix exponential has size 5 times the vectors."""
    exponential = 7.5e-10 * (5.0 * vectors) ** 3
    return factor_s(dofs) + vectors * vector_s(dofs) + exponential + steps * (2e-5 + 3e-9 * vectors**2)


def memory_bytes(layers: Sequence[tuple[float, bool]]) -> int:
    """Return the memory [bytes] of a process that steps a scene on the CPU, without the stored history of the run.

    layers: unknowns of each skin, and whether its whole layer is stepped.
    The error is 5 % for the layers of the fit: the palm of the demo at 5 k, 9 k and 31 k unknowns, a disc at 13 k.
    """
    return round(PROCESS_BYTES + sum(17.3e3 * dofs + (64.0 * dofs**1.5 if whole else 0.0) for dofs, whole in layers))


@dataclass(frozen=True)
class Choice:
    """Predicted cost of a solver.

    seconds: predicted time [s]; infinite if the solver cannot be used, or if its cost is unknown.
    refusal: the reason why the solver cannot be used; None if it can be used.
    """

    name: str
    seconds: float
    refusal: str | None = None
    arguments: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)
    """Expensive results of the cost estimate that the solution reuses."""


def ranked(options: Iterable[Choice]) -> list[Choice]:
    """Sort choices: the cheapest first, refusals last."""
    return sorted(options, key=lambda choice: (choice.seconds, choice.refusal is not None))


def scene_choices(
    dofs: float,
    substeps: float,
    vectors: float,
    refusal: str | None,
    modes: float,
    modal_refusal: str | None,
    laws: int = 1,
    cached: bool | None = None,
) -> list[Choice]:
    """Return the solvers that can step the layer of a scene, the cheapest first.

    dofs: unknowns of the layer. substeps: substeps of the whole run.
    vectors, refusal: approximate number of vectors of a reduced model for the load; why it is impossible, or None.
    modes, modal_refusal: the same for general modes. laws: number of relaxation laws of the layer.
    cached: whether modes are reused in RUNS runs. None: if there is a cache.
    """
    reduced, modal = Choice("reduced", math.inf, refusal), Choice("modal", math.inf, modal_refusal)
    if refusal is None:
        reduced = Choice("reduced", reduced_s(dofs, substeps, vectors))
    if modal_refusal is None:
        # Modes on disk are reused in later runs
        share = 1.0 / RUNS if (cache.folder() is not None if cached is None else cached) else 1.0
        modal = Choice("modal", share * modes_s(dofs, modes, laws) + substeps * modal_step_s(modes, laws))
    return ranked([reduced, modal, Choice("wedges", wedges_s(dofs, substeps))])
