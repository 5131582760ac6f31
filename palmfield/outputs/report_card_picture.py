"""Draw a report card: the mesh seen from the palm and from the back, with faults in colour."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch as Swatch
from scipy.spatial import cKDTree

from palmfield.hand.chirality import chirality, fingers_direction
from palmfield.hand.holes import plane_axes
from palmfield.hand.joint_tree import named_side
from palmfield.hand.repair import MOST_PLACES
from palmfield.hand.reportcard import ReportCard, fault_faces
from palmfield.hand.triangles import face_normals, unique_edges
from palmfield.outputs.style import save, style
from palmfield.types import Float

COLOURS = {"refused": "#dc2626", "noted": "#d97706", "repaired": "#2563eb"}
SKIN = np.array([0.87, 0.80, 0.74])
MARK_REACH_m = 0.002
# Up to this number of places are marked by rings, in a view that shows them
FEW, GRAZING = 5, 0.2


def draw_card(card: ReportCard, path: Path) -> Path:
    """Draw a PNG with two views; return its path. Raises OutputError if it cannot be written."""
    up, palm = directions(card)
    with style():
        figure = Figure(figsize=(9.0, 6.2), dpi=120, layout="constrained")
        left, right = figure.subplots(1, 2)
        draw_view(left, card, up, palm, "palm" if _known(card) else "one side")
        draw_view(right, card, up, -palm, "back" if _known(card) else "other side")
        swatches = [_swatch(finding) for finding in card.facts["findings"]]
        if swatches:
            figure.legend(handles=swatches, loc="outside lower center", ncols=2)
        verdict = card.facts["verdict"]
        size = " x ".join(f"{v:.0f}" for v in card.facts["size_mm"])
        unit = f"unit {card.facts['unit']}, {card.facts['unit_source']}"
        figure.suptitle(f"{Path(card.facts['file']).name}: {verdict}; {size} mm; {unit}")
        save(figure, path)
    return path


def _swatch(finding: dict[str, Any]) -> Swatch:
    """Return the legend entry of a finding.

    It is filled if the picture marks the finding, and has a number if only some are marked.
    """
    marked = len(finding["places_mm"])
    text = f"{finding['count']} x {finding['name']}, {finding['outcome']}"
    if marked == MOST_PLACES < finding["count"]:
        text += f" (first {marked} marked)"
    colour = COLOURS[finding["outcome"]]
    return Swatch(facecolor=colour if marked else "none", edgecolor=colour, label=text)


def _known(card: ReportCard) -> bool:
    return card.facts.get("side", "unknown") != "unknown"


def directions(card: ReportCard) -> tuple[Float, Float]:
    """Return unit vectors to the fingers and out of the palm. If the mesh was refused, they are axes of the file."""
    vertices = card.mesh.vertices
    along = fingers_direction(vertices, card.mesh.faces)
    if "side" not in card.facts:
        return along, plane_axes(vertices)[2]
    named = "unknown" if card.mesh.rig is None else named_side(card.mesh.rig.joints.names)
    palm = chirality(vertices, card.mesh.faces, named).palm
    along -= (along @ palm) * palm
    return along / np.linalg.norm(along), palm


def draw_view(axes: Axes, card: ReportCard, up: Float, to_eye: Float, title: str) -> None:
    """Draw the mesh of a card [mm], seen from direction to_eye, with `up` upwards and faults in colour."""
    vertices, faces = card.mesh.vertices, card.mesh.faces
    right = np.cross(up, to_eye)
    unit, _ = face_normals(vertices, faces)
    # Light from the eye, slightly from above and left; both sides of faces are lit, because some face inwards
    light = to_eye + 0.4 * up - 0.4 * right
    shade = 0.35 + 0.65 * np.abs(unit @ light) / np.linalg.norm(light)
    colour = shade[:, None] * SKIN
    for finding in card.facts["findings"]:
        if finding["places_mm"]:
            places = 1e-3 * np.array(finding["places_mm"])
            marked = fault_faces(vertices, faces, places, MARK_REACH_m)
            tint = np.array([int(COLOURS[finding["outcome"]][i : i + 2], 16) / 255 for i in (1, 3, 5)])
            colour[marked] = (0.5 + 0.5 * shade[marked, None]) * tint
    flat = 1e3 * vertices @ np.stack([right, up], axis=1)
    back_to_front = np.argsort(vertices[faces].mean(axis=1) @ to_eye)
    shown: Any = np.clip(colour[back_to_front], 0.0, 1.0)
    axes.add_collection(
        PolyCollection(list(flat[faces[back_to_front]]), facecolors=shown, edgecolors=shown, linewidths=0.3)
    )
    edges, count = unique_edges(faces)
    # The rim of a hole is visible only if its own faces are visible
    rim = edges[(count == 1) & np.isin(edges, faces[unit @ to_eye > -GRAZING]).all(axis=1)]
    axes.add_collection(LineCollection(flat[rim], colors=COLOURS["refused"], linewidths=1.5))
    for finding in card.facts["findings"]:
        places = 1e-3 * np.array(finding["places_mm"]).reshape(-1, 3)
        if 0 < len(places) <= FEW:
            near = cKDTree(vertices[faces].mean(axis=1)).query(places)[1]
            visible = places[unit[near] @ to_eye > -GRAZING]
            at = 1e3 * visible @ np.stack([right, up], axis=1)
            axes.plot(*at.T, "o", ms=16, mfc="none", mec=COLOURS[finding["outcome"]], mew=1.5)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(title=title, xlabel="mm")
