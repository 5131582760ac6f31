"""What a scene or a command gives and nothing would read, or read otherwise than meant: refused or warned of."""

import json
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
from refusals import changed, refused

import palmfield
from palmfield.acoustics.air import sound_speed
from palmfield.acoustics.calibration_file import Calibration, Elements, Pose, write_calibration
from palmfield.acoustics.reference import pressure64
from palmfield.cli.app import main
from palmfield.config.stimulus import too_far
from palmfield.planning.scene_plan import warnings
from palmfield.session.preview import preview
from palmfield.simulation.spec import SceneSpec
from palmfield.types import Air, Estimate, Float

SKIN = "plugin 'palmfield.skin' instance 'skin': "
STIMULUS = "plugin 'palmfield.stimulus' instance 'stimulus': "
STEADY = {"modulation": None, "am_quantity": None, "am_frequency_Hz": None, "am_depth": None}
HAND = {"shape": "hand", "radius_m": None, "thickness_m": None, "patch_site": "centre"}


def typed(line: list[str], monkeypatch: pytest.MonkeyPatch) -> int | str | None:
    """The exit code of a command."""
    monkeypatch.setattr(sys, "argv", ["palmfield", *line])
    with pytest.raises(SystemExit) as stop:
        main()
    return stop.value.code


def course_of(scene: Path, words: str) -> str:
    """The one warning that has these words."""
    (text,) = [text for text in warnings(scene) if words in text]
    return text


# -- keys that nothing would look at -------------------------------------------------------------------------------


@pytest.mark.parametrize("key", ["radius_m", "thickness_m"])
def test_a_hand_has_no_size_of_a_disc(key, small_scene):
    refused(
        small_scene(skin=HAND | {key: 0.05}),
        f"{SKIN}{key} applies to shape 'disc', but shape is 'hand': remove the key, or set",
    )


@pytest.mark.parametrize(("key", "value"), [("depth_m", 0.005), ("patch_radius_m", 0.01), ("patch_site", "centre")])
def test_a_disc_has_no_layer_laid_on_it(key, value, small_scene):
    shapes = "'hand' or 'articulated' or 'mesh' or 'rigged' or 'cylinder'"
    refused(
        small_scene(skin={key: value}), f"{SKIN}{key} applies to shape {shapes}, but shape is 'disc': remove the key"
    )


@pytest.mark.parametrize("edges", ["rays", "knife_edge"])
def test_edges_of_shadows_without_shadows(edges, small_scene):
    refused(
        small_scene(skin={"shadow_edges": edges}),
        f"{SKIN}shadow_edges '{edges}' applies to body_sound 'shadows', but body_sound is 'none': remove the key, or "
        "set body_sound to shadows",
    )
    spec = palmfield.load(small_scene(skin={"shadow_edges": edges, "body_sound": "shadows"})).runtime.spec
    assert isinstance(spec, SceneSpec) and spec.skins[0].config.shadow_edges == edges


@pytest.mark.parametrize("value", ["", "  "])
def test_a_key_that_is_set_to_nothing(value, small_scene, monkeypatch, capsys):
    assert typed(["info", str(small_scene()), "--set", f"skin.material={value}"], monkeypatch) == 2
    said = capsys.readouterr()
    assert f"--set skin.material={value}".strip() in said.err and "no value after the =" in said.err and not said.out


def test_a_key_said_of_a_plugin_and_of_its_only_instance(small_scene):
    keys = {"palmfield.stimulus.am_frequency_Hz": 100, "stimulus.am_frequency_Hz": 200}
    text = refused(small_scene(), "both set am_frequency_Hz of instance 'stimulus'", "give one of them", keys=keys)
    assert "100" in text and "200" in text and all(key in text for key in keys)


def test_one_instance_of_two_may_differ(small_scene, add_skin):
    path = add_skin(small_scene(), "0.05 0 0.12")
    spec = palmfield.load(path, keys={"palmfield.skin.accuracy": 0.3, "second.accuracy": 0.4}).runtime.spec
    assert [skin.config.accuracy for skin in spec.skins] == [0.3, 0.4]


