"""What a scene's files say that MuJoCo can't build: told with file, line, element, and how to mend it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import mujoco
import pytest

import palmfield
from palmfield.errors import SceneError, did_you_mean
from palmfield.session.mujoco_messages import attributes, children
from palmfield.session.scene_text import read_scene_text

RAW = re.compile(r"XML Error|XML_ERROR|ErrorID|Schema violation|Element name|mjMINVAL|id -?\d+, line")
"""Words of MuJoCo and its parser that tell users nothing."""


def told(scene: Path, old: str, new: str, file: str = "small.xml") -> str:
    """What is said of a scene with another text in one of its files; it is one line, with the line of the change."""
    path = scene.with_name(file)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(SceneError) as refusal:
        palmfield.load(scene)
    message = str(refusal.value)
    line = text[: text.index(old)].count("\n") + 1
    assert "\n" not in message and not RAW.search(message), message
    assert message.startswith(f"{path}, line {line}: "), (message, line)
    return message.removeprefix(f"{path}, line {line}: ")


GEOM = '<geom type="cylinder" size="0.02 0.004"'
FAULTS = {
    "element": (GEOM, GEOM.replace("geom", "goem"), "<goem> is unknown inside <body> (did you mean 'geom'?); allowed:"),
    "attribute": (GEOM, GEOM.replace("size", "sze"), "<geom> has no attribute 'sze' (did you mean 'size'?); allowed: "),
    "unit": (GEOM, GEOM.replace("0.004", "4mm"), "<geom> attribute 'size' has value '0.02 4mm', not all of which are "),
    "too many": (GEOM, GEOM.replace("0.004", "1 2 3"), "<geom> attribute 'size' has value '0.02 1 2 3', more numbers"),
    "keyword": (GEOM, GEOM.replace("cylinder", "can"), "<geom> attribute 'type' has value 'can'; give one of the"),
    "no include": ("uhev1.xml", "uhev2.xml", "uhev2.xml' does not exist or cannot be read; give a path relative to"),
    "name twice": ('<site name="centre"', '<site name="centre"/><site name="centre"', "name 'centre' is given twice"),
    "not closed": (GEOM, "<geom>" + GEOM, "<geom> of line 8 is not closed before this; close it by </geom> or />"),
    "quote": ('type="cylinder"', "type=cylinder", "a character is not allowed here in XML; put values in quotes"),
    "massless": ("<geom type", '<body><joint/></body><geom type', "moves and has no mass; give the body a geom"),
    "stray text": ("<worldbody>", "<worldbody> oops", "text 'oops' between elements has no meaning"),
    "no number": ('pos="0 0 0.12"', 'pos="nan 0 0.12"', "<body> attribute 'pos' has value 'nan 0 0.12'; allowed: "),
    "axis": ('axis="1 0 0"', 'axis="0 0 0"', "<joint> has an axis of length 0; give attribute 'axis' a direction"),
    "in the world": ("<body name", '<joint type="hinge"/><body name', "<joint> is in the world body, which"),
    "attribute twice": ('name="pad"', 'name="pad" name="pad"', "an attribute is given twice; give it once"),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_of_plain_scenes_are_told_with_line_and_mend(fault, small_scene):
    old, new, expected = FAULTS[fault]
    if fault == "not closed":
        path = small_scene()
        plain = path.with_name("plain.xml")
        plain.write_text(plain.read_text().replace(GEOM, "<geom>" + GEOM))
        with pytest.raises(SceneError, match=r"plain\.xml, line 9: <geom> of line 8 is not closed before this; close"):
            palmfield.load(path)
        return
    assert expected in told(small_scene(), old, new, "plain.xml")


PLUGINS = {
    "key": (
        'key="thickness_m"', 'key="thicknes_m"', "unknown key 'thicknes_m' (did you mean 'thickness_m'?); allowed",
    ),
    "plugin": (
        "palmfield.stimulus", "palmfield.stimuls", "not installed (did you mean 'palmfield.stimulus'?); palmfield",
    ),
    "value": ('value="free"', 'value="fre"', "key 'side' has value 'fre' (did you mean 'free'?); allowed: fixed | "),
    "material": ('"ecoflex_00-10"', '"ecoflex_0010"', "is unknown (did you mean 'ecoflex_00-10'?); use one"),
    "body": ('value="pad"', 'value="pda"', "the scene has no body 'pda' (did you mean 'pad'?); it has: "),
    "site": ('objname="centre"', 'objname="center"', "the scene has no site 'center' (did you mean 'centre'?)"),
    "instance": ('instance="skin"', 'instance="skn"', "no plugin instance 'skn' (did you mean 'skin'?); it has: "),
    "instance twice": (
        '<instance name="driver">', '<instance name="driver"/><instance name="driver">', "name 'driver' is given twice",
    ),
    "timestep": ('timestep="0.001"', 'timestep="0"', "option 'timestep' has value 0; allowed: seconds > 0"),
    "duration": ('data="0.015"', 'data="-1"', "numeric 'palmfield_duration_s' has value -1; allowed: seconds > 0"),
    "device": ('data="cpu"', 'data="gpu"', "text 'palmfield_device' has value 'gpu': device 'gpu' is not on this"),
    "no value": ('<config key="side" value="free"/>', '<config key="side"/>', "<config> lacks the attribute 'value'"),
    "misplaced": ('<instance name="skin">', '<config/><instance name="skin">', "<config> is unknown inside <plugin>"),
}  # fmt: skip


@pytest.mark.parametrize("fault", PLUGINS)
def test_faults_of_plugins_are_told_with_line_and_mend(fault, small_scene):
    old, new, expected = PLUGINS[fault]
    assert expected in told(small_scene(), old, new)


def test_near_misses_of_names_in_keys(small_scene):
    for key, near in (("skn.accuracy", "skin"), ("stimulu.focus_m", "stimulus"), ("skin.acuracy", "accuracy")):
        with pytest.raises(SceneError, match=rf"did you mean '{near}'\?"):
            palmfield.load(small_scene(), keys={key: 0.1})


@pytest.mark.parametrize("text", ["", "hello", "<mujoco>", "<mujoco/><mujoco/>", "\0", "<mjoco/>", "<mujoco><body>&x;"])
def test_what_is_no_scene(text, tmp_path):
    path = tmp_path / "scene.xml"
    path.write_text(text)
    with pytest.raises(SceneError) as refusal:
        palmfield.load(path)
    assert not RAW.search(str(refusal.value)) and str(refusal.value).startswith(f"{path}")
    assert "; " in str(refusal.value)


def test_what_mujoco_passes_over_is_no_fault(small_scene):
    """A comment with dashes in it and a bare ampersand are no XML, and many MJCF files have them."""
    path = small_scene()
    path.write_text(path.read_text().replace('model="small"', 'model="salt & pepper"') + "<!-- --- the end --- -->\n")
    assert mujoco.MjSpec.from_file(str(path)).modelname == "salt & pepper"
    assert palmfield.load(path).skins == ("skin",)


def test_lines_of_included_files_are_told_with_their_file(small_scene):
    path = small_scene()
    elements = read_scene_text(path).elements
    geom = next(one for one in elements if one.tag == "geom" and one.attributes.get("size") == "0.02 0.004")
    assert (geom.file.name, geom.line) == ("plain.xml", 8)
    board = next(one for one in elements if one.attributes.get("name") == "board")
    assert board.file.name == "uhev1.xml"


def test_a_file_that_includes_itself(small_scene):
    path = small_scene()
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace("<worldbody>", '<include file="plain.xml"/><worldbody>'))
    with pytest.raises(
        SceneError, match=r"plain\.xml, line 4: file 'plain\.xml' includes itself; remove this <include>"
    ):
        palmfield.load(path)


def test_a_scene_that_is_not_there_names_the_one_that_is(small_scene, tmp_path):
    path = small_scene()
    with pytest.raises(SceneError, match=rf"smal\.xml does not exist \(did you mean '{path}'\?\)"):
        palmfield.load(path.with_name("smal.xml"))
    with pytest.raises(SceneError, match=r"did you mean '/.*mjcf/scenes/palm_am200\.xml'\?"):
        palmfield.load(tmp_path / "palm_am200")
    beside = path.with_name("uhev1.xml")
    beside.touch()
    with pytest.raises(SceneError, match=r"nothere\.xml does not exist; `palmfield new"):  # 6 of 10 letters in common
        palmfield.load(beside.with_name("nothere.xml"))
    with pytest.raises(SceneError, match="is a folder; allowed: the path of an MJCF file"):
        palmfield.load(tmp_path)


def test_an_unknown_command_names_the_one_that_is_near():
    code = "import sys; sys.argv = ['palmfield', 'pln', 'x.xml']\nfrom palmfield.cli.app import main\nmain()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 2 and "Did you mean 'plan'" in done.stderr


def test_the_schema_is_mujocos_own():
    assert {"geom", "site", "joint", "body", "frame", "include"} <= set(children("body"))
    assert {"worldbody", "asset", "sensor", "extension"} <= set(children("mujoco")) and "body" not in children("mujoco")
    assert {"name", "size", "type", "fromto"} <= set(attributes("geom"))


def test_near_is_near():
    assert did_you_mean("focus_mm", ["focus_m", "frame"]) == " (did you mean 'focus_m'?)"
    assert did_you_mean("nose", ["focus_m", "frame"]) == "" == did_you_mean("", ["a"])


SENSORS = '<sensor><user dim="3"/></sensor>'
COPIES = '<worldbody><site name="s"/><replicate count="{}" offset=".1 0 0">{}</replicate></worldbody>'
TINY = '<geom size=".01"/>'


@pytest.mark.parametrize(
    "inside, said",
    [
        ('<asset><model name="m" file="scene.xml"/></asset>', "model 'scene.xml' attaches itself; remove this <model>"),
        ('<asset><model name="m" file="b.xml"/></asset>', r"b\.xml, line 1: model 'scene.xml' attaches itself"),
        ('<compiler assetdir="sub"/><asset><model name="m" file="b.xml"/></asset>', "attaches itself"),
        (COPIES.format(100_000, TINY), "count '100000' makes a total of 100000 copies; allowed: at most 10000"),
        (COPIES.format(200, f'<replicate count="200">{TINY}</replicate>'), "makes a total of 40200 copies"),
        (COPIES.format(2, TINY) + SENSORS, "sensor <user> has no object, and MuJoCo 4.0 doubles .* give it objtype"),
        (COPIES.format(16, TINY) + "<sensor><clock/></sensor>", "sensor <clock> has no object"),
        ('<sensor><user dim="1000000000"/></sensor>', "attribute 'dim' has value '1000000000'; allowed: a total"),
        ('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>', "attribute 'nrow'"),
        ('<worldbody><flexcomp type="grid" count="1000 1000 10" name="f"/></worldbody>', "attribute 'count'"),
        ('<size nuserdata="2000000000"/>', "attribute 'nuserdata'"),
        ('<asset><mesh name="m" file="/dev/zero"/></asset>', "<mesh> file '/dev/zero': it is a device; allowed: a"),
        ('<asset><mesh name="m" file="pipe.stl"/></asset>', "it is a pipe"),
        ('<compiler texturedir="sub"/><asset><texture type="cube" fileup="pipe.png"/></asset>', "it is a pipe"),
        ('<include file="laugh0.xml"/>', "laugh1.*is included twice; include it once"),
        ('<asset><model name="m" file="more0.xml"/></asset><worldbody>'
         + '<attach model="m" prefix="a"/>' * 12 + "</worldbody>", "larger than 1000000 elements"),
    ],
)  # fmt: skip
def test_what_ends_or_fills_mujoco_is_refused_before_it_reads(tmp_path, inside, said):
    """On each of these MuJoCo 4.0 ends by a signal, takes gigabytes, or hours; r: the cases of the same kind."""
    (tmp_path / "sub").mkdir()
    for pipe in (tmp_path / "pipe.stl", tmp_path / "sub" / "pipe.png"):
        os.mkfifo(pipe)
    for folder in (tmp_path, tmp_path / "sub"):
        (folder / "b.xml").write_text('<mujoco><asset><model name="m" file="../scene.xml"/></asset></mujoco>'
                                      if folder.name == "sub" else
                                      '<mujoco><asset><model name="m" file="scene.xml"/></asset></mujoco>')  # fmt: skip
    for n in range(7):
        more = f'<asset><model name="m" file="more{n + 1}.xml"/></asset><worldbody>' + '<attach model="m"/>' * 12
        (tmp_path / f"more{n}.xml").write_text(f"<mujoco>{more if n < 6 else '<worldbody>'}</worldbody></mujoco>")
    for n in range(21):
        again = f'<include file="laugh{n + 1}.xml"/>' * 2 if n < 20 else "<option/>"
        (tmp_path / f"laugh{n}.xml").write_text(f"<mujocoinclude>{again}</mujocoinclude>")
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{inside}</mujoco>")
    with pytest.raises(SceneError, match=said) as refused:
        palmfield.Simulation(path)
    assert "line" in str(refused.value)


def test_what_mujoco_can_copy_is_left_to_it(tmp_path):
    (tmp_path / "part.xml").write_text("<mujoco><worldbody><body name='b'/></worldbody></mujoco>")
    path = tmp_path / "scene.xml"
    path.write_text(
        "<mujoco><asset><model name='m' file='part.xml'/></asset>"
        + COPIES.format(50, TINY)
        + "<worldbody><attach model='m' body='b' prefix='p'/></worldbody>"
        + "<sensor><user dim='3' objtype='site' objname='s'/></sensor></mujoco>"
    )
    assert len(read_scene_text(path).elements) == 11
    assert len(mujoco.MjSpec.from_file(str(path)).sensors) == 1
