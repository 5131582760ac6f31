"""Estimates for the modes of a skin before they are computed: whether they are possible, and their number."""

import math

from palmfield.config.skin import ENDLESS
from palmfield.simulation.model import StimulusModel
from palmfield.simulation.spec import SkinSpec
from palmfield.skin.scene_layer import SceneLayer
from palmfield.stimulus.schedule import frame_rates, main_frequencies, turn_m, turn_rate_Hz

BLOCKS, BLOCKS_AT, BLOCKS_POWER = 32, 0.05, 0.9
"""Number of Krylov blocks for the modes at one accuracy, and the exponent with which it decreases with accuracy."""
SHARE_OF_VECTORS = 0.36
"""Approximate number of modes per block and load shape, without the weak modes."""
SHAPES = 15.0
"""Approximate number of load shapes at accuracy 0.2 on a region as wide as a spot."""
LEAST_CORNER_Hz = 75.0
"""Corner frequency of the load spectrum of a stimulus with only start and end. The spectrum of a step falls as 1/f."""


def refusal(skin: SkinSpec, layer: SceneLayer) -> str | None:
    """Return why general modes of a skin are impossible, in words, or None. Reasons that need matrices come later."""
    if skin.config.cover != "patch" and skin.config.solver == "auto":
        return "modes of a cover are blind to foci far from patch_site; use solver modal if all foci stay near it"
    config = skin.config
    if config.body_sound == "scattering":
        return "boundary elements for every sample load would cost more than a run"
    if config.side == "absorbing":
        return "absorbing sides couple the modes"
    if config.base in ENDLESS:
        return "the dashpots below its base couple the modes"
    return None


def laws(layer: SceneLayer) -> int:
    """Return the number of relaxation laws in the material sheets of a layer."""
    return len({sheet.material.law for sheet in layer.sheets})


def expected_modes(skin: SkinSpec, layer: SceneLayer) -> float:
    """Return the expected number of modes. The estimate comes from the shipped scenes."""
    shapes = SHAPES * (region_m(layer) / layer.demand.spot_fwhm_m) ** 2 * (0.2 / skin.config.accuracy) ** 0.35
    return float(SHARE_OF_VECTORS * block_count(skin.config.accuracy) * shapes)


def block_count(accuracy: float) -> int:
    """Return the number of Krylov blocks for the modes at an accuracy of the skin."""
    blocks: float = BLOCKS * (BLOCKS_AT / accuracy) ** BLOCKS_POWER
    return max(round(blocks), 3)


def region_m(layer: SceneLayer) -> float:
    """Return the radius of the region of a skin that contains the foci of the class [m].

    The region has fine elements. It is a patch of a certain radius, with a margin for foci that touch it from outside.
    """
    sizes, spot_m = layer.sizes, layer.demand.spot_fwhm_m
    if layer.config.patch_radius_m or layer.config.shape == "disc":
        return sizes.radius_m + 0.5 * spot_m
    return max(sizes.fine_radius_m, 2.0 * spot_m)


def corner_Hz(stimulus: StimulusModel, spot_m: float) -> float:
    """Return the approximate frequency above which the load spectrum of a stimulus falls [Hz].

    spot_m: width of the spot [m]

    A focus with speed v and spot width w passes a point in the time w / v. A focus that jumps at some rate counts as
    one that moves to the next point in this time. AM adds its own frequency.
    """
    config = stimulus.config
    corners = [LEAST_CORNER_Hz, *(0.5 * f for f in frame_rates(config))]
    corners += [0.5 * f for f in main_frequencies(config)[:1]]
    rate = turn_rate_Hz(config)
    if rate is not None:
        corners.append(rate * turn_m(config) / (math.pi * spot_m))
    return max(corners)