@pytest.mark.parametrize(
    ("custom", "expected"),
    [
        (
            '<numeric name="palmfield_duration" data="0.5"/>',
            ["did you mean 'palmfield_duration_s'?", "is unknown to palmfield"],
        ),
        ('<text name="palmfield_devise" data="cpu"/>', ["did you mean 'palmfield_device'?", "text 'palmfield_devise'"]),
        ('<numeric name="palmfeild_duration_s" data="1"/>', ["did you mean 'palmfield_duration_s'?"]),
        ('<text name="palmfield_speed" data="1"/>', ["allowed: numeric 'palmfield_duration_s' and text"]),
        ('<text name="palmfield_duration_s" data="1"/>', ["the wrong element type; allowed: <numeric name="]),
        ('<numeric name="palmfield_device" data="1"/>', ["the wrong element type; allowed: <text name="]),
    ],
)
def test_a_setting_of_the_scene_that_is_misspelt(custom, expected, small_scene):
    path = changed(small_scene(), "<custom>", f"<custom>{custom}")
    line = 1 + path.read_text()[: path.read_text().index(custom)].count("\n")
    refused(path, f"line {line}:", *expected)


def test_a_duration_is_one_number(small_scene):
    refused(
        small_scene(duration_s="0.1 0.2"), "line 6:", "'palmfield_duration_s' has 2 numbers; allowed: one, in seconds"
    )


def test_settings_of_other_programs_are_left_alone(small_scene):
    path = changed(small_scene(), "<custom>", '<custom><numeric name="my_duration_s" data="1 2"/>')
    assert palmfield.load(path).runtime.spec.duration_s == 0.015


# -- values that are read otherwise than meant ---------------------------------------------------------------------


def test_a_vector_with_commas_is_told_once_with_blanks(small_scene):
    text = refused(small_scene(stimulus={"focus_m": "0,0,0.12"}), f"{STIMULUS}key 'focus_m' has value '0,0,0.12'")
    assert text.count("focus_m") == 1 and "write '0 0 0.12', with spaces in place of commas" in text


def test_words_in_a_vector_are_no_commas(small_scene):
    text = refused(small_scene(stimulus={"focus_m": "0 0 near"}), "allowed: three finite numbers")
    assert "comma" not in text and text.count("focus_m") == 1


@pytest.mark.parametrize("focus", [(float("nan"), 0.0, 0.15), (0.0, float("inf"), 0.0)])
def test_a_focus_that_is_no_place_has_no_unit(focus):
    said = too_far(focus)
    assert said is not None and "finite" in said and "millimetres" not in said
    assert "millimetres" in str(too_far((0.0, 0.0, 150.0)))


def test_a_long_list_does_not_follow_what_was_meant(small_scene):
    meant = refused(small_scene(skin={"radius_mm": 20}), "(did you mean 'radius_m'?)", "`palmfield keys skin` lists")
    assert "foundation" not in meant
    refused(small_scene(skin={"nose": 20}), "unknown key 'nose'; allowed: body", "foundation_normal_Pa_m")


@pytest.mark.parametrize("name", ['name=""', 'name=" "', ""])
def test_an_instance_without_a_name(name, small_scene):
    path = changed(small_scene(), '<instance name="driver">', f"<instance {name}>")
    refused(path, "<instance>", "name")


def test_a_sensor_of_an_instance_that_is_not_there(small_scene):
    path = changed(small_scene(), '<instance name="skin">', '<instance name="a/b">')
    refused(path, "line ", "attribute 'instance': the scene has no plugin instance 'skin'", "it has: ", "a/b")


def csv(folder: Path, gains: list[float]) -> Path:
    """The transducers of a row, 10 mm apart."""
    rows = "".join(f"{10 * i},0,0,{gain}\n" for i, gain in enumerate(gains))
    path = folder / "row.csv"
    path.write_text("x_mm,y_mm,z_mm,gain\n" + rows)
    return path


def test_a_gain_beyond_what_transducers_differ_by(small_scene, tmp_path):
    array = {"layout": "csv", "transducers": csv(tmp_path, [1.0, -1.1, 5.0])}
    refused(small_scene(array=array), "line 4", "column gain: 5; allowed: -2 to 2, relative to p0", "key p0_Pa_m")
    csv(tmp_path, [1.0, -1.1, 2.0])
    assert len(palmfield.load(small_scene(array=array)).runtime.model.arrays) == 3


def test_an_array_of_which_nothing_sounds(small_scene, tmp_path):
    array = {"layout": "csv", "transducers": csv(tmp_path, [0.0, 0.0])}
    refused(small_scene(array=array), "plugin 'palmfield.array' instance 'array': all 2 transducers are dead")


# -- sound that doesn't come ---------------------------------------------------------------------------------------


