"""Read and write scans in Universal File Format (vibrometer software) with pyuff (extra [uff]).

It reads nodes (data sets 15 and 2411), units (164), and functions at nodes (58, and 58b in binary).
It writes 164, 2411, trace lines (82), and 58 or 58b. The fourth line of a function is the beam: `sight x y z`.
"""

import math
from pathlib import Path
from typing import Any

import numpy as np

from palmfield.errors import MeasurementError, OutputError, reason_of
from palmfield.files import reading, regular, writing
from palmfield.instruments.scan import UNITS, Quantity, Scan
from palmfield.types import Float

KINDS: dict[int, Quantity] = {8: "displacement", 11: "velocity"}
NUMBERS = {quantity: number for number, quantity in KINDS.items()}
TIME_RESPONSE = 1
SIGHT = "sight "
ALONG_BEAM = (0, 3)
LONGEST_LINE = 250
DELIMITER, TAIL = b"    -1", 4096
"""Line that ends a data set, and largest number of bytes after the last such line."""
LONGEST_PATH = 80
"""Largest length of a path. The messages of pyuff contain paths."""


def _pyuff() -> Any:
    try:
        import pyuff
    except ModuleNotFoundError:
        raise OutputError("files of UFF need the extra [uff]: pip install 'palmfield[uff]'") from None
    return pyuff


def _sets(file: Path) -> list[dict[str, Any]]:
    with reading(file, MeasurementError, "a UFF file"):
        regular(file)
    pyuff = _pyuff()
    try:
        opened = pyuff.UFF(str(file))
        kinds = {15, 2411, 164, 58}
        # pyuff raises plain Exceptions and ignores unreadable data
        found = [opened.read_sets(n) for n, kind in enumerate(opened.get_set_types()) if int(kind) in kinds]
    except Exception as error:
        text = reason_of(error, LONGEST_PATH)
        raise MeasurementError(f"{file}: cannot be read as UFF: {text}; give a UFF file") from None
    if not found:
        raise MeasurementError(f"{file}: contains no data sets 15, 2411 or 58; give a UFF file of a scan")
    # pyuff ignores an incomplete set, so a point would be missing without a message
    if not file.read_bytes()[-TAIL:].rstrip().endswith(DELIMITER):
        raise MeasurementError(f"{file}: ends within a data set; give the complete file")
    return [one for one in found if one]


def _nodes(file: Path, sets: list[dict[str, Any]]) -> tuple[dict[int, Float], float]:
    """Return positions of nodes [m] by number, and the unit of length of the file [m]."""
    factors = [float(one["length"]) for one in sets if one["type"] == 164]
    metre = 1.0 / factors[-1] if factors else 1.0
    places: dict[int, Float] = {}
    for one in sets:
        if one["type"] in (15, 2411):
            table = np.column_stack([one["x"], one["y"], one["z"]]) * metre
            places |= {int(number): place for number, place in zip(one["node_nums"], table, strict=True)}
    if not places:
        raise MeasurementError(
            f"{file}: has no nodes (data sets 15 or 2411), so positions are unknown; export the nodes"
        )
    return places, metre


def read_uff(file: Path) -> Scan:
    """Read the time responses of displacement or velocity in a file, as one scan.

    Raises MeasurementError for files without time responses, with several quantities, different times, or nodes without
    a position.
    """
    sets = _sets(file)
    places, metre = _nodes(file, sets)
    functions = [one for one in sets if one["type"] == 58 and int(one.get("func_type", 0)) == TIME_RESPONSE]
    if not functions:
        raise MeasurementError(f"{file}: has no time responses (data set 58 of function type 1)")
    kinds = {int(one["ordinate_spec_data_type"]) for one in functions}
    if len(kinds) != 1 or not kinds <= set(KINDS):
        raise MeasurementError(
            f"{file}: time responses have data types {', '.join(map(str, sorted(kinds)))}; allowed: 8 "
            "(displacement) or 11 (velocity)"
        )
    first = functions[0]
    times = np.asarray(first["x"], dtype=float)
    if first.get("abscissa_spacing") == 1:
        times = float(first["abscissa_min"]) + float(first["abscissa_inc"]) * np.arange(len(times))
    values, points, sights = [], [], []
    scaled = any(one["type"] == 164 for one in sets)
    for one in functions:
        node = int(one["rsp_node"])
        if node not in places:
            raise MeasurementError(f"{file}: a time response belongs to node {node}, which has no position")
        direction = int(one.get("rsp_dir", 0))
        if abs(direction) not in ALONG_BEAM:
            raise MeasurementError(
                f"{file}: a time response of node {node} has direction {direction}; allowed: 3 and -3 (z, the beam "
                "of one head), and 0"
            )
        record = np.asarray(one["data"])
        if len(record) != len(times) or np.abs(np.asarray(one["x"]) - np.asarray(first["x"])).max() > 1e-9:
            raise MeasurementError(
                f"{file}: the times of node {node} differ from those of node {int(first['rsp_node'])}"
            )
        # Direction along an axis of the node; -3 is opposite to z
        unit = _unit(file, one, KINDS[int(one["ordinate_spec_data_type"])], metre if scaled else None)
        values.append((-unit if direction < 0 else unit) * record.real)
        points.append(places[node])
        sights.append(_sight(str(one.get("id4", ""))))
    aimed = all(sight is not None for sight in sights)
    return Scan(
        KINDS[kinds.pop()], times, np.array(points), np.array(values).T, np.array(sights) if aimed else None, file.name
    )


