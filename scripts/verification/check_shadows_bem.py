#!/usr/bin/env python3
"""Compare shadows of a finger over a palm by knife edges with boundary elements.

python scripts/verification/check_shadows_bem.py [--write docs/bench/shadows.md] [--commit HASH]

A rigid round finger with rounded ends is across the beam, with its upper side 10 to 20 mm below the plane of the focus,
and moves across. The reference on that plane is the sound of the array plus the sound scattered by the finger, by
boundary elements. Both methods omit the palm and its echo: the comparison is of the incident sound.

Errors are those of |p|^2 relative to the peak of the free focus. A picture is next to the page.
"""

import argparse
import sys
import time
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import trimesh
from check_shadows import (
    ELEMENTS_HEADING,
    ROOT,
    HEIGHT_m,
    Place,
    array,
    focused,
    moved,
    screen_integral,
    screen_squares,
    squares,
    wavelength,
)

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.scattering import scatter
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.outputs.style import COLOURS, save, style
from palmfield.simulation.shadows import SKIN_SPACING_m
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import processor
from palmfield.types import Float, Int

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "oracles"))

from scattered_sound import scattered_field

RADIUS_m, LENGTH_m = 0.008, 0.06
"""Radius and length of the finger; the length includes both rounded ends."""
GAPS_m = (0.010, 0.015, 0.020)
OFFSETS_m = np.arange(0.0, 0.0261, 0.002)
"""Distances of the finger's axis from the middle of the beam; both sides are symmetric."""
PER_WAVELENGTH = 7.0
"""Elements per wavelength; with 10 the sound at the focus changes by less than 0.3 % of the free peak."""
WANTED = 0.05
CLOSER_m = 0.004
"""Distance between nodes at which weights are computed: half of that in a scene."""
SHOWN = 4
"""Position of the finger in the lower row of the picture."""


class Compared(NamedTuple):
    """|p|^2 over the free peak at points of a plane behind a finger, shapes (offsets, n).

    points: [m], shape (n, 3); faces: of the finger's mesh; true: by boundary elements
    knife, rays: by both methods; closer: by knife edges with nodes CLOSER_m apart
    """

    points: Float
    faces: int
    knife: Float
    closer: Float
    rays: Float
    true: Float


def finger(gap_m: float, edge_m: float, radius_m: float = RADIUS_m, length_m: float = LENGTH_m) -> tuple[Float, Int]:
    """Return a capsule along y in the middle of the beam: vertices [m], shape (v, 3), and faces, shape (f, 3)."""
    straight = length_m - 2.0 * radius_m
    bend = np.linspace(0.0, 0.5 * np.pi, round(0.5 * np.pi * radius_m / edge_m) + 1)
    along = np.linspace(-0.5 * straight, 0.5 * straight, round(straight / edge_m) + 1)
    low = np.column_stack([radius_m * np.sin(bend), -0.5 * straight - radius_m * np.cos(bend)])
    wall = np.column_stack([np.full(len(along), radius_m), along])
    profile = np.concatenate([low, wall[1:-1], low[::-1] * [1.0, -1.0]])
    body = trimesh.creation.revolve(profile, sections=round(2.0 * np.pi * radius_m / edge_m))
    turned = np.array(body.vertices)[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    return moved(turned, z=HEIGHT_m - gap_m - radius_m), np.array(body.faces, np.int32)


def plane(arrays: PhasedArray, x: Float, y: Float) -> Place:
    """Return points of the palm's plane on a grid, facing the board."""
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), HEIGHT_m)], axis=-1).reshape(-1, 3)
    return Place(points, np.tile([0.0, 0.0, -1.0], (len(points), 1)), SurfaceArp(arrays.field, len(points)))


def compared(arrays: PhasedArray, place: Place, offsets: Float, shape: tuple[Float, Int]) -> Compared:
    """Compare the methods for a finger at some positions across the beam."""
    drive, length = focused(arrays), wavelength(arrays)
    vertices, faces = shape
    peak = abs(arrays.field.pressure(np.array([[0.0, 0.0, HEIGHT_m]]), drive).pressure[0]) ** 2
    free = arrays.field.pressure(place.points, drive).pressure

    def incident(points: Float) -> Float:
        return arrays.field.pressure(points, drive).pressure

    true = []
    for offset in offsets:
        solved = scatter(moved(vertices, x=offset), faces, incident, 2.0 * np.pi / length, device="cpu")
        true.append(np.abs(free + scattered_field(solved, place.points, device="cpu").pressure) ** 2)
    knife, rays = squares(arrays, place, shape, offsets)
    closer, _ = squares(arrays, place, shape, offsets, CLOSER_m)
    return Compared(place.points, len(faces), knife / peak, closer / peak, rays / peak, np.array(true) / peak)


def on_axis(points: Float) -> Float:
    """Return the points of the middle line across the finger, as a mask."""
    return np.abs(points[:, 1]) < 1e-9


