"""Unit of a mesh file: given by the user or the format, or inferred from the size of a hand."""

from typing import NamedTuple

from palmfield.errors import SceneError

METRES = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
DIGITS = 5
LEAST_EXTENT_m, GREATEST_EXTENT_m = 0.02, 0.6
# Lengths of a hand, from a child's to a large one with its wrist, and of a forearm with hand, from elbow to fingertip.
HAND_m, FOREARM_m = (0.13, 0.26), (0.36, 0.56)
# Breadth over length: at least 0.3 for a hand, at most 0.4 for a forearm with its hand.
LEAST_HAND_BREADTH, GREATEST_FOREARM_BREADTH = 0.3, 0.4


class Unit(NamedTuple):
    """A unit of length. name: key of METRES; metres: its length [m]; source: reason of the choice, for the report."""

    name: str
    metres: float
    source: str


def choose_unit(
    requested: str, by_format: str | None, length: float, breadth: float, what: str, tips: int = DIGITS
) -> Unit:
    """Choose the unit of a file.

    requested: a key of METRES, or "auto"; by_format: unit defined by the file format, or None
    length, breadth: longest and middle extent, in the unit of the file; what: name of the file, for messages
    tips: number of detected digit tips
    With "auto", the unit of the format is used. If the format has none and the mesh has five fingertips, the result is
    the only unit in which the mesh has the size of a hand (0.13 to 0.26 m long, broader than 0.3 of the length) or of a
    forearm with its hand (0.36 to 0.56 m long, narrower than 0.4).
    Raises SceneError for an unknown unit, if none or several units fit, if there are not five tips, and for a size
    outside 20 to 600 mm.
    """
    if requested != "auto" and requested not in METRES:
        raise SceneError(f"{what}: unit {requested!r} is unknown; use one of {', '.join(METRES)} or auto")
    if requested != "auto":
        unit = Unit(requested, METRES[requested], "given by the user")
    elif by_format is not None:
        unit = Unit(by_format, METRES[by_format], "set by the file format")
    else:
        if tips != DIGITS:
            raise SceneError(
                f"{what} has no unit, and {tips} fingertips were found instead of {DIGITS}, so it may not be a "
                f"hand and the unit is not guessed; give the unit, one of {', '.join(METRES)}"
            )
        unit = _inferred(length, breadth, what)
    size = length * unit.metres
    if not LEAST_EXTENT_m <= size <= GREATEST_EXTENT_m:
        others = [
            f"{length * metres * 1e3:.4g} mm in unit {name}"
            for name, metres in METRES.items()
            if LEAST_EXTENT_m <= length * metres <= GREATEST_EXTENT_m
        ]
        advice = f"it would be {' or '.join(others)}" if others else "no unit gives the size of a hand; scale the mesh"
        raise SceneError(f"{what} is {size * 1e3:.4g} mm long in unit {unit.name}; allowed: 20 to 600 mm; {advice}")
    return unit


def size_of_a_hand(length_m: float, breadth_m: float) -> bool:
    """Return whether a mesh has the size of a hand or of a forearm with its hand, see `choose_unit`."""
    return bool(_parts(length_m, breadth_m / length_m))


def _parts(size_m: float, slender: float) -> list[str]:
    hand = HAND_m[0] <= size_m <= HAND_m[1] and slender >= LEAST_HAND_BREADTH
    forearm = FOREARM_m[0] <= size_m <= FOREARM_m[1] and slender <= GREATEST_FOREARM_BREADTH
    return ["hand"] * hand + ["forearm with hand"] * forearm


def _inferred(length: float, breadth: float, what: str) -> Unit:
    candidates = [
        (name, metres, part) for name, metres in METRES.items() for part in _parts(length * metres, breadth / length)
    ]
    if len(candidates) == 1:
        name, metres, part = candidates[0]
        return Unit(name, metres, f"inferred: a {part} of {length * metres * 1e3:.4g} mm")
    choices = ", ".join(f"{length * metres * 1e3:.4g} mm with {name}" for name, metres in METRES.items())
    number = "no unit gives" if not candidates else f"{' and '.join(f[0] for f in candidates)} both give"
    raise SceneError(f"{what} has no unit, and {number} the size of a hand or forearm: {choices}; give the unit")
