"""Write the notes below the tables of Mizushima & Sato 2024."""

from palmfield.errors import MeasurementError
from palmfield.metrics import half_width
from palmfield_papers.answer import Setting
from palmfield_papers.mizushima2024.bone import BONE_M, over_flat
from palmfield_papers.mizushima2024.bows import Bows
from palmfield_papers.mizushima2024.field import needed_p0_Pa_m, scan, width_mm

LENGTHS_MM, RADII_MM = (50.0, 30.0), (6.0, 5.0, 3.0)


def _width(bows: Bows, axis: str) -> str:
    try:
        return f"{width_mm(bows, axis):.1f}"
    except MeasurementError:
        return "beyond the scan"


def notes(setting: Setting) -> str:
    """Return two readings varied together, the level of 4000 Pa, and assumptions where the text is open."""
    lines = [
        "## Focal length and radius together",
        "",
        "The verdicts vary one reading at a time. The printed angles fit a focal length of 30 mm and the printed "
        "Rayleigh length a radius of 5 mm, so here both vary together, bows in step, through a quarter inch. This was "
        "set up after the first answers had been seen, so it is a hypothesis and doesn't count.",
        "",
        "| focal length [mm] | radius [mm] | x, outermost [mm] | x, central lobe [mm] | y [mm] | z [mm] |",
        "|---|---|---|---|---|---|",
    ]
    for length in LENGTHS_MM:
        for radius in RADII_MM:
            bows = Bows(1e-3 * length, 1e-3 * radius)
            central = 1e3 * half_width(*scan(bows, "x"), of="central")
            cells = (_width(bows, "x"), f"{central:.1f}", _width(bows, "y"), _width(bows, "z"))
            lines.append(f"| {length:g} | {radius:g} | " + " | ".join(cells) + " |")
    p0 = needed_p0_Pa_m(Bows(30e-3, 5e-3))
    lines += [
        "",
        "## How plausible 4000 Pa are",
        "",
        f"In step at the focus, with a focal length of 30 mm, every speaker would need {p0:.0f} Pa at 1 m (peak); "
        f"published values of such transducers reach from 1.3 to 8.5. At 2.53 the focus has "
        f"{4000.0 * (2.53 / p0) ** 2:.0f} Pa. A pressure microphone that doubles the sound at its face, and peak "
        "values taken for rms, would together make 4000 Pa of 500: more than any published value gives, too.",
        "",
        "## Read into the text",
        "",
        "- Speakers arrive in step at the common focus. On a parabola that one generator drives they would not: the "
        "outer ones are 3 mm farther away, a third of a wave. This is tested as a cause.",
        "- The radiation pressure's part at the modulation frequency goes with the square of the carrier's pressure.",
        "- 4000 Pa is the amplitude of that part in the middle of the focus.",
        "- The gel's moduli at 10 Hz are printed; their course over frequency is assumed (preset `hitohada_*`). "
        "Its largest displacement lies at 1 Hz, where the assumption counts most.",
        "- At 4000 Pa a frictionless layer of C0 is pressed by 41 % of its thickness, where a linear "
        "law is no longer right.",
    ]
    lines += ["", "## The gel on a curved bone", "", _on_bone(setting)]
    return "\n".join(lines) + "\n"


def _on_bone(setting: Setting) -> str:
    if setting.quick:
        return "Left to the full run."
    bonded, slides = over_flat("bonded"), over_flat("free_slip")
    finer = over_flat("bonded", 1)
    return (
        f"Wrapped round a rigid bone of {1e3 * BONE_M:g} mm radius (assumed), at rest, gel C0 moves {bonded:.2f} times "
        f"as far as on a flat one where it is bonded ({finer:.2f} on quartered triangles) and {slides:.2f} times where "
        "it slides. The configuration is flat, so this is a hypothesis and doesn't count."
    )
