"""What the error estimate of a run costs: the meshes that it compares, and seconds."""

from palmfield.simulation.model import SkinModel
from palmfield.skin.costs import factor_s
from palmfield.skin.from_config import softest_and_stiffest_sheets
from palmfield.skin.scene_layer import SceneLayer

RATIO = 1.25
"""Element sizes of the two meshes that are compared."""
FINER_BELOW = 15_000
"""Unknowns above which a finer mesh costs minutes and gigabytes."""
LAYERS = 3
"""A coarser mesh must keep two rows of elements: one alone is off by 20 %."""


def compares_with_finer(layer: SceneLayer, dofs: int) -> bool:
    """Whether the error estimate of a layer with `dofs` unknowns takes a finer mesh, rather than a coarser one."""
    return dofs < FINER_BELOW or len(layer.sizes.depth_fractions) - 1 < LAYERS


def estimate_s(skin: SkinModel) -> float:
    """Seconds that the error estimate of the run takes."""
    dofs, more = skin.layer.dofs, RATIO**3
    # A complex factorisation counts twice
    materials = 0 if softest_and_stiffest_sheets(skin.spec.config) is None else 6
    edge = 0 if skin.spec.config.shape == "disc" else 2
    if skin.solver.own_mesh:
        # The estimate of the solver is included in its seconds.
        return (3 + edge + materials) * factor_s(dofs) if edge or materials else 0.0
    low, high = (dofs, more * dofs) if compares_with_finer(skin.layer, dofs) else (dofs / more, dofs)
    step = 0 if skin.choice.solver.exact_in_time else 2
    return (3 + step + edge + materials) * factor_s(low) + 3 * factor_s(high)
