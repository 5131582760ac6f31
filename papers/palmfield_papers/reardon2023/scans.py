"""`palmfield papers reardon2023 --scans FOLDER`: predictions for public scans, registered before velocities are read.

1. scans.toml and the positions are read, and checked against the hand or plate.
2. The bands are computed and written to predictions.json, and its SHA-256 to predictions.sha256.
3. Only then `scan_score` reads velocity and reference.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError, naming
from palmfield.files import made_folder, read_text, read_toml, reading, write_text
from palmfield.hand import hand_surface, load_preset
from palmfield.instruments.scan import UNITS
from palmfield.instruments.settings import Settings
from palmfield.outputs.scan_files.named_mat import MatVariables, NamedMat
from palmfield.types import Complex, Float
from palmfield_papers.answer import Setting
from palmfield_papers.reardon2023.configuration import RADIUS_m
from palmfield_papers.reardon2023.given import array_width
from palmfield_papers.reardon2023.hand import ACROSS_m_s, WIDTH_m
from palmfield_papers.reardon2023.scan_bands import MATERIALS, DEPTHS_m, bands, skins
from palmfield_papers.reardon2023.scan_numbers import Pass

SETTING, PREDICTIONS, DIGEST = "scans.toml", "predictions.json", "predictions.sha256"
TABLES = ("setting", "variables", "files")
HAND_MARGIN_m, HAND_EDGE_m = 0.008, 0.004
"""Distance from the outline of the hand up to which a place counts as on the hand, and edge length of its mesh."""
HAND_SIZES = (0.75, 1.3)
"""Allowed sizes of the hand relative to the preset. The size follows from the length of the path."""
MOST_OFF = 0.1
"""Fraction of the places that may be off the hand. Hands differ in the spread of their fingers."""

Length = Annotated[float, Field(gt=0.0, lt=0.2)]


class ScanSetting(Settings):
    """Table [setting]: skin, and path of the focus. Its start and end are in the frame and unit of the places."""

    instrument: ClassVar[str] = "setting"
    body: Literal["hand", "plate"] = "hand"
    start: tuple[float, float]
    end: tuple[float, float]
    width_m: Annotated[float, Field(ge=0.0, lt=0.2)] = WIDTH_m
    across_m_s: Annotated[float, Field(gt=0.0)] = ACROSS_m_s
    fwhm_m: Length | None = None
    hand: str = "open_men_p50"
    material: str = ""
    depths_m: tuple[Length, ...] = ()


class FileSetting(Settings):
    """One line of [files]: speed along the path, and the end towards which the focus moves."""

    instrument: ClassVar[str] = "files"
    along_m_s: Annotated[float, Field(ge=0.1, le=50.0)]
    towards: Literal["end", "start"] = "end"


def read_scans(
    folder: Path, names: Mapping[str, str] | None = None
) -> tuple[ScanSetting, dict[str, NamedMat], dict[str, Pass]]:
    """Read setting, files and passes by name, from settings and positions only. names: replaces [variables]"""
    file = folder / SETTING
    with reading(file, MeasurementError, "the settings of the scans, see docs/gallery/scans.md"):
        tables = read_toml(file)
    files = tables.get("files")
    if not set(tables) <= set(TABLES) or not isinstance(files, dict) or not files:
        raise MeasurementError(f"{file}: has tables {', '.join(tables)}; give {', '.join(TABLES)}, a line per file")
    for name, table in (*tables.items(), *files.items()):
        if not isinstance(table, dict):
            raise MeasurementError(f"{file}: '{name}' is {table}; give a table, such as {{along_m_s = 7.0}}")
    with naming(str(file)):
        setting = ScanSetting(**tables.get("setting", {}))
        variables = MatVariables(**{**tables.get("variables", {}), **(names or {})})
        own = {name: FileSetting(**table) for name, table in files.items()}
    scans = {name: NamedMat(folder / name, variables) for name in own}
    return setting, scans, {name: _pass(scans[name], setting, one) for name, one in own.items()}


def _pass(scan: NamedMat, setting: ScanSetting, own: FileSetting) -> Pass:
    """Return the pass of a file, with its places in the frame of its path."""
    unit = UNITS["displacement"][scan.variables.places_unit]
    start, end = unit * np.array([setting.start, setting.end])
    scan.check_shape()
    places, length = scan.places_m[:, :2], float(np.linalg.norm(end - start))
    with naming(str(scan.file)):
        _check_places(places, setting, start, end)
    along = (end - start) / length * (1.0 if own.towards == "end" else -1.0)
    turned = (places - 0.5 * (start + end)) @ np.column_stack([along, [-along[1], along[0]]])
    return Pass(own.along_m_s, length, setting.width_m, setting.across_m_s, turned)


@cache
def _hand(name: str) -> tuple[Complex, complex, complex]:
    """Return the vertices of a hand, the base of the thumb and the tip of the index finger as x + iy [m]."""
    hand = hand_surface(load_preset(name), HAND_EDGE_m)
    at = {mark: complex(*place[:2]) for mark, place in hand.landmarks.items()}
    return hand.surface.vertices[:, :2] @ np.array([1.0, 1j]), 0.5 * (at["wrist"] + at["thenar"]), at["index_tip"]


def _check_places(places: Float, setting: ScanSetting, start: Float, end: Float) -> None:
    """Raise MeasurementError for places that are not on the hand or the plate."""
    mend = "correct start, end and places_unit, or remove these places from all variables"
    outline, base, tip = _hand(setting.hand)
    begin, finish = complex(*start), complex(*end)
    length, size = abs(finish - begin), abs(finish - begin) / abs(tip - base)
    if length == 0.0 or (setting.body == "hand" and not HAND_SIZES[0] <= size <= HAND_SIZES[1]):
        low, high = (1e3 * share * abs(tip - base) for share in HAND_SIZES)
        raise MeasurementError(f"the path is {1e3 * length:.4g} mm long; allowed: {low:.0f} to {high:.0f} mm, base of "
                               f"the thumb to tip of the index finger: {mend}")  # fmt: skip
    far = np.linalg.norm(places - 0.5 * (start + end), axis=1)
    if far.max() > RADIUS_m:
        raise MeasurementError(f"place {far.argmax()} is {1e3 * far.max():.4g} mm from the middle of the path; "
                               f"allowed: {1e3 * RADIUS_m:g} mm, the {setting.body}: {mend}")  # fmt: skip
    # A similarity takes the path to that of the preset; hands are seen from either side
    x = (places @ np.array([1.0, 1j]) - begin) / (finish - begin)
    tree = cKDTree(np.column_stack([outline.real, outline.imag]))
    seen = [base + one * (tip - base) for one in (x, x.conj())]
    off = min((size * tree.query(np.column_stack([one.real, one.imag]))[0] for one in seen), key=np.mean)
    if setting.body == "hand" and np.mean(off > HAND_MARGIN_m) > MOST_OFF:
        raise MeasurementError(
            f"{np.sum(off > HAND_MARGIN_m)} of {len(off)} places are off hand {setting.hand}, place {off.argmax()} by "
            f"{1e3 * off.max():.0f} mm; allowed: {MOST_OFF:.0%} beyond {1e3 * HAND_MARGIN_m:g} mm: {mend}, or set hand"
        )


def predict(
    setting: ScanSetting, passes: Mapping[str, Pass], out: Path, *, quick: bool, device: str
) -> tuple[dict[str, Any], str]:
    """Return predictions and their digest, and write both to `out`. Existing predictions for this setting are kept.

    Raises MeasurementError if existing predictions belong to another setting, or do not match their digest.
    """
    width_m = setting.fwhm_m or 1e-3 * round(array_width(Setting(quick=quick, device=device)).value or math.nan, 2)
    preset = setting.material or MATERIALS[setting.body]
    of = skins(preset, setting.depths_m or DEPTHS_m[setting.body], width_m, quick)
    asked = {"palmfield": version("palmfield"), "quick": quick, "fwhm_m": width_m, "material": preset,
             "setting": setting.model_dump(mode="json"), "skins": [one.name for one in of],
             "passes": {name: vars(one) | {"places_m": np.round(one.places_m, 6).tolist()}
                        for name, one in passes.items()}}  # fmt: skip
    file, mark = out / PREDICTIONS, out / DIGEST
    if not file.is_file():
        made_folder(out)
        found = {"asked": asked} | bands(passes, of, quick, device)
        write_text(file, json.dumps(found, indent=1, allow_nan=False) + "\n")
        write_text(mark, f"{_digest(file)}  {PREDICTIONS}\n")
    found = json.loads(read_text(file))
    if found["asked"] != json.loads(json.dumps(asked)) or read_text(mark).split()[0] != _digest(file):
        raise MeasurementError(f"{file}: was changed, or is of another setting; give another folder by --out")
    return found, _digest(file)


def _digest(file: Path) -> str:
    return hashlib.sha256(read_text(file).encode()).hexdigest()
