"""Bad input: each kind is refused in one line, with element, value and what is allowed, before anything slow."""

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import mujoco
import numpy as np
import pytest
from refusals import changed, refused
from unestimated import UNESTIMATED

import palmfield
from palmfield.cli.app import main
from palmfield.config.skin import WHOLE_HISTORY, SkinConfig
from palmfield.errors import PalmfieldError
from palmfield.planning.scene_plan import warnings
from palmfield.simulation.validate import MOST_SUBSTEPS, MOST_UNKNOWNS
from palmfield.skin.solver_choice import Name

SKIN = "plugin 'palmfield.skin' instance 'skin': "
STIMULUS = "plugin 'palmfield.stimulus' instance 'stimulus': "


def instance(path: Path, plugin: str) -> tuple[str, int, int]:
    """A scene's text, and where in it a plugin begins and ends."""
    text = path.read_text()
    start = text.index(f'<plugin plugin="{plugin}"><instance')
    return text, start, text.index("</plugin>", start) + len("</plugin>")


# -- MuJoCo's own options ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["0", "-0.001", "nan"])
def test_a_timestep_that_is_none(value, small_scene):
    path = changed(small_scene(), 'timestep="0.001"', f'timestep="{value}"')
    refused(path, f"option 'timestep' has value {value}; allowed: seconds > 0")


def test_a_timestep_that_steps_of_the_skin_cannot_fill(small_scene, meshing_fails):
    path = changed(small_scene(), 'timestep="0.001"', 'timestep="1e308"')
    refused(path, "the MuJoCo timestep of 1e+308 s holds too many skin steps", "set timestep smaller")


@pytest.mark.parametrize(("key", "value"), [("focus_m", "0 0 0.1_2"), ("am_frequency_Hz", "2_00")])
def test_digits_that_an_underscore_joins(key, value, small_scene):
    refused(small_scene(stimulus={key: value}), f"key '{key}' has value '{value}'; allowed: ")


def test_a_timestep_of_0_in_a_spec(small_scene):
    spec = mujoco.MjSpec.from_file(str(small_scene()))
    spec.option.timestep = 0.0
    refused(spec, "option 'timestep' has value 0; allowed: seconds > 0")


# MuJoCo 4.0 dies of what these two give it, so a child of this process runs them.
REFUSED = """
import sys
import mujoco
import palmfield

spec = mujoco.MjSpec.from_file(sys.argv[1])
spec.sensors[0].objtype = mujoco.mjtObj.mjOBJ_UNKNOWN
for scene in (spec, *sys.argv[2:]):
    try:
        palmfield.load(scene)
    except palmfield.SceneError as error:
        print(error)
"""


