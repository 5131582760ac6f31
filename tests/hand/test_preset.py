import pytest

from palmfield.errors import SceneError
from palmfield.hand.preset import DIGITS, load_preset, preset_names

GOOD = "open_men_p50"


def write(tmp_path, old, new):
    from palmfield.data import folder

    text = (folder("hand_models") / f"{GOOD}.toml").read_text()
    assert old in text
    path = tmp_path / "own.toml"
    path.write_text(text.replace(old, new, 1))
    return path


def test_shipped_presets_hold_the_ansur_means():
    men, women = load_preset("open_men_p50"), load_preset("open_women_p50")
    assert (men.length_m, men.breadth_m) == (0.1933, 0.0883)
    assert (women.length_m, women.breadth_m) == (0.1811, 0.0782)
    assert set(preset_names()) >= {"open_men_p50", "open_women_p50"}
    assert tuple(men.digits) == DIGITS


def test_unknown_name_lists_the_presets():
    with pytest.raises(SceneError, match=r"'closed_fist' is unknown.*open_men_p50, .*open_women_p50"):
        load_preset("closed_fist")


def test_own_file(tmp_path):
    assert load_preset(write(tmp_path, "length_m = 0.1933", "length_m = 0.2")).length_m == 0.2


@pytest.mark.parametrize(
    "old, new, says",
    [
        ("length_m = 0.1933", "length_m = -0.1", "length_m.*greater than 0.*-0.1"),
        ("breadth_m = 0.0883", "breath_m = 0.0883", "breadth_m.*required"),
        ("flexion_deg = [6.0, 4.0]", "flexion_deg = [6.0]", "3 bones need 2 flexion angles"),
        ("[digits.index]", "[digits.pointer]", "digits must be thumb, index"),
        ("name =", "name", "cannot be read as TOML"),
    ],
)
def test_bad_file_is_one_line(tmp_path, old, new, says):
    with pytest.raises(SceneError, match=says) as caught:
        load_preset(write(tmp_path, old, new))
    assert "\n" not in str(caught.value)


def test_missing_file(tmp_path):
    with pytest.raises(SceneError, match="does not exist"):
        load_preset(tmp_path / "none.toml")
