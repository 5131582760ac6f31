"""MJCF files held against what writes them."""

import re

import numpy as np

SKIN = re.compile(r"<deformable>.*</deformable>", re.DOTALL)
PLACE_m = 2e-5
"""A marching-cubes mesh in float32 differs among processors in its last digits, and the file is rounded to 10 um."""


def assert_same_file(file: str, written: str) -> None:
    """The same text, but for the skin's places, which may differ by their rounding."""
    skins = [SKIN.search(text) for text in (file, written)]
    assert skins[0] and skins[1] and SKIN.sub("", file) == SKIN.sub("", written)
    mine, other = (skin.group() for skin in skins)
    for name in ("face", "vertid"):
        assert re.findall(f' {name}="([^"]*)"', mine) == re.findall(f' {name}="([^"]*)"', other)
    for name, apart in (("vertex", PLACE_m), ("vertweight", 2e-3)):
        numbers = [np.array(" ".join(re.findall(f' {name}="([^"]*)"', skin)).split(), float) for skin in (mine, other)]
        assert numbers[0].shape == numbers[1].shape and np.abs(numbers[0] - numbers[1]).max() < apart
