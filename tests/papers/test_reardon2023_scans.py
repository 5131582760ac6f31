"""Blind predictions of scans that another solver made on another base, and what is refused."""

import hashlib
import json
import re
import sys

import numpy as np
import pytest
import spectral_scan as oracle
from scipy.io import loadmat, savemat
from scipy.spatial import cKDTree

from palmfield.cli.app import main
from palmfield.errors import MeasurementError
from palmfield.hand import hand_surface, load_preset
from palmfield.outputs.scan_files import named_mat
from palmfield.skin import preset
from palmfield_papers.reardon2023 import scan_bands
from palmfield_papers.reardon2023.runs import QUICK
from palmfield_papers.reardon2023.scan_numbers import CENTROID, SPEED, WAKE, WIDTH, Pass, band_passed, numbers
from palmfield_papers.reardon2023.scan_score import INSIDE, OUTSIDE, UNRESOLVED, measured, score
from palmfield_papers.reardon2023.scans import DIGEST, PREDICTIONS, read_scans

NAME, ALONG, FWHM_M = "hand_7_distal.mat", 7.0, 0.01
SETTING = """[setting]
body = "hand"
start = [{0:.4f}, {1:.4f}]
end = [{2:.4f}, {3:.4f}]
fwhm_m = 0.01
depths_m = [0.0075]
[variables]
places = "locs"
places_unit = "mm"
reference = "ref"
rate = "fs"
[files]
"hand_7_distal.mat" = {{along_m_s = 7.0}}
"""


def on_palm():
    """Places on an open hand, 10 mm apart [m], and start and end of the path there."""
    hand = hand_surface(load_preset("open_men_p50"), 4e-3)
    marks = {name: hand.landmarks[name][:2] for name in ("wrist", "thenar", "index_tip")}
    start, end = 0.5 * (marks["wrist"] + marks["thenar"]), marks["index_tip"]
    x, y = np.meshgrid(np.arange(-80, 60, 10) * 1e-3, np.arange(-55, 130, 10) * 1e-3, indexing="ij")
    places = np.column_stack([x.ravel(), y.ravel()])
    near = cKDTree(hand.surface.vertices[:, :2]).query(places)[0] < 4e-3
    return places[near & (np.linalg.norm(places - 0.5 * (start + end), axis=1) < 0.11)], start, end


@pytest.fixture(scope="module")
def scanned():
    """Places, path, and motion of a skin 10 mm deep that slides on its base, by the other solver."""
    places, start, end = on_palm()
    along = (end - start) / np.linalg.norm(end - start)
    local = (places - 0.5 * (start + end)) @ np.column_stack([along, [-along[1], along[0]]])
    length = float(np.linalg.norm(end - start))
    times, values = oracle.velocity(local, preset("palm"), 0.01, "free_slip", FWHM_M, ALONG, length=length)
    return places, (start, end), Pass(ALONG, length, 0.02, 2.5, local), times, values


@pytest.fixture
def few(monkeypatch):
    """The bands of two skins in place of ten."""
    monkeypatch.setattr(scan_bands, "MODULI", ("mid",))


def folder_of(folder, scanned, noise=0.01, **changes):
    places, (start, end), _, times, values = scanned
    (folder / "scans.toml").write_text(SETTING.format(*(1e3 * start), *(1e3 * end)))
    oracle.write(folder / NAME, 1e3 * places, times, values, noise=noise)
    if changes:
        savemat(folder / NAME, {k: v for k, v in loadmat(folder / NAME).items() if k[0] != "_"} | changes)
    return folder


