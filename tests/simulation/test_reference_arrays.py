"""Every shipped scene, on a small layer, does what it did before the redesign of the core."""

import pytest
from check_scene_reference import allowed, differences, scenes

pytestmark = pytest.mark.usefixtures("kept_operators")


@pytest.mark.parametrize("name", scenes("small"))
def test_a_scene_does_what_it_did(name):
    found = dict(differences("small", name))
    assert len(found) >= 12
    assert {what: value for what, value in found.items() if not value <= allowed("small", name, what)} == {}


def test_there_are_arrays_of_every_scene():
    assert len(scenes("small")) == 15
    assert scenes("small") == scenes("shipped")
