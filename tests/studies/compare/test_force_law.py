"""The force-law kit: its numbers by boundary elements, and sheets of laboratories that obey one law or the other."""

import numpy as np
import pytest
from typer.testing import CliRunner

from palmfield.acoustics import FieldEvaluator, density, layout, sound_speed
from palmfield.acoustics.focus import focus
from palmfield.acoustics.scattering import closed, scatter, wall_arp
from palmfield.cli.app import app
from palmfield.errors import MeasurementError
from palmfield.studies.compare.force_law import COLUMNS, EXPECTED, GRID_MM, N_MG, force_law
from palmfield.types import Air

AIR = Air()
CASES = {"1": ("autd2018_2x2", 0.1, 0.2), "2": ("autd2018_2x2", 0.2, 0.1), "3": ("uhev1", 0.2, 0.5)}
"""Array, depth [m] and drive of the protocol."""
EDGE_M, THICK_M, CELLS = 0.012, 0.002, 20


def plate(depth):
    s = np.linspace(-0.5 * EDGE_M, 0.5 * EDGE_M, CELLS + 1)
    x, y = np.meshgrid(s, s, indexing="ij")
    corner = np.arange((CELLS + 1) ** 2).reshape(CELLS + 1, CELLS + 1)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    return closed(np.column_stack([x.ravel(), y.ravel(), np.full(x.size, depth)]), faces, THICK_M)[:2]


def force(field, drive, depth):
    """Force along the axis on both faces and the rim of the plate [N], by boundary elements."""
    k = 2.0 * np.pi * field.array.frequency_Hz / sound_speed(AIR)
    found = scatter(*plate(depth), lambda p: field.pressure(p, drive).pressure.astype(complex), k, device="cpu")
    return float((wall_arp(found, AIR) * -found.normals[:, 2] * found.areas).sum())


@pytest.fixture(scope="module")
def readings():
    """By case: rms pressures on the grid [Pa], and weights [mg] at five heights."""
    found = {}
    for case, (name, depth, level) in CASES.items():
        field = FieldEvaluator(layout(name), AIR, device="cpu")
        drive = level * focus(layout(name), AIR, [0.0, 0.0, depth])
        places = np.array([(1e-3 * x, 1e-3 * y, depth) for x in GRID_MM for y in GRID_MM])
        rms = np.abs(field.pressure(places, drive).pressure) / np.sqrt(2.0)
        weights = {z: force(field, drive, depth + 1e-3 * z) / N_MG for z in (-1.6, -0.8, 0.0, 0.8, 1.6)}
        found[case] = rms, weights
    return found


def sheet(readings, *, by_formula=False, gain=1.0):
    """Text of a sheet; by_formula: of a plate that weighs what the usual formula says; gain: of the microphone."""
    lines = [",".join(COLUMNS)]
    for case, (rms, weights) in readings.items():
        cell = (2e-3) ** 2
        formula = 2.0 * float((rms**2).sum()) * cell / (density(AIR) * sound_speed(AIR) ** 2) / N_MG
        places = [(x, y) for x in GRID_MM for y in GRID_MM]
        lines += [f"{case},pressure_Pa,{x:g},{y:g},0,{gain * p:.5g}" for (x, y), p in zip(places, rms, strict=True)]
        lines += [f"{case},scale_mg,0,0,{z:g},{5.0 + (formula if by_formula else w):.4f}" for z, w in weights.items()]
        lines += [f"{case},off_mg,0,0,0,{5.0 + d:.3f}" for d in (-0.02, 0.02, 0.0)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("case", EXPECTED)
def test_boundary_elements_give_the_expected_ratios(case, readings, tmp_path):
    """The sheet's own sum over 36 places and the mean over five heights, without scatter, within half the band."""
    (tmp_path / "sheet.csv").write_text(sheet({case: readings[case]}))
    (one,) = force_law(tmp_path / "sheet.csv")
    assert one.measured == pytest.approx(EXPECTED[case][1], abs=0.02) and one.ours
    assert not one.formula


def test_a_plate_that_obeys_the_formula_refutes_us_and_a_wrong_microphone_does_not_hide_it(readings, tmp_path):
    (tmp_path / "sheet.csv").write_text(sheet(readings, by_formula=True, gain=1.1))
    found = {one.what: one for one in force_law(tmp_path / "sheet.csv")}
    both = found["case 1 over case 3"]
    assert both.formula and not both.ours and both.measured == pytest.approx(1.0, abs=0.01)
    (tmp_path / "sheet.csv").write_text(sheet(readings, gain=1.1))
    both = force_law(tmp_path / "sheet.csv")[-1]
    assert both.ours and not both.formula


def test_the_command_judges_a_sheet(readings, tmp_path):
    (tmp_path / "sheet.csv").write_text(sheet(readings))
    result = CliRunner().invoke(app, ["compare", "force-law", str(tmp_path / "sheet.csv")])
    assert result.exit_code == 0 and result.stdout.count("agrees") >= 4 and len(result.stdout.splitlines()) == 4


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("case,kind", "kind,case", "line 1 is 'kind,case,x_mm"),
        ("1,pressure_Pa,-5,-5,0", "1,presure_Pa,-5,-5,0", r"line 2: kind is 'presure_Pa' \(did you mean 'pressure_Pa'"),
        ("1,pressure_Pa,-5,-5,0", "7,pressure_Pa,-5,-5,0", "line 2: case is '7'; allowed: 1, 2, 3"),
        ("1,pressure_Pa,-5,-5,0,", "1,pressure_Pa,-5,-5,0,x", "line 2, column value: 'x"),
        ("1,pressure_Pa,-5,-5", "1,pressure_Pa,-4,-5", r"lacks pressure_Pa at places \(x, y\) \[\(-5.0, -5.0\)\] mm"),
        ("1,off_mg", "2,off_mg", "0 off_mg"),
    ],
)
def test_what_is_wrong_in_a_sheet_is_named(readings, tmp_path, old, new, words):
    text = sheet(readings)
    assert old in text
    (tmp_path / "sheet.csv").write_text(text.replace(old, new))
    with pytest.raises(MeasurementError, match=words):
        force_law(tmp_path / "sheet.csv")
