"""Levels of whole populations of afferents: one rule per class, from the motion at each ending.

level = 20 log10 of the factor by which the stimulus may shrink before its class no longer decides that it is there.
SA1, RA1: at least one unit fires (one impulse of RA1 can be felt: A. B. Vallbo and R. S. Johansson, Hum. Neurobiol. 3
(1984) 3). PC: the root of the sum of squared levels of all units reaches that under the contactor of Bolanowski et al.
(1988) at their threshold, so that thresholds fall by 3 dB per doubling of the area, as theirs do.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from palmfield.errors import OutputError
from palmfield.perception.afferents import (
    AFFERENTS,
    BLOCK,
    PROBE_M,
    Afferent,
    largest_under_probe,
    potentials,
    under_probe,
)
from palmfield.perception.observers import OBSERVERS, threshold_m
from palmfield.types import Float

DENSITIES_PER_CM2: dict[str, dict[str, float]] = {
    "palm": {"sa1": 8.0, "ra1": 25.0, "pc": 9.0},
    "finger": {"sa1": 30.0, "ra1": 37.0, "pc": 10.0},
    "fingertip": {"sa1": 70.0, "ra1": 141.0, "pc": 21.0},
}
"""Units per cm2 by region. R. S. Johansson and A. B. Vallbo, J. Physiol. 286 (1979) 283: the abstract prints totals of
58 in the palm, 241 at the fingertip, and 1 : 1.6 : 4.2 for the three regions. The values of each class are those that
later papers cite; with 16, 15 and 9 SA2 units they add up to these totals. The figure itself was not compared."""
CONTACT_m2, CONTACT_Hz, REACH_M = 2.9e-4, 250.0, 0.03
"""Contactor and frequency at which the rule of PC is set, and radius of the skin around its centre that responds."""
PROBES_M = (5e-4, 3e-3)
"""Radii of the probe between which the levels of SA1 and RA1 are uncertain [m]."""


@dataclass(frozen=True)
class Population:
    """An observer that reads all afferents of some classes; the class with the highest level decides.

    why: one line on its meaning; `spread_of` gives the spread of each class
    """

    name: str
    classes: tuple[str, ...]
    why: str


POPULATIONS = {
    one.name: one
    for one in (
        Population(
            "population_all", tuple(AFFERENTS), "all classes of afferents; the one with the highest level decides"
        ),
        Population("population_pc", ("pc",), "PC afferents, summed over the area: vibration above 50 Hz"),
        Population("population_ra", ("ra1",), "RA1 afferents, the most excited unit: flutter, 5 to 50 Hz"),
        Population("population_sa", ("sa1",), "SA1 afferents, the most excited unit: pressure, below 5 Hz"),
    )
}
"""Observers by name, in the order in which to read them."""


def spread_of(name: str) -> tuple[float, str]:
    """Return the half-width of the spread of the level of a class [dB], and its origin."""
    if name == "pc":
        spread = OBSERVERS["bolanowski_1988"].spread_dB
        assert spread is not None
        return spread, "reading of the threshold of the contactor"
    own, *others = (largest_under_probe(AFFERENTS[name], radius) for radius in (PROBE_M, *PROBES_M))
    spread = max(abs(20.0 * math.log10(one / own)) for one in others)
    return round(spread, 1), "radius of the probe of the thresholds of single units, 0.5 to 3 mm"


@cache
def pc_criterion() -> float:
    """Return the root of the sum of squared levels of PC units at the threshold of the contactor, see CONTACT_m2."""
    pc, radius = AFFERENTS["pc"], math.sqrt(CONTACT_m2 / math.pi)
    distance = np.linspace(0.0, REACH_M, 3001)
    threshold = float(threshold_m(OBSERVERS["bolanowski_1988"], CONTACT_Hz))
    periods = np.arange(0.0, 0.1, 1.0 / CONTACT_Hz / 64)
    course = np.sin(2.0 * np.pi * CONTACT_Hz * periods)[:, None]
    level, _ = potentials(pc, course, float(periods[1]))
    per_metre = float(level[len(level) // 2 :].max())
    moved = under_probe(pc, radius, distance) / largest_under_probe(pc)
    levels = per_metre * threshold * moved
    density_per_m2 = 1e4 * DENSITIES_PER_CM2["palm"]["pc"]
    return math.sqrt(density_per_m2 * float(np.trapezoid(levels**2 * 2.0 * np.pi * distance, distance)))


def unit_levels(afferent: Afferent, motion: Float, step_s: float, window: slice | None = None) -> Float:
    """Return the largest level of each unit over its threshold, (n,): a unit fires if its level reaches 1.

    motion: motion of the probe with the same effect [m], shape (t, n), from rest; step_s: its time step [s]
    window: samples in which levels count, all by default; the motion before them is used as well
    """
    chosen = window or slice(None)
    result = np.zeros(motion.shape[1])
    for first in range(0, motion.shape[1], BLOCK):
        part = slice(first, first + BLOCK)
        level, step = potentials(afferent, motion[:, part], step_s)
        parts = round(step_s / step)
        begin, end, _ = chosen.indices(len(motion))
        result[part] = level[begin * parts : (end - 1) * parts + 1].max(axis=0, initial=0.0)
    return result


def class_level_dB(name: str, levels: Float) -> float:
    """Return the level of a class by its rule [dB SL], from the levels of its units, (n,); -inf without motion."""
    if name not in AFFERENTS:
        raise OutputError(f"class of afferents is '{name}'; allowed: {', '.join(AFFERENTS)}")
    decides = float(np.linalg.norm(levels)) / pc_criterion() if name == "pc" else float(levels.max(initial=0.0))
    return 20.0 * math.log10(decides) if decides > 0.0 else -math.inf
