"""Values of keys on a command line: files of the current folder are taken from there, and told."""

import logging

import pytest

from palmfield.cli.options import parsed_keys
from palmfield.errors import SceneError


def test_a_file_of_the_current_folder_is_taken_from_there_and_told(tmp_path, monkeypatch, caplog):
    (tmp_path / "course.csv").write_text("t,x\n")
    monkeypatch.chdir(tmp_path)
    with caplog.at_level(logging.INFO, "palmfield.cli"):
        given = parsed_keys(["motion.trajectory=course.csv", "palmfield.motion.keyframes=other.csv"])
    assert given["motion.trajectory"] == str((tmp_path / "course.csv").resolve())
    assert f"--set motion.trajectory: {(tmp_path / 'course.csv').resolve()}, from the current folder" in caplog.text
    # What is not there is relative to the scene, as its own keys are
    assert given["palmfield.motion.keyframes"] == "other.csv" and "other.csv" not in caplog.text


def test_what_names_no_file_and_what_is_whole_already_stays(tmp_path, monkeypatch):
    (tmp_path / "palm").write_text("")
    monkeypatch.chdir(tmp_path)
    whole = str(tmp_path / "palm")
    assert parsed_keys(["skin.material=palm", f"skin.mesh={whole}"]) == {"skin.material": "palm", "skin.mesh": whole}


def test_unset_takes_a_key_out(tmp_path, monkeypatch):
    assert parsed_keys(["stimulus.am_depth=unset", "skin.mesh=unset"]) == {"stimulus.am_depth": "", "skin.mesh": ""}
    with pytest.raises(SceneError, match="KEY=unset to remove"):
        parsed_keys(["stimulus.am_depth="])
