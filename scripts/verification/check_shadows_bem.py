#!/usr/bin/env python3
"""Shadows of a finger over a palm with knife edges, against boundary elements.

python scripts/verification/check_shadows_bem.py [--write docs/bench/shadows.md] [--commit HASH]

A rigid round finger with rounded ends lies across the beam, its upper side 10 to 20 mm below the plane of the focus,
and moves across. The truth on that plane is the array's sound with what the finger scatters, by boundary elements. The
palm itself is left out in both, as its echo is in neither: what is compared is the sound that comes to it.

Errors are those of |p|^2, as shares of the free focus's peak. A picture lies beside the page.
"""

import argparse
import time
from pathlib import Path
from typing import NamedTuple

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import trimesh
from check_shadows import ROOT, HEIGHT_m, Place, array, focused, moved, squares, wavelength

from palmfield.acoustics.phased_array import PhasedArray
from palmfield.acoustics.scattering import scatter, scattered_field
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.outputs.style import COLOURS, save, style
from palmfield.types import Float, Int

HEADING = "## A finger over a palm, by boundary elements"
RADIUS_m, LENGTH_m = 0.008, 0.06
"""Of the finger; its length has both rounded ends in it."""
GAPS_m = (0.010, 0.015, 0.020)
OFFSETS_m = np.arange(0.0, 0.0261, 0.002)
"""Of the finger's axis from the middle of the beam; sound and finger are the same on either side."""
PER_WAVELENGTH = 8.0
"""Elements: the force on spheres is right to 1 % there (docs/bench/scattering.md)."""
WANTED = 0.05


class Compared(NamedTuple):
    """|p|^2 over the free peak at points of a plane behind a finger, shapes (offsets, n).

    points: [m], shape (n, 3); faces: of the finger's mesh; knife, rays: by both ways; true: by boundary elements
    """

    points: Float
    faces: int
    knife: Float
    rays: Float
    true: Float

    def errors(self, by: Float, where: Float | slice = slice(None)) -> Float:
        """Of one way at some of the points."""
        return np.abs(by - self.true)[:, where]


def finger(gap_m: float, edge_m: float, radius_m: float = RADIUS_m, length_m: float = LENGTH_m) -> tuple[Float, Int]:
    """A capsule along y in the middle of the beam: vertices [m], shape (v, 3), and faces, shape (f, 3)."""
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
    """Points of the palm's plane on a grid, looking at the board."""
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), np.full((len(x), len(y)), HEIGHT_m)], axis=-1).reshape(-1, 3)
    return Place(points, np.tile([0.0, 0.0, -1.0], (len(points), 1)), SurfaceArp(arrays.field, len(points)))


def compared(arrays: PhasedArray, place: Place, gap_m: float, offsets: Float, shape: tuple[Float, Int]) -> Compared:
    """A finger at some places across the beam."""
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
    return Compared(place.points, len(faces), knife / peak, rays / peak, np.array(true) / peak)


def on_axis(points: Float) -> Float:
    """The points of the middle line across the finger, as a mask."""
    return np.abs(points[:, 1]) < 1e-9


def row(gap_m: float, found: Compared) -> str:
    """Of the table."""
    numbers = []
    for by in (found.knife, found.rays):
        error = found.errors(by)
        numbers += [f"{error.max():.3f}", f"{np.sqrt((error**2).mean()):.3f}", f"{100 * (error < WANTED).mean():.0f} %"]
    spot = found.true.sum(axis=1)
    of_spot = np.abs(found.knife.sum(axis=1) - spot).max() / found.true.sum(axis=1).max()
    return f"| {1e3 * gap_m:.0f} mm | " + " | ".join(numbers) + f" | {of_spot:.3f} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--commit", default=None)
    options = parser.parse_args()
    arrays = array()
    place = plane(arrays, np.linspace(-0.024, 0.024, 33), np.linspace(-0.012, 0.012, 9))
    start, rows = time.perf_counter(), []
    with style():
        figure, axes = plt.subplots(2, len(GAPS_m), figsize=(10, 6), layout="constrained", sharey="row")
        for column, gap_m in zip(axes.T, GAPS_m, strict=True):
            found = compared(arrays, place, gap_m, OFFSETS_m, finger(gap_m, wavelength(arrays) / PER_WAVELENGTH))
            rows.append(row(gap_m, found))
            print(rows[-1], found.faces, "faces", flush=True)
            middle = np.argmin(np.linalg.norm(found.points[:, :2], axis=1))
            for by, style_, label in (
                (found.true, {"color": "black"}, "boundary elements"),
                (found.knife, {"color": COLOURS[0]}, "knife edges"),
                (found.rays, {"color": COLOURS[1], "linestyle": ":"}, "rays"),
            ):
                column[0].plot(1e3 * OFFSETS_m, by[:, middle], label=label, **style_)
                column[1].plot(1e3 * found.points[on_axis(found.points), 0], by[4][on_axis(found.points)], **style_)
            column[0].set(title=f"{1e3 * gap_m:.0f} mm over the palm", xlabel="finger moved by, mm")
            column[1].set(xlabel=f"x on the palm, mm, finger at {1e3 * OFFSETS_m[4]:.0f} mm")
        axes[0, 0].set(ylabel="|p|² at the focus, of the free peak")
        axes[1, 0].set(ylabel="|p|² across the finger")
        axes[0, 0].legend()
        seconds = time.perf_counter() - start
        print(f"{seconds:.0f} s")
        if options.write is None:
            return
        save(figure, ROOT / "docs" / "images" / "shadows_bem.png")
