"""The files of standard stimuli: each plays, is told in the documents, and says what its source says."""

import math
from pathlib import Path

import pytest

from palmfield.errors import SceneError
from palmfield.stimulus.schedule import main_frequencies
from palmfield.stimulus.standard import names, read_stimulus, standard

DOCS = Path(__file__).resolve().parents[2] / "docs" / "stimuli.md"


@pytest.mark.parametrize("name", names())
def test_each_plays_and_is_told(name):
    found = standard(name)
    assert found.config.path in ("point", "circle", "lm")
    assert found.source and found.published and found.read in ("whole text", "abstract")
    assert f"| `{name}` | {found.about} |" in DOCS.read_text()
    # It stands in a comment of a scene
    assert "--" not in found.about + found.source + found.published + found.assumed
    longest = 1.0 / min(main_frequencies(found.config) or [1.0 / found.duration_s])
    assert found.duration_s >= min(longest, 2.0)


def test_numbers_that_sources_print():
    """Held against the texts and abstracts: speeds, rates and lengths, computed from keys."""
    circle = standard("chilles_circle").config
    assert math.pi * circle.path_diameter_m * circle.path_rate_Hz == pytest.approx(4.40, abs=0.01)
    steps = standard("lm_small_steps").config
    assert 5.0 <= steps.path_rate_Hz <= 15.0 and steps.path_step_m < 1e-3
    foci = standard("gap_pair").config.foci_m
    assert 1e3 * (foci[3] - foci[0]) == pytest.approx(32.3)
    assert standard("freeman_circle").config.path_rate_Hz == 17
    sine = standard("hasegawa_sine_200").config
    assert (sine.am_burst_length_s, sine.am_frequency_Hz, sine.am_quantity) == (1.0, 200.0, "arp")


def test_keys_for_an_instance_and_as_text():
    pair = standard("gap_pair")
    assert pair.keys_for("left")["left.am_frequency_Hz"] == 200
    assert pair.texts()["foci_m"] == "-0.01615 0 0 0.01615 0 0"


def test_an_unknown_name_and_bad_files(tmp_path):
    with pytest.raises(SceneError, match=r"stimulus 'gap_pairs'.*gap_pair, "):
        standard("gap_pairs")
    good = 'about = "a"\nsource = "s"\npublished = "p"\nread = "abstract"\nduration_s = 1\n[keys]\n'
    for text, told in (
        ("about = 3 4", "give about, source"),
        (good.replace('published = "p"\n', ""), "published: Field required"),
        (good.replace("abstract", "half"), "whole text"),
        (good + "path = 'spiral'\n", "spiral|Input should be"),
        (good + "path = 'circle'\n", "path_diameter_m"),
    ):
        path = tmp_path / "own.toml"
        path.write_text(text)
        with pytest.raises(SceneError, match=told):
            read_stimulus(path)
