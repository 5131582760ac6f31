"""Cost of the error estimate of a run: compared meshes and time."""

from palmfield.simulation.model import SkinModel
from palmfield.skin.costs import assembly_s, factor_s, vector_s
from palmfield.skin.extreme_sheets import softest_and_stiffest_sheets

FINER = 1.25
"""Ratio of the element sizes of a mesh of few unknowns to those of the next finer one."""
COARSER = 1.5
"""Ratio of the edges of two meshes with as many rows of elements."""
FINER_BELOW = 10_000
"""Number of unknowns below which the other mesh is finer: a coarser one has too few triangles under the spot."""
VECTORS = 50
"""Approximate number of vectors of the reduced model of one point."""


def compares_with_finer(dofs: int) -> bool:
    """Return whether the error estimate of a layer with `dofs` unknowns uses a finer instead of a coarser mesh."""
    return dofs < FINER_BELOW


def estimate_s(skin: SkinModel) -> float:
    """Return the expected time of the error estimate of a run [s]."""
    dofs = skin.layer.dofs
    materials = 0 if softest_and_stiffest_sheets(skin.spec.config) is None else 2
    edge = 0 if skin.spec.config.shape == "disc" else 1
    if skin.solver.own_mesh:
        # The time of the solver includes its own estimate.
        return (1 + edge) * _model_s(dofs) + materials * assembly_s(dofs) if edge or materials else 0.0
    if compares_with_finer(dofs):
        # The other meshes have finer edges, and another number of rows
        return (2 + edge) * _model_s(dofs) + _model_s(COARSER**2 * dofs) + materials * assembly_s(dofs)
    # The estimate uses the reduced model of a predicted load
    own, low = _model_s(dofs) if skin.choice.solver.any_pose else 0.0, dofs / COARSER**2
    return own + (2 + edge) * _model_s(low) + materials * assembly_s(low)


def _model_s(dofs: float) -> float:
    return assembly_s(dofs) + factor_s(dofs) + VECTORS * vector_s(dofs)
