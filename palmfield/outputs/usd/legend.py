"""Add a legend of the colours of a scene as geometry next to the coloured object: a bar, ticks and labels."""

from itertools import pairwise

import numpy as np
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator
from pxr import Usd, UsdGeom
from scipy.spatial import Delaunay

from palmfield.outputs.camera import Camera
from palmfield.outputs.usd.looks import LEGEND_SHARE, PICTURE
from palmfield.outputs.usd.palette import COLOURS, Palette, indices_of, paint
from palmfield.outputs.usd.prims import about, add_mesh, integers
from palmfield.outputs.usd.quantities import Quantity
from palmfield.types import Float, Int

INK = (0.02, 0.02, 0.02)
TALL = 0.55
"""Height of the bar as a fraction of the picture height."""
WIDE = 0.06
"""Width of the whole legend as a fraction of the height of the bar."""
TEXT = 0.05
STEPS_A_LETTER = 14.0


def add_legend(
    stage: Usd.Stage, path: str, name: str, quantity: Quantity, palette: Palette, camera: Camera, depth_m: float
) -> None:
    """Add the legend of a quantity in the right part of the picture, at a distance [m] from the camera.

    Its customData contains the quantity, low and high in the unit of the primvar, and the ticks in this unit and in the
    displayed unit.
    """
    root = UsdGeom.Xform.Define(stage, path)
    pixel = depth_m / camera.focal
    height = TALL * PICTURE[1] * pixel
    left = (LEGEND_SHARE + 0.02) * PICTURE[0] - camera.centre[0]
    corner = camera.eye + depth_m * camera.forward + pixel * left * camera.right
    corner = corner + (pixel * (camera.centre[1] - 0.5 * PICTURE[1]) - 0.5 * height) * camera.up

    def placed(flat: Float) -> Float:
        return corner + height * (flat[:, :1] * camera.right + flat[:, 1:] * camera.up)

    rows = np.linspace(0.0, 1.0, COLOURS + 1)
    sides = np.stack([np.zeros(COLOURS + 1), rows], axis=1), np.stack([np.full(COLOURS + 1, WIDE), rows], axis=1)
    lower = np.arange(COLOURS)
    right = lower + COLOURS + 1
    quads = np.stack([lower, right, right + 1, lower + 1], axis=1)
    bar = add_mesh(stage, f"{path}/Bar", placed(np.concatenate(sides)), quads, None)
    colour = paint(bar, palette, "uniform", quantity=name, units=quantity.unit)
    indices_of(colour).Set(integers(lower))
    low, high = quantity.per_unit * palette.low, quantity.per_unit * palette.high
    ticks: Float = np.asarray(MaxNLocator(7, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    ticks = ticks[(ticks >= low - 1e-9 * (high - low)) & (ticks <= high + 1e-9 * (high - low))]
    heights = (ticks - low) / (high - low)
    about(
        root.GetPrim(), quantity=name, units=quantity.unit, low=palette.low, high=palette.high, map=palette.map,
        ticks=(ticks / quantity.per_unit).tolist(), shown_ticks=ticks.tolist(),
        shown_units=quantity.shown_unit,
    )  # fmt: skip
    marks = np.concatenate([_box(WIDE, WIDE + 0.02, at - 0.002, at + 0.002) for at in heights])
    add_mesh(stage, f"{path}/Ticks", placed(marks), np.arange(len(marks)).reshape(-1, 4), INK)
    texts = [(WIDE + 0.03, at - 0.35 * TEXT, f"{0.0 if abs(tick) < 1e-12 else tick:g}".replace("-", "\u2212"))
             for at, tick in zip(heights, ticks, strict=True)]  # fmt: skip
    lines = [f"[{quantity.shown_unit}]", *reversed(quantity.title.split())]
    texts += [(0.0, 1.0 + (0.6 + 1.3 * number) * TEXT, line) for number, line in enumerate(lines)]
    points, faces = lettering(texts)
    add_mesh(stage, f"{path}/Labels", placed(points), faces, INK)


def _box(left: float, right: float, low: float, high: float) -> Float:
    return np.array([[left, low], [right, low], [right, high], [left, high]])


def lettering(texts: list[tuple[float, float, str]]) -> tuple[Float, Int]:
    """Return texts at positions as flat triangles: points, shape (n, 2), and triangles, shape (m, 3)."""
    points, faces, count = [], [], 0
    for x, y, text in texts:
        outline = TextPath((0.0, 0.0), text, size=1.0)
        rings = [ring for ring in map(np.asarray, outline.to_polygons()) if len(ring) > 3]
        dense = np.unique(np.concatenate([_dense(ring) for ring in rings]).round(6), axis=0)
        corners = dense[Delaunay(dense).simplices]
        # A triangle is part of a letter if an odd number of outlines encloses its centre
        inside = np.zeros(len(corners), bool)
        for ring in rings:
            inside ^= Outline(ring).contains_points(corners.mean(axis=1))
        kept = corners[inside].reshape(-1, 2)
        points.append(TEXT * kept + [x, y])
        faces.append(count + np.arange(len(kept)).reshape(-1, 3))
        count += len(kept)
    return np.concatenate(points), np.concatenate(faces)


def _dense(ring: Float) -> Float:
    """Return a closed outline whose point spacing is small compared with a letter."""
    parts = []
    for a, b in pairwise(ring):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) * STEPS_A_LETTER)))
        parts.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate(parts)