def strip(arrays: PhasedArray, points: Float, gap_m: float) -> Float:
    """Return |p|^2 over the free peak on the middle line behind a strip as wide as the finger, (offsets, n)."""
    height = HEIGHT_m - gap_m - RADIUS_m
    peak = screen_squares(arrays, np.array([[0.0, 0.0, HEIGHT_m]]), np.ones((1, len(arrays.array))))[0]
    rows = []
    for offset in OFFSETS_m:
        left = screen_integral(arrays, points, offset - RADIUS_m, offset + RADIUS_m, height)
        rows.append(screen_squares(arrays, points, left))
    return np.array(rows) / peak


def row(gap_m: float, found: Compared, screen: Float) -> str:
    """Return a row of the table."""
    numbers, middle = [], on_axis(found.points)
    for error in (
        np.abs(found.knife - found.true),
        np.abs(found.closer - found.true),
        np.abs(screen - found.true[:, middle]),
        np.abs(found.rays - found.true),
    ):
        numbers += [f"{error.max():.3f}", f"{np.sqrt((error**2).mean()):.3f}", f"{100 * (error < WANTED).mean():.0f} %"]
    return f"| {1e3 * gap_m:.0f} mm | " + " | ".join(numbers) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--commit", default=None)
    options = parser.parse_args()
    arrays = array()
    place = plane(arrays, np.linspace(-0.024, 0.024, 33), np.linspace(-0.012, 0.012, 9))
    middle = on_axis(place.points)
    focus = np.argmin(np.linalg.norm(place.points[:, :2], axis=1))
    start, rows = time.perf_counter(), []
    with style():
        figure, axes = plt.subplots(2, len(GAPS_m), figsize=(10, 6), layout="constrained", sharey="row")
        for column, gap_m in zip(axes.T, GAPS_m, strict=True):
            found = compared(arrays, place, OFFSETS_m, finger(gap_m, wavelength(arrays) / PER_WAVELENGTH))
            screen = strip(arrays, place.points[middle], gap_m)
            rows.append(row(gap_m, found, screen))
            print(rows[-1], found.faces, "faces", flush=True)
            for name, by, look in (
                ("boundary elements", found.true, {"color": "black"}),
                ("knife edges", found.knife, {"color": COLOURS[0]}),
                ("the same, nodes 4 mm apart", found.closer, {"color": COLOURS[0], "linestyle": "--"}),
                ("rays", found.rays, {"color": COLOURS[1], "linestyle": ":"}),
            ):
                column[0].plot(1e3 * OFFSETS_m, by[:, focus], label=name, **look)
                column[1].plot(1e3 * place.points[middle, 0], by[SHOWN, middle], **look)
            column[0].plot(1e3 * OFFSETS_m, screen[:, len(screen[0]) // 2], color="grey", label="Kirchhoff, flat strip")
            column[1].plot(1e3 * place.points[middle, 0], screen[SHOWN], color="grey")
            column[0].set(title=f"{1e3 * gap_m:.0f} mm below the palm", xlabel="finger moved by, mm")
            column[1].set(xlabel=f"x on the palm, mm; finger at {1e3 * OFFSETS_m[SHOWN]:.0f} mm")
        axes[0, 0].set(ylabel="|p|² at the focus, of the free peak")
        axes[1, 0].set(ylabel="|p|² across the finger")
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
        seconds = time.perf_counter() - start
        print(f"{seconds:.0f} s")
        if options.write is None:
            return
        save(figure, ROOT / "docs" / "images" / "shadows_bem.png")
    text = SECTION.format(
        rows="\n".join(rows),
        header=" | ".join(
            f"{name}: largest | rms | below 5 %" for name in ("knife edges", "closer nodes", "strip", "rays")
        ),
        spacing=1e3 * SKIN_SPACING_m,
        wide=2e3 * RADIUS_m,
        long=1e3 * LENGTH_m,
        elements=PER_WAVELENGTH,
        closer=1e3 * CLOSER_m,
        seconds=seconds,
        last=1e3 * OFFSETS_m[-1],
        page=options.write,
        processor=processor(),
        commit=options.commit or git_commit(),
    )
    page = options.write.read_text().partition(ELEMENTS_HEADING)[0].rstrip()
    options.write.write_text(f"{page}\n\n{text}")


SECTION = (
    ELEMENTS_HEADING
    + """

Written by `python scripts/verification/check_shadows_bem.py --write {page}`,
commit {commit}, {processor}, {seconds:.0f} s on a machine that others used.

A rigid finger, {wide:.0f} mm thick and {long:.0f} mm long, lies across the beam below the plane of the focus. Its
positions are up to {last:.0f} mm from the middle. The reference is a solution by boundary elements, {elements:.0f} per
wavelength, on 48 x 24 mm of that plane. The table has errors of |p|^2 relative to the peak without the finger: the
largest error, the rms error, and the share of points with an error below 5 %. Four models are compared: knife edges as
in scenes (nodes {spacing:.0f} mm apart), knife edges with nodes {closer:.0f} mm apart ("closer nodes"), Kirchhoff's
integral over a flat strip with the width of the finger ("strip"), and rays.

| finger below the palm | {header} |
|---|---|---|---|---|---|---|---|---|---|---|---|---|
{rows}

![|p|² behind a finger](../images/shadows_bem.png)

The error of knife edges is largest in the half shadow, where |p|^2 is steepest. Kirchhoff's integral over a flat
strip has similar errors, so the main cause is the assumption of a flat screen.
"""
)


if __name__ == "__main__":
    main()
