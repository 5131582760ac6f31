"""Write the notes below the tables of Reardon's page."""

from palmfield_papers.answer import Setting
from palmfield_papers.reardon2023.configuration import Plate
from palmfield_papers.reardon2023.hand import FELT, conditions, observer_counts
from palmfield_papers.reardon2023.lines import likeness_of_nulls
from palmfield_papers.reardon2023.resolution import level_of

CHOSEN = """## What was chosen where the file leaves room

- Slab: {density:g} kg/m3, {shear:.0f} Pa, Kelvin-Voigt, Poisson's ratio 0.4999; the pressure is sudden at t = 0 and
  constant from then on, as the text says. Nothing holds a free slab.
- *absorbing* rim: an endless slab of which the 25 cm are looked at. *reflecting*: a smooth wall, without radial motion
  and free along z, which sends all waves back.
- *largest change* (R8-R9c, d): the largest fall of the focal energy ratio, and the largest rise of the residual energy,
  from the slow speed to 5, 7, 10 and 20 m/s, whatever their sign is.
- Zigzags begin at the lower edge of a path of 16 cm. Those of 4 cm have one turn on it at 5 and 6 m/s, so that there is
  none but the first and the last.
- The scan of the plate has 40 by 30 places, with one row on the path.
- R12: 200 kHz is a focus that moves on, half a control step late. Beside each difference stands the one from a focus
  that is late by half a step of the slow rate, which is what a held focus is on average.
- R14: the ridge of the spiral begins at the largest magnitude at most a spot's width behind the focus, follows the
  largest within 3 mm of radius from angle to angle, and ends after three turns.
- R19: the text prints no accuracy. The noise is set so that the mean at 0.5 and 1 m/s is 95 %; 75 and 99 % stand beside
  it, as do shorter memories. Receptors lie 5 mm apart on the path and are weighed by the table afferent_human, 2 to
  350 Hz, and by nothing outside. The reversed stimulus runs the same path back. A first version took the mirrored one,
  whose zigzag has other corners: places alone then told the direction, to 97 % on skin that doesn't propagate.
"""
HYPOTHESES = """## Hypotheses, found by looking at the answers

None of these counts.

- A free slab of 1 cm under a constant force keeps accelerating in its slowest flexural waves: the middle of an endless
  plate moves at F/(8 (D rho h)^(1/2)) for ever. That motion has no front, lies everywhere, and lasts longest under slow
  foci, so that it decides energies, areas and wakes of slow foci. A bonded slab has none of it.
- With a bonded back, which is a listed reading, R8-R9d, R10a, R10b and R20c agree; with a free one, the base, none of
  the four does. The paper's slab may have been held from below.
- Energies over M: with the mean over time of [metrics.energy_density] a slow focus gives each place more time. A paper
  that integrates over time, or divides by the focus's time per length, gets another ratio.
- The half-angle by the ridge is that of the strongest wave of a dispersive plate and not of its front.
"""


def _accuracy_table(setting: Setting) -> list[str]:
    of = conditions(setting, level_of(setting))
    lines = ["| skin, duration | " + " | ".join(f"{v:g} m/s" for v in FELT) + " |", "|" + "---|" * (len(FELT) + 1)]
    lines += [f"| {name} | " + " | ".join(f"{one[v]:.1f}" for v in FELT) + " |" for name, one in of.items()]
    counts = (
        "It is at chance on waves at 4, 7 and 11 m/s and not at chance without propagation at constant duration: it "
        "counts."
        if observer_counts(of)
        else "Only an observer that is at chance on waves at 4, 7 and 11 m/s, and not at chance without propagation "
        "when the duration is held constant, says something of waves. This one is not of that kind: its rows say "
        "nothing of the paper's explanation."
    )
    return [*lines, "", counts, ""]


def notes(setting: Setting) -> str:
    """Return Markdown: choices, null pairs of the metrics, the controls of the observer, hypotheses."""
    base = Plate()
    nulls = likeness_of_nulls(setting)
    lines = [
        CHOSEN.format(density=base.material.density_kg_m3, shear=base.material.shear_relaxed_Pa),
        "## Null pairs of MSE and SSIM",
        "",
        "Of energy densities of a straight path at 7 m/s, over the slab, each over its largest:",
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
