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
        "Receivers: the microphone (mean over its face, with the response of its body over angle, that of a rigid "
        "sphere of its diameter), its face without the body, and a point.",
        "",
        "## Assumptions where the text is open",
        "",
        "- The microphone points at the middle of the units. Its body is computed without other bodies near it.",
        "- Forces are computed with alpha 2 and the incident pressure, as in eq. 1 of the text; forces by the law of a "
        "rigid wall are printed too. Repeated reflections between reflector and units are not modelled.",
        "- The exponent 1.5 is a property of transducers and drivers: duty cycles are computed for it, and the "
        "modelled device has it. The radiation pressure is quadratic in the sound pressure.",
        "- The resonance of the transducers is at the carrier. The text does not print the filter from 2 to 40 kHz: "
        "here it is a Kaiser-windowed sinc of 8 frames with half its amplitude at 1 kHz.",
        "- At 1000 Hz a period has two packets. Three phases of the sine relative to the packets were computed, and "
        "the worst is compared.",
        f"- A skew of 1 us is {skew:.1f} degrees of the carrier.",
        "- The force of row H22 is that on 12 x 12 mm. At larger distances the focus is wider, so the force decreases "
        "less than the squared pressure in its middle.",
    ]
    return "\n".join(lines) + "\n"
