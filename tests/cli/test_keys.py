"""The keys' table, its page, and the configuration that it is made from."""

from pathlib import Path
from typing import ClassVar, Literal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.cli.keys import SCENE_KEYS, as_markdown, as_text
from palmfield.config import (
    CONFIGS,
    Config,
    SkinConfig,
    StimulusConfig,
    allowed,
    known_keys,
    parse,
    renamed_table,
    table,
    unit,
)
from palmfield.errors import SceneError

PAGE = Path(__file__).parents[2] / "docs" / "keys.md"


def test_page_is_up_to_date():
    assert PAGE.read_text() == as_markdown(), "run: palmfield keys --markdown > docs/keys.md"


def test_keys_of_the_whole_scene_are_those_that_are_read():
    from palmfield.simulation.scene_reader import DEFAULT_DURATION_S, DEVICE, DURATION

    assert {row[0]: row[3] for row in SCENE_KEYS} == {DURATION: f"{DEFAULT_DURATION_S:g}", DEVICE: "auto"}
    assert all(row[0] in as_text() for row in SCENE_KEYS) and DEVICE not in as_text("palmfield.skin")


def test_renamed_keys_are_told_on_the_page():
    page = as_markdown()
    assert "| `palmfield.driver device` | board |" in page and "| `palmfield.skin solver full` | wedges |" in page
    assert "solver full" in as_text("palmfield.skin") and "Renamed" not in as_text("palmfield.motion")


def test_every_key_has_a_meaning_and_every_quantity_a_unit():
    for config in CONFIGS:
        for key, key_unit, takes, _, meaning in table(config):
            assert meaning and takes
            shares = {"am_depth", "am_waveform_duty", "drive_amplitude"}
            pure = {
                *shares,
                "foci_arp",
                "arp_alpha",
                "duty_exponent",
                "duty_limit",
                "path_points",
                "accuracy",
                "quality",
            }
            pure.add("force_accuracy")
            assert bool(key_unit) == ("number" in takes and key not in pure) or "whole" in takes, key


def test_unknown_plugin_names_those_there_are():
    with pytest.raises(SceneError, match=r"there is no plugin .palmfield\.nose.; allowed: array, stimulus"):
        as_text("palmfield.nose")
    with pytest.raises(SceneError, match=r"there is no plugin 'skn' \(did you mean 'skin'\?\); allowed: "):
        as_text("skn")


def test_a_plugin_goes_by_its_short_name_too():
    assert as_text("skin") == as_text("palmfield.skin") != as_text("stimulus")


@given(value=st.floats())
def test_a_number_is_taken_or_refused_with_its_key(value):
    try:
        config = parse(StimulusConfig, {"arp_peak_Pa": repr(value)}, "element")
        assert config.arp_peak_Pa == value and 0 < value < float("inf")
    except SceneError as error:
        assert "element" in str(error) and "arp_peak_Pa" in str(error) and repr(value) in str(error)
        assert not 0 < value < float("inf")


@given(text=st.text(max_size=20))
def test_any_text_for_a_choice_is_taken_or_refused_in_one_line(text):
    try:
        assert parse(SkinConfig, {"base": text, "patch_site": "x"}, "e").base == text in ("bonded", "free_slip", "free")
    except SceneError as error:
        assert ("base_normal_Pa_m" if text == "springs" else "bonded | free_slip") in str(error)


def test_units_come_from_the_names():
    assert [unit(k) for k in ("p0_Pa_m", "foundation_normal_Pa_m", "arp_peak_Pa", "radius_m", "step_s")] == [
        "Pa m", "Pa/m", "Pa", "m", "s",
    ]  # fmt: skip


class Nose(Config):
    plugin: ClassVar[str] = "palmfield.nose"
    about: ClassVar[str] = "A plugin with a past."
    renamed: ClassVar[dict[str, str]] = {
        "smell": "odour", "solver=full": "wedges", "compute": "the scene's palmfield_device text",
    }  # fmt: skip

    odour: str = "rose"
    solver: Literal["auto", "wedges"] = "auto"


def test_renamed_keys_stay_known_and_are_refused_with_what_to_use():
    assert known_keys(Nose) == ["odour", "solver", "smell", "compute"]
    with pytest.raises(SceneError, match=r"^plugin 'nose': key 'smell' is renamed: use odour$"):
        parse(Nose, {"smell": "rose"}, "plugin 'nose'")
    with pytest.raises(SceneError, match="key 'compute' is renamed: use the scene's palmfield_device text"):
        parse(Nose, {"compute": "cpu", "odour": "oak"}, "e")


def test_renamed_values_are_refused_with_what_to_use():
    with pytest.raises(SceneError, match="key 'solver' has value 'full', which is renamed: use wedges"):
        parse(Nose, {"solver": "full"}, "e")
    with pytest.raises(SceneError, match=r"key 'solver' has value 'quick'; allowed: auto \| wedges"):
        parse(Nose, {"solver": "quick"}, "e")
    assert parse(Nose, {"solver": "wedges"}, "e").solver == "wedges"
    assert renamed_table(Nose)[1] == ("solver full", "wedges")


@pytest.mark.parametrize("name", ["axisymmetric", "lateral_waves"])
def test_a_solver_of_whole_histories_is_refused_with_the_call_that_does_it(name):
    with pytest.raises(SceneError) as refusal:
        parse(SkinConfig, {"solver": name, "patch_site": "x"}, "e")
    assert str(refusal.value).startswith(f"e: key 'solver' has value '{name}', which needs the whole load history")
    assert f"palmfield.skin.solve(..., solver='{name}')" in str(refusal.value)


def test_what_is_renamed_is_gone_and_what_to_use_is_there():
    for config in CONFIGS:
        for name, use in config.renamed.items():
            key, _, value = name.partition("=")
            assert (key in config.model_fields) == bool(value), name
            assert not value or use in allowed(config, key).split(" | "), name


def test_a_stimulus_names_its_arrays_and_its_skin():
    keys = {"arrays": "left right", "path": "line", "path_width_m": "0.01", "path_rate_Hz": "1", "path_on": "skin"}
    config = parse(StimulusConfig, keys | {"on_skin": "palm"}, "e")
    assert (config.arrays, config.on_skin) == (("left", "right"), "palm")
    with pytest.raises(SceneError, match="arrays are 'left left': name each once"):
        parse(StimulusConfig, {"arrays": "left left"}, "e")
    with pytest.raises(SceneError, match="on_skin applies to a path on the skin, but path_on is 'plane'"):
        parse(StimulusConfig, keys | {"on_skin": "palm", "path_on": "plane"}, "e")
