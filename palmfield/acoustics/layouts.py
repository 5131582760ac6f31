"""Known boards, in the array frame of palmfield (origin at the centroid of transducers, x right, y up, z out)."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy  # loads its submodules at first use

from palmfield.acoustics.directivities.t4010a1 import T4010A1_DIRECTIVITY
from palmfield.acoustics.placement import combined, from_poses, placed
from palmfield.acoustics.transducer import ANY_P0, ANY_QUALITY
from palmfield.types import Array, Estimate, Float, Int

AUTD_COLUMNS, AUTD_ROWS, AUTD_PITCH_M = 18, 14, 10.16e-3
AUTD_MISSING = ((1, 1), (2, 1), (16, 1))
"""Sites of an AUTD unit without a transducer, as (column, row), both from 0 at the corner of transducer 0."""

AUTD_BOARD_M = (192.0e-3, 151.4e-3)
"""Outer width and height of the board of an AUTD unit."""

TRANSDUCER_DIAMETER_M = 10e-3
"""Outer diameter of the common 40 kHz transducers."""

SONICSURFACE_BLOCK = ((0, 7, 1, 2), (4, 3, 6, 5))
"""Addresses in a block of 2 rows and 4 columns, rows in the direction of +y.

Blocks of 8 addresses are numbered up the board. Strips of 8 blocks are numbered from left to right.
"""

OPENMPD_BLOCK = ((1, 5), (0, 4), (3, 6), (2, 7))
"""Bytes in a block of 4 columns and 2 rows, by column to the right and by row downwards.

