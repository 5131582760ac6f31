"""A board that can be built with other transducers plays a file of their places, and says what its rounding costs."""

import re

import numpy as np
import pytest
from scipy.optimize import minimize
from typer.testing import CliRunner

from palmfield.acoustics.air import sound_speed
from palmfield.cli.app import app
from palmfield.errors import DeviceError
from palmfield.hardware.decode import decode
from palmfield.types import Air

RUN = CliRunner()
FOCUS = np.array([0.01, 0.005, 0.09])


def places(kind: str) -> np.ndarray:
    """Ultraino's own 8 x 8 at 10.0 mm, and a cap of 64 that looks at a common point; with normals."""
    if kind == "flat":
        own = np.array([[-0.035 + 0.01 * (n % 8), -0.035 + 0.01 * (n // 8), 0.0] for n in range(64)])
        return np.hstack([own, np.tile([0.0, 0.0, 1.0], (64, 1))])
    turn, tilt = 2.4 * np.arange(64), np.radians(10.0 + 0.5 * np.arange(64))
    normals = -np.column_stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), -np.cos(tilt)])
    return np.hstack([[0.0, 0.0, 0.1] - 0.1 * normals, normals])


def file_of(path, kind: str, count: int = 64):
    rows = [",".join(f"{x:.9g}" for x in one) + f",{(n + 7) % count}" for n, one in enumerate(places(kind)[:count])]
    path.write_text("\n".join(["x_m,y_m,z_m,nx,ny,nz,address", *rows, ""]))
    return path


@pytest.mark.parametrize("kind", ["flat", "cap"])
def test_a_file_of_places_is_played_from_them(kind, tmp_path):
    file, raw, log = file_of(tmp_path / "own.csv", kind), tmp_path / "b.bin", tmp_path / "b.jsonl"
    line = ["drive", "--focus", *map(str, FOCUS), "--board", "ultraino", "--layout", str(file), "--duration", "0.1"]
    done = RUN.invoke(app, [*line, "--record", str(raw), "--log", str(log)])
    assert done.exit_code == 0, done.output
    for found in (decode(log), decode(raw, "ultraino", str(file))):
        heard = next(one for one in found.foci if one.sounding == 64)
        assert np.linalg.norm(np.array(heard.focus) - FOCUS) < 4e-3 and heard.misfit_rad < 0.25


def test_another_number_of_transducers_is_refused(tmp_path):
    file = file_of(tmp_path / "own.csv", "flat", 60)
    line = [
        "drive",
        "--focus",
        "0",
        "0",
        "0.08",
        "--board",
        "ultraino",
        "--record",
        str(tmp_path / "b.bin"),
        "--layout",
    ]
    assert "60 transducers; allowed: 64 to 896 in steps of 64" in str(RUN.invoke(app, [*line, str(file)]).exception)
    line[line.index("ultraino")] = "sonicsurface"
    assert isinstance(RUN.invoke(app, [*line, str(file)]).exception, DeviceError)


def test_how_far_rounding_moves_a_focus_is_said(tmp_path):
    """Against a search of its own over what ten divisions of a period leave of the phases."""
    own, k = places("flat")[:, :3], 2 * np.pi * 40e3 / sound_speed(Air())
    asked = np.exp(-1j * k * np.linalg.norm(FOCUS - own, axis=1))
    rounded = np.exp(2j * np.pi * np.rint(10 * np.angle(asked) / (2 * np.pi)) / 10)

    def loudest(drive):
        def quiet(point):
            r = np.linalg.norm(point - own, axis=1)
            return -abs((drive * np.exp(1j * k * r) / r).sum())

        best = [minimize(quiet, FOCUS * [1, 1, z], method="Nelder-Mead", options={"xatol": 1e-6}) for z in (0.8, 1.0)]
        return min(best, key=lambda one: one.fun).x

    expected = 1e3 * np.linalg.norm(loudest(rounded) - loudest(asked))
    line = ["drive", "--focus", *map(str, FOCUS), "--board", "ultraino", "--record", str(tmp_path / "b.bin")]
    done = RUN.invoke(app, [*line, "--layout", str(file_of(tmp_path / "own.csv", "flat")), "--duration", "0.1"])
    said = re.search(r"rounding by the board moves it by ([\d.]+) mm", done.output)
    assert said and float(said[1]) == pytest.approx(expected, abs=0.4), (done.output, expected)
