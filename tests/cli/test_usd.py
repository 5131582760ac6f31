"""`palmfield usd` as a user types it."""

import json
import sys

import pytest
from unestimated import UNESTIMATED

import palmfield
from palmfield.cli.app import main

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.fixture(scope="module")
def run(module_scene, tmp_path_factory):
    out = tmp_path_factory.mktemp("usd") / "run"
    with UNESTIMATED:
        palmfield.run(module_scene(duration_s=0.005), out, plots=[])
    return out


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr()


def test_a_package_with_the_field_is_written_and_checked(run, monkeypatch, capsys, tmp_path):
    path = tmp_path / "palm.usdz"
    asked = ("--colour", "arp", "--limits", "0,20", "--magnify", 5000, "--field", "slice", "--out", path, "--check")
    code, out = call(monkeypatch, capsys, "usd", run, *asked)
    assert code == 0 and f"wrote {path}" in out.out and "report no errors" in out.out and path.stat().st_size > 1e5
    code, out = call(monkeypatch, capsys, "usd", run, "--quantities", "arp", "--colour", "none", "--json")
    said = json.loads(out.out)
    assert code == 0 and said["bytes"] == (run / "scene.usdc").stat().st_size and said["findings"] is None


def test_quantities_are_listed(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "usd", "--list")
    assert code == 0 and "normal_displacement" in out.out and "a push is negative" in out.out


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--colour", "arpp"), "did you mean 'arp'"),
        (("--out", "palm.obj"), "ends in .usdc, .usda, .usdz"),
        (("--from", "4", "--to", "2"), "rising"),
        (("--limits", "3"), "allowed: 2 numbers"),
    ],
)
def test_what_is_not_possible_is_named(run, monkeypatch, capsys, options, words):
    code, out = call(monkeypatch, capsys, "usd", run, *options)
    assert code == 2 and words in out.err and "Traceback" not in out.err


def test_a_folder_is_needed(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "usd")
    assert code == 2 and "needs DIR" in out.err
