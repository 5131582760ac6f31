"""Skin that the sound can't come to is warned of before the run, over the whole motion, with the share that is lit."""

import re
import time
from pathlib import Path

import numpy as np
import pytest
from refusals import changed

import palmfield
from palmfield.outputs.summary_table import format_summary
from palmfield.planning.scene_plan import warnings
from palmfield.planning.visibility import KINDS, MOMENTS, hidden_patches
from palmfield.session.preview import preview

pytestmark = pytest.mark.usefixtures("kept_operators")

SCENES = Path(__file__).parents[2] / "mjcf" / "scenes"
FACING = 'quat="0 1 0 0"'
TOLD = re.compile("faces away|edge-on|is hidden|too far")


def turned(path: Path, angle_deg: float) -> Path:
    """The scene with its pad turned about x, from looking down at the array."""
    half = np.deg2rad(180.0 - angle_deg) / 2.0
    plain = path.with_name("plain.xml")
    plain.write_text(plain.read_text().replace(FACING, f'quat="{np.cos(half)} {np.sin(half)} 0 0"'))
    return path


def told(path: Path, **keys: object) -> list[str]:
    return [text for text in warnings(palmfield.load(path, keys=keys)) if TOLD.search(text)]


def lit(text: str) -> float:
    return float(re.search(r"([\d.]+) % of the patch of the skin is lit", text)[1])


@pytest.mark.parametrize(
    ("angle_deg", "words"), [(180.0, "faces away"), (90.0, None), (80.0, "is edge-on"), (40.0, None)]
)
def test_a_patch_at_an_angle(angle_deg, words, small_scene):
    found = told(turned(small_scene(), angle_deg))
    if angle_deg == 90.0:
        # Half of the array is behind the skin, and cosines cancel: either name is true
        assert len(found) == 1 and ("edge-on" in found[0] or "faces away" in found[0])
        assert lit(found[0]) == pytest.approx(50.0, abs=10.0)
    elif words is None:
        assert not found
    else:
        (text,) = found
        assert f"skin 'skin' {words}" in text and "stimulus 'stimulus'" in text and "moments" not in text
        assert lit(text) == 0.0 if words == "faces away" else lit(text) > 50.0


def test_the_summary_of_a_run_in_the_dark_is_no_silence(small_scene):
    result = palmfield.run(turned(small_scene(), 180.0), duration_s=0.003)
    assert result.summary["peak_arp_Pa"] == 0.0
    level = result.summary["stimuli"][0]["drive_level"]
    assert 0.9 < level <= 1.0
    text = " ".join(format_summary(result.summary).split())
    assert "silence" not in text and "although the array is on" in text and f"at {level:.3f} of full" in text


def test_what_stands_between_hides(small_scene, add_skin):
    """A disc of 20 mm radius, 40 mm before the focus: which ways it cuts is plane geometry."""
    path = add_skin(small_scene(), "0 0 0.08")
    (text,) = [text for text in told(path) if "skin 'skin'" in text]
    assert text.startswith("the focus of stimulus 'stimulus' on skin 'skin' is hidden from the array by a body or an")
    assert text.endswith("body_sound 'none' ignores this: set it to shadows")
    shadowed = told(path, **{"palmfield.skin.body_sound": "shadows"})
    assert not any("ignores this" in text for text in shadowed) and len(shadowed) == len(told(path))
    array = palmfield.load(path).runtime.model.arrays.array.positions
    focus = np.array([0.0, 0.0, 0.12])
    crossing = focus + (array - focus) * ((0.12 - 0.08) / (focus[2] - array[:, 2]))[:, None]
    back = focus + (array - focus) * ((0.12 - 0.088) / (focus[2] - array[:, 2]))[:, None]
    passes = (np.hypot(*crossing.T[:2]) > 0.02) & (np.hypot(*back.T[:2]) > 0.02)
    assert lit(text) == pytest.approx(100.0 * passes.mean(), abs=5.0)
    assert not [text for text in told(add_skin(small_scene(), "0.06 0 0.08")) if "skin 'skin'" in text]


def test_a_whole_motion_is_looked_at():
    """Another hand comes between the first and its array for a while."""
    view = preview(SCENES / "two_hands.xml", accuracy=0.5)
    (text,) = hidden_patches(view)
    so, of, first_s = re.search(r"is hidden .* at (\d+) of (\d+) moments, first at ([\d.]+) s", text).groups()
    assert int(of) == MOMENTS + 1 and 3 <= int(so) <= 12
    assert 0.0 < float(first_s) < view.duration_s and lit(text) < 50.0


def test_a_hand_that_leaves_is_out_of_reach():
    view = preview(SCENES / "approach_withdraw.xml", accuracy=0.5)
    (text,) = hidden_patches(view)
    assert re.search(r"the focus of stimulus 'stimulus' is too far from skin 'skin' at \d+ of 33 moments", text)


@pytest.mark.parametrize("name", ["palm_am200", "phantom_stm70", "hover_explore"])
def test_what_is_in_sight_is_not_told_of(name):
    assert hidden_patches(preview(SCENES / f"{name}.xml", accuracy=0.5)) == []


@pytest.mark.parametrize(
    "keys",
    [{"start_s": 0.005}, {"stop_s": 0.001}, {"burst_window": "hann", "burst_length_s": 0.01, "burst_period_s": 0.02}],
)
def test_it_matters_not_when_a_stimulus_sounds(keys, small_scene):
    (text,) = told(turned(small_scene(stimulus=keys), 180.0))
    assert "faces away" in text and lit(text) == 0.0


def test_silent_stimuli_are_not_looked_for(small_scene):
    assert told(turned(small_scene(stimulus={"drive_amplitude": 0}), 180.0)) == []


def test_looking_costs_less_than_opening(small_scene):
    start = time.perf_counter()
    view = preview(SCENES / "hover_explore.xml", accuracy=0.3)
    palmfield.plan(SCENES / "hover_explore.xml", accuracy=0.3)
    opened = time.perf_counter()
    assert hidden_patches(view) == []
    assert time.perf_counter() - opened < opened - start


def test_every_kind_has_its_words():
    assert all("{skin}" in words and "{stimulus}" in words for words in KINDS.values())


SLAB = '<body name="slab" pos="{} 0 0.06"><geom type="box" size="0.1 0.1 0.002"{}/></body></worldbody>'


@pytest.mark.parametrize(
    ("x", "more", "keys", "told"),
    [
        (0.0, "", {}, "a geom of body 'slab' blocks 100 % of the lines from the array to skin 'skin'"),
        (
            0.1,
            "",
            {},
            "% of the lines from the array to skin 'skin', but the sound passes through it: list the body in key",
        ),
        (0.0, ' rgba="1 1 1 0"', {}, None),
        (0.3, "", {}, None),
        (0.0, "", {"skin.body_sound": "shadows", "skin.obstacles": "slab"}, None),
    ],
    ids=["before it", "half before it", "invisible", "aside", "named"],
)
def test_what_no_skin_names_is_told_where_sound_goes_through_it(x, more, keys, told, small_scene):
    path = small_scene()
    changed(path.parent / "plain.xml", "</worldbody>", SLAB.format(x, more))
    said = [text for text in warnings(palmfield.load(path, keys=keys)) if "blocks" in text]
    assert said == [] if told is None else len(said) == 1 and told in said[0]
    if x == 0.1:
        assert 30.0 < float(said[0].split(" blocks ")[1].split(" %")[0]) < 70.0
