"""Bodies in front of the array for bench_scattering.py, and its pictures."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import PowerNorm
from matplotlib.figure import Figure

from palmfield.acoustics.scattering import closed
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import HandSurface, hand_surface
from palmfield.hand.triangles import face_components
from palmfield.outputs.style import COLOURS, save, style
from palmfield.types import Float, Int

FOCUS = np.array([0.0, 0.0, 0.2])
"""Place of the focus in the array frame [m]. The tested point of the skin of each body is placed here."""

HAND_EDGE_m = 1.01e-3
FINGER_m = 0.033
SHEET_EDGE_m = 1.0e-3


@dataclass(frozen=True)
class Body:
    """A closed mesh in the array frame [m]; the comparison uses faces within `reach_m` of the focus."""

    name: str
    what: str
    vertices: Float
    faces: Int
    reach_m: float


def whole_hand() -> HandSurface:
    """Return the open hand of a median man, with eight triangles per wavelength."""
    return hand_surface(load_preset("open_men_p50"), HAND_EDGE_m)


def palm(hand: HandSurface) -> Body:
    body = hand.surface
    return Body("hand", "whole open hand, focus on the palm", body.vertices + FOCUS, body.faces, 0.06)


def finger(hand: HandSurface) -> Body:
    """Return the end of the index finger joined to its mirror image: a closed smooth capsule with two tips."""
    vertices, faces, marks = hand.surface.vertices.copy(), hand.surface.faces, hand.landmarks
    tip, knuckle = marks["index_tip"], marks["index_knuckle"]
    axis = (tip - knuckle) / np.linalg.norm(tip - knuckle)
    cut = tip - FINGER_m * axis
    along = (vertices - cut) @ axis
    close = np.abs(along) < 0.3 * HAND_EDGE_m  # moved onto the cut, so that it leaves no slivers
    vertices[close] -= along[close, None] * axis
    across = np.linalg.norm(vertices - cut - along[:, None] * axis, axis=1)
    kept = faces[((along > -5e-3) & (across < 0.02))[faces].all(axis=1)]
    sliced = trimesh.Trimesh(*trimesh.intersections.slice_faces_plane(vertices, kept, axis, cut)[:2], process=False)
    sliced.merge_vertices(digits_vertex=8)
    points, half = sliced.vertices, sliced.faces
    parts = face_components(half)
    half = half[parts == parts[np.linalg.norm(points[half].mean(axis=1) - tip, axis=1).argmin()]]
    mirrored = points - 2.0 * ((points - cut) @ axis)[:, None] * axis
    halves = np.concatenate([half, half[:, ::-1] + len(points)])
    whole = trimesh.Trimesh(np.concatenate([points, mirrored]), halves, process=False)
    whole.merge_vertices(digits_vertex=8)
    whole.update_faces(whole.nondegenerate_faces())
    placed = np.asarray(whole.vertices) - marks["index_pad"] + FOCUS
    return Body(
        "finger", "end of the index finger, doubled, focus on the pad", placed, whole.faces.astype(np.int32), 0.06
    )


def cupped() -> Body:
    """Return a sheet 8 mm thick, bent to a gutter that is hollow towards the array.

    The radius is 35 mm, the angle 100 deg and the length 70 mm.
    """
    radius, arc, length = 0.035, np.radians(100.0), 0.07
    s = np.linspace(-arc / 2, arc / 2, round(radius * arc / SHEET_EDGE_m) + 1)
    y = np.linspace(-length / 2, length / 2, round(length / SHEET_EDGE_m) + 1)
    turn, along = np.meshgrid(s, y, indexing="ij")
    points = np.stack([radius * np.sin(turn), along, radius * (np.cos(turn) - 1.0)], axis=-1).reshape(-1, 3)
    corner = np.arange(turn.size).reshape(turn.shape)
    a, b, c, d = corner[:-1, :-1].ravel(), corner[1:, :-1].ravel(), corner[1:, 1:].ravel(), corner[:-1, 1:].ravel()
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([a, d, c], axis=1)]).astype(np.int32)
    vertices, whole, _ = closed(points, faces, 8e-3)
    return Body("cupped", "bent sheet, hollow towards the array", vertices + FOCUS, whole, 0.06)


def turned(body: Body, degrees: float) -> Body:
    """Return the body rotated so that one wall comes between focus and array.

    The axis is the line along y through the focus.
    """
    cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.array([[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]])
    vertices = (body.vertices - FOCUS) @ rotation.T + FOCUS
    return Body("turned", f"{body.what}, turned by {degrees:g} deg", vertices, body.faces, body.reach_m)


def front(body: Body, normals: Float) -> np.ndarray:
    """Return the faces that are turned to the array, within the body's reach of the focus."""
    centroids = body.vertices[body.faces].mean(axis=1)
    return (normals[:, 2] < -0.1) & (np.linalg.norm(centroids - FOCUS, axis=1) < body.reach_m)


