"""Write the notes below the tables of Reardon's page."""

from palmfield_papers.answer import Setting
from palmfield_papers.reardon2023.configuration import Plate
from palmfield_papers.reardon2023.hand import FELT, conditions, observer_counts
from palmfield_papers.reardon2023.lines import likeness_of_nulls
from palmfield_papers.reardon2023.resolution import level_of

CHOSEN = """## Choices where the file of tolerances is open

- Slab: {density:g} kg/m3, {shear:.0f} Pa, Kelvin-Voigt, Poisson's ratio 0.4999; the pressure starts suddenly at t = 0
  and is constant from then on, as in the text. A free slab has no support.
- *absorbing* rim: an infinite slab, of which 25 cm are evaluated. *reflecting*: a smooth wall, without radial motion
  and free along z, which reflects all waves.
- *largest change* (R8-R9c, d): the largest decrease of the focal energy ratio, and the largest increase of the residual
  energy, from the slow speed to 5, 7, 10 and 20 m/s. Both may be negative.
- Zigzags begin at the lower edge of a path of 16 cm. Those of 4 cm have one turn on it at 5 and 6 m/s: no turn is left
  without the first and the last.
- The scan of the plate has 40 by 30 points, with one row on the path.
- R12: 200 kHz is a focus that moves continuously, half a control step late. Each difference is printed together with
  that from a focus late by half a step of the slow rate, which is the mean delay of a held focus.
- R14: the ridge of the spiral begins at the largest magnitude at most one width of the spot behind the focus, follows
  the largest within 3 mm of radius from angle to angle, and ends after three turns.
- R19: the text prints no accuracy. The noise is set so that the mean at 0.5 and 1 m/s is 95 %; 75 and 99 % and shorter
  memories are printed too. Receptors are 5 mm apart on the path, weighted by the table afferent_human from 2 to 350 Hz,
  with weight 0 outside. The reversed stimulus runs the same path backward. A first version used the mirrored path,
  whose zigzag has other corners: then places gave the direction, with 97 % right answers on skin without waves.
"""
HYPOTHESES = """## Hypotheses, found from the answers

These hypotheses do not count.

- A free slab of 1 cm under a constant force keeps moving in its slowest flexural waves: the middle of an infinite
  plate has the constant velocity F/(8 (D rho h)^(1/2)). This motion has no front, is present everywhere, and lasts
  longest under slow foci: it dominates their energies, areas and wakes. A bonded slab does not have this motion.
- With a bonded back, which is a listed reading, R8-R9d, R10a, R10b and R20c agree; with a free back, the base, all four
  do not. The slab of the paper may have been supported from below.
- Energies over M: in the mean over time of [metrics.energy_density], a slow focus gives each place more time. An
  integral over time, or a division by the time of the focus per length, gives another ratio.
- The half-angle by the ridge is that of the strongest wave of a dispersive plate and not of its front.
"""


def _accuracy_table(setting: Setting) -> list[str]:
    of = conditions(setting, level_of(setting))
    lines = ["| skin, duration | " + " | ".join(f"{v:g} m/s" for v in FELT) + " |", "|" + "---|" * (len(FELT) + 1)]
    lines += [f"| {name} | " + " | ".join(f"{one[v]:.1f}" for v in FELT) + " |" for name, one in of.items()]
    counts = (
        "The observer is at chance with waves at 4, 7 and 11 m/s and not at chance without propagation at constant "
        "duration, so it counts."
        if observer_counts(of)
        else "Only an observer that is at chance with waves at 4, 7 and 11 m/s, and not at chance without propagation "
        "at constant duration, tests the effect of waves. This observer does not meet both conditions, so its rows do "
        "not test the explanation of the paper."
    )
    return [*lines, "", counts, ""]


def notes(setting: Setting) -> str:
    """Return Markdown: choices, pairs of fields that test the metrics, controls of the observer, hypotheses."""
    base = Plate()
    nulls = likeness_of_nulls(setting)
    lines = [
        CHOSEN.format(density=base.material.density_kg_m3, shear=base.material.shear_relaxed_Pa),
        "## Null pairs of MSE and SSIM",
        "",
        "Energy densities of a straight path at 7 m/s over the slab, each relative to its maximum:",
        "",
        "| pair | MSE | SSIM |",
        "|---|---|---|",
        *(f"| {name} | {one:.2g} | {like:.3f} |" for name, (one, like) in nulls.items()),
        "",
        "## The direction observer and its controls",
        "",
        "Expected share of right answers [%] on the tissue of the base readings:",
        "",
        *_accuracy_table(setting),
        HYPOTHESES,
    ]
    return "\n".join(lines)