def test_a_level_of_0_is_told_and_the_layer_is_as_with_sound(small_scene):
    silent = palmfield.load(small_scene(stimulus={"drive_amplitude": 0}))
    loud = palmfield.load(small_scene(stimulus={"drive_amplitude": 1}))
    spots = [scene.runtime.model.skins[0].layer.demand.spot_fwhm_m for scene in (silent, loud)]
    assert spots[0] == spots[1] < 0.03
    assert "its drive_amplitude is 0" in course_of(small_scene(stimulus={"drive_amplitude": 0}), "emits no sound")


def test_a_stimulus_that_starts_after_the_run_or_has_stopped(small_scene):
    late = small_scene(stimulus={"start_s": 5})
    said = course_of(late, "emits no sound in this run")
    assert "stimulus 'stimulus'" in said and "starts at 5 s" in said and "ends at 0.015 s" in said
    assert not [text for text in warnings(late, 5.1) if "emits no sound" in text]
    scene = palmfield.Simulation(small_scene(stimulus={"stop_s": 0.001}))
    assert not [text for text in warnings(scene) if "emits no sound" in text]
    scene.start_at(0.002)
    assert [text for text in warnings(scene) if "it stops at 0.001 s" in text]


@pytest.mark.parametrize("behind_mm", [25, 60])
def test_a_focus_off_the_skin_is_told_with_what_the_skin_gets(behind_mm, small_scene):
    focus = np.array([0.0, 0.0, 0.12 + 1e-3 * behind_mm])
    path = small_scene(stimulus={**STEADY, "focus_m": f"0 0 {focus[2]}"})
    said = course_of(path, "no focus is near skin 'skin'")
    array = preview(path).runtime.model.arrays.array

    def loudness(at: Float, points: Float) -> Float:
        phases = -2.0 * np.pi * 40e3 / sound_speed(Air()) * np.linalg.norm(array.positions - at, axis=1)
        return np.abs(pressure64(points, array, np.exp(1j * phases), Air(), gradient=False)[0]) ** 2

    turn, out = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 24), np.linspace(0.0, 0.02, 21))
    face = np.column_stack([(out * np.cos(turn)).ravel(), (out * np.sin(turn)).ravel(), np.full(turn.size, 0.12)])
    on_face = loudness(focus, face)
    loudest = face[on_face.argmax()]
    share = 100.0 * on_face.max() / loudness(loudest, loudest[None])[0]
    told = float(said.partition("point has ")[2].partition(" %")[0])
    assert f"stays {behind_mm} mm from" in said and told == pytest.approx(share, rel=0.1) and told > 5.0


def test_a_skin_behind_the_focus_hardly_moves(small_scene):
    said = course_of(small_scene(stimulus={**STEADY, "focus_m": "0 0 0.03"}), "no focus is near")
    assert "so the skin hardly moves" in said and "for the 4.5 mm spot at the focus" in said


def test_a_focus_off_the_skin_is_told_alike_whatever_sets_its_level(small_scene):
    """20 Pa are in the array's reach at 60 mm, where the focus is, and not at 200, where the skin is."""
    keys, told = {**STEADY, "focus_m": "0 0 0.06"}, []
    for level in ({"arp_peak_Pa": 20}, {"drive_amplitude": 1}, {"drive_amplitude": 0.1}):
        path = small_scene(stimulus=keys | level)
        changed(path.parent / "plain.xml", 'pos="0 0 0.12"', 'pos="0 0 0.2"')
        told.append(course_of(path, "no focus is near skin 'skin'"))
    assert len(set(told)) == 1 and "stays 140 mm from" in told[0]


def test_a_focus_off_the_skin_is_told_for_a_board_that_takes_one_focus(small_scene):
    keys = {**STEADY, "focus_m": "0 0 0.2", "drive_amplitude": 1, "arp_peak_Pa": None}
    path = small_scene(
        array={"layout": "autd2018"}, stimulus={**keys, "control_rate_Hz": 1000}, driver={"board": "autd2018"}
    )
    assert "stays 80 mm from" in course_of(path, "no focus is near skin 'skin'")


def test_a_layer_too_large_for_a_focus_far_aside_says_that_it_misses(small_scene, monkeypatch):
    monkeypatch.setattr("palmfield.simulation.validate.available_bytes", lambda: 10**5)
    path = small_scene(stimulus={"focus_m": "1 1 1"}, skin={"element_m": 0.00351})
    refused(path, "free: 0.0001 GB (the focus of stimulus 'stimulus' misses the skin: it is 1.67e+03 mm from")
    assert "misses" not in refused(small_scene(skin={"element_m": 0.00352}), "free: 0.0001 GB; set element_m")


