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
    """Return notes: two readings varied together, the level of 4000 Pa, and assumptions where the text is open."""
    lines = [
        "## Focal length and radius together",
        "",
        "The verdicts vary one reading at a time. The printed angles fit a focal length of 30 mm and the printed "
        "Rayleigh length a radius of 5 mm, so here both vary together, with bows in phase and a diaphragm of a quarter "
        "inch. This was set up after the first answers were seen, so it is a hypothesis and does not count.",
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
        "## Plausibility of 4000 Pa",
        "",
        f"In phase at the focus, with a focal length of 30 mm, every speaker would need {p0:.0f} Pa at 1 m (peak); "
        f"published values of such transducers are 1.3 to 8.5 Pa. With 2.53 Pa the focus has "
        f"{4000.0 * (2.53 / p0) ** 2:.0f} Pa. A pressure microphone that doubles the sound at its face, and peak "
        "values read as rms, would together turn 500 Pa into 4000 Pa. No published value gives 500 Pa either.",
        "",
        "## Assumptions where the text is open",
        "",
        "- The sound of all speakers arrives in phase at the common focus. On a parabola with one generator it would "
        "not: the outer speakers are 3 mm farther away, a third of a wavelength. This is tested as a cause.",
        "- The part of the radiation pressure at the modulation frequency is proportional to the squared carrier "
        "pressure.",
        "- 4000 Pa is the amplitude of that part in the middle of the focus.",
        "- The moduli of the gel at 10 Hz are printed; those at other frequencies are assumed (preset `hitohada_*`). "
        "Its largest displacement is at 1 Hz, where the assumption has the largest effect.",
        "- At 4000 Pa a frictionless layer of C0 is compressed by 41 % of its thickness, where a linear "
        "law is no longer valid.",
    ]
    lines += ["", "## The gel on a curved bone", "", _on_bone(setting)]
    return "\n".join(lines) + "\n"


def _on_bone(setting: Setting) -> str:
    if setting.quick:
        return "Computed in full runs only."
    bonded, slides = over_flat("bonded"), over_flat("free_slip")
    finer = over_flat("bonded", 1)
    return (
        f"On a rigid bone of {1e3 * BONE_M:g} mm radius (assumed), at rest, the displacement of gel C0 is {bonded:.2f} "
        f"times that on a flat bone if it is bonded ({finer:.2f} on quartered triangles) and {slides:.2f} times if it "
        "slides. The configuration is flat, so this is a hypothesis and does not count."
    )
