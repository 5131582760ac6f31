"""The keys' table, its page, and the configuration that it is made from."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from palmfield.cli.keys import as_markdown, as_text
from palmfield.config import CONFIGS, SkinConfig, StimulusConfig, parse, table, unit
from palmfield.errors import SceneError

PAGE = Path(__file__).parent.parent / "docs" / "keys.md"


def test_page_is_up_to_date():
    assert PAGE.read_text() == as_markdown(), "run: palmfield keys --markdown > docs/keys.md"


def test_every_key_has_a_meaning_and_every_quantity_a_unit():
    for config in CONFIGS:
        for key, key_unit, allowed, _, meaning in table(config):
            assert meaning and allowed
            pure = {"am_depth", "drive_amplitude", "path_points", "accuracy", "quality"}
            assert bool(key_unit) == ("number" in allowed and key not in pure) or "whole" in allowed, key


def test_unknown_plugin_names_those_there_are():
    with pytest.raises(SceneError, match=r"palmfield\.skin"):
        as_text("palmfield.nose")


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
        assert parse(SkinConfig, {"base": text, "patch_site": "x"}, "e").base in ("bonded", "free_slip")
    except SceneError as error:
        assert "bonded | free_slip" in str(error)


def test_units_come_from_the_names():
    assert [unit(k) for k in ("p0_Pa_m", "foundation_normal_Pa_m", "arp_peak_Pa", "radius_m", "step_s")] == [
        "Pa m", "Pa/m", "Pa", "m", "s",
    ]  # fmt: skip
