"""Draw letters, a circle and a line from thenar to index tip on the skin of a hand.

It writes docs/images/paths_on_skin.png.

python scripts/draw_paths.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.stimulus.curves import circle, letters
from palmfield.stimulus.surface_path import drawn, through

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "paths_on_skin.png"
THENAR_m = (-0.027, -0.022, 0.0)
LETTERS_AT_m = (0.006, 0.012, 0.0)
CIRCLE_AT_m = (0.012, -0.02, 0.0)
# Seen by someone who looks at the palm with the fingers up, a right hand's thumb (-x) is on the right
TO_THE_RIGHT = (-1.0, 0.0, 0.0)
ABOVE_SKIN_m = 0.0007


def main() -> None:
    hand = hand_surface(load_preset("open_men_p50"))
    surface = hand.surface
    text = letters("PALM", 0.012)
    paths = [
        (drawn(surface, LETTERS_AT_m, TO_THE_RIGHT, text), text.pen_down, "navy", 'letters "PALM", 12 mm'),
        (drawn(surface, CIRCLE_AT_m, TO_THE_RIGHT, circle(0.03)), None, "darkgreen", "circle, 30 mm"),
        (through(surface, [THENAR_m, hand.landmarks["index_tip"]]), None, "crimson", "thenar to index tip"),
    ]
    figure, panels = plt.subplots(1, 2, figsize=(13, 7), subplot_kw={"projection": "3d"})
    for panel, (elevation, azimuth) in zip(panels, [(-90.0, 90.0), (-35.0, 160.0)], strict=True):
        light = LightSource(azdeg=225.0, altdeg=-45.0)
        corners = 1e3 * surface.vertices[surface.faces]
        skin = Poly3DCollection(corners, facecolors=(0.87, 0.68, 0.58), shade=True, lightsource=light)
        skin.set_zorder(0)
        panel.add_collection3d(skin)
        for path, pen_down, colour, label in paths:
            arc = np.linspace(0.0, path.length_m * (1.0 - 1e-9), 1200)
            positions, normals = path.at(arc, surface.vertices, surface.faces)
            above = 1e3 * (positions + ABOVE_SKIN_m * normals)
            draws = np.ones(len(arc), dtype=bool) if pen_down is None else pen_down(arc)
            pieces = np.stack([above[:-1], above[1:]], axis=1)[draws[:-1] & draws[1:]]
            panel.add_collection3d(Line3DCollection(pieces, colors=colour, linewidths=2.0, zorder=10, label=label))
        low, high = 1e3 * surface.vertices.min(axis=0), 1e3 * surface.vertices.max(axis=0)
        middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
        panel.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
        panel.set(zlim=(middle[2] - half, middle[2] + half))
        panel.set_box_aspect((1, 1, 1), zoom=1.5)
        panel.computed_zorder = False
        panel.view_init(elev=elevation, azim=azimuth)
        panel.set_axis_off()
    panels[0].legend(loc="lower left")
    figure.tight_layout()
    figure.savefig(TARGET, dpi=75)


if __name__ == "__main__":
    main()
