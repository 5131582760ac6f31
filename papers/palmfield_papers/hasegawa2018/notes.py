"""Write the notes below the tables of Hasegawa & Shinoda 2018."""

import numpy as np

from palmfield.drive.boards.autd2018 import CARRIER_HZ
from palmfield_papers.answer import Setting
from palmfield_papers.hasegawa2018.units import DEPTHS_M, Units, focal_pressure


def notes(setting: Setting) -> str:
    """Return pressures at all depths by directivity and receiver, and assumptions where the text is open."""
    lines = [
        "## Pressure at the focus over that at 200 mm",
        "",
        "| units | transducers | receiver | " + " | ".join(f"{1e3 * depth:g} mm" for depth in DEPTHS_M) + " |",
        "|" + "---|" * (3 + len(DEPTHS_M)),
    ]
    for count in (1, 4):
        for directivity in ("piston", "table", "point"):
            for receiver in ("microphone", "face", "point"):
                units = Units(count, directivity)
                shares = [focal_pressure(units, d, receiver) / focal_pressure(units, 0.2, receiver) for d in DEPTHS_M]
                cells = " | ".join(f"{share:.2f}" for share in shares)
                lines.append(f"| {count} | {directivity} | {receiver} | {cells} |")
    skew = np.degrees(2.0 * np.pi * CARRIER_HZ * 1e-6)
    lines += [
        "",
        "Receivers: the microphone (mean over its face, and its body's response over angle by a rigid sphere of its "
        "diameter), its face alone, and a point.",
        "",
        "## Read into the text",
        "",
        "- The microphone looks at the middle of the units, and its body counts as alone in each transducer's sound.",
        "- Forces take alpha 2 and the incident pressure, as the text's eq. 1 does; those by the law of a rigid wall "
        "stand beside. Sound that goes back and forth between reflector and units is left out.",
        "- The exponent 1.5 belongs to transducers and drivers: duty cycles are made for it, and the device has it. "
        "The radiation pressure is quadratic in the sound pressure.",
        "- The transducers' resonance lies at the carrier. The filter from 2 to 40 kHz is not printed: a "
        "Kaiser-windowed sinc of 8 frames with half its amplitude at 1 kHz.",
        "- At 1000 Hz there are two packets a period; three phases of the sine against them were run, and the worst is "
        "held.",
        f"- A skew of 1 us is {skew:.1f} degrees of the carrier.",
        "- The force of row H22 is that on 12 x 12 mm. Farther away the focus is wider, so that it falls less than the "
        "pressure squared in its middle.",
    ]
    return "\n".join(lines) + "\n"
