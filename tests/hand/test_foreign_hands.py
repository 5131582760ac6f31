"""Ten meshes that imitate other people's habits, and three things that are no hands: what their cards say."""

import foreign_hands
import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.hand.reportcard import report_card

UNITS = {"quads.obj": "cm", "decimetres.ply": "dm", "z_up.stl": "in"}
MENDED = {
    "webxr.glb": "sibling joints",
    "openxr.glb": "sibling joints",
    "unnamed.glb": "sibling joints",
    "quads.obj": "open wrist",
    "z_up.stl": "split vertices",
    "inner_shell.obj": "inner shells",
    "forearm.ply": "open wrist",
    "crossed.ply": "layers that fold",
}
DOUBTS = {"unnamed.glb": "sibling joints", "mirrored.glb": "named for a right hand, but its shape is that of a left"}


@pytest.mark.parametrize("foreign", foreign_hands.HANDS, ids=lambda foreign: foreign.file)
def test_a_hand_of_other_people(foreign, tmp_path):
    path = tmp_path / foreign.file
    foreign.make(path)
    facts = report_card(path).facts
    assert facts["verdict"] == foreign.verdict
    default = "m" if path.suffix == ".glb" else "mm"
    assert facts["unit"] == UNITS.get(foreign.file, default)
    left = foreign.file in ("decimetres.ply", "mirrored.glb")
    assert facts["side"] == ("left" if left else "right") and facts["side_sureness"] > 0.9
    found = {finding["name"] for finding in facts["findings"]}
    if foreign.file in MENDED:
        assert MENDED[foreign.file] in found
    doubts = DOUBTS.get(foreign.file)
    assert any(doubts in doubt for doubt in facts["doubts"]) if doubts else foreign.verdict != "accepted with doubts"
    longest = max(facts["size_mm"])
    assert (
        (400.0 if foreign.file == "forearm.ply" else 180.0) < longest < (450.0 if "forearm" in foreign.file else 210.0)
    )


def test_a_hand_that_folds_says_how_to_mend_it(tmp_path):
    path = tmp_path / "crossed.ply"
    foreign_hands.crossed(path)
    card = report_card(path)
    assert "separate fingers that intersect or touch" in card.refusal and "folds at (" in card.refusal
    assert card.facts["self_intersections"] > 100


FEWER_TIPS = {"bottle.ply": 1, "ring.ply": 1, "fork.ply": 4}


@pytest.mark.parametrize("thing", foreign_hands.NO_HANDS, ids=lambda thing: thing.file)
def test_what_is_no_hand_gets_no_unit_and_is_doubted(thing, tmp_path):
    path = tmp_path / thing.file
    thing.make(path)
    tips = FEWER_TIPS[thing.file]
    with pytest.raises(
        SceneError, match=rf"{tips} fingertips were found instead of 5, .*not guessed; give the unit, one of m"
    ):
        report_card(path)
    card = report_card(path, "mm")
    assert card.facts["verdict"] == "accepted with doubts" and card.facts["side"] == "unknown"
    assert f"fingertips: {tips}, not 5" in card.doubts
    assert any("surface has 1" in doubt for doubt in card.doubts) == (thing.file == "ring.ply")


def test_quads_stay_the_triangles_that_they_were_made_of():
    vertices, faces = foreign_hands.plain_hand()
    polygons = foreign_hands.as_quads(vertices, faces)
    quads = [polygon for polygon in polygons if len(polygon) == 4]
    assert len(quads) > 0.4 * len(faces)
    fans = [polygon[:3] for polygon in polygons] + [[a, c, d] for a, _, c, d in quads]
    np.testing.assert_array_equal(*(np.unique(np.sort(f, axis=1), axis=0) for f in (fans, faces)))
