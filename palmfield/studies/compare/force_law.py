"""Evaluate a data sheet of the force-law kit: the force on a small plate in a focus, divided by the usual formula.

`docs/gallery/force_law.md` has the protocol. The formula is 2 p_rms^2 / (rho c^2), integrated over the plate.
"""

import csv
import math
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmfield.acoustics import density, sound_speed
from palmfield.errors import MeasurementError, refuse_unknown
from palmfield.files import read_text, reading
from palmfield.tables import numbers_in
from palmfield.types import Air

NAME = "force-law"
EXPECTED = {"1": ("autd2018_2x2, 100 mm", 0.57), "2": ("autd2018_2x2, 200 mm", 0.80), "3": ("uhev1, 200 mm", 0.945)}
"""Array and depth of each case, and the force ratio by boundary elements for plates of 12 x 12 x 2 mm."""
BAND = 0.03
FORMULA = 1.0
GRID_MM = (-5.0, -3.0, -1.0, 1.0, 3.0, 5.0)
"""Positions of the microphone along both axes. They are centres of 2 mm cells that cover the plate."""
LEAST_SHIFTS = 4
"""Smallest number of plate positions within half a wavelength along the axis. The echo is averaged over them."""
COLUMNS = ("case", "kind", "x_mm", "y_mm", "z_mm", "value")
KINDS = ("pressure_Pa", "scale_mg", "off_mg", "microphone_dB", "air_hPa", "air_C")
"""Kinds of readings: rms pressure without the plate; scale with sound and without; microphone uncertainty; air."""
STILL = {"air_C": 20.0, "air_hPa": 1013.25}
"""Air that is used if the sheet has none."""
N_MG = 9.80665e-6


@dataclass(frozen=True)
class Judged:
    """One force ratio of the sheet.

    error: of the measurement; ours, formula: whether the ratio agrees with each of the two
    """

    what: str
    expected: float
    band: float
    measured: float
    error: float
    ours: bool
    formula: bool

    def __str__(self) -> str:
        ours, formula = ("agrees" if one else "disagrees" for one in (self.ours, self.formula))
        return (
            f"{self.what}: {self.measured:.3f} +- {self.error:.3f}; palmfield {self.expected:.3f} +- {self.band:.3f} "
            f"{ours}, the usual formula (1 +- {self.band:.3f}) {formula}"
        )


def force_law(sheet: str | Path) -> list[Judged]:
    """Return the ratio of each case of a sheet, and the quotient of cases 1 and 3.

    In this quotient the gain of the microphone cancels. Raises MeasurementError, with line and column, for other
    columns and kinds, and for missing readings.
    """
    file = Path(sheet)
    found = _read(file)
    ratios = {case: _ratio(file, case, kinds) for case, kinds in found.items()}
    judged = [
        _judged(*EXPECTED[case], BAND, ratio, math.hypot(own, gain)) for case, (ratio, own, gain) in ratios.items()
    ]
    if "1" in ratios and "3" in ratios:
        (first, own, _), (third, other, _) = ratios["1"], ratios["3"]
        expected = EXPECTED["1"][1] / EXPECTED["3"][1]
        band = expected * math.hypot(BAND / EXPECTED["1"][1], BAND / EXPECTED["3"][1])
        error = first / third * math.hypot(own / first, other / third)
        judged.append(_judged("case 1 over case 3", expected, band, first / third, error))
    return judged


def _judged(what: str, expected: float, band: float, ratio: float, error: float) -> Judged:
    ours, formula = (abs(ratio - value) <= band + error for value in (expected, FORMULA))
    return Judged(what, expected, band, ratio, error, ours, formula)


def _read(file: Path) -> dict[str, dict[str, list[list[float]]]]:
    """Return, by case and kind, the rows of x_mm, y_mm, z_mm, value."""
    with reading(file, MeasurementError, "a CSV file in UTF-8"):
        rows = list(csv.reader(read_text(file, "utf-8-sig").splitlines()))
    if not rows or tuple(rows[0]) != COLUMNS:
        raise MeasurementError(f"{file}: line 1 is '{','.join(rows[0]) if rows else ''}'; give {','.join(COLUMNS)}")
    found: dict[str, dict[str, list[list[float]]]] = defaultdict(lambda: defaultdict(list))
    for line, row in enumerate(rows[1:], 2):
        case, kind = (*row, "", "")[:2]
        refuse_unknown(MeasurementError, f"{file}: line {line}: case is {{}}", case, EXPECTED)
        refuse_unknown(MeasurementError, f"{file}: line {line}: kind is {{}}", kind, KINDS)
        found[case][kind].append(numbers_in(f"{file}: line {line}", COLUMNS[2:], row[2:], MeasurementError))
    return found


def _ratio(file: Path, case: str, kinds: dict[str, list[list[float]]]) -> tuple[float, float, float]:
    """Return the ratio, its error due to the scatter of the scale, and its error due to the microphone."""
    pressure, weight, off = (np.array(kinds[kind]).reshape(-1, 4) for kind in KINDS[:3])
    needed = {(x, y) for x in GRID_MM for y in GRID_MM}
    missing = sorted(needed - {(x, y) for x, y, *_ in pressure.tolist()})
    shifts = len(np.unique(weight[:, 2]))
    if missing or shifts < LEAST_SHIFTS or len(off) < 2:
        raise MeasurementError(
            f"{file}: case {case} has scale_mg at {shifts} z_mm (needed: {LEAST_SHIFTS}), {len(off)} off_mg "
            f"(needed: 2), and lacks pressure_Pa at places (x, y) {missing[:3]} mm; measure these, or remove the case"
        )
    means = [np.mean([p**2 for x, y, _, p in pressure.tolist() if (x, y) == place]) for place in sorted(needed)]
    degrees, hectopascals = (kinds[kind][0][3] if kinds[kind] else usual for kind, usual in STILL.items())
    air = Air(degrees, pressure_Pa=100.0 * hectopascals)
    formula_N = 2.0 * float(np.mean(means)) * (2e-3 * len(GRID_MM)) ** 2 / (density(air) * sound_speed(air) ** 2)
    net = weight[:, 3].mean() - off[:, 3].mean()
    ratio = abs(net) * N_MG / formula_N
    scatter = off[:, 3].std(ddof=1) * math.sqrt(1.0 / len(off) + 1.0 / len(weight)) * N_MG / formula_N
    gain_dB = kinds["microphone_dB"][0][3] if kinds["microphone_dB"] else 0.0
    return ratio, float(scatter), ratio * (10.0 ** (gain_dB / 10.0) - 1.0)