def _unit(file: Path, function: dict[str, Any], quantity: Quantity, by_set: float | None) -> float:
    """Return the unit of values [m or m/s].

    It comes from the label of the function, if any, and must agree with data set 164.
    """
    time = str(function.get("abscissa_axis_units_lab") or "").strip()
    if time.lower() not in ("", "none", "s", "sec", "seconds"):
        raise MeasurementError(f"{file}: times have the unit label '{time[:20]}'; allowed: s; export in seconds")
    label = str(function.get("ordinate_axis_units_lab") or "").strip().replace("\u00b5", "u").replace("\u03bc", "u")
    if label.lower() in ("", "none"):
        return 1.0 if by_set is None else by_set
    if label not in UNITS[quantity]:
        raise MeasurementError(
            f"{file}: {quantity} has the unit label '{label[:20]}'; allowed: {', '.join(UNITS[quantity])}, or none"
        )
    factor = UNITS[quantity][label]
    if by_set is not None and not math.isclose(factor, by_set, rel_tol=1e-6):
        raise MeasurementError(
            f"{file}: values have the unit label '{label}', but data set 164 has lengths of {by_set:g} m; allowed: "
            "the same unit in both; correct one of them"
        )
    return factor


def _sight(text: str) -> list[float] | None:
    if not text.startswith(SIGHT):
        return None
    try:
        numbers = [float(part) for part in text[len(SIGHT) :].split()]
    except ValueError:
        return None
    return numbers if len(numbers) == 3 else None


def _geometry(points: Float) -> list[dict[str, Any]]:
    count = len(points)
    numbers = np.arange(1, count + 1)
    zeros = np.zeros(count, dtype=int)
    lines = [
        {"type": 82, "trace_num": n + 1, "id": "scan", "color": 1, "nodes": numbers[begin : begin + LONGEST_LINE]}
        for n, begin in enumerate(range(0, count, LONGEST_LINE - 1))
        if len(numbers[begin : begin + LONGEST_LINE]) > 1
    ]
    return [
        {"type": 164, "units_code": 1, "units_description": "SI", "temp_mode": 1, "length": 1.0, "force": 1.0,
         "temp": 1.0, "temp_offset": 0.0},
        {"type": 2411, "node_nums": numbers, "def_cs": zeros, "disp_cs": zeros, "color": zeros, "x": points[:, 0],
         "y": points[:, 1], "z": points[:, 2]},
        *lines,
    ]  # fmt: skip


def write_uff(file: Path, scan: Scan, *, binary: bool = True) -> None:
    """Write a scan: units, nodes, trace lines, and a time response for each point, as 58b, or as 58 if not binary.

    Times in headers have single precision, an error of 1e-6 of the step. Raises OutputError if that fails.
    """
    step = 1.0 / scan.rate_Hz
    number = NUMBERS[scan.quantity]
    functions = []
    for n in range(len(scan.points)):
        beam = "NONE" if scan.sights is None else SIGHT + " ".join(f"{x:.9g}" for x in scan.sights[n])
        functions.append(
            {"type": 58, "binary": int(binary), "func_type": TIME_RESPONSE, "rsp_node": n + 1, "rsp_dir": 3,
             "ref_node": 0, "ref_dir": 0, "rsp_ent_name": "NONE", "ref_ent_name": "NONE", "data": scan.values[:, n],
             "x": scan.times_s, "id1": f"{scan.quantity} along the beam", "id2": "palmfield", "id3": "NONE",
             "id4": beam, "id5": "NONE", "ver_num": 1, "load_case_id": 0, "ord_data_type": 4,
             "abscissa_spacing": 1, "abscissa_min": float(scan.times_s[0]), "abscissa_inc": step,
             "num_pts": len(scan.times_s), "z_axis_value": 0.0, "abscissa_spec_data_type": 17,
             "orddenom_spec_data_type": 0, "abscissa_axis_lab": "Time",
             "abscissa_axis_units_lab": "s", "ordinate_spec_data_type": number,
             "ordinate_axis_lab": scan.quantity, "ordinate_axis_units_lab": "m/s" if number == 11 else "m"}
        )  # fmt: skip
    _write(file, [*_geometry(scan.points), *functions])


def _write(file: Path, sets: list[dict[str, Any]]) -> None:
    pyuff = _pyuff()
    with writing(file):
        # Check first, because pyuff appends to the file set by set
        file.write_bytes(b"")
        try:
            pyuff.UFF(str(file)).write_sets(sets, mode="overwrite")
        except OSError:
            raise
        except Exception as error:
            raise OutputError(f"cannot write {file}: {reason_of(error, LONGEST_PATH)}") from None
