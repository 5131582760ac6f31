"""Draw a skin in a plane, with values in colour, seen from the array that it faces."""

from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.colors import Colormap, PowerNorm
from matplotlib.tri import Triangulation

from palmfield.outputs.frames import Loudest, in_world, loudest, nearest, pose_at, to_local
from palmfield.outputs.schema import instances
from palmfield.outputs.style import beyond
from palmfield.types import Float

DISTANCES_M = (0.010, 0.020)


class SkinView(NamedTuple):
    """A skin relative to an array at the loudest moment on the skin.

    array: its name; pose: pose of the array, shape (7,); vertices: vertices of the skin in the frame of the array [m],
    shape (n, 3)
    """

    array: str
    pose: Float
    vertices: Float
    loudest: Loudest


def view_of_skin(result: xr.DataTree, name: str, skin: xr.Dataset, when: Loudest | None = None) -> SkinView:
    """Return a skin relative to the array that it faces most. when: a moment that replaces the loudest moment"""
    when, body = when or loudest(skin), instances(result, "body").get(name)
    vertices = in_world(skin, body, when.time_s)
    corners = vertices[skin["face"].values]
    outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    poses = {key: pose_at(array, when.time_s) for key, array in instances(result, "array").items()}
    ways = {key: pose[:3] - vertices.mean(axis=0) for key, pose in poses.items()}
    best = max(poses, key=lambda key: float(ways[key] @ outward) / max(float(np.linalg.norm(ways[key])), 1e-9))
    return SkinView(best, poses[best], to_local(vertices, poses[best]), when)


def draw_patch(
    figure: Any,
    axes: Any,
    faces: Any,
    vertices: Float,
    values: Float,
    colours: str | Colormap,
    limits: tuple[float, float],
    unit: str,
    gamma: float = 1.0,
) -> None:
    """Draw the patch over x (to the right) and y (up) of the array, with a colour bar. The view is onto the array.

    Triangles closer to the array, which the sound reaches first, are drawn over the others.
    vertices: vertices in the frame of the array [m], shape (n, 3); values: shape (n,), in `unit`
    gamma: exponent of the colour scale; below 1 it enhances small values
    """
    order = np.argsort(-vertices[faces].mean(axis=1)[:, 2])
    triangles = Triangulation(vertices[:, 0] * 1e3, vertices[:, 1] * 1e3, faces[order])
    low, high = limits
    drawn = axes.tripcolor(triangles, values, shading="gouraud", cmap=colours, norm=PowerNorm(gamma, low, high))
    axes.set(xlabel="array x [mm]", ylabel="array y [mm]", aspect="equal")
    axes.grid(visible=False)
    label = unit if gamma == 1.0 else f"{unit} (colours by the power {gamma:g})"
    figure.colorbar(drawn, ax=axes, shrink=0.85, pad=0.02, label=label, extend=beyond(values, low, high))


def probe_vertices(rest: Float, peak: Float) -> list[tuple[int, float]]:
    """Return vertex and distance [m] of the largest |u|, and of points 10 and 20 mm away (closer on a small patch)."""
    first = int(peak.argmax())
    distance = np.linalg.norm(rest - rest[first], axis=1)
    scale = min(1.0, 0.9 * float(distance.max()) / DISTANCES_M[-1])
    others = [nearest(distance, scale * target) for target in DISTANCES_M]
    return [(first, 0.0)] + [(v, float(distance[v])) for v in others if v != first]