def test_a_plugin_sensor_without_objtype(small_scene):
    """A spec, a file, and a file that includes it: in a process of their own, which MuJoCo could end."""
    path = small_scene()
    file, including = path.with_name("file.xml"), path.with_name("including.xml")
    whole = path.read_text().replace(' objtype="site" objname="centre"', "")
    assert whole != path.read_text()
    file.write_text(whole)
    start, end = whole.index("<sensor>"), whole.index("</sensor>") + len("</sensor>")
    path.with_name("sensors.xml").write_text(f"<mujoco>{whole[start:end]}</mujoco>")
    including.write_text(whole[:start] + '<include file="sensors.xml"/>' + whole[end:])
    command = [sys.executable, "-c", REFUSED, *map(str, (path, file, including))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    of_spec, *of_files = done.stdout.splitlines()
    # A file is refused before MuJoCo reads it, a spec when MuJoCo has read it
    assert "sensor 'skin' of plugin 'palmfield.skin' has no objtype; give objtype='site' and objname" in of_spec
    assert len(of_files) == 2 and all("give it objtype and objname" in line and "has no o" in line for line in of_files)


# -- costs ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def meshing_fails(monkeypatch):
    """Nothing may be meshed before a cost is refused."""

    def made(*_):
        raise AssertionError("a layer is meshed")

    monkeypatch.setattr("palmfield.skin.mesh.disc.disc_patch", made)
    monkeypatch.setattr("palmfield.skin.scene_layer.surface_patch", made)


@pytest.mark.parametrize("element_m", [1e-4, 1e-6, 1e-300])
def test_elements_so_small_that_the_run_cannot_end(element_m, small_scene, meshing_fails):
    path = small_scene(skin={"element_m": element_m})
    refused(
        path, f"{SKIN}elements of {1e3 * element_m:.3g} mm give about", "unknowns",
        f"allowed: at most {MOST_UNKNOWNS:.2g}; set element_m or accuracy larger",
    )  # fmt: skip


@pytest.mark.parametrize("step_s", [5e-8, 1e-12, 1e-300])
def test_steps_so_small_that_the_run_cannot_end(step_s, small_scene, meshing_fails):
    path = small_scene(skin={"step_s": step_s})
    refused(
        path, f"{SKIN}the step of {step_s:.2g} s gives {1e-3 / step_s:.2g} substeps per MuJoCo step",
        f"allowed: at most {MOST_SUBSTEPS:,}; set step_s larger, or timestep smaller",
    )  # fmt: skip


def test_a_layer_for_which_memory_is_short(small_scene, meshing_fails, monkeypatch):
    monkeypatch.setattr("palmfield.simulation.validate.available_bytes", lambda: 10**5)
    # Of a size of its own: equal scenes share a model
    path = small_scene(skin={"element_m": 0.00347})
    refused(path, f"{SKIN}elements of 3.47 mm", "factors need about", "free: 0.0001 GB; set element_m")


@pytest.mark.parametrize("timestep", [1e-12, 1e-300])
def test_timesteps_so_small_that_the_run_cannot_end(timestep, small_scene, meshing_fails):
    path = small_scene()
    path.write_text(path.read_text().replace('timestep="0.001"', f'timestep="{timestep}"'))
    refused(path, f"option 'timestep' has value {timestep:g}: a run of", "would take", "set timestep larger")


def test_a_duration_so_long_that_the_run_cannot_end(small_scene):
    path = small_scene(duration_s="1e9")
    refused(path, "a run of 1e+09 s would take 1e+12 steps", "or numeric 'palmfield_duration_s' smaller")


def test_the_second_skin_alone_costs_too_much(small_scene, add_skin, meshing_fails):
    path = add_skin(small_scene(), "0.05 0 0.12")
    refusal = "plugin 'palmfield.skin' instance 'second': elements of 0.001 mm give about"
    refused(path, refusal, keys={"second.element_m": 1e-6})


def test_stock_mujoco_refuses_a_cost_before_it_meshes(small_scene, meshing_fails):
    path = small_scene(skin={"element_m": 1e-6})
    with pytest.raises(ValueError, match=r"elements of 0\.001 mm give about 7e\+10 unknowns"):
        mujoco.MjModel.from_xml_path(str(path))


# -- skins and stimuli ---------------------------------------------------------------------------------------------


def ball(path: Path, radius_m: float, rings: int = 12) -> None:
    """An OBJ file of a sphere, its poles on z."""
    across = 2 * rings
    turn, height = np.meshgrid(np.arange(across) * np.pi / rings, np.pi * np.arange(1, rings) / rings)
    points = np.stack([np.sin(height) * np.cos(turn), np.sin(height) * np.sin(turn), np.cos(height)], axis=-1)
    points = radius_m * np.concatenate([points.reshape(-1, 3), [[0, 0, 1], [0, 0, -1]]])
    top, bottom = len(points) - 1, len(points)
    faces = []
    for i in range(across):
        j = (i + 1) % across
        faces += [(top, i + 1, j + 1), (bottom, (rings - 2) * across + j + 1, (rings - 2) * across + i + 1)]
        for ring in range(rings - 2):
            a, b, c, d = (ring * across + i, ring * across + j, (ring + 1) * across + i, (ring + 1) * across + j)
            faces += [(a + 1, c + 1, b + 1), (b + 1, c + 1, d + 1)]
    lines = [f"v {x} {y} {z}" for x, y, z in points] + [f"f {a} {b} {c}" for a, b, c in faces]
    path.write_text("\n".join(lines))


@pytest.fixture
def two_on_a_ball(small_scene):
    """Writes a ball with two skins, the second one's middle at an angle [deg] from that of the first."""

    def write(angle_deg: float) -> Path:
        path = small_scene(
            skin={"shape": "mesh", "mesh": "ball.obj", "mesh_unit": "m", "patch_site": "centre", "radius_m": None,
                  "thickness_m": None, "depth_m": 0.006, "patch_radius_m": 0.012}
        )  # fmt: skip
        ball(path.with_name("ball.obj"), 0.03)
        x, z = 0.03 * np.sin(np.deg2rad(angle_deg)), 0.03 * np.cos(np.deg2rad(angle_deg))
        site = '<site name="centre" size="0.001"/>'
        sites = f'<site name="centre" pos="0 0 0.03" size="0.001"/><site name="beside" pos="{x} 0 {z}" size="0.001"/>'
        changed(path.with_name("plain.xml"), site, sites)
        text, start, end = instance(path, "palmfield.skin")
        twin = text[start:end].replace('name="skin"', 'name="second"').replace('value="centre"', 'value="beside"')
        path.write_text(text[:end] + twin + text[end:])
        return path

    return write


def test_layers_on_one_body_that_overlap(two_on_a_ball):
    refused(
        two_on_a_ball(30.0), "plugin 'palmfield.skin' instance 'second': its layer overlaps that of instance 'skin' on "
        "body 'pad' (distance of the surfaces", "set patch_site or patch_radius_m to separate them",
    )  # fmt: skip


def test_a_layer_deeper_than_its_body(two_on_a_ball):
    path = changed(two_on_a_ball(90.0), 'key="depth_m" value="0.006"', 'key="depth_m" value="0.09"')
    with pytest.raises(PalmfieldError) as caught:
        palmfield.Simulation(path).step()
    expected = (
        r"key 'depth_m' has value 0\.09: the body below the layer is 0\.0\d+ m thick; allowed: a layer of at most"
    )
    assert (found := re.search(expected, str(caught.value))), str(caught.value)
    # The ball is 60 mm thick at most
    assert 0.05 < float(re.search(r"0\.0\d+(?= m thick)", found[0])[0]) <= 0.06


@pytest.mark.parametrize("height, where", [(0.008, "above"), (-0.0079, "below")])
def test_a_sensor_off_the_skin(height, where, small_scene):
    path = small_scene()
    site = '<site name="centre" size="0.001"/>'
    changed(path.with_name("plain.xml"), site, site.replace("size", f'pos="0 0 {height}" size'))
    with pytest.raises(PalmfieldError) as caught:
        palmfield.Simulation(path).step()
    off = f"its site is {1e3 * abs(height):.1f} mm {where} the skin; allowed: at most 5 mm: move it onto the skin"
    assert off in str(caught.value)


def test_layers_on_one_body_that_lie_apart(two_on_a_ball):
    assert palmfield.load(two_on_a_ball(90.0)).skins == ("skin", "second")


@pytest.mark.parametrize(
    "key, value, shapes",
    [
        ("mesh", "hand.obj", "'mesh' or 'rigged'"),
        ("mesh_unit", "mm", "'mesh' or 'rigged'"),
        ("hand", "open_men_p95", "'hand' or 'articulated'"),
    ],
)
def test_keys_of_a_shape_that_the_skin_has_not(key, value, shapes, small_scene):
    refused(
        small_scene(skin={key: value}),
        SKIN,
        f"{key} applies to shape {shapes}, but shape is 'disc': remove the key, or set",
    )


def test_a_mesh_needs_no_unit_where_its_format_has_one():
    keys = {"shape": "mesh", "patch_site": "palm"}
    for name in ("hand.glb", "HAND.GLTF", "mano.pkl"):
        assert SkinConfig(mesh=name, **keys).unit == "auto"
    assert SkinConfig(mesh="hand.glb", mesh_unit="mm", **keys).unit == "mm"
    with pytest.raises(ValueError, match=r"shape 'mesh' needs mesh_unit for 'hand\.ply'"):
        SkinConfig(mesh="hand.ply", **keys)
    with pytest.raises(ValueError, match="shape 'mesh' needs mesh"):
        SkinConfig(**keys)


def test_a_skin_that_no_stimulus_comes_near_is_warned_of(small_scene, add_skin):
    path = add_skin(small_scene(), "0.3 0 0.12")
    (line,) = [text for text in warnings(path) if "no focus is near" in text]
    assert "no focus is near skin 'second': the focus of stimulus 'stimulus' stays" in line and "\n" not in line


def test_a_scene_without_stimulus(small_scene):
    path = small_scene()
    text, start, end = instance(path, "palmfield.stimulus")
    path.write_text(text[:start] + text[end:])
    refused(path, f"{SKIN}the scene has no 'palmfield.stimulus'", "needed: at least one")


@pytest.fixture
def two_arrays(small_scene, add_array):
    """Writes a scene of two arrays and two stimuli, which name these arrays."""

    def write(first: str, second: str) -> Path:
        path = add_array(small_scene(stimulus={"arrays": first}))
        text, start, end = instance(path, "palmfield.stimulus")
        twin = text[start:end].replace('name="stimulus"', 'name="again"').replace(f'"{first}"', f'"{second}"')
        path.write_text(text[:end] + twin + text[end:])
        return path

    return write


def test_two_stimuli_that_name_one_array(two_arrays):
    refused(
        two_arrays("array", "second array"), "plugin 'palmfield.stimulus' instance 'again': key 'arrays' names "
        "'array', which instance 'stimulus' already drives; allowed: one stimulus per array",
    )  # fmt: skip


def test_a_stimulus_that_names_an_unknown_array(two_arrays):
    refused(two_arrays("array", "third"), "instance 'again': key 'arrays' names 'third'; the scene's arrays are: ")


def test_a_path_on_an_unknown_skin(small_scene):
    circle = {"path": "circle", "path_diameter_m": 0.01, "path_rate_Hz": 50, "path_on": "skin", "on_skin": "paw"}
    refused(small_scene(stimulus=circle), f"{STIMULUS}key 'on_skin' has value 'paw'; allowed: skin")


def test_on_skin_of_a_stimulus_that_follows_none(small_scene):
    refused(small_scene(stimulus={"on_skin": "paw"}), f"{STIMULUS}on_skin applies to a path on the skin")


# -- devices -------------------------------------------------------------------------------------------------------

NO_DEVICE = "text 'palmfield_device' has value 'cuda:7': device 'cuda:7' is not on this machine; use one of auto, cpu"


def test_a_device_that_is_not_there(small_scene):
    refused(small_scene(), NO_DEVICE, device="cuda:7")
    refused(small_scene(device="cuda:7"), NO_DEVICE)


@pytest.mark.parametrize("device", ["gpu", "cuda", "cuda:", "CPU", ""])
def test_a_word_that_is_no_device(device, small_scene):
    refused(small_scene(), f"device '{device}' is unknown; allowed: auto, cpu or cuda:N", device=device)


def test_a_device_of_the_command_line_that_is_not_there(small_scene, monkeypatch, capsys):
    path = small_scene()
    arguments = ["palmfield", "run", str(path), "--device", "cuda:7", "--out", str(path.parent / "out")]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 2
    assert NO_DEVICE in capsys.readouterr().err.strip().splitlines()[-1]
    assert not (path.parent / "out").exists()


# -- keys ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments", [{"keys": {"skin.accuracy": 0.1}}, {"device": "cpu"}, {"accuracy": 0.1}, {"board": "ideal"}], ids=str
)
def test_a_compiled_model_takes_no_keys(arguments, small_scene):
    model = mujoco.MjModel.from_xml_path(str(small_scene()))
    refused(model, "compiled (MjModel)", "give its file or its MjSpec with the keys, or the model without", **arguments)


