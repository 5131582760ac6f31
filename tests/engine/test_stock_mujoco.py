"""Shipped scenes in stock MuJoCo, started anywhere."""

import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
MOVED = (
    "approach_withdraw", "hover_explore", "tap_button", "follow_fingertip", "trace_shape", "two_hands", "grasp_object",
    "live_palm",
    "two_hands_both_feel", "palm_and_fingertip",
)  # fmt: skip
COMPILE = """
import sys
import mujoco

for path in sys.argv[1:]:
    model = mujoco.MjModel.from_xml_path(path)
    print(path, flush=True)
    if path.endswith("tap_button.xml"):
        data = mujoco.MjData(model)
        for _ in range(3):
            mujoco.mj_step(model, data)
        from palmfield import raise_errors
        raise_errors(data)
        print(data.time, flush=True)
"""


@pytest.mark.slow
def test_scenes_with_motions_open_from_any_folder(tmp_path):
    paths = [str(SCENES / f"{name}.xml") for name in MOVED]
    done = subprocess.run(
        [sys.executable, "-c", COMPILE, *paths], cwd=tmp_path, capture_output=True, text=True, timeout=500
    )
    assert done.returncode == 0, done.stderr
    opened = done.stdout.split()
    assert [line for line in opened if line.endswith(".xml")] == paths
    assert float(opened[paths.index(str(SCENES / "tap_button.xml")) + 1]) > 0.0


def test_all_scenes_with_motions_are_tried():
    moved = {path.stem for path in SCENES.glob("*.xml") if "palmfield.motion" in path.read_text()}
    assert moved <= set(MOVED)


BALL = "v 0.02 0 0\nv -0.02 0 0\nv 0 0.02 0\nv 0 -0.02 0\nv 0 0 0.02\nv 0 0 -0.02\n" + "".join(
    f"f {a} {b} {c}\n"
    for a, b, c in (
        (1, 3, 5), (3, 2, 5), (2, 4, 5), (4, 1, 5), (3, 1, 6), (2, 3, 6), (4, 2, 6), (1, 4, 6),
    )
)  # fmt: skip
MESH = {"shape": "mesh", "mesh": "ball.obj", "mesh_unit": "m", "patch_site": "centre", "radius_m": None,
        "thickness_m": None, "depth_m": 0.004, "patch_radius_m": 0.008, "element_m": 0.004}  # fmt: skip


def test_a_mesh_is_found_from_the_working_directory(small_scene, monkeypatch):
    path = small_scene(skin=MESH)
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace('<site name="centre"', '<site name="centre" pos="0 0 0.02"'))
    path.with_name("ball.obj").write_text(BALL)
    monkeypatch.chdir(path.parent)
    model = mujoco.MjModel.from_xml_path(str(path))
    assert model.npluginstate > 0


def test_a_mesh_that_is_nowhere_is_named_with_the_ways_out(small_scene, tmp_path_factory, monkeypatch):
    path = small_scene(skin=MESH)
    path.with_name("ball.obj").write_text(BALL)
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    with pytest.raises(ValueError, match=r"instance 'skin': key 'mesh': file 'ball\.obj' .* absolute path"):
        mujoco.MjModel.from_xml_path(str(path))


@pytest.mark.parametrize("watched", [True, False], ids=["terminal", "pipe"])
def test_a_terminal_shows_how_long_loading_takes(watched, small_scene, monkeypatch, capsys):
    """FORCE_COLOR stands for a terminal."""
    monkeypatch.setenv("FORCE_COLOR", "1") if watched else monkeypatch.delenv("FORCE_COLOR", raising=False)
    # A skin of its own: one that an earlier test has made would be known
    mujoco.MjModel.from_xml_path(str(small_scene(skin={"accuracy": 0.41 + 0.01 * watched})))
    assert ("preparing the skin layers" in capsys.readouterr().err) is watched
