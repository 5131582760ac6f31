"""The command line as a user types it."""

import json
import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import typer.main
from unestimated import UNESTIMATED

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.layouts import LAYOUTS
from palmfield.cli.app import GROUPS, OF_OTHERS, app, main
from palmfield.drive.boards.sonicsurface import BOARD, FRAME_BYTES, OFF_SEQUENCE
from palmfield.outputs import instances, open_result
from palmfield.session.preview import preview
from palmfield.simulation.model import array_instances
from palmfield.stimulus.standard import names, standard
from palmfield.types import Air

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"

COMMANDS = (
    "run", "plan", "info", "drive", "boards", "board", "decode", "replay", "keys", "new", "migrate", "recover", "hand",
    "usd",
)  # fmt: skip


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
    names = group.list_commands(None) if hasattr(group, "list_commands") else ()
    for name in names:
        yield (*before, name)
        yield from command_lines(group.get_command(None, name), *before, name)


@pytest.mark.smoke
@pytest.mark.parametrize("line", [(), *command_lines(typer.main.get_command(app))], ids=" ".join)
def test_every_command_has_help(line, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, *line, "--help")
    assert code == 0 and not out.err
    assert " ".join(["palmfield", *line, "[OPTIONS]"]) in " ".join(out.out.split())


@pytest.mark.smoke
def test_help_lists_each_command_in_one_group_by_one_line(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    code, out = call(monkeypatch, capsys, "--help")
    assert code == 0
    sections = re.findall(r"^(\w[\w ]*):\n((?:  .*\n)+)", out.out, flags=re.MULTILINE)
    assert [name for name, _ in sections] == ["Options", *GROUPS, OF_OTHERS]
    rows = [row for _, text in sections[1:] for row in text.splitlines()]
    assert len({re.match(r"  [a-z]+ +", row).end() for row in rows}) == 1 and max(map(len, rows)) <= 80
    commands = [row.split()[0] for row in rows]
    assert commands == typer.main.get_command(app).list_commands(None) and len(set(commands)) == len(commands)
    # A new user writes a scene before it is run, and looks at it when it is
    assert commands.index("new") < commands.index("run") < commands.index("plot")


def test_help_is_quick_to_import():
    slow = ("warp", "mujoco", "numpy", "scipy", "xarray", "pydantic")
    code = f"import sys\nfrom palmfield.cli.app import app\nprint([name for name in {slow} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "[]\n"


def test_the_program_looks_for_garbage_as_usual_after_its_start():
    code = """
import gc, sys
from palmfield.cli.app import start
usual, sys.argv = gc.get_threshold(), ["palmfield", "--version"]
try:
    start()
except SystemExit:
    assert gc.get_threshold() != usual
kept = [[] for _ in range(400_000)]
assert gc.get_threshold() == usual and gc.get_freeze_count() > 200_000
ring = []
ring.append(ring)
del ring
assert gc.collect() > 0
"""
    subprocess.run([sys.executable, "-c", code], check=True)


def test_new_scene_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(monkeypatch, capsys, "new", "first")[0] == 0
    assert mujoco.MjModel.from_xml_path("first/first_plain.xml").nplugin == 0
    small = ("--set", "skin.accuracy=0.3", "--set", "skin.patch_radius_m=0.02")
    quick = ("--duration", "0.011", "--device", "cpu", "--accuracy", 0.4, *small[2:])
    code, out = call(monkeypatch, capsys, "run", "first/first.xml", "--out", "o", *quick)
    assert code == 0
    assert out.out.startswith("felt: ") and "peak ARP" in out.out and "o/scene.usdc" in out.out
    assert "level above threshold" in out.out and "hasegawa_2018" in out.out
    again = ("run", "first/first.xml", "--duration", "0.005", "--out", "o", "--no-plots")
    code, out = call(monkeypatch, capsys, *again)
    assert code == 2 and "of another run" in out.err and "--overwrite" in out.err
    code, out = call(monkeypatch, capsys, *again, "--overwrite", *small)
    assert code == 0 and json.loads(Path("o/summary.json").read_text())["steps"] == 5
    code, out = call(monkeypatch, capsys, "new", "first")
    assert code == 2 and "already exists" in out.err


@pytest.mark.parametrize("name", names())
def test_a_new_scene_plays_a_standard_stimulus(name, tmp_path, monkeypatch, capsys):
    """The scene's keys are those of the file, and nothing else is changed."""
    monkeypatch.chdir(tmp_path)
    assert call(monkeypatch, capsys, "new", "first", "--stimulus", name)[0] == 0
    spec = preview(tmp_path / "first" / "first.xml", accuracy=0.5).runtime.spec
    (stimulus,) = spec.stimuli
    assert stimulus.config == standard(name).config
    root = ElementTree.parse(tmp_path / "first" / "first.xml").getroot()
    duration = root.find("./custom/numeric[@name='palmfield_duration_s']")
    assert float(duration.get("data")) == standard(name).duration_s


def test_standard_stimuli_are_shown(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "stimulus", "standard")
    assert code == 0 and [line.split()[0] for line in out.out.splitlines()] == list(names())
    code, out = call(monkeypatch, capsys, "stimulus", "standard", "lm_small_steps")
    assert code == 0 and "0.027 N" in out.out and '<config key="path_step_m" value="0.0002"/>' in out.out
    code, out = call(monkeypatch, capsys, "stimulus", "standard", "lm_small_steps", "--json")
    assert code == 0 and json.loads(out.out)["keys"]["path"] == "lm"
    code, out = call(monkeypatch, capsys, "new", "x", "--stimulus", "lm_small_step")
    assert code == 2 and "lm_small_steps" in out.err


def test_a_new_scene_can_be_moved_and_sent(tmp_path, monkeypatch, capsys):
    for place in ("here", "there"):
        (tmp_path / place).mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert call(monkeypatch, capsys, "new", "first")[0] == 0
    moved = (tmp_path / "here" / "first").rename(tmp_path / "there" / "of_another_name")
    own = {path.name for path in moved.iterdir()}
    for path in moved.iterdir():
        text = path.read_text()
        assert str(SCENES.parents[1]) not in text and "../" not in text
        assert set(re.findall(r'file="([^"]*)"', text)) <= own
    code, out = call(monkeypatch, capsys, "info", moved / "first.xml")
    assert code == 0 and "uhev1" in out.out


def test_a_new_scene_has_a_place_for_the_laboratorys_p0(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert call(monkeypatch, capsys, "new", "first")[0] == 0
    scene = tmp_path / "first" / "first.xml"
    text = scene.read_text()
    begin, end = text.index("<!-- Peak pressure"), text.index("-->", text.index("<!-- Peak pressure"))
    comment = text[begin:end]
    own = LAYOUTS["uhev1"].p0
    assert f"{own.value:g} Pa m" in comment and f"{own.low:g} to {own.high:g}" in " ".join(comment.split())
    keys = re.findall(r'<config key="(\w+)" value="([^"]+)"/>', comment)
    assert [key for key, _ in keys] == ["calibration", "p0_Pa_m", "p0_low_Pa_m", "p0_high_Pa_m"]
    given = "".join(f'<config key="{key}" value="{value}"/>' for key, value in keys[1:])
    scene.write_text(text[:begin] + given + text[end + len("-->") :])
    p0 = array_instances(preview(scene, accuracy=0.5).runtime.spec)[0].p0
    assert (p0.value, p0.low, p0.high) == (own.value, own.low, own.high) and "p0_Pa_m" in p0.source


def test_new_refuses_a_path(monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "new", "../x")
    assert code == 2 and "'../x'" in out.err


@pytest.mark.smoke
def test_drive_records_what_run_simulates(tmp_path, monkeypatch, capsys):
    file = tmp_path / "focus.bin"
    code, out = call(monkeypatch, capsys, "drive", "--focus", 0.02, -0.01, 0.15, "--record", file, "--duration", 0.5)
    assert code == 0, out.err
    data = file.read_bytes()
    assert data.startswith(OFF_SEQUENCE) and data.endswith(OFF_SEQUENCE)
    assert (len(data) - 2 * len(OFF_SEQUENCE)) % FRAME_BYTES == 0
    emitted = BOARD.decode(data)[2]
    wanted = focus(layout("sonicsurface"), Air(), np.array([0.02, -0.01, 0.15]))
    assert np.abs(np.angle(emitted / wanted)).max() <= np.pi / 32 + 1e-9


@UNESTIMATED
def test_simulated_drive_is_decoded_from_the_recorded_bytes(tmp_path, monkeypatch, capsys):
    """Each frame that the board would get makes exactly the phases that the simulation used for it."""
    scene = SCENES / "palm_circle_sonicsurface.xml"
    file, out = tmp_path / "circle.bin", tmp_path / "out"
    assert call(monkeypatch, capsys, "drive", scene, "--record", file, "--duration", 0.03)[0] == 0
    # What the skin makes of it matters nothing here.
    quick = ("--duration", 0.03, "--device", "cpu", "--accuracy", 0.5, "--no-plots")
    assert call(monkeypatch, capsys, "run", scene, "--out", out, *quick)[0] == 0
    emitted = [frame for frame in BOARD.decode(file.read_bytes()) if np.abs(frame).max() > 0]
    with open_result(out) as result:
        (ds,) = instances(result, "array").values()
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
        ("drive", "--focus", 0, 0, 150, "--record", "x"),
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


def test_a_focus_in_millimetres_is_refused_with_the_likely_unit(tmp_path, monkeypatch, capsys):
    file = tmp_path / "focus.bin"
    code, out = call(monkeypatch, capsys, "drive", "--focus", 0, 0, 150, "--record", file)
    assert code == 2 and not file.exists()
    assert "--focus has value 0 0 150, which is 150 m away" in out.err
    assert "if these are millimetres, give 0 0 0.15" in out.err


@pytest.mark.smoke
def test_info_names_array_material_and_law(small_scene, monkeypatch, capsys):
    code, out = call(monkeypatch, capsys, "info", small_scene(), "--device", "cpu", "--set", "skin.arp_law=alpha")
    assert code == 0 and "uhev1" in out.out and "ecoflex" in out.out and "ARP law" in out.out
    assert "cpu (palmfield_device)" in out.out and "alpha" in out.out.lower()
    assert "(skin)" not in out.out


def test_info_names_every_instance_of_several(small_scene, monkeypatch, capsys):
    path = small_scene()
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace("<worldbody>", '<worldbody><site name="right" pos="0.3 0 0"/>', 1))
    right = '<instance name="right"><config key="site" value="right"/><config key="layout" value="autd3"/></instance>'
    path.write_text(
        path.read_text().replace('<plugin plugin="palmfield.array">', f'<plugin plugin="palmfield.array">{right}', 1)
    )
    code, out = call(monkeypatch, capsys, "info", path)
    assert code == 0 and "array (right)" in out.out and "array (array)" in out.out and "arrays driven" in out.out


def test_a_device_that_is_not_there_is_refused_with_those_that_are(small_scene, monkeypatch, capsys):
    for command in ("run", "plan", "info"):
        code, out = call(monkeypatch, capsys, command, small_scene(), "--device", "cuda:9")
        assert code == 2 and "'cuda:9' is not on this machine; use one of auto, cpu" in out.err
        code, out = call(monkeypatch, capsys, command, small_scene(), "--device", "toaster")
        assert code == 2 and "auto, cpu or cuda:N" in out.err


@UNESTIMATED
def test_a_skin_without_a_focus_is_warned_of_before_the_run(small_scene, tmp_path, monkeypatch, capsys):
    scene = small_scene(stimulus={"focus_m": "0.15 0 0.12"})
    code, out = call(monkeypatch, capsys, "run", scene, "--out", tmp_path / "out", "--duration", "0.002", "--no-plots")
    assert code == 0 and "warning: no focus is near skin 'skin'" in out.err


def test_keys_are_set_for_one_plan_and_checked(monkeypatch, capsys):
    scene = SCENES / "phantom_step.xml"
    code, out = call(monkeypatch, capsys, "plan", scene, "--set", "skin.accuracy=0.3", "--set", "stimulus.stop_s=0.01")
    assert code == 0 and "target 30 %" in out.out
    for text, words in (
        ("skin.accuracy", "has no value"),
        ("skin.nose=1", "unknown key 'nose'"),
        ("motion.body=x", "it has"),
        ("driver.device=ideal", "renamed: use board"),
    ):
        code, out = call(monkeypatch, capsys, "plan", scene, "--set", text)
        assert code == 2 and words in out.err


def test_a_mesh_that_cannot_be_read_still_gets_its_card(tmp_path, monkeypatch, capsys):
    (tmp_path / "hand.obj").write_text("nothing of a mesh")
    code, out = call(monkeypatch, capsys, "hand", tmp_path / "hand.obj", "--json", tmp_path / "card.json")
    assert code == 2 and "hand.obj" in out.err
    card = json.loads((tmp_path / "card.json").read_text())
    assert card["accepted"] is False and card["findings"][0]["name"] == "not examined"
