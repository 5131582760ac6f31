"""Predicted seconds of the skin's work on one core: what the choice between solvers rests on, in scenes and in `solve`.

Fitted to the layers of shipped scenes on one core of the 2-core machine: factorised in 0.05 to 2.8 s for 1.5 k to 28 k
unknowns, stepped in 0.27 to 4.9 ms a substep for 1.5 k to 13 k (docs/bench/skin_c0.md has discs). Known to a factor of
1.5 or so.
"""


def assembly_s(dofs: float) -> float:
    """Mesh and matrices."""
    return 3e-5 * dofs


def factor_s(dofs: float) -> float:
    """One real factorisation; a complex one takes twice as long."""
    return 2.2e-8 * dofs**1.82


def wedge_step_s(dofs: float) -> float:
    """One substep of the whole layer: both passes over its blocks, and products with its matrices."""
    return 7.5e-9 * dofs**1.4


def vector_s(dofs: float) -> float:
    """One vector of a reduced model: a solve by factors that fill like dofs^1.5, and products with all matrices."""
    return 9e-9 * dofs**1.52


def reduced_step_s(vectors: float) -> float:
    """One substep of a reduced model, a dense product of three times its vectors."""
    return 2e-5 + 3e-9 * vectors**2


def modes_s(dofs: float, modes: float) -> float:
    """Make modes for every load: their vectors, each orthogonal to all before it, and two eigenproblems."""
    return factor_s(dofs) + modes * vector_s(dofs) + 5e-10 * dofs * modes**2 + 2e-9 * modes**3


def modal_step_s(modes: float) -> float:
    """One substep of modes that move by themselves, with their share of the load's products."""
    return 1e-5 + 7e-8 * modes


def wedges_s(dofs: float, steps: float) -> float:
    """Factorise and step the whole layer."""
    return factor_s(dofs) + steps * wedge_step_s(dofs)


def reduced_s(dofs: float, steps: float, vectors: float) -> float:
    """Make and step a reduced model of a layer; its matrix exponential is of five times its vectors."""
    exponential = 7.5e-10 * (5.0 * vectors) ** 3
    return factor_s(dofs) + vectors * vector_s(dofs) + exponential + steps * reduced_step_s(vectors)
