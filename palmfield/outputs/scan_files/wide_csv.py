"""Read and write scans as CSV: a column of times, and a column for each point.

# quantity: velocity
# unit: mm/s
time_s,P1,P2,P3
x_m,0,0.005,0.01
y_m,0,0,0
z_m,0,0,0
sight_x,0.7071,0.7071,0.7071      (the three lines sight_x, sight_y, sight_z are optional)
...
0,0.013,0.012,-0.001
7.8125e-06,0.013,0.011,-0.001
"""

import csv
from itertools import pairwise
from pathlib import Path
from typing import cast

import numpy as np

from palmfield.errors import MeasurementError, did_you_mean, naming, refuse_unknown
from palmfield.files import regular, writing
from palmfield.instruments.scan import QUANTITIES, SIGHTS, UNITS, Quantity, Scan
from palmfield.tables import UNREADABLE, numbers_in

PLACES = ("x_m", "y_m", "z_m")


def read_csv(file: Path) -> Scan:
    """Read a scan from a CSV file. Raises MeasurementError with line and column for errors in it."""
    head: dict[str, str] = {}
    rows: list[tuple[int, list[str]]] = []
    try:
        with regular(file).open(newline="", encoding="utf-8-sig") as text:
            for number, line in enumerate(text, 1):
                if line.startswith("#"):
                    name, _, value = line[1:].partition(":")
                    head[name.strip()] = value.strip()[:60]
                elif line.strip():
                    rows.append((number, [cell.strip() for cell in next(csv.reader([line]))]))
    except UNREADABLE as error:
        raise MeasurementError(f"{file}: cannot be read: {error}; give a CSV file (UTF-8)") from None
    quantity, factor = _quantity(file, head)
    if not rows or rows[0][1][0] != "time_s" or len(rows[0][1]) < 2:
        found = rows[0][1][0] if rows else "nothing"
        raise MeasurementError(
            f"{file}: begins with '{found[:40]}'; needed: a first line with time_s and the names of the points, "
            "separated by commas"
        )
    names = rows[0][1][1:]
    instead = "give a finite number, or remove the column"
    labelled: dict[str, list[float]] = {}
    moments: list[list[float]] = []
    for line_number, cells in rows[1:]:
        place = f"{file}: line {line_number}"
        if cells[0] in labelled:
            raise MeasurementError(f"{place} repeats '{cells[0]}'; give it once")
        if cells[0] in (*PLACES, *SIGHTS):
            labelled[cells[0]] = numbers_in(place, names, cells[1:], MeasurementError, instead=instead)
        elif cells[0][:1].isalpha() and cells[0].lower() not in ("nan", "inf", "infinity"):
            raise MeasurementError(
                f"{place} begins with '{cells[0]}'{did_you_mean(cells[0], (*PLACES, *SIGHTS))}; "
                f"allowed: a time, or {', '.join((*PLACES, *SIGHTS))}, positions in metres"
            )
        else:
            moments.append(numbers_in(place, ("time_s", *names), cells, MeasurementError, instead=instead))
    for name in PLACES if not set(SIGHTS) & set(labelled) else (*PLACES, *SIGHTS):
        if name not in labelled:
            raise MeasurementError(f"{file}: has no line '{name},...'; give the {', '.join(PLACES)} of the points")
    table = np.array(moments).reshape(-1, len(names) + 1)
    for first, second in pairwise(range(len(table))):
        if table[second, 0] <= table[first, 0]:
            raise MeasurementError(f"{file}: time {table[second, 0]:g} follows {table[first, 0]:g}; times must rise")
    points, sights = (
        np.array([labelled[name] for name in part]).T if part[0] in labelled else None for part in (PLACES, SIGHTS)
    )
    assert points is not None
    return Scan(quantity, table[:, 0], points, factor * table[:, 1:], sights, file.name)


def _quantity(file: Path, head: dict[str, str]) -> tuple[Quantity, float]:
    example = "begin the file with lines '# quantity: velocity' and '# unit: mm/s'"
    for name in ("quantity", "unit"):
        if name not in head:
            raise MeasurementError(f"{file}: has no line '# {name}: ...'; {example}")
    with naming(str(file)):
        refuse_unknown(MeasurementError, "quantity is {}", head["quantity"], QUANTITIES)
        quantity = cast(Quantity, head["quantity"])
        refuse_unknown(MeasurementError, f"unit of {quantity} is {{}}", head["unit"], UNITS[quantity])
    return quantity, UNITS[quantity][head["unit"]]


def write_csv(file: Path, scan: Scan) -> None:
    """Write a scan; `read_csv` reads it back unchanged. Raises OutputError if that fails."""
    unit = "m/s" if scan.quantity == "velocity" else "m"
    with writing(file), file.open("w", newline="", encoding="utf-8") as text:
        text.write(f"# quantity: {scan.quantity}\n# unit: {unit}\n")
        writer = csv.writer(text)
        writer.writerow(["time_s", *(f"P{n + 1}" for n in range(len(scan.points)))])
        for names, columns in ((PLACES, scan.points), (SIGHTS, scan.sights)):
            if columns is not None:
                writer.writerows([name, *row] for name, row in zip(names, columns.T.tolist(), strict=True))
        writer.writerows(np.column_stack([scan.times_s, scan.values]).tolist())
