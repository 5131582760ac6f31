#!/usr/bin/env python3
"""Compare shadows by knife edges and by rays with a Kirchhoff screen.

python scripts/verification/check_shadows.py [--write docs/bench/shadows.md] [--commit HASH]

An opaque strip (a finger's width) and a half plane between array and focus move across the beam. The reference is
Kirchhoff's integral over the opaque area in float64 for each transducer. The reference of a finger is in
scripts/verification/check_shadows_bem.py.

Errors are those of |p|^2 relative to the peak of the free focus. A picture is next to the page.
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import trimesh

from palmfield.acoustics.knife_edge import Emitters, KnifeEdges, shadow_nodes
from palmfield.acoustics.occlusion import Occlusion, distance_to_arrays
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.surface_arp import SurfaceArp, rows_of
from palmfield.config import ArrayConfig
from palmfield.outputs.style import COLOURS, save, style
from palmfield.simulation.shadows import SKIN_SPACING_m
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Complex, Float, Int

ROOT = Path(__file__).resolve().parents[2]
HEIGHT_m, SCREEN_m, STRIP_m = 0.2, 0.12, 0.016
"""Heights of the focus and of the screen, and width of the strip."""
REACH_m = 0.09
"""Half length of screens: the sound of all transducers passes closer to their middle."""
CELL_m = 5e-4
STEP_m = 1e-4
ELEMENTS_HEADING = "## A finger over a palm, by boundary elements"
"""Heading of the part of the page that another script writes."""


class Place(NamedTuple):
    """Evaluated points [m] with outward normals, shapes (n, 3), and the objects that compute the sound there."""

    points: Float
    normals: Float
    sound: SurfaceArp


def array() -> PhasedArray:
    """Return the 16 x 16 board."""
    place = Placement.of(IDENTITY)
    return PhasedArray([ArrayInstance(ArrayConfig(layout="uhev1"), place)], [place], "cpu")


def focused(arrays: PhasedArray) -> Complex:
    """Return the drive of a focus over the middle, shape (N,)."""
    away = np.linalg.norm(arrays.array.positions - [0.0, 0.0, HEIGHT_m], axis=1)
    return np.exp(-2j * np.pi * away / wavelength(arrays))


def wavelength(arrays: PhasedArray) -> float:
    """Return the wavelength [m]."""
    return Emitters(arrays, rows_of(arrays.field), "cpu").wavelength_m


def moved(points: Float, x: float = 0.0, z: float = 0.0) -> Float:
    """Return shifted points, shape (n, 3)."""
    return points + np.array([x, 0.0, z])


def most(steps: Float) -> float:
    """Return the largest change from one row to the next."""
    return float(np.abs(np.diff(steps, axis=0)).max())


def line(arrays: PhasedArray, count: int = 61) -> Place:
    """Return points along x through the focus, facing the board."""
    points = np.zeros((count, 3))
    points[:, 0], points[:, 2] = np.linspace(-0.024, 0.024, count), HEIGHT_m
    normals = np.tile([0.0, 0.0, -1.0], (count, 1))
    return Place(points, normals, SurfaceArp(arrays.field, count))


def squares(
    arrays: PhasedArray, place: Place, shape: tuple[Float, Int], shifts: Float, spacing_m: float = SKIN_SPACING_m
) -> tuple[Float, Float]:
    """Return |p|^2 at a place behind a shape moved along x, shapes (shifts, n): with knife edges, and by rays.

    spacing_m: of the nodes at which weights are computed
    """
    vertices, faces = shape
    occlusion, drive = Occlusion(vertices, faces, "cpu"), focused(arrays)
    emitters = Emitters(arrays, rows_of(arrays.field), "cpu")
    nodes = shadow_nodes(place.points, place.normals, spacing_m)
    edges = KnifeEdges(occlusion.outline, emitters, nodes, len(place.points))
    bent, cut = [], []
    for shift in shifts:
        occlusion.move(moved(vertices, x=shift))
        free = place.sound.evaluate(place.points, place.normals, drive, flux=True)
        reach = distance_to_arrays(place.points, free.flux, arrays)
        cut.append(np.where(occlusion.lit(place.points, free.flux, reach), free.amplitude, 0.0) ** 2)
        there = edges.evaluate(place.points[nodes.numbers], place.normals[nodes.numbers])
        sound = place.sound.evaluate(place.points, place.normals, drive, shades=edges.shades if there else None)
        bent.append(sound.amplitude.astype(float) ** 2)
    return np.array(bent), np.array(cut)


def screen_integral(
    arrays: PhasedArray, points: Float, low_m: float, high_m: float, screen_m: float = SCREEN_m
) -> Complex:
    """Return the share of each transducer's sound at points behind an opaque screen, shape (n, N).

    The screen is between x = low and high. Kirchhoff's integral with obliquity over the opaque area at this height, in
    float64. At its ends in y the sum is faded out, because a half plane has no such ends, which would scatter sound.
    """
    k = 2.0 * np.pi / wavelength(arrays)
    x = np.arange(low_m + 0.5 * CELL_m, high_m, CELL_m)
    y = np.arange(-REACH_m + 0.5 * CELL_m, REACH_m, CELL_m)
    fade = np.ones(len(y)), np.ones(len(x))
    ends = np.abs(y) > 0.75 * REACH_m
    fade[0][ends] = np.cos(0.5 * np.pi * (np.abs(y[ends]) - 0.75 * REACH_m) / (0.25 * REACH_m)) ** 2
    if high_m - low_m > 0.05:
        far = x > high_m - 0.02
        fade[1][far] = np.cos(0.5 * np.pi * (x[far] - high_m + 0.02) / 0.02) ** 2
    cells = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), screen_m)], axis=-1).reshape(-1, 3)
    area = CELL_m**2 * np.outer(fade[1], fade[0]).ravel()
    onward = np.linalg.norm(cells[:, None] - points, axis=2)
    there = np.exp(1j * k * onward) / onward
    rising = there * (points[:, 2] - screen_m) / onward
    away = np.linalg.norm(cells[:, None] - arrays.array.positions, axis=2).T
    arrives = area * np.exp(1j * k * away) / away
    field = 0.5 * ((arrives * screen_m / away) @ there + arrives @ rising)
    whole = np.linalg.norm(points[:, None] - arrays.array.positions, axis=2)
    left: Complex = 1.0 - k / (2j * np.pi) * field.T * whole * np.exp(-1j * k * whole)
    return left


def screen_squares(arrays: PhasedArray, points: Float, left: Complex) -> Float:
    """Return |p|^2 at points with these shares of each transducer's sound, shapes (n,) and (n, N)."""
    drive = focused(arrays)
    pairs = zip(points, left, strict=True)
    sums = [pressure64(point[None], arrays.array, drive * rest, arrays.air)[0][0] for point, rest in pairs]
    return np.abs(np.array(sums)) ** 2


