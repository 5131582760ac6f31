"""Cost of the error estimate of a run: compared meshes and time."""

from palmfield.simulation.model import SkinModel
from palmfield.skin.costs import assembly_s, factor_s, vector_s
from palmfield.skin.from_config import softest_and_stiffest_sheets
from palmfield.skin.scene_layer import SceneLayer

RATIO = 1.25
"""Ratio of the element sizes of the two compared meshes."""
WIDE = 1.5
"""The same for a layer with fewer than LAYERS rows of elements, whose coarser mesh keeps its rows."""
FINER_BELOW, UNEVEN_FINER_BELOW = 5_000, 15_000
"""Number of unknowns below which the other mesh is finer, because a coarser one has too few triangles under the spot.
The second is for layers of few rows on bodies, whose depth varies."""
LAYERS = 3
"""Least number of element rows for a coarser mesh with fewer rows. It must have two: one row has an error of 20 %."""
VECTORS = 50
"""Approximate number of vectors of the reduced model of one point."""


def compares_with_finer(layer: SceneLayer, dofs: int) -> bool:
    """Return whether the error estimate of a layer with `dofs` unknowns uses a finer instead of a coarser mesh."""
    uneven = layer.config.shape != "disc" and len(layer.sizes.depth_fractions) - 1 < LAYERS
    return dofs < (UNEVEN_FINER_BELOW if uneven else FINER_BELOW)


def estimate_s(skin: SkinModel) -> float:
    """Return the expected time of the error estimate of a run [s]."""
    dofs, more = skin.layer.dofs, RATIO**3
    materials = 0 if softest_and_stiffest_sheets(skin.spec.config) is None else 2
    edge = 0 if skin.spec.config.shape == "disc" else 1
    if skin.solver.own_mesh:
        # The time of the solver includes its own estimate.
        return (1 + edge) * _model_s(dofs) + materials * assembly_s(dofs) if edge or materials else 0.0
    if compares_with_finer(skin.layer, dofs):
        return (1 + edge) * _model_s(dofs) + _model_s(more * dofs) + materials * assembly_s(dofs)
    rows = len(skin.layer.sizes.depth_fractions) - 1
    low, deeper = (dofs / more, 0.0) if rows >= LAYERS else (dofs / WIDE**2, (rows + 1) / rows)
    # The estimate uses the reduced model of a predicted load
    own = _model_s(dofs) if skin.choice.solver.any_pose else 0.0
    return (1 + edge) * _model_s(low) + own + _model_s(deeper * low) + materials * assembly_s(low)


def _model_s(dofs: float) -> float:
    return assembly_s(dofs) + factor_s(dofs) + VECTORS * vector_s(dofs)