def described(spec: mujoco.MjSpec) -> tuple:
    plugins = [(plugin.plugin_name, plugin.name, dict(plugin.config)) for plugin in spec.plugins]
    return plugins, [(text.name, text.data) for text in spec.texts]


@pytest.mark.parametrize("text", [True, False])
def test_a_spec_takes_keys_and_is_left_as_it_is(text, small_scene):
    spec = mujoco.MjSpec.from_file(str(small_scene()))
    if not text:
        spec.delete(spec.texts[0])
    before = described(spec)
    focus = (0.0, 0.001, 0.12)
    simulation = palmfield.load(
        spec, device="auto", accuracy=0.1, board="ideal", keys={"stimulus.focus_m": focus, "stimulus.am_depth": 0.5}
    )
    assert described(spec) == before
    assert simulation.runtime.spec.stimuli[0].config.focus_m == focus
    assert simulation.runtime.spec.skins[0].config.accuracy == 0.1
    refused(spec, f"{SKIN}key 'accuracy' has value '7.0'", accuracy=7.0)
    assert described(spec) == before
    simulation.step()
    again = palmfield.load(spec)
    again.step()
    assert again.runtime.spec.stimuli[0].config.focus_m == (0.0, 0.0, 0.12)


def test_a_compiled_model_works_without_keys(small_scene):
    simulation = palmfield.load(mujoco.MjModel.from_xml_path(str(small_scene())))
    simulation.step()
    assert simulation.time > 0.0 and np.isfinite(simulation.skin().displacement).all()