Blocks of 8 bytes are numbered up the board. Strips of 8 blocks are numbered from right to left. This is the pin map of
the vendor (`pin_ROM`, PinMapping.vhd of RMResearch/OpenMPD_Hardware, FPGA 3.4.2).
"""

BOW_TILT_DEG = 30.0
BOW_SPACING_M = 10e-3


Point = tuple[float, float, float]


@dataclass(frozen=True)
class Layout:
    """One known board.

    about: description. source: source of the values, and the values that it does not state.
    focus: usual focus [m], array frame, or a function that computes it from the array.
    build: function that makes the array, with a p0 that `palmfield.acoustics.arrays.layout` replaces.
    p0: peak pressure of one transducer at 1 m on its axis at full drive [Pa m]. quality: quality factor of the
    resonance. earlier: former layouts of this name, first version first.
    """

    about: str
    source: str
    focus: Point | Callable[[Array], Point]
    build: Callable[[], Array]
    p0: Estimate = ANY_P0
    quality: Estimate = ANY_QUALITY
    earlier: tuple[str, ...] = ()

    @property
    def focus_m(self) -> Point:
        """Usual focus [m], array frame."""
        return self.focus(self.build()) if callable(self.focus) else self.focus

    @property
    def version(self) -> int:
        """Version number from 1, recorded in files on the transducers of an array."""
        return len(self.earlier) + 1


def lattice(columns: int, rows: int, pitch_m: float) -> Float:
    """Return centred sites of a flat board in z = 0 [m], shape (columns rows, 3), by rows from low y, x fastest."""
    y, x = np.meshgrid(np.arange(rows) - (rows - 1) / 2, np.arange(columns) - (columns - 1) / 2, indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)]) * pitch_m


def grid(pitch_m: float) -> Float:
    """Return the sites of a flat 16 x 16 board [m], shape (256, 3), in the order of `lattice`."""
    return lattice(16, 16, pitch_m)


def sonicsurface_order() -> Int:
    """Return the address of each site of `grid` on a SonicSurface board, shape (256,)."""
    row, column = np.divmod(np.arange(256), 16)
    block = np.array(SONICSURFACE_BLOCK)
    return (64 * (column // 4) + 8 * (row // 2) + block[row % 2, column % 4]).astype(np.int32)


def centred(array: Array) -> Array:
    """Return the array moved so that the centroid of the transducers is the origin."""
    return placed(array, -array.positions.mean(axis=0), np.eye(3))


def uhev1() -> Array:
    return from_poses("uhev1", grid(10.3e-3), np.tile([0.0, 0.0, 1.0], (256, 1)))


def stratos_explore() -> Array:
    return replace(uhev1(), name="stratos_explore")


def sonicsurface() -> Array:
    sites = grid(10.5e-3)[np.argsort(sonicsurface_order())]
    normals = np.tile([0.0, 0.0, 1.0], (256, 1))
    return from_poses("sonicsurface", sites, normals, address=np.arange(256, dtype=np.int32))


def openmpd_order() -> Int:
    """Return the byte of each transducer of an OpenMPD board, shape (256,), in the order of the vendor: by columns from
    the left, each from above."""
    column, row = np.divmod(np.arange(256), 16)
    block = np.array(OPENMPD_BLOCK)
    return (192 - 64 * (column // 4) + 8 * (7 - row // 2) + block[column % 4, row % 2]).astype(np.int32)


def openmpd() -> Array:
    """Return OpenMPD in the order of the vendor (columns from low x, each from high y), with bytes as addresses."""
    x, y, z = grid(10.5e-3).reshape(16, 16, 3)[::-1].transpose(2, 1, 0).reshape(3, 256)
    normals = np.tile([0.0, 0.0, 1.0], (256, 1))
    return from_poses("openmpd", np.column_stack([x, y, z]), normals, address=openmpd_order())


def openmpd_rows() -> Array:
    """Return OpenMPD in byte order, by rows from low y, x fastest."""
    normals = np.tile([0.0, 0.0, 1.0], (256, 1))
    return from_poses("openmpd_rows", grid(10.5e-3), normals, address=np.arange(256, dtype=np.int32))


def ultraino() -> Array:
    """Return 64 transducers in the order of the signals of an Ultraino board, by rows from low y, x fastest."""
    normals = np.tile([0.0, 0.0, 1.0], (64, 1))
    return from_poses("ultraino", lattice(8, 8, 10.5e-3), normals, address=np.arange(64, dtype=np.int32))


def autd_board() -> Array:
    """Return an AUTD unit. The origin is the centre of the grid of 18 x 14, not the centroid of the 249 transducers."""
    sites = lattice(AUTD_COLUMNS, AUTD_ROWS, AUTD_PITCH_M)
    missing = [AUTD_COLUMNS * row + column for column, row in AUTD_MISSING]
    positions = np.delete(sites, missing, axis=0)
    normals = np.tile([0.0, 0.0, 1.0], (len(positions), 1))
    return from_poses("autd", positions, normals, directivity_table=T4010A1_DIRECTIVITY)


def autd2018() -> Array:
    return centred(autd_board())


def autd2018_2x2() -> Array:
    """Return four units by columns from the left, each from below. Margins are left and below in the left column. Units
    in the right column are rotated by 180 degrees, so their margins are right and above."""
    board = autd_board()
    # from the centre of the board to the centre of its sites, which reach the right and upper edges of the board
    offset = [
        (outer - ((count - 1) * AUTD_PITCH_M + TRANSDUCER_DIAMETER_M)) / 2
        for outer, count in zip(AUTD_BOARD_M, (AUTD_COLUMNS, AUTD_ROWS), strict=True)
    ]
    units = []
    for side in (-1.0, 1.0):
        turn = np.diag([-side, -side, 1.0])
        for step in (-1.0, 1.0):
            centre = np.array([side * AUTD_BOARD_M[0] / 2, step * AUTD_BOARD_M[1] / 2, 0.0])
            units.append(placed(board, centre + turn @ [*offset, 0.0], turn))
    return centred(combined(units, "autd2018_2x2"))


def autd3() -> Array:
    return replace(centred(autd_board()), address=np.arange(249, dtype=np.int32))


def autd3_units(columns: int, rows: int) -> Array:
    """Return the units edge to edge, not rotated, by rows from low y, x fastest."""
    width, height = AUTD_BOARD_M
    places = [(column * width, row * height, 0.0) for row in range(rows) for column in range(columns)]
    return centred(combined([placed(autd3(), place, np.eye(3)) for place in places], f"autd3_{columns}x{rows}"))


def bow(focal_length_m: float) -> tuple[Float, Float]:
    """Return positions relative to the focus [m] and unit normals of the six speakers of a bow, shapes (6, 3).

    The speakers are in the plane x = 0 on the parabola z = y^2/(4 f), with its vertex midway between the third and
    fourth, at centre distances of BOW_SPACING_M; all face the focus of the parabola.
    """

    def height(y: float) -> float:
        return y**2 / (4.0 * focal_length_m)

    def excess(y: float, last: float) -> float:
        return float(np.hypot(y - last, height(y) - height(last))) - BOW_SPACING_M

    half = [BOW_SPACING_M / 2]
    for _ in range(2):
        half.append(scipy.optimize.brentq(excess, half[-1], half[-1] + 2 * BOW_SPACING_M, args=(half[-1],)))
    positions = np.array([[0.0, y, height(y) - focal_length_m] for y in [-v for v in reversed(half)] + half])
    return positions, -positions / np.linalg.norm(positions, axis=1, keepdims=True)


def two_bow(name: str, focal_length_m: float, piston_radius_m: float) -> Array:
    """Return two bows along y, inclined towards a common focus from both sides; speakers 1-6 at low x, then 7-12."""
    positions, normals = bow(focal_length_m)
    one = from_poses(name, positions, normals, piston_radius_m=piston_radius_m)
    tilt = np.radians(BOW_TILT_DEG)
    bows = []
    for angle in (tilt, -tilt):
        turn = [[np.cos(angle), 0.0, np.sin(angle)], [0.0, 1.0, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]]
        bows.append(placed(one, np.zeros(3), turn))
    return centred(combined(bows, name))


def two_bow_as_printed() -> Array:
    return two_bow("two_bow_as_printed", 50e-3, 3e-3)


def two_bow_corrected() -> Array:
    return two_bow("two_bow_corrected", 30e-3, 5e-3)


def bow_focus(array: Array) -> Point:
    """Return the point on the z axis where the axes of the speakers of a two-bow array meet [m], by symmetry."""
    (_, y, z), (_, slope_y, slope_z) = array.positions[0], array.normals[0]
    return 0.0, 0.0, float(z - y * slope_z / slope_y)


AUTD_UNIT = (
    "AUTD3 software (shinolab, MIT): grid of 18 x 14 places, pitch 10.16 mm (10.18 in its first releases), board "
    "192 x 151.4 mm; places (1,1), (2,1) and (16,1) have been empty since 2016. Directivity: table of the T4010A1"
)
PISTON = "Directivity: a piston of the size of the MA40S4S"
BOW_SETUP = (
    "Mizushima & Sato 2024: 6 speakers per bow, 10 mm apart on a parabola, bows tilted by 30 deg. Assumption: every "
    "axis points to the common focus, as their sum of on-axis pressures implies. "
)

UHEV1_P0 = Estimate(
    1.27,
    0.7,
    2.6,
    "inferred",
    "reproduces the 12 Pa in the finite-element model of Chilles et al. 2019; their table lists this pressure among "
    "material parameters, and their measured motion implies a lower p0",
)
AUTD_P0 = Estimate(
    2.8,
    2.53,
    4.386,
    "inferred",
    "with the directivity of the T4010A1, this p0 reproduces the 20 mN on 12 x 12 mm measured by Hasegawa & Shinoda "
    "2018; the AUTD3 software uses 4.386, other projects 2.53",
)
STRATOS_P0 = Estimate(
    1.27,
    0.7,
    4.386,
    "assumed",
    "value of its predecessor UHEV1; the level of its own transducers is not published",
)

LAYOUTS = {
    "uhev1": Layout(
        "Ultrahaptics UHEV1: 16 x 16 elements, 10.3 mm pitch",
        f"Chilles et al. 2019 do not print the pitch; 10.3 to 10.5 mm is the usual figure. {PISTON}",
        (0.0, 0.0, 0.2),
        uhev1,
        UHEV1_P0,
    ),
    "stratos_explore": Layout(
        "Ultraleap STRATOS Explore (USX): 256 elements, assumed to be 16 x 16 at 10.3 mm pitch; simulation only",
        "Ultraleap's support pages state up to 256 transducers at 40 kHz; grid and pitch are assumed equal to the "
        "UHEV1",
        (0.0, 0.0, 0.2),
        stratos_explore,
        STRATOS_P0,
    ),
    "sonicsurface": Layout(
        "SonicSurface: 16 x 16 elements, 10.5 mm pitch, in the order of the board's data bytes",
        f"SonicSurface (upnalab, MIT): positions and byte order. {PISTON}",
        (0.0, 0.0, 0.2),
        sonicsurface,
    ),
    "openmpd": Layout(
        "OpenMPD (AcoustophoreticBoard): 16 x 16 elements, 10.5 mm pitch, ordered by columns, with the vendor's "
        "pin map; version 2 (version 1 is openmpd_rows)",
        "OpenMPD (University College London): positions, normals (0, 0, 1) and pins are those that the vendor's driver "
        "(AsierInhoImpl_V2.cpp of sbg97/OpenMPD_Driver) reads from board files (board_N.pat of RMResearch/OpenMPD). "
        "All 75 files and the FPGA's PinMapping.vhd have the same pin map. The driver rotates boards and does not "
        f"mirror them, so seen from the front, x points right and y up. Not tested on hardware. {PISTON}",
        (0.0, 0.0, 0.12),
        openmpd,
        earlier=("openmpd_rows",),
    ),
    "openmpd_rows": Layout(
        "OpenMPD with transducers ordered by rows, in byte order: version 1 of layout openmpd, for files made with it",
        "This assumption of earlier versions agrees with none of the vendor's board files: for new work use openmpd",
        (0.0, 0.0, 0.12),
        openmpd_rows,
    ),
    "ultraino": Layout(
        "One Arduino Mega of Ultraino: 8 x 8 elements, 10.5 mm pitch, in the order of its signals",
        "Ultraino (Marzo et al. 2018) drives 64 transducers per Mega. Users build their own arrays, so grid and "
        f"pitch are assumptions. {PISTON}",
        (0.0, 0.0, 0.08),
        ultraino,
    ),
    "autd2018": Layout(
        "One unit of Hasegawa & Shinoda 2018: 249 elements, aperture printed as 180 x 140 mm",
        f"Hasegawa & Shinoda 2018 state number and aperture; the other data are those of the {AUTD_UNIT}",
        (0.0, 0.0, 0.2),
        autd2018,
        AUTD_P0,
    ),
    "autd2018_2x2": Layout(
        "Four units of Hasegawa & Shinoda 2018, arranged to span the printed 364 x 302.8 mm",
        "Hasegawa & Shinoda 2018. The printed height, 302.8 mm, is that of two boards. The printed width, 364 mm, is "
        "10 mm less on each side. One board has such a margin only on its left, so we assume that the right column is "
        "rotated by 180 deg. With the pitch of 10.16 mm a margin is 9.3 mm and the width 365.4 mm",
        (0.0, 0.0, 0.4),
        autd2018_2x2,
        AUTD_P0,
    ),
    "autd3": Layout("AUTD3 unit: 249 elements in the order of its index", AUTD_UNIT, (0.0, 0.0, 0.2), autd3, AUTD_P0),
    **{
        f"autd3_{columns}x{rows}": Layout(
            f"{columns * rows} AUTD3 units, {columns} wide and {rows} high, not rotated, boards edge to edge: "
            "pitch of the units 192 x 151.4 mm",
            AUTD_UNIT,
            (0.0, 0.0, 0.4),
            partial(autd3_units, columns, rows),
            AUTD_P0,
        )
        for columns, rows in ((2, 2), (3, 2), (4, 2))
    },
    "two_bow_as_printed": Layout(
        "Two bows of 6 speakers, focal length 50 mm, diaphragms 6 mm across",
        BOW_SETUP + "As printed: focal length 50 mm; the paper calls a = 6 mm the diameter",
        bow_focus,
        two_bow_as_printed,
    ),
    "two_bow_corrected": Layout(
        "Two bows of 6 speakers, focal length 30 mm, pistons of 5 mm radius",
        BOW_SETUP
        + "Corrected: a focal length of 30 mm agrees better with the printed angles 40, 28 and 10 deg; a radius of "
        "5 mm gives k a^2/2 = 9.2 mm, near the printed Rayleigh length of about 10 mm",
        bow_focus,
        two_bow_corrected,
    ),
}
