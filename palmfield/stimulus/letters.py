"""A single-stroke font for capitals and digits, on a grid of 4 by 6."""

import numpy as np

from palmfield.errors import SceneError
from palmfield.types import Float

GRID_HEIGHT = 6.0
ADVANCE = 6.0
"""Grid units from the left edge of a letter to that of the next; letters are at most 4 wide."""

# Strokes are separated by blanks; each point of a stroke is two digits, x (0 to 4) and y (0 to 6).
GLYPHS = {
    "A": "002640 1333",
    "B": "00063645443303 3342413000",
    "C": "4536160501103041",
    "D": "0006264442412000",
    "E": "46060040 0333",
    "F": "460600 0333",
    "G": "453616050110304143 4323",
    "H": "0006 0343 4640",
    "I": "2620",
    "J": "4641301001",
    "K": "0006 4603 0340",
    "L": "060040",
    "M": "0006234640",
    "N": "00064046",
    "O": "301001051636454130",
    "P": "00063645443303",
    "Q": "301001051636454130 2240",
    "R": "00063645443303 2340",
    "S": "453616050413334241301001",
    "T": "0646 2620",
    "U": "060110304146",
    "V": "062046",
    "W": "0610233046",
    "X": "0640 4600",
    "Y": "0623 4623 2320",
    "Z": "06460040",
    "0": "301001051636454130 1234",
    "1": "152620",
    "2": "0516364544010040",
    "3": "0516364544334241301001 1333",
    "4": "30360242",
    "5": "46060334424130100001",
    "6": "453616050110304142331302",
    "7": "064610",
    "8": "130405163645443313 3342413010010213",
    "9": "011030414536160504133344",
}


def strokes(text: str) -> list[Float]:
    """Return the strokes of a text in writing order, each of shape (n, 2), in units of the height of the letters.

    Small letters are written as capitals. The text begins at x = 0 with its baseline at y = 0.
    Raises SceneError for a text without letters, and for characters other than A-Z, 0-9 and the blank.
    """
    polylines: list[Float] = []
    for place, letter in enumerate(text.upper()):
        if letter == " ":
            continue
        if letter not in GLYPHS:
            raise SceneError(f"letters: {letter!r} in {text!r} is not supported; use A-Z, 0-9 and spaces")
        for stroke in GLYPHS[letter].split():
            grid = np.array([int(digit) for digit in stroke], dtype=np.float64).reshape(-1, 2)
            polylines.append((grid + np.array([ADVANCE * place, 0.0])) / GRID_HEIGHT)
    if not polylines:
        raise SceneError(f"letters: {text!r} has no letters or digits; give at least one of A-Z and 0-9")
    return polylines