@pytest.mark.parametrize("key", ["paw.accuracy", "accuracy", ".accuracy", "palmfield.paw.accuracy", ""])
def test_keys_of_an_unknown_instance(key, small_scene):
    has = "it has: array, driver, palmfield.array, palmfield.driver, palmfield.skin, palmfield.stimulus, skin, stimulus"
    refused(small_scene(), f"key '{key}' belongs to no instance or plugin of this scene; {has}", keys={key: 1})


@pytest.mark.parametrize("owner", ["skin", "palmfield.skin"])
def test_keys_that_an_instance_has_not(owner, small_scene):
    refused(
        small_scene(),
        f"{SKIN}unknown key 'radius_mm' (did you mean 'radius_m'?); allowed: the keys that `palmfield keys skin` lists",
        keys={f"{owner}.radius_mm": 20},
    )


VALUES = {
    "skin.element_m": "finite number > 0",
    "skin.accuracy": "finite number >= 0.002 and <= 0.5",
    "skin.shear_branch_Pa": "finite number >= 0",
    "stimulus.focus_m": "three finite numbers",
    "stimulus.am_frequency_Hz": "finite number > 0",
    "stimulus.start_s": "finite number >= 0",
    "array.temperature_C": "finite number",
    "array.p0_Pa_m": "finite number > 0",
}


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "six", "1e999", "0x10", "1,5"])
@pytest.mark.parametrize("key", VALUES)
def test_values_that_are_no_finite_numbers(key, value, small_scene):
    path = small_scene()
    _, name = key.split(".")
    text = f"0 0 {value}" if name == "focus_m" else value
    refused(path, f"key '{name}' has value '{text}'; allowed: {VALUES[key]}", keys={key: text})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float64("nan")])
