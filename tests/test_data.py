"""Where data folders are found."""

from pathlib import Path

import pytest

import palmfield.data
from palmfield.data import find_file, folder
from palmfield.errors import SceneError


@pytest.mark.parametrize("name", ["mjcf", "hand_models"])
def test_the_clone_has_its_folders_beside_the_package(name):
    clone = Path(__file__).resolve().parents[1]
    assert folder(name).is_dir()
    assert folder(name) == clone / name


@pytest.fixture
def package(tmp_path, monkeypatch):
    """An empty place where palmfield is made to believe that it is installed."""
    home = tmp_path / "site" / "palmfield"
    home.mkdir(parents=True)
    monkeypatch.setattr(palmfield.data, "PACKAGE", home)
    return home


def test_the_wheel_comes_before_the_clone(package):
    beside = package.parent / "mjcf"
    beside.mkdir()
    assert folder("mjcf") == beside
    inside = package / "_data" / "mjcf"
    inside.mkdir(parents=True)
    assert folder("mjcf") == inside


def test_a_missing_folder_names_both_places(package):
    with pytest.raises(SceneError) as missing:
        folder("hand_models")
    assert str(package / "_data" / "hand_models") in str(missing.value)
    assert str(package.parent / "hand_models") in str(missing.value)


def test_another_name_is_refused():
    with pytest.raises(SceneError, match="'meshes' does not exist"):
        folder("meshes")


def test_an_absolute_name_is_itself(tmp_path):
    assert find_file(str(tmp_path / "none.toml")) == tmp_path / "none.toml"


def test_the_working_directory_comes_before_the_scenes(tmp_path, monkeypatch):
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    name = "../motions/tap_button.toml"
    assert find_file(name) == folder("mjcf") / "motions" / "tap_button.toml"
    own = tmp_path / "motions" / "tap_button.toml"
    own.parent.mkdir()
    own.write_text("")
    assert find_file(name) == own


def test_a_file_that_is_nowhere_is_named_with_the_ways_out(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SceneError, match=r"file 'none\.toml' .*palmfield\.load.*scene's folder.*absolute path"):
        find_file("none.toml")
