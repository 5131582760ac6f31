"""What is known of the modes of a skin before they are computed: whether they serve, and about how many there are."""

import math

from palmfield.simulation.model import StimulusModel
from palmfield.simulation.spec import SkinSpec
from palmfield.skin.scene_layer import SceneLayer
from palmfield.stimulus.schedule import frame_rates, main_frequencies, turn_m, turn_rate_Hz

BLOCKS, BLOCKS_AT, BLOCKS_POWER = 32, 0.05, 0.9
"""Blocks of the modes' space at one accuracy, and the power of the accuracy with which they become fewer."""
KEPT = 0.36
"""Modes for each block and shape that are left when the weak ones are out, about."""
SHAPES = 15.0
"""Load shapes at accuracy 0.2 on a region as wide as a spot, about."""
LEAST_CORNER_Hz = 75.0
"""Corner of the spectrum of a load with only onset and end: the sound of a start or stop falls as 1/f."""


def refusal(skin: SkinSpec, layer: SceneLayer) -> str | None:
    """Why a skin can't move by modes for every load, in words, or None; reasons that need its matrices come later."""
    config = skin.config
    if config.body_sound == "scattering":
        return "boundary elements for every sample load would cost more than a run"
    if config.side == "absorbing":
        return "absorbing sides couple the modes"
    return None


def laws(layer: SceneLayer) -> int:
    """Number of relaxation laws of the sheets of a layer."""
    return len({sheet.material.law for sheet in layer.sheets})


def expected_modes(skin: SkinSpec, layer: SceneLayer) -> float:
    """Expected number of modes, from the shipped scenes."""
    shapes = SHAPES * (region_m(layer) / layer.demand.spot_fwhm_m) ** 2 * (0.2 / skin.config.accuracy) ** 0.35
    return float(KEPT * block_count(skin.config.accuracy) * shapes)


def block_count(accuracy: float) -> int:
    """Blocks of the space of the modes that an accuracy of the skin needs."""
    blocks: float = BLOCKS * (BLOCKS_AT / accuracy) ** BLOCKS_POWER
    return max(round(blocks), 3)


def region_m(layer: SceneLayer) -> float:
    """Radius of the region of a skin that contains the foci of the class [m].

    The region has fine elements: a whole patch of given radius, with a margin for foci that touch it from outside.
    """
    sizes, spot_m = layer.sizes, layer.demand.spot_fwhm_m
    if layer.config.patch_radius_m or layer.config.shape == "disc":
        return sizes.radius_m + 0.5 * spot_m
    return max(sizes.fine_radius_m, 2.0 * spot_m)


def corner_Hz(stimulus: StimulusModel, spot_m: float) -> float:
    """Frequency above which the spectrum of the load of a stimulus falls, about [Hz].

    A focus with speed v and spot width w passes a point in w / v. One that jumps at some rate is as sudden as a focus
    that has moved on by then. AM has its own frequency. spot_m: width of the spot [m].
    """
    config = stimulus.config
    corners = [LEAST_CORNER_Hz, *(0.5 * f for f in frame_rates(config))]
    corners += [0.5 * f for f in main_frequencies(config)[:1]]
    rate = turn_rate_Hz(config)
    if rate is not None:
        corners.append(rate * turn_m(config) / (math.pi * spot_m))
    return max(corners)