def test_numbers_of_python_that_are_not_finite(value, small_scene):
    path = small_scene()
    refused(path, f"{SKIN}key 'accuracy' has value '{value}'; allowed: finite number", accuracy=value)
    where = np.array([0.0, 0.0, value])
    refused(path, f"{STIMULUS}key 'focus_m' has value '0.0 0.0 {value}'", keys={"stimulus.focus_m": where})


RENAMED = {
    "device": ({"driver": {"device": "ideal"}}, "key 'device' is renamed: use board"),
    "compute": ({"array": {"compute": "cpu"}}, "key 'compute' is renamed: use the scene's palmfield_device text"),
    "full": ({"skin": {"solver": "full"}}, f"{SKIN}key 'solver' has value 'full', which is renamed: use wedges"),
    "implicit": ({"skin": {"solver": "implicit"}}, "key 'solver' has value 'implicit', which is renamed: use wedges"),
    "waves": ({"skin": {"solver": "lateral_waves"}}, "call palmfield.skin.solve(..., solver='lateral_waves')"),
}


@pytest.mark.parametrize("case", RENAMED)
def test_what_is_renamed_or_a_solver_of_its_own(case, small_scene):
    changes, expected = RENAMED[case]
    refused(small_scene(**changes), expected)
    keys = {f"{owner}.{key}": value for owner, own in changes.items() for key, value in own.items()}
    refused(small_scene(), expected, keys=keys)


def test_solvers_that_are_told_of_are_those_of_solve():
    assert set(WHOLE_HISTORY) <= set(get_args(Name))


# -- what would say nothing ----------------------------------------------------------------------------------------


