"""Cost of the error estimate of a run: compared meshes and time."""

from palmfield.simulation.model import SkinModel
from palmfield.skin.costs import factor_s
from palmfield.skin.from_config import softest_and_stiffest_sheets
from palmfield.skin.scene_layer import SceneLayer

RATIO = 1.25
"""Ratio of the element sizes of the two compared meshes."""
FINER_BELOW = 15_000
"""Number of unknowns above which a finer mesh would cost minutes and gigabytes."""
LAYERS = 3
"""Least number of element rows for a coarser mesh, which must have two rows: one row has an error of 20 %."""


def compares_with_finer(layer: SceneLayer, dofs: int) -> bool:
    """Return whether the error estimate of a layer with `dofs` unknowns uses a finer instead of a coarser mesh."""
    return dofs < FINER_BELOW or len(layer.sizes.depth_fractions) - 1 < LAYERS


def estimate_s(skin: SkinModel) -> float:
    """Return the expected time of the error estimate of a run [s]."""
    dofs, more = skin.layer.dofs, RATIO**3
    # A complex factorisation counts twice
    materials = 0 if softest_and_stiffest_sheets(skin.spec.config) is None else 6
    edge = 0 if skin.spec.config.shape == "disc" else 2
    if skin.solver.own_mesh:
        # The time of the solver includes its own estimate.
        return (3 + edge + materials) * factor_s(dofs) if edge or materials else 0.0
    low, high = (dofs, more * dofs) if compares_with_finer(skin.layer, dofs) else (dofs / more, dofs)
    step = 0 if skin.choice.solver.exact_in_time else 2
    return (3 + step + edge + materials) * factor_s(low) + 3 * factor_s(high)