def test_both_solvers_give_the_same_numbers_on_one_skin(scanned):
    """Modes in depth and steps in time, against transforms of the exact compliance: bonded, 7.5 mm."""
    one = scanned[2]
    times, values = oracle.velocity(one.places_m, preset("palm"), 0.0075, "bonded", FWHM_M, ALONG, length=one.length_m)
    by_oracle = numbers(one, np.column_stack([np.interp(one.times_s, times, v) for v in band_passed(values, 2e-4).T]))
    skin = scan_bands.skins("palm", (0.0075,), FWHM_M, True)[0]
    found = scan_bands.predicted({"a": one}, skin, QUICK, "cpu")["a"]
    assert set(found) == set(by_oracle) >= {WAKE, SPEED, CENTROID, WIDTH}
    for name, value in found.items():
        room = {"%": 1.0, "B": 0.3, "m": 0.5}.get(name[-2], 0.0)
        assert value == pytest.approx(by_oracle[name], rel=0.05, abs=room), name


def test_predictions_are_registered_before_the_velocity_is_read(scanned, few, tmp_path, monkeypatch):
    folder, out, read = folder_of(tmp_path, scanned), tmp_path / "out", []

    def watched(file, name, original=named_mat.read_variable):
        read.append((name, (out / DIGEST).is_file()))
        return original(file, name)

    monkeypatch.setattr(named_mat, "read_variable", watched)
    digest, verdicts = score(folder, out, quick=True)
    assert {name for name, registered in read if not registered} == {"locs"}
    assert {name for name, registered in read if registered} == {"y", "ref", "fs"}
    assert digest == hashlib.sha256((out / PREDICTIONS).read_bytes()).hexdigest()
    assert (out / DIGEST).read_text() == f"{digest}  {PREDICTIONS}\n"
    facts = json.loads((out / "score.json").read_text())
    assert facts["digest"] == digest and len(facts["verdicts"]) == len(verdicts) >= 10
    assert (out / "scans.png").stat().st_size > 10_000 and digest in (out / "score.md").read_text()
    # One skin 7.5 mm deep, bonded or free, is not the one that was scanned: some numbers must tell
    assert {one.verdicts["all"] for one in verdicts} == {INSIDE, OUTSIDE}


def test_a_destroyed_velocity_still_has_predictions(scanned, few, tmp_path):
    folder, out = folder_of(tmp_path, scanned), tmp_path / "out"
    data = bytearray((folder / NAME).read_bytes())
    start = data.index(loadmat(folder / NAME)["y"].tobytes(order="F")[:64])
    data[start - 8 : start + 4096] = b"\xff" * 4104
    (folder / NAME).write_bytes(bytes(data))
    with pytest.raises(MeasurementError, match="variable 'y' cannot be read"):
        score(folder, out, quick=True)
    predictions = (out / PREDICTIONS).read_bytes()
    assert hashlib.sha256(predictions).hexdigest() == (out / DIGEST).read_text().split()[0]
    assert WAKE in json.loads(predictions)["bands"][NAME]
    # A later call with the good file scores the same predictions, and none that were changed afterwards
    folder_of(tmp_path, scanned)
    score(folder, out, quick=True)
    assert (out / PREDICTIONS).read_bytes() == predictions
    (out / PREDICTIONS).write_bytes(predictions.replace(b'"low"', b'"low "').replace(b"0.0", b"0.1", 1))
    with pytest.raises(MeasurementError, match="was changed, or is of another setting"):
        score(folder, out, quick=True)


@pytest.mark.parametrize("noise", [0.01, 0.04])
def test_numbers_come_through_noise_delays_and_the_file_within_their_error(scanned, tmp_path, noise):
    """The truth is the motion that was written, without noise; 3 of its standard deviations and the sampling."""
    _, files, passes = read_scans(folder_of(tmp_path, scanned, noise))
    _, _, one, times, values = scanned
    found, spread, hidden = measured(files[NAME], passes[NAME])
    truth = numbers(one, np.column_stack([np.interp(one.times_s, times, v) for v in band_passed(values, 2e-4).T]))
    for name in set(found) - hidden - {SPEED}:
        room = {"%": 0.5, "B": 0.1, "m": 0.2}.get(name[-2], 1.0)
        assert abs(found[name] - truth[name]) <= 3.0 * spread[name] + room, name


