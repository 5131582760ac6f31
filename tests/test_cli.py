"""The command line as a user types it."""

import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import mujoco
import numpy as np
import pytest
import typer.main
import xarray as xr

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.cli.app import app, main
from palmfield.drive.boards.sonicsurface import FRAME_BYTES, OFF_FRAME, decode
from palmfield.types import Air

SCENES = Path(__file__).parent.parent / "mjcf" / "scenes"

COMMANDS = ("run", "plan", "info", "drive", "keys", "new", "recover", "hand")


def call(monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", ["palmfield", *map(str, arguments)])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code, capsys.readouterr()


@pytest.mark.parametrize("command", COMMANDS)
def test_help_teaches_by_example(command, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, command, "--help")
    assert code == 0 and f"palmfield {command}" in out.out and "Example" in out.out


def command_lines(group, *before):
    for name, command in getattr(group, "commands", {}).items():
        yield (*before, name)
        yield from command_lines(command, *before, name)


@pytest.mark.smoke
@pytest.mark.parametrize("line", [(), *command_lines(typer.main.get_command(app))], ids=" ".join)
def test_every_command_has_help(line, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, *line, "--help")
    assert code == 0 and not out.err
    assert " ".join(["palmfield", *line, "[OPTIONS]"]) in " ".join(out.out.split())


def test_help_is_quick_to_import():
    code = "import sys; sys.argv = ['palmfield', '--help']\nfrom palmfield import cli\nprint('warp' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"


def test_new_scene_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(monkeypatch, capsys, "new", "first")[0] == 0
    assert mujoco.MjModel.from_xml_path("first_plain.xml").nplugin == 0
    code, out = call(monkeypatch, capsys, "run", "first.xml", "--duration", "0.011", "--out", "o", "--device", "cpu")
    assert code == 0
    assert "peak ARP" in out.out and "observer 1" in out.out and "observer 2" in out.out and "o/scene.usdc" in out.out
    code, out = call(monkeypatch, capsys, "new", "first")
    assert code == 2 and "exists already" in out.err


def test_new_refuses_a_path(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "new", "../x")
    assert code == 2 and "'../x'" in out.err


@pytest.mark.smoke
def test_drive_records_what_run_simulates(tmp_path, monkeypatch, capsys):
    file = tmp_path / "focus.bin"
    code, out = call(monkeypatch, capsys, "drive", "--focus", 0.02, -0.01, 0.15, "--record", file, "--duration", 0.5)
    assert code == 0, out.err
    data = file.read_bytes()
    assert len(data) % FRAME_BYTES == 0 and data.endswith(OFF_FRAME * 2)
    emitted = decode(data)[0]
    wanted = focus(layout("sonicsurface"), Air(), np.array([0.02, -0.01, 0.15]))
    assert np.abs(np.angle(emitted / wanted)).max() <= np.pi / 32 + 1e-9


def test_simulated_drive_is_decoded_from_the_recorded_bytes(tmp_path, monkeypatch, capsys):
    """Each frame that the board would get makes exactly the phases that the simulation used for it."""
    scene = SCENES / "palm_circle_sonicsurface.xml"
    file, out = tmp_path / "circle.bin", tmp_path / "out"
    assert call(monkeypatch, capsys, "drive", scene, "--record", file, "--duration", 0.03)[0] == 0
    assert call(monkeypatch, capsys, "run", scene, "--out", out, "--duration", 0.03, "--device", "cpu")[0] == 0
    emitted = [frame for frame in decode(file.read_bytes()) if np.abs(frame).max() > 0]
    with xr.open_dataset(out / "result.nc", engine="h5netcdf") as ds:
        simulated = ds["drive_amplitude"].values * np.exp(1j * ds["drive_phase"].values)
    distinct = [simulated[0]] + [b for a, b in pairwise(simulated) if not np.allclose(a, b, atol=1e-6)]
    assert len(distinct) == len(emitted) == 3
    np.testing.assert_allclose(distinct, emitted, atol=1e-6)


@pytest.mark.smoke
@pytest.mark.parametrize(
    "arguments",
    [
        ("drive",),
        ("drive", "--focus", 0, 0, 0.2),
        ("drive", "--focus", 0, 0, -0.2, "--record", "x"),
        ("drive", "--focus", 0, 0, 0.2, "--record", "x", "--board", "toaster"),
        ("drive", "--focus", 0, 0, 0.2, "--port", "/dev/none"),
        ("drive", "--focus", 0, 0, 0.2, "--record", "x", "--duration", -1),
        ("run", "none.xml"),
        ("recover", "none"),
        ("keys", "nose"),
    ],
)
def test_bad_arguments_end_in_one_line_and_exit_code_2(arguments, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    code, out = call(monkeypatch, capsys, *arguments)
    assert code == 2
    assert out.err.startswith("palmfield: ") and len(out.err.strip().splitlines()) == 1


@pytest.mark.smoke
def test_info_names_array_material_and_law(small_scene, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "info", small_scene())
    assert code == 0 and "uhev1" in out.out and "ecoflex" in out.out and "ARP law" in out.out


def test_keys_are_set_for_one_plan_and_checked(monkeypatch, capsys):
    scene = SCENES / "phantom_step.xml"
    code, out = call(monkeypatch, capsys, "plan", scene, "--set", "skin.accuracy=0.3", "--set", "stimulus.stop_s=0.01")
    assert code == 0 and "30 % wanted" in out.out
    for text, words in (
        ("skin.accuracy", "has no value"),
        ("skin.nose=1", "unknown key 'nose'"),
        ("motion.body=x", "it has"),
    ):
        code, out = call(monkeypatch, capsys, "plan", scene, "--set", text)
        assert code == 2 and words in out.err


def test_a_mesh_that_cannot_be_read_still_gets_its_card(tmp_path, monkeypatch, capsys):
    (tmp_path / "hand.obj").write_text("nothing of a mesh")
    code, out = call(monkeypatch, capsys, "hand", tmp_path / "hand.obj", "--json", tmp_path / "card.json")
    assert code == 2 and "hand.obj" in out.err
    card = json.loads((tmp_path / "card.json").read_text())
    assert card["accepted"] is False and card["findings"][0]["name"] == "not examined"
