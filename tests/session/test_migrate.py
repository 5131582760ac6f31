"""Scenes of the last version, rewritten: old names become new ones, and every other byte stays."""

import difflib
from pathlib import Path

import pytest

import palmfield
from palmfield.config import CONFIGS
from palmfield.errors import OutputError, SceneError
from palmfield.session.migrate import MOVED, migrate, migrated


def aged(path: Path, *changes: tuple[str, str]) -> Path:
    """The scene with texts of the last version in it."""
    text = path.read_text()
    for new, old in changes:
        assert new in text
        text = text.replace(new, old, 1)
    path.write_text(text)
    return path


OLD = (
    ('<config key="board" value="ideal"/>', "<config   value='ideal' key = 'device' /><!-- it > all -- & more -->"),
    ('<config key="side"', '<!-- whole -->\n      <config key="solver" value="full"></config>\n<config key="side"'),
    ('<instance name="array">', '<instance name="array">\n        <config key="compute" value="cpu"/>\n'),
    ('    <text name="palmfield_device" data="cpu"/>\n', ""),
)  # fmt: skip


def test_every_other_byte_stays(small_scene, tmp_path):
    path = aged(small_scene(), *OLD)
    before = path.read_bytes()
    with pytest.raises(SceneError, match=rf"is renamed: use .* \(`palmfield migrate {path}` rewrites it\)"):
        palmfield.load(path)
    result = migrate(path, tmp_path / "new.xml")
    assert path.read_bytes() == before
    after = (tmp_path / "new.xml").read_text()
    lines = [line for line in difflib.ndiff(before.decode().splitlines(), after.splitlines()) if line[0] in "+-"]
    assert [line[0] + line[1:].strip() for line in lines] == [
        '+<text name="palmfield_device" data="cpu"/>',
        '-<config key="compute" value="cpu"/>',
        '-<config key="solver" value="full"></config>',
        '+<config key="solver" value="wedges"></config>',
        "-<plugin plugin=\"palmfield.driver\"><instance name=\"driver\"><config   value='ideal' key = 'device' />"
        "<!-- it > all -- & more --></instance></plugin>",
        "+<plugin plugin=\"palmfield.driver\"><instance name=\"driver\"><config   value='ideal' key = 'board' />"
        "<!-- it > all -- & more --></instance></plugin>",
    ]  # fmt: skip
    assert [change.split(": ", 1)[1] for change in result.changes] == [
        "solver 'full' of 'palmfield.skin' is now 'wedges'",
        "key 'device' of 'palmfield.driver' is now 'board'",
        "key 'compute' is now the scene's text 'palmfield_device'",
    ]
    spec = palmfield.load(tmp_path / "new.xml").runtime.spec
    assert spec.skins[0].config.solver == "wedges" and spec.driver.board == "ideal" and spec.device == "cpu"


def test_a_key_and_its_value_are_renamed_together(small_scene):
    path = aged(small_scene(), ('"am_quantity" value="amplitude"', '"am_of" value="pressure"'))
    with pytest.raises(SceneError, match="key 'am_of' is renamed: use am_quantity with value 'amplitude'"):
        palmfield.load(path)
    (change,) = migrate(path, overwrite=True).changes
    assert "key 'am_of' of 'palmfield.stimulus' is now 'am_quantity', with value 'amplitude' for 'pressure'" in change
    assert palmfield.load(path).runtime.spec.stimuli[0].config.am_quantity == "amplitude"
    path = aged(small_scene(stimulus={"am_quantity": "arp"}), ("am_quantity", "am_of"))
    migrate(path, overwrite=True)
    assert palmfield.load(path).runtime.spec.stimuli[0].config.am_quantity == "arp"


def test_nothing_is_replaced_unless_asked_for(small_scene):
    path = aged(small_scene(), OLD[0])
    before = path.read_bytes()
    with pytest.raises(OutputError, match=r"small\.xml exists and would be replaced \(line 13: key 'device'.*--ov"):
        migrate(path)
    assert path.read_bytes() == before
    assert migrate(path, overwrite=True).changes and path.read_bytes() != before
    again = path.read_bytes()
    assert migrate(path).changes == () and path.read_bytes() == again


@pytest.mark.parametrize("custom", ["<custom/>", "<custom></custom>", ""])
def test_a_text_of_the_scene_finds_a_place(custom, small_scene):
    path = aged(small_scene(), OLD[2])
    text = path.read_text()
    start, end = text.index("<custom>"), text.index("</custom>") + len("</custom>")
    path.write_text(text[:start] + custom + text[end:])
    migrate(path, overwrite=True)
    assert path.read_text().count("palmfield_device") == 1
    assert palmfield.load(path).runtime.spec.device == "cpu"


def test_a_text_that_is_there_is_kept_and_said(small_scene):
    (change,) = migrated(aged(small_scene(device="auto"), OLD[2])).changes
    assert "is now the scene's text 'palmfield_device', which line 7 already sets to 'auto'" in change


def test_two_keys_that_become_one_must_agree(small_scene, add_array):
    path = add_array(aged(small_scene(), OLD[2]), keys='<config key="compute" value="cuda:0"/>')
    with pytest.raises(SceneError, match="but is now one text 'palmfield_device' of the whole scene; make"):
        migrated(path)


def test_files_that_are_included_are_named(small_scene):
    path = small_scene()
    text = path.read_text()
    start, end = text.index("<extension>"), text.index("</extension>") + len("</extension>")
    plugins = path.with_name("plugins.xml")
    plugins.write_text(f"<mujoco>{text[start:end]}</mujoco>".replace('key="board"', 'key="device"'))
    path.write_text(text[:start] + '<include file="plugins.xml"/>' + text[end:])
    assert migrated(path)[1:] == ((), (plugins,))
    migrate(plugins, overwrite=True)
    assert palmfield.load(path).runtime.spec.driver.board == "ideal"


def test_all_that_is_renamed_can_be_rewritten():
    for config in CONFIGS:
        for name, use in config.renamed.items():
            key, _, value = name.partition("=")
            assert value or use in config.model_fields or (config.plugin, key) in MOVED


def test_what_is_no_scene_of_text(tmp_path):
    with pytest.raises(SceneError, match="does not exist"):
        migrated(tmp_path / "none.xml")
    (tmp_path / "wide.xml").write_bytes("<mujoco/>".encode("utf-16"))
    with pytest.raises(SceneError, match="is not in UTF-8; save it in UTF-8"):
        migrated(tmp_path / "wide.xml")
