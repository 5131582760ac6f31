"""Scenes: the shipped ones load, and each kind of bad input gets one line that names cause and mend."""

import pickle
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

import palmfield
from palmfield.cli.app import main
from palmfield.errors import PalmfieldError
from palmfield.session.mujoco_messages import in_words
from palmfield.session.scene_text import read_scene_text

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
HAPTIC = sorted(p for p in SCENES.glob("*.xml") if not p.name.startswith("plain_"))
PLAIN = sorted(SCENES.glob("plain_*.xml"))


@pytest.mark.parametrize("path", HAPTIC, ids=lambda p: p.stem)
def test_shipped_scene_loads_and_can_be_planned(path):
    sim = palmfield.load(path, device="cpu")
    text = str(palmfield.plan(sim))
    assert "Effects not modelled" in text and path.name in text


@pytest.mark.parametrize("path", PLAIN, ids=lambda p: p.stem)
def test_plain_scene_opens_without_palmfield(path):
    code = (
        "import sys; sys.modules['palmfield'] = None\n"  # any import of palmfield fails
        "import warnings; warnings.simplefilter('ignore')\nimport mujoco\n"
        f"m = mujoco.MjModel.from_xml_path({str(path)!r})\n"
        "d = mujoco.MjData(m); mujoco.mj_step(m, d)\nprint(m.nplugin)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert done.stdout.strip() == "0"


def test_sonicsurface_circle_is_within_the_boards_reach():
    stimulus = palmfield.load(SCENES / "palm_circle_sonicsurface.xml").runtime.model.stimuli[0].config
    assert stimulus.path_rate_Hz <= 11 and stimulus.path_points >= 8


BAD = {
    "nan": (
        {"array": {"p0_Pa_m": "nan"}}, "plugin 'palmfield.array' instance 'array': key 'p0_Pa_m' has value 'nan';",
    ),
    "renamed key": (
        {"driver": {"device": "ideal"}},
        "plugin 'palmfield.driver' instance 'driver': key 'device' is renamed: use board",
    ),
    "renamed value": ({"skin": {"solver": "full"}}, "key 'solver' has value 'full', which is renamed: use wedges"),
    "key of the array": (
        {"array": {"compute": "cpu"}}, "key 'compute' is renamed: use the scene's palmfield_device text",
    ),
    "whole load history": ({"skin": {"solver": "axisymmetric"}}, "palmfield.skin.solve(..., solver='axisymmetric')"),
    "unit": ({"stimulus": {"focus_m": "0 0 120mm"}}, "key 'focus_m' has value '0 0 120mm'; allowed: three finite"),
    "choice": ({"skin": {"base": "glued"}}, "key 'base' has value 'glued'; allowed: bonded | free_slip"),
    "behind": ({"stimulus": {"focus_m": "0 0 -0.1"}}, "plugin 'palmfield.stimulus' instance 'stimulus': key "
    "'focus_m': focus"),
    "too loud": ({"stimulus": {"arp_peak_Pa": 1e6}}, "'stimulus': arp_peak_Pa 1e+06 exceeds the output of the array"),
    "missing am": ({"stimulus": {"am_depth": None}}, "modulation 'am' needs am_depth"),
    "unknown key": ({"skin": {"radius_mm": 20}}, "unknown key 'radius_mm' (did you mean 'radius_m'?); allowed: the"),
    "no body": ({"skin": {"body": "paw"}}, "the scene has no body 'paw' (did you mean 'pad'?); it has: world"),
    "missing mesh": (
        {"skin": {"shape": "mesh", "mesh": "gone.obj", "mesh_unit": "mm", "patch_site": "centre", "radius_m": None,
                  "thickness_m": None}}, "gone.obj",
    ),
    "step": ({"skin": {"step_s": 0.0003}}, "must divide the timestep"),
    "am on board": ({"driver": {"board": "sonicsurface"}, "array": {"layout": "sonicsurface"}}, "sonicsurface gives"),
    "other board": (
        {"driver": {"board": "sonicsurface"}, "stimulus": {"modulation": "none"}},
        "drives the layout 'sonicsurface' only",
    ),
    "no device": ({"device": "cuda:7"}, "device 'cuda:7' is not on this machine"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD, ids=str)
def test_bad_value_is_one_line_and_exit_code_2(case, small_scene, capsys, monkeypatch):
    changes, expected = BAD[case]
    path = small_scene(**changes)
    monkeypatch.setattr(sys, "argv", ["palmfield", "run", str(path), "--out", str(path.parent / "out")])
    with pytest.raises(SystemExit) as stop:
        main()
    captured = capsys.readouterr()
    assert stop.value.code == 2
    line = captured.err.strip().splitlines()[-1]
    assert line.startswith("palmfield: ") and expected in line
    assert not (path.parent / "out" / "result.nc").exists()


def refuse(path, match):
    with pytest.raises(PalmfieldError, match=match) as caught:
        palmfield.load(path)
    assert "\n" not in str(caught.value)


def test_hand_inside_the_array(small_scene):
    path = small_scene()
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace('pos="0 0 0.12"', 'pos="0 0 -0.001"'))
    refuse(path, "body 'pad' is too close to the array")


def test_unknown_plugin(small_scene):
    path = small_scene()
    path.write_text(path.read_text().replace("palmfield.driver", "palmfield.drivr"))
    refuse(
        path,
        r"line 13: .*'palmfield.drivr' is not installed \(did you mean 'palmfield.driver'\?\); palmfield provides: ",
    )


def test_palmfield_beside_a_python_that_has_not_installed_it(small_scene):
    """As with PYTHONPATH: MuJoCo finds plugins by entry points."""
    path = small_scene()
    said = "XML Error: plugin palmfield.driver not found\nElement 'plugin', line 13\n"
    told = in_words(said, str(path), read_scene_text(path), ["palmfield.driver", "palmfield.array"])
    assert "did you mean" not in told and "pip install" in told and "palmfield.driver" in told


def test_zero_size_mesh(small_scene):
    path = small_scene(
        skin={"shape": "mesh", "mesh": "flat.obj", "mesh_unit": "m", "patch_site": "centre", "radius_m": None,
              "thickness_m": None}
    )  # fmt: skip
    path.with_name("flat.obj").write_text("v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n")
    refuse(path, "flat.obj")


def test_broken_xml_and_missing_file(tmp_path):
    bad = tmp_path / "bad.xml"
    bad.write_text("<mujoco><worldbody></mujoco>")
    refuse(bad, "bad.xml")
    refuse(tmp_path / "none.xml", "does not exist")


def test_plain_scene_is_no_haptic_scene():
    refuse(PLAIN[0], "no plugin 'palmfield.skin'")


def test_driving_what_the_board_cannot_play(capsys, monkeypatch, tmp_path):
    scene = SCENES / "phantom_am200.xml"
    monkeypatch.setattr(
        sys, "argv", ["palmfield", "drive", str(scene), "--board", "sonicsurface", "--record", str(tmp_path / "x.bin")]
    )
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert "sonicsurface" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_two_stimuli_that_name_no_array_are_refused(small_scene):
    path = small_scene()
    text = path.read_text()
    start, end = text.index('<plugin plugin="palmfield.stimulus">'), text.index('<plugin plugin="palmfield.skin">')
    path.write_text(text[:end] + text[start:end].replace('name="stimulus"', 'name="again"') + text[end:])
    refuse(
        path,
        "plugin 'palmfield.stimulus' instance 'again': it names no arrays, and neither does instance 'stimulus'; "
        "set key 'arrays' of each stimulus",
    )


def test_two_drivers_are_refused(small_scene):
    path = small_scene()
    text = path.read_text()
    start, end = text.index('<plugin plugin="palmfield.driver">'), text.index("</extension>")
    path.write_text(text[:end] + text[start:end].replace('name="driver"', 'name="again"') + text[end:])
    refuse(path, "the scene has 2 of 'palmfield.driver'; allowed: one")


def test_mujoco_itself_reports_the_error(small_scene):
    with pytest.raises(ValueError, match="key 'p0_Pa_m' has value 'nan'"):
        mujoco.MjModel.from_xml_path(str(small_scene(array={"p0_Pa_m": "nan"})))


def test_an_error_carries_what_it_is_about_as_fields(small_scene):
    """Names come from the layers that know them, and are not put into the text of those that don't."""
    with pytest.raises(palmfield.SceneError) as loud:
        palmfield.load(small_scene(stimulus={"arp_peak_Pa": 1e6}))
    assert loud.value.about[1:] == ("plugin 'palmfield.stimulus' instance 'stimulus'",)
    assert loud.value.args[0].startswith("arp_peak_Pa 1e+06 exceeds") and "small.xml" in loud.value.about[0]
    behind = small_scene(stimulus={"focus_m": "0 0 -0.1"})
    with pytest.raises(palmfield.SceneError) as turned:
        palmfield.load(behind)
    place, *about = turned.value.about
    assert about == ["plugin 'palmfield.stimulus' instance 'stimulus'", "key 'focus_m'"]
    line = 1 + behind.read_text()[: behind.read_text().index('"focus_m"')].count("\n")
    assert f"line {line}" in place
    assert str(turned.value) == ": ".join((*turned.value.about, turned.value.args[0]))
    again = pickle.loads(pickle.dumps(turned.value))
    assert again.about == turned.value.about and str(again) == str(turned.value)
