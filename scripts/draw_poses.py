"""Draw the named poses of a hand, from the palm and from the side of the thumb; writes docs/images/poses.png.

python scripts/draw_poses.py
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.colors import LightSource
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from palmfield.hand.poses import POSE_NAMES, named_pose, posed_surface
from palmfield.hand.preset import load_preset
from palmfield.hand.skinning import SkinnedHand

TARGET = Path(__file__).resolve().parents[1] / "docs" / "images" / "poses.png"


def main() -> None:
    hand = SkinnedHand(load_preset("open_men_p50"), 0.003)
    figure, panels = plt.subplots(2, 5, figsize=(16, 6.4), subplot_kw={"projection": "3d"})
    for column, name in enumerate(POSE_NAMES):
        surface = posed_surface(hand, named_pose(hand.hand, name))
        for row, (elevation, azimuth, roll) in enumerate([(-90.0, 90.0, 0.0), (15.0, 205.0, 0.0)]):
            panel = panels[row, column]
            corners = 1e3 * surface.vertices[surface.faces]
            light = LightSource(azdeg=225.0, altdeg=-45.0)
            skin = Poly3DCollection(corners, facecolors=(0.87, 0.68, 0.58), shade=True, lightsource=light)
            panel.add_collection3d(skin)
            low, high = 1e3 * surface.vertices.min(axis=0), 1e3 * surface.vertices.max(axis=0)
            middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
            panel.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
            panel.set(zlim=(middle[2] - half, middle[2] + half))
            panel.set_box_aspect((1, 1, 1), zoom=1.4)
            panel.view_init(elev=elevation, azim=azimuth, roll=roll)
            panel.set_axis_off()
        panels[0, column].set_title(name)
    figure.tight_layout()
    figure.savefig(TARGET, dpi=70)


if __name__ == "__main__":
    main()