# -- sensors that a run would refuse -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('objname="centre"', 'objname="array"', "needs objtype='site' and a site of body 'pad'"),
        ('objtype="site" objname="centre"', 'objtype="body" objname="pad"', "needs objtype='site'"),
        ('objname="centre"', 'objname="above"', "its site is 6.7 mm above the skin; allowed: at most 5 mm"),
        ('objname="centre"', 'objname="aside"', "mm from the skin layer and would read the rim"),
    ],
)
@pytest.mark.parametrize("command", ["plan", "info"])
def test_a_sensor_off_its_skin_is_refused_before_the_run(old, new, expected, command, small_scene, monkeypatch, capsys):
    path = changed(small_scene(), old, new)
    sites = '<site name="above" pos="0 0 0.0067"/><site name="aside" pos="0.04 0 0"/>'
    changed(path.with_name("plain.xml"), '<site name="centre"', sites + '<site name="centre"')
    line = 1 + path.read_text()[: path.read_text().index("<sensor>")].count("\n")
    assert typed([command, str(path)], monkeypatch) == 2
    said = capsys.readouterr()
    assert f"{path}, line {line}: {SKIN}sensor 'skin'" in said.err and expected in said.err and not said.out


# -- p0 ------------------------------------------------------------------------------------------------------------


def test_info_tells_how_p0_is_known(small_scene, monkeypatch, capsys):
    assert typed(["info", str(small_scene())], monkeypatch) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "uncalibrated: 1.27 Pa m (0.7 to 2.6), inferred: reproduces the 12 Pa" in said
    assert typed(["info", str(small_scene()), "--json"], monkeypatch) == 0
    (array,) = json.loads(capsys.readouterr().out)["arrays"]
    told = {key: array[key] for key in ("p0_Pa_m", "p0_low_Pa_m", "p0_high_Pa_m", "p0_kind", "calibrated")}
    assert told == {
        "p0_Pa_m": 1.27, "p0_low_Pa_m": 0.7, "p0_high_Pa_m": 2.6, "p0_kind": "inferred", "calibrated": False,
    }  # fmt: skip


@pytest.mark.parametrize("p0", [131, 50, 0.00127])
def test_a_p0_that_no_transducer_has_is_doubted(p0, small_scene):
    said = course_of(small_scene(array={"p0_Pa_m": p0}), "p0 of array 'array'")
    assert f"is {p0:g} Pa m" in said and "0.7 to 8.5" in said and "check the unit" in said


@pytest.mark.parametrize("p0", [0.5, 2.53, 12])
def test_a_p0_that_one_may_have_is_not(p0, small_scene):
    assert not [text for text in warnings(small_scene(array={"p0_Pa_m": p0})) if "p0 of array" in text]


# -- arrays in another unit ----------------------------------------------------------------------------------------


def test_places_in_another_unit_are_refused_or_doubted(small_scene, tmp_path):
    """Metres under names of millimetres are refused; pistons that stand in one another are told; a board's are not."""
    keys = {"layout": "csv", "transducers": "own.csv"}
    for scale, told in (
        (1e-3, "0.0105 mm apart"),
        (0.5, "5.25 mm apart, but their pistons are 9 mm wide"),
        (1.0, None),
    ):
        places = [(10.5 * scale * x, 10.5 * scale * y) for x in range(-4, 5) for y in range(-4, 5)]
        (tmp_path / "own.csv").write_text("x_mm,y_mm,z_mm\n" + "".join(f"{x},{y},0\n" for x, y in places))
        scene = small_scene(array=keys)
        if scale == 1e-3:
            assert "allowed: at least 1.0 mm: check the unit" in refused(scene, told)
        elif told:
            course_of(scene, told)
            assert not [
                text for text in warnings(small_scene(array=keys | {"piston_radius_m": 0.0025})) if "wide" in text
            ]
        else:
            assert not [text for text in warnings(scene) if "apart" in text]


