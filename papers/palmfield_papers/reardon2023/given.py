"""Numbers that need no run of the slab: inputs, errors of the paper, and the focus of the array."""

import math

import numpy as np

from palmfield.acoustics import FieldEvaluator, layout
from palmfield.acoustics.arp import arp
from palmfield.acoustics.focus import focus
from palmfield.skin import preset
from palmfield.skin.materials.dispersion import describe
from palmfield.types import Air
from palmfield_papers.answer import Answer, Setting
from palmfield_papers.reardon2023.configuration import FWHM_m
from palmfield_papers.reardon2023.hand import ACROSS_m_s, WIDTH_m
from palmfield_papers.reardon2023.phantom import SCAN_X_m, SCAN_Y_m

SOUND_m_s, CARRIER_Hz = 343.0, 40e3
FOCUS_m = 0.2


def _closed(value: float, note: str) -> Answer:
    return Answer(value, 0.0, note=note)


def array_width(setting: Setting) -> Answer:
    """Return the answer of entry R2e: the width of the ARP of 16 x 16 transducers at 200 mm.

    It is found by parabolic interpolation between samples of 0.1 mm.
    """
    array, air = layout("uhev1"), Air()
    widths = []
    for step in (1e-4, 5e-5):
        x = np.arange(-0.012, 0.012 + 0.5 * step, step)
        points = np.stack([x, np.zeros_like(x), np.full_like(x, FOCUS_m)], axis=1)
        field = FieldEvaluator(array, air).pressure(points, focus(array, air, [0.0, 0.0, FOCUS_m]), gradient=True)
        load = arp(field, np.tile([0.0, 0.0, -1.0], (len(x), 1)), air, array.frequency_Hz, device="cpu").astype(float)
        above = np.flatnonzero(load >= 0.5 * load.max())
        ends = [
            np.interp(0.5 * load.max(), [load[a], load[b]], [x[a], x[b]])
            for a, b in ((above[0] - 1, above[0]), (above[-1] + 1, above[-1]))
        ]
        widths.append(1e3 * float(ends[1] - ends[0]))
    return Answer(widths[1], abs(widths[1] - widths[0]), note="layout uhev1, default law of the ARP")


def words(note: str) -> Answer:
    """Return an answer that consists of words only."""
    return Answer(None, note=note)


ANSWERS = {
    "R2b": lambda setting: _closed(1e4 * math.pi * FWHM_m**2 / 4.0, "disc of the source's width"),
    "R2d": lambda setting: _closed(100.0 * (FWHM_m / (0.5 * SOUND_m_s / CARRIER_Hz) - 1.0), "6 mm over c/(2 f)"),
    "R2e": array_width,
    "R4a": lambda setting: words(
        "as printed, inertia and elasticity both have the other sign: a static force would move the skin against "
        "itself; the solver takes the corrected one"
    ),
    "R4b": lambda setting: words("the solver takes complex moduli; 0.02 Pa s corresponds to the printed absorption"),
    "R5c": lambda setting: _closed(preset("gelatin_2").density_kg_m3, "preset gelatin_2"),
    "R5d": lambda setting: _closed(describe(preset("gelatin_2"), 1.0).shear_speed_m_s, "preset gelatin_2 at 1 Hz"),
    "R5e": lambda setting: _closed(1e-3 * preset("gelatin_2").shear_relaxed_Pa, "preset gelatin_2"),
    "R7d": lambda setting: words("asin(1/M) is between front and path, half of the cone's apex angle"),
    "R15b": lambda setting: _closed(float(len(SCAN_X_m) * len(SCAN_Y_m)), "40 by 30 places 5 mm apart"),
    "R16-R18j": lambda setting: _closed(ACROSS_m_s / (2.0 * WIDTH_m), "lateral speed over twice the width"),
    "R16-R18k": lambda setting: _closed(ACROSS_m_s / WIDTH_m, "lateral speed over the width"),
}  # fmt: skip