def test_what_noise_hides_is_not_resolved(scanned, few, tmp_path):
    _, verdicts = score(folder_of(tmp_path, scanned, noise=2.0), tmp_path / "out", quick=True)
    assert {one.verdicts["all"] for one in verdicts} == {UNRESOLVED}


@pytest.mark.parametrize(
    ("old", "new", "changes", "words"),
    [
        (
            'places_unit = "mm"',
            'places_unit = "m"',
            {},
            "the path is .* mm long; allowed: 124 to 216 mm.*correct start, end",
        ),
        (
            'body = "hand"',
            'body = "plate"',
            {"locs": "shift"},
            r"place \d+ is .* mm from the middle.*125 mm, the plate",
        ),
        ("start =", "end =", {}, r"places are off hand open_men_p50, place \d+ by .* allowed: 10% beyond 8 mm"),
        ("end = [-42.5", "end = [-72.5, 190.0] #", {}, "the path is .* mm long; allowed: 124 to 216 mm"),
        ("", "", {"locs": np.full((200, 2), np.nan)}, r"place 0 \(of 200 such\) is \(nan, nan\)"),
        ('"locs"', '"xyz"', {}, "variable 'xyz' is missing.*found: .*ref"),
        ("along_m_s = 7.0", "along = 7.0", {}, "unknown key 'along'"),
        ("along_m_s = 7.0", "along_m_s = 0.5", {}, "needed: -5 to .* ms from start"),
        ("{along_m_s = 7.0}", "7.0", {}, "'hand_7_distal.mat' is 7.0; give a table"),
        ('"fs"', '"rate"', {}, "rate: variable 'rate' is missing; set rate in"),
        ("[files]", "[file]", {}, "has tables setting, variables, file; give"),
        ("hand_7_distal", "hand_8_distal", {}, "cannot be read"),
    ],
)
def test_what_is_wrong_is_refused_with_its_mend(scanned, few, tmp_path, old, new, changes, words):
    if "locs" in changes and isinstance(changes["locs"], str):
        changes = {"locs": 1e3 * scanned[0] + 60.0}
    folder = folder_of(tmp_path, scanned, **changes)
    text = (folder / "scans.toml").read_text()
    assert old in text
    both = {old: new, new: old} if (old, new) == ("start =", "end =") else {old: new}
    (folder / "scans.toml").write_text(
        re.sub("|".join(map(re.escape, both)), lambda m: both[m[0]], text) if old else text
    )
    with pytest.raises(MeasurementError, match=words):
        _, files, passes = read_scans(folder)
        measured(files[NAME], passes[NAME])


def test_the_command_names_variables_and_can_stop_before_the_velocity(scanned, few, tmp_path, monkeypatch, capsys):
    folder = folder_of(tmp_path, scanned)
    arguments = [
        "--scans",
        str(folder),
        "--quick",
        "--variable",
        "velocity=u",
        "--out",
        str(tmp_path),
        "--predict-only",
    ]
    for names, changed, code, said in (
        (["reardon2023"], {}, 2, "velocity: variable 'u' is missing"),
        (["chilles2019"], {"velocity=u": "velocity=y"}, 2, "give it with reardon2023 alone"),
        (["reardon2023"], {"velocity=u": "velocity=y"}, 0, "SHA-256 of the predictions"),
    ):
        given = [changed.get(word, word) for word in arguments]
        monkeypatch.setattr(sys, "argv", ["palmfield", "papers", *names, *given])
        with pytest.raises(SystemExit) as stopped:
            main()
        out, err = capsys.readouterr()
        assert stopped.value.code == code and said in (err if code else out)
    assert sorted(one.name for one in (tmp_path / "reardon2023_scans").iterdir()) == [PREDICTIONS, DIGEST]
