"""Colours in a viewer, the same as in pictures of results."""

import numpy as np
from matplotlib import colormaps

from palmfield.types import Float

FAINT = 0.02
"""Share of the largest ARP below which skin has no colour."""
FULL = 0.25
"""Share of the largest ARP above which the colour covers the skin completely."""
FOCUS: Float = np.array([0.0, 0.75, 0.65, 1.0])


def arp_colours(shares: Float) -> Float:
    """Return colours for ARP relative to the largest, shape (n,): red, green, blue and opacity, shape (n, 4)."""
    colours = np.array(colormaps["magma_r"](0.07 + 0.75 * np.clip(shares, 0.0, 1.0)))
    colours[:, 3] = np.clip((shares - FAINT) / (FULL - FAINT), 0.0, 1.0)
    return colours


def phase_colours(phases: Float) -> Float:
    """Return colours of phases [rad], shape (n,), on a cyclic scale, shape (n, 4)."""
    return np.array(colormaps["twilight"](np.mod(phases, 2.0 * np.pi) / (2.0 * np.pi)))