def draw_bodies(
    path: Path, bodies: list[Body], visible: dict[str, np.ndarray], pressed: dict[str, dict[str, Float]]
) -> None:
    """Draw one row per body: the ARP of each model as seen from the array, and along a line through the focus."""
    models = list(next(iter(pressed.values())))
    with style():
        figure = Figure(figsize=(15.0, 3.0 * len(bodies)), layout="constrained")
        axes = figure.subplots(len(bodies), len(models) + 1, squeeze=False)
        for row, body in zip(axes, bodies, strict=True):
            show = np.flatnonzero(visible[body.name])
            corners = 1e3 * (body.vertices[body.faces[show]][:, :, :2] - FOCUS[:2])
            order = np.argsort(-body.vertices[body.faces[show]][:, :, 2].mean(axis=1))
            peak = float(pressed[body.name]["boundary elements"][show].max())
            for axis, model in zip(row, models, strict=False):
                patches = PolyCollection(list(corners[order]), cmap="inferno", norm=PowerNorm(0.5, 0.0, peak))
                patches.set_array(np.clip(pressed[body.name][model][show][order], 0.0, None))
                patches.set_edgecolor("face")
                patches.set_rasterized(True)
                axis.add_collection(patches)
                axis.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", title=f"{body.name}: {model}")
                axis.autoscale_view()
                axis.grid(False)
            figure.colorbar(patches, ax=list(row[: len(models)]), label="ARP, Pa (suction drawn as 0)", pad=0.01)
            _profile(row[-1], body, show, pressed[body.name])
        save(figure, path, dpi=90)


def _profile(axis: Axes, body: Body, show: np.ndarray, pressed: dict[str, Float]) -> None:
    centroids = 1e3 * (body.vertices[body.faces[show]].mean(axis=1) - FOCUS)
    line = np.flatnonzero(np.abs(centroids[:, 1]) < 0.7)
    line = line[np.argsort(centroids[line, 0])]
    for (model, values), colour, mark in zip(pressed.items(), (*COLOURS, "#222222"), "os^.", strict=True):
        axis.plot(centroids[line, 0], values[show][line], mark, color=colour, label=model, markersize=2.5, alpha=0.8)
    axis.axhline(0.0, color="#888888", linewidth=0.7)
    axis.set(xlabel="x, mm", ylabel="ARP, Pa", title="along x through the focus")
    axis.set_ylim(None, 1.4 * max(float(values[show][line].max()) for values in pressed.values()))
    axis.legend(fontsize=7, ncols=2, loc="upper center")


def draw_spheres(
    path: Path,
    angle: tuple[Float, Float, Float],
    refinement: tuple[Float, Float],
    sweep: tuple[Float, Float, Float],
) -> None:
    """Draw three panels.

    angle: degrees, |p| by boundary elements, |p| by series; refinement: elements per wavelength, error; sweep: ka, two
    errors
    """
    with style():
        figure = Figure(figsize=(12.0, 3.4), layout="constrained")
        left, middle, right = figure.subplots(1, 3)
        order = np.argsort(angle[0])
        left.plot(angle[0], angle[1], ".", color=COLOURS[0], markersize=2, label="boundary elements")
        left.plot(angle[0][order], angle[2][order], color=COLOURS[2], linewidth=0.9, label="series")
        left.set(xlabel="angle from the far pole, deg", ylabel="|p| over |p incident|", title="Rigid sphere, ka = 10")
        left.legend()
        middle.loglog(*refinement, "o-", color=COLOURS[0], label="error")
        guide = refinement[1][0] * (refinement[0][0] / refinement[0]) ** 2
        middle.loglog(refinement[0], guide, "--", color="#888888", label="second order")
        middle.axhline(0.02, color=COLOURS[1], linewidth=0.8, label="2 %")
        middle.set(xlabel="elements a wavelength", ylabel="relative L2 error", title="Refinement, ka = 6")
        middle.set_xticks([4, 6, 8, 12, 16], labels=["4", "6", "8", "12", "16"], minor=False)
        middle.set_xticks([], minor=True)
        middle.legend()
        right.semilogy(sweep[0], sweep[1], color=COLOURS[0], label="both surfaces")
        right.semilogy(sweep[0], sweep[2], color=COLOURS[2], linewidth=0.9, label="outer surface alone")
        right.set(xlabel="ka", ylabel="relative L2 error", title="Irregular frequencies (500 elements)")
        right.set_ylim(None, 2.0)
        right.legend(loc="upper center", ncols=2)
        save(figure, path)
