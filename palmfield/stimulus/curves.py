"""Paths in a plane, by arc length: line, circle, zigzag, square, Z, Lissajous, letters, polyline. Lengths in metres."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from palmfield.errors import SceneError
from palmfield.types import Float

MOST_TURNS = 1000
CIRCLE_POINTS = 256
"""Number of corners of a circle; a polygon of n sides is shorter than its circle by pi^2 / (6 n^2): 2.5e-5 here."""
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


@dataclass(frozen=True)
class PlanePath:
    """A polyline in a plane.

    points: corners [m], shape (n, 2), float64; a closed path continues from the last to the first
    closed: whether the path returns to its start; an open path is traversed there and back
    lifted: True for segments that are pen lifts, which draw nothing, shape (n - 1,); None without lifts
    """

    points: Float
    closed: bool
    lifted: NDArray[np.bool_] | None = None

    @cached_property
    def corners(self) -> Float:
        """All corners in order [m], with the first one again at the end of a closed path, shape (n or n + 1, 2)."""
        return np.vstack([self.points, self.points[:1]]) if self.closed else self.points

    @cached_property
    def corner_arcs(self) -> Float:
        """Arc length from the start to each of `corners` [m]."""
        steps = np.linalg.norm(np.diff(self.corners, axis=0), axis=1)
        return np.concatenate([[0.0], np.cumsum(steps)])

    @cached_property
    def slopes(self) -> Float:
        """Unit direction of each segment, shape (n - 1, 2) or (n, 2); zeros for a segment without length."""
        steps = np.diff(self.corner_arcs)
        return np.asarray(np.diff(self.corners, axis=0) / np.where(steps > 0.0, steps, 1.0)[:, None])

    @cached_property
    def length_m(self) -> float:
        """Length of one turn, or of one way of an open path, pen lifts included."""
        return float(self.corner_arcs[-1])

    def at(self, arc_m: ArrayLike) -> Float:
        """Return points [m], shape (k, 2), at arc lengths from the start [m], shape (k,), of any size and sign.

        A closed path repeats; an open path is traversed there and back, at(2 L - s) = at(s).
        """
        arc = folded(arc_m, self.length_m, self.closed)
        segment = np.minimum(self.corner_arcs.searchsorted(arc, "right") - 1, len(self.slopes) - 1)
        points: Float = self.corners[segment] + (arc - self.corner_arcs[segment])[:, None] * self.slopes[segment]
        return points

    def pen_down(self, arc_m: ArrayLike) -> NDArray[np.bool_]:
        """Return whether the path draws at arc lengths [m], shape (k,); False on the straight moves between strokes.

        Lifts have an arc length like strokes. To make them fast, increase the speed during a lift, with the sound off.
        """
        arc = folded(arc_m, self.length_m, self.closed)
        if self.lifted is None:
            return np.ones(len(arc), dtype=np.bool_)
        segment = self.corner_arcs.searchsorted(arc, "right") - 1
        return ~self.lifted[np.minimum(segment, len(self.lifted) - 1)]


def folded(arc_m: ArrayLike, length_m: float, closed: bool) -> Float:
    """Map arc lengths, shape (k,), into 0..length_m, periodically if closed, else there and back."""
    arc = np.asarray(arc_m, dtype=np.float64).reshape(-1)
    if closed:
        return np.mod(arc, length_m)
    there_and_back = np.mod(arc, 2.0 * length_m)
    return np.minimum(there_and_back, 2.0 * length_m - there_and_back)


def line(length_m: float, direction_deg: float = 0.0) -> PlanePath:
    """Return a straight line in a direction from x towards y, from its rear end. Raises SceneError for a bad length."""
    half = 0.5 * _size("line", length_m=length_m)[0]
    if not math.isfinite(direction_deg):
        raise SceneError(f"line: direction_deg = {direction_deg} is not a direction; give degrees")
    along = np.array([math.cos(math.radians(direction_deg)), math.sin(math.radians(direction_deg))])
    return PlanePath(half * np.array([-along, along]), closed=False)


def circle(diameter_m: float) -> PlanePath:
    """Return a circle, counter-clockwise from its +x point; the relative error of its length is below 1e-4.

    Raises SceneError for a bad diameter.
    """
    (diameter,) = _size("circle", diameter_m=diameter_m)
    angle = 2.0 * math.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    return PlanePath(0.5 * diameter * np.stack([np.cos(angle), np.sin(angle)], axis=1), closed=True)


def zigzag(width_m: float, height_m: float, turns: int) -> PlanePath:
    """Return straight strokes up and down with `turns` corners between start and end, evenly spaced in x.

    It starts at the lower left (-x, -y). Raises SceneError for bad sizes, and for turns below 1 or not whole.
    """
    width, height = _size("zigzag", width_m=width_m, height_m=height_m)
    count = _whole("zigzag", turns=turns)[0] + 2
    y = np.where(np.arange(count) % 2 == 0, -0.5, 0.5) * height
    return PlanePath(np.stack([np.linspace(-0.5 * width, 0.5 * width, count), y], axis=1), closed=False)


def zigzag_about(length_m: float, width_m: float, stroke_m: float) -> tuple[Float, Float]:
    """Return the corners of a zigzag about a line: distances along the line and to its left [m], both of shape (k,).

    stroke_m: distance along the line of one stroke across the whole width. The zigzag begins at the right edge; its
    last stroke ends at the end of the line. Raises SceneError for bad sizes.
    """
    length, width, stroke = _size("zigzag", length_m=length_m, width_m=width_m, stroke_m=stroke_m)
    along = np.append(np.arange(0.0, length * (1.0 - 1e-9), stroke), length)
    turned = along / stroke
    return along, width * np.abs(turned - 2.0 * np.round(0.5 * turned)) - 0.5 * width


def zigzagged(path: PlanePath, width_m: float, stroke_m: float) -> PlanePath:
    """Return a zigzag of this width about an open path, like `zigzag_about`, with straight strokes from edge to edge.

    Raises SceneError for bad sizes, and for a closed path, where the ends of the zigzag would not meet.
    """
    if path.closed:
        raise SceneError(
            "zigzag: the path is closed, so the ends of a zigzag about it would not meet; use an open path"
        )
    along, left = zigzag_about(path.length_m, width_m, stroke_m)
    segment = np.minimum(path.corner_arcs.searchsorted(along, "right") - 1, len(path.slopes) - 1)
    slopes = path.slopes[segment]
    sideways = np.stack([-slopes[:, 1], slopes[:, 0]], axis=1)
    # at(length) is the end of an open path, where it turns back
    return PlanePath(path.at(along) + left[:, None] * sideways, closed=False)


def square(side_m: float) -> PlanePath:
    """Return a square with sides along x and y, counter-clockwise from its lower left corner (-x, -y).

    Raises SceneError for a bad side.
    """
    (side,) = _size("square", side_m=side_m)
    return PlanePath(0.5 * side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]), closed=True)


def z_shape(width_m: float, height_m: float) -> PlanePath:
    """Return the letter Z: from the upper left (-x, +y) along the top, down the diagonal, along the foot.

    Raises SceneError for bad sizes.
    """
    width, height = _size("z_shape", width_m=width_m, height_m=height_m)
    unit = np.array([[-1.0, 1.0], [1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    return PlanePath(0.5 * unit * [width, height], closed=False)


def lissajous(width_m: float, height_m: float, a: int, b: int, phase_deg: float) -> PlanePath:
    """Return x = width/2 sin(a u + phase), y = height/2 sin(b u), u = 0..2 pi; it starts at u = 0, on the x axis.

    a, b: whole numbers of 1 or more without a common divisor, with which the curve would repeat itself
    Raises SceneError for bad sizes, counts and phase.
    """
    width, height = _size("lissajous", width_m=width_m, height_m=height_m)
    a, b = _whole("lissajous", a=a, b=b)
    if math.gcd(a, b) != 1:
        raise SceneError(f"lissajous: a = {a} and b = {b} have a common divisor; divide both by {math.gcd(a, b)}")
    if not math.isfinite(phase_deg):
        raise SceneError(f"lissajous: phase_deg = {phase_deg} is not finite; give an angle in degrees")
    # Points every 1/1024 of an oscillation, so that width and height have a relative error of 2e-5
    u = 2.0 * math.pi * np.arange(256 * max(a, b)) / (256 * max(a, b))
    points = np.stack([width * np.sin(a * u + math.radians(phase_deg)), height * np.sin(b * u)], axis=1)
    return PlanePath(0.5 * points, closed=True)


def letters(text: str, height_m: float) -> PlanePath:
    """Return capitals and digits in single strokes, from the start of the first stroke.

    Between strokes the pen is lifted and moves straight, see `pen_down`.
    Raises SceneError for a bad height and for characters other than letters, 0-9 and the blank.
    """

    (height,) = _size("letters", height_m=height_m)
    points: list[Float] = []
    lifted: list[bool] = []
    for stroke in strokes(text):
        for i, point in enumerate(stroke):
            if points and i == 0:
                if np.array_equal(points[-1], point):
                    continue
                lifted.append(True)
            elif points:
                lifted.append(False)
            points.append(point)
    return PlanePath(_centred(height * np.array(points)), False, np.array(lifted))


def polyline(points: ArrayLike) -> PlanePath:
    """Return straight lines through points [m], shape (n, 2), shifted so that the centre of their extent is the origin.

    The path starts at the first point; it is closed if the last point equals the first.
    Raises SceneError for another shape, values that are not finite, and fewer than two distinct consecutive points.
    """
    corners = np.asarray(points, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise SceneError(f"polyline: points have shape {corners.shape}; give (n, 2), x and y in metres")
    if not np.all(np.isfinite(corners)):
        raise SceneError("polyline: points hold values that are not finite; give x and y in metres")
    moved = np.any(np.diff(corners, axis=0) != 0.0, axis=1)
    corners = corners[np.concatenate([[True], moved])] if len(corners) else corners
    if len(corners) < 2:
        raise SceneError(f"polyline: {len(corners)} distinct points; give at least two")
    closed = bool(np.array_equal(corners[0], corners[-1]))
    return PlanePath(_centred(corners[:-1] if closed else corners), closed)


def _centred(points: Float) -> Float:
    return points - 0.5 * (points.min(axis=0) + points.max(axis=0))


def _size(shape: str, **sizes: float) -> list[float]:
    for name, size in sizes.items():
        if not (math.isfinite(size) and size > 0.0):
            raise SceneError(f"{shape}: {name} = {size} is not a size; give metres, above 0")
    return [float(size) for size in sizes.values()]


def _whole(shape: str, **counts: float) -> list[int]:
    for name, count in counts.items():
        if not (1 <= count <= MOST_TURNS and int(count) == count):
            raise SceneError(f"{shape}: {name} = {count} is not a count; give a whole number from 1 to {MOST_TURNS}")
    return [int(count) for count in counts.values()]


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