def flat(low_m: float, high_m: float) -> tuple[Float, Int]:
    """Return a thin opaque plate from x = low to high."""
    box = trimesh.creation.box((high_m - low_m, 0.4, 2e-4))
    return moved(np.array(box.vertices), x=0.5 * (low_m + high_m), z=SCREEN_m), np.array(box.faces, np.int32)


def screens(arrays: PhasedArray, axes: list[plt.Axes]) -> list[str]:
    """Return rows of the table for a strip and a half plane."""
    place, rows = line(arrays, 25), []
    peak = float(screen_squares(arrays, place.points[12:13], np.ones((1, len(arrays))))[0])
    for axis, (name, low, high) in zip(
        axes, (("strip of 16 mm", -0.008, 0.008), ("half plane", 0.0, 0.2)), strict=True
    ):
        shifts = np.linspace(-0.04, 0.04, 33)
        bent, cut = squares(arrays, place, flat(low, high), shifts)
        reach = min(high, 0.12 + low)
        true = np.array(
            [
                screen_squares(arrays, place.points, screen_integral(arrays, place.points, low + x, reach + x))
                for x in shifts
            ]
        )
        fine = np.arange(-0.03, 0.03, STEP_m)
        slid, jumped = squares(arrays, place, flat(low, high), fine)
        rows.append(row(name, bent, cut, true, peak, most(slid), most(jumped)))
        axis.plot(1e3 * shifts, true[:, 12] / peak, color="black", label="Kirchhoff screen")
        axis.plot(1e3 * fine, slid[:, 12] / peak, color=COLOURS[0], label="knife edges")
        axis.plot(1e3 * fine, jumped[:, 12] / peak, color=COLOURS[1], linestyle=":", label="rays")
        axis.set(title=name, xlabel="screen moved by, mm", ylabel="|p|², of the free peak")
    axes[0].legend()
    return rows


def row(name: str, bent: Float, cut: Float, true: Float, peak: float, step: float, jump: float) -> str:
    """Return a row of the table: worst and rms errors of both methods, and the change by 0.1 mm."""
    one, other = np.abs(bent - true) / peak, np.abs(cut - true) / peak
    rms = [np.sqrt((error**2).mean()) for error in (one, other)]
    return (
        f"| {name} | {one.max():.3f} | {rms[0]:.3f} | {other.max():.3f} | {rms[1]:.3f} | {step / peak:.4f} | "
        f"{jump / peak:.3f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--commit", default=None)
    options = parser.parse_args()
    arrays = array()
    with style():
        figure, axes = plt.subplots(1, 2, figsize=(9, 3.3), layout="constrained")
        rows = screens(arrays, list(axes))
        print("\n".join(rows), flush=True)
        if options.write is None:
            return
        picture = ROOT / "docs" / "images" / "shadows.png"
        save(figure, picture)
    text = PAGE.format(
        rows="\n".join(rows),
        height=1e3 * SCREEN_m,
        processor=processor(),
        commit=options.commit or git_commit(),
        page=options.write,
    )
    elements = options.write.read_text().partition(ELEMENTS_HEADING) if options.write.exists() else ("", "", "")
    options.write.write_text(text + "".join(elements[1:]))


PAGE = """# Accuracy of shadows

For everyone who uses `body_sound` `shadows`. Written by `python scripts/verification/check_shadows.py --write {page}`,
commit {commit}, {processor}.

The focus is 200 mm above the middle of board uhev1. If key `shadow_edges` is `knife_edge` (default), each edge
diffracts the sound. If it is `rays`, a point is either lit or dark. The table has errors of |p|^2 within 24 mm of the
focus, relative to the peak without the body. The bodies are screens {height:.0f} mm above the board at 33 positions.
The reference is Kirchhoff's integral over the area of the screen in float64. The last two columns have the largest
change of |p|^2 over a distance of 0.1 mm.

| body | knife edge, largest error | knife edge, rms error | rays, largest error | rays, rms error | \
knife edge, change in 0.1 mm | rays, change in 0.1 mm |
|---|---|---|---|---|---|---|
{rows}

![|p|² behind a screen](../images/shadows.png)

Black is the reference, red is knife edges, dotted green is rays.

"""


if __name__ == "__main__":
    main()