def test_a_humidity_that_is_a_share_is_doubted(small_scene):
    assert "check the unit" in course_of(small_scene(array={"humidity_percent": 0.5}), "humidity_percent of array")
    assert not [text for text in warnings(small_scene(array={"humidity_percent": 5})) if "humidity" in text]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"gain": 5.0}, "has gains of about 5; gains are relative to p0"),
        ({"gain": 0.2}, "has gains of about 0.2; gains are relative to p0"),
        ({"offset_m": (0.3, 0.4, 0.0)}, "displaces the board by 0.5 m: check the unit"),
        ({"high": 900.0}, "has a p0 of 1.2 to 900 Pa m, which is too wide to be useful"),
        ({}, None),
    ],
)
def test_a_calibration_of_no_board_is_doubted(changes, told, small_scene, tmp_path):
    count = 256
    elements = Elements(
        enabled=(True,) * count, polarity=(1,) * count, phase_rad=(0.0,) * count,
        gain=(changes.get("gain", 1.1),) * count,
    )  # fmt: skip
    p0 = Estimate(1.3, 1.2, changes.get("high", 1.4), "measured", "ours")
    pose = Pose(offset_m=changes.get("offset_m", (1e-3, 0.0, 0.0)))
    calibration = Calibration(layout="uhev1", p0=p0, elements=elements, pose=pose)
    write_calibration(tmp_path / "ours.json", calibration)
    said = [text for text in warnings(small_scene(array={"calibration": "ours.json"})) if "calibration of" in text]
    assert said == [] if told is None else len(said) == 1 and told in said[0]


@pytest.mark.parametrize(
    ("rate_Hz", "told"),
    [
        (150, "the played frequency is 50 Hz"),
        (390, "played frequency is 190 Hz"),
        (400, "depends on the phase of the frames"),
        (401, None),
        (0, None),
    ],
)
def test_frames_too_rare_for_a_modulation_are_told(rate_Hz, told, small_scene):
    said = [
        text for text in warnings(small_scene(stimulus={"control_rate_Hz": rate_Hz})) if "frames per second" in text
    ]
    assert said == [] if told is None else len(said) == 1 and told in said[0]


@pytest.mark.parametrize(
    ("keys", "told"),
    [
        ({"density_kg_m3": 1.03}, "has a density of 1.03 kg/m^3; skins and phantoms have 500 to 3000"),
        ({"shear_relaxed_Pa": 12}, "has a relaxed shear modulus of 12 Pa"),
        ({"bulk_Pa": 1000}, "check bulk_Pa"),
        ({}, None),
    ],
)
def test_a_material_that_no_skin_is_of_is_doubted(keys, told, small_scene):
    """K = 1000 Pa beside the preset's shear modulus is a solid that grows thicker as it is drawn out."""
    said = [text for text in warnings(small_scene(skin=keys)) if text.startswith("material ")]
    assert said == [] if told is None else len(said) == 1 and told in said[0]


# -- Ctrl-C --------------------------------------------------------------------------------------------------------


@pytest.fixture
def python_raises():
    """A shell that runs tests in the background has them ignore Ctrl-C."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def test_ctrl_c_while_preparing_leaves_the_old_run_and_says_so(small_scene, python_raises, monkeypatch, capsys):
    path = small_scene()
    out = path.with_name("out")
    out.mkdir()
    (out / "summary.json").write_text("{}")

    def interrupted(*_):
        signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr("palmfield.session.recorded_run.static_arrays", interrupted)
    assert typed(["run", str(path), "--out", str(out), "--overwrite", "--quiet"], monkeypatch) == 130
    said = capsys.readouterr().err
    assert f"interrupted before the first step; {out} contains the results of an earlier run" in said
    assert "recover" not in said and [file.name for file in out.iterdir()] == ["summary.json"]


def test_ctrl_c_that_a_library_turns_into_its_own_error(small_scene, monkeypatch, capsys):
    def loads(*_, **__):
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt:
            raise ImportError("numpy.core.multiarray failed to import")  # noqa: B904

    monkeypatch.setattr("palmfield.Simulation", loads)
    assert typed(["run", str(small_scene())], monkeypatch) == 130
    assert capsys.readouterr().err.strip().splitlines()[-1] == "palmfield: interrupted"


def test_other_errors_keep_their_traceback(small_scene, monkeypatch):
    def fails(*_, **__):
        raise ImportError("of its own")

    monkeypatch.setattr("palmfield.Simulation", fails)
    monkeypatch.setattr(sys, "argv", ["palmfield", "run", str(small_scene())])
    with pytest.raises(ImportError, match="of its own"):
        main()