def test_keys_of_a_modulation_that_is_off_are_warned_of(small_scene):
    (line,) = [text for text in warnings(small_scene(stimulus={"modulation": "none"})) if "modulation" in text]
    assert line.startswith(
        "keys am_quantity, am_frequency_Hz, am_depth of stimulus 'stimulus' have no effect, because its modulation is"
    )
    steady = {"modulation": "none", "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
    assert not [text for text in warnings(small_scene(stimulus=steady)) if "modulation" in text]
    assert not [text for text in warnings(small_scene()) if "modulation" in text]


@UNESTIMATED
def test_a_run_prints_that_keys_do_nothing(small_scene, monkeypatch, capsys):
    path = small_scene()
    arguments = ["run", str(path), "--set", "stimulus.modulation=none", "--duration", "0.002", "--no-plots"]
    monkeypatch.chdir(path.parent)
    monkeypatch.setattr(sys, "argv", ["palmfield", *arguments])
    with pytest.raises(SystemExit) as stop:
        main()
    assert stop.value.code == 0 and "warning: keys am_quantity" in capsys.readouterr().err


@pytest.mark.parametrize("distance_m, apart", [(0.0, "0.0 mm apart"), (0.001, "1.0 mm apart")])
def test_two_arrays_at_one_place(distance_m, apart, small_scene, add_array):
    path = add_array(small_scene())
    changed(path.with_name("plain.xml"), 'pos="0.3 0 0"', f'pos="{distance_m} 0 0"')
    refused(
        path, "plugin 'palmfield.array' instance ", "its transducers overlap those of instance ", apart,
        "give it its own site by key 'site'",
    )  # fmt: skip


def test_arrays_side_by_side_are_no_overlap(small_scene, add_array):
    """Boards of 16 transducers 10.3 mm apart, the next one where the seventeenth would be."""
    path = add_array(small_scene())
    changed(path.with_name("plain.xml"), 'pos="0.3 0 0"', f'pos="{16 * 0.0103} 0 0"')
    assert len(palmfield.load(path).runtime.model.arrays) == 512


@pytest.mark.parametrize(
    "focus, unit, metres", [("0 0 120", "millimetres", "0 0 0.12"), ("0 2 -20", "centimetres", "0 0.02 -0.2")]
)
def test_a_focus_in_another_unit(focus, unit, metres, small_scene):
    refused(
        small_scene(stimulus={"focus_m": focus}), f"{STIMULUS}key 'focus_m' has value '{focus}', which is",
        "allowed: metres, at most 10 from the origin", f"if these are {unit}, give {metres}",
    )  # fmt: skip


@pytest.mark.parametrize("duplicate", ['<config key="focus_m" value="0 0 0.1"/>', '<config key="focus_m" value=""/>'])
def test_a_key_given_twice(duplicate, small_scene):
    path = changed(small_scene(), '<config key="focus_m"', duplicate + '<config key="focus_m"')
    refused(path, "key 'focus_m'", "twice", "line 11")


def test_a_key_set_twice_on_the_command_line(small_scene, monkeypatch, capsys):
    arguments = ["palmfield", "info", str(small_scene()), "--set", "skin.accuracy=0.3", "--set", "skin.accuracy=0.1"]
    monkeypatch.setattr(sys, "argv", arguments)
    with pytest.raises(SystemExit) as stop:
        main()
    said = "--set gives skin.accuracy twice, '0.3' and '0.1'; allowed: each key once"
    assert stop.value.code == 2 and said in capsys.readouterr().err


def test_a_key_without_a_value(small_scene):
    path = changed(small_scene(), 'key="side" value="free"', 'key="side" value=""')
    refused(path, f"{SKIN}key 'side' has no value; allowed: fixed | free | roller | absorbing, or remove the key")
    assert palmfield.load(small_scene(), keys={"skin.side": ""}).runtime.spec.skins[0].config.side == "fixed"


@pytest.mark.parametrize("key", ["patch_radius_m", "depth_m"])
@pytest.mark.parametrize("value", [1.5e-8, 4e-4, 20.0])
def test_a_layer_of_no_skins_size_is_refused_with_what_is_allowed(key, value):
    """A patch of 15 nm was planned as one of radius 0 mm, and ended the run with an IndexError."""
    with pytest.raises(PalmfieldError, match=rf"key '{key}' has value .* allowed: finite number >= 0.0005 and <= 1"):
        palmfield.plan("mjcf/scenes/follow_fingertip.xml", accuracy=0.5, keys={f"skin.{key}": value})


def test_a_patch_that_modes_cannot_serve_is_stepped_whole():
    keys = {"skin.patch_radius_m": 5e-4}
    palmfield.Simulation("mjcf/scenes/follow_fingertip.xml", accuracy=0.4, keys=keys).run(0.002)
