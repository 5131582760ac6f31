"""Draw the presets by region, from the palm and from the back, and write their measures and depths to bone.

python scripts/draw_hands.py    writes docs/images/hands_labels.png and the tables of docs/hands.md
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from palmfield.hand.articulated import articulate
from palmfield.hand.labels import REGIONS, depth_by_region, region_labels
from palmfield.hand.measure import measures
from palmfield.hand.preset import HandPreset, load_preset, preset_names
from palmfield.hand.surface import hand_surface
from palmfield.studies.bench.table import keep_rows

DOCS = Path(__file__).resolve().parents[1] / "docs"
EDGE_m = 0.003
# Mean and standard deviation of the hand's circumference [m], ANSUR II (Gordon et al. 2014)
AROUND_m = {"men": (0.2123, 0.0102), "women": (0.1866, 0.0088)}
DEVIATIONS = {"p05": -1.645, "p50": 0.0, "p95": 1.645}
DEPTH_PRESETS = ("open_men_p50", "open_women_p50")
SHOWN = ("thumb_pulp", "index_pulp", "middle_pulp", "ring_pulp", "little_pulp", "index_proximal_palmar", "thenar",
         "hypothenar", "index_middle_pad", "middle_ring_pad", "ring_little_pad", "palm_centre", "dorsum")  # fmt: skip
"""Regions on the page; the file of depths has all."""
# Neighbours in the list of regions are mostly neighbours on the hand: hues far apart for them.
COLOURS = plt.get_cmap("gist_rainbow")(np.arange(len(REGIONS)) * 0.381966 % 1.0)


def main() -> None:
    draw(DOCS / "images" / "hands_labels.png")
    page = DOCS / "hands.md"
    before, _, rest = page.read_text(encoding="utf-8").partition("<!-- tables -->\n")
    _, mark, after = rest.partition("<!-- end of tables -->")
    tables = "\n".join(["<!-- tables -->", *measure_table(), "", *shown_depths(depth_table()), ""])
    page.write_text(before + tables + mark + after, encoding="utf-8")


def right_hands() -> list[HandPreset]:
    return [preset for preset in map(load_preset, preset_names()) if preset.side == "right"]


def draw(target: Path) -> None:
    figure, panels = plt.subplots(2, 6, figsize=(18, 8), subplot_kw={"projection": "3d"})
    for column, preset in enumerate(right_hands()):
        surface = hand_surface(preset, EDGE_m).surface
        _, labels = region_labels(articulate(preset), surface)
        # A face goes with the label that most of its corners have, the first one's where all differ.
        corners = labels[surface.faces]
        label = np.where(corners[:, 1] == corners[:, 2], corners[:, 1], corners[:, 0])
        for row, azimuth, elevation in ((0, 90.0, -90.0), (1, -90.0, 90.0)):
            panel = panels[row, column]
            skin = Poly3DCollection(1e3 * surface.vertices[surface.faces], facecolors=COLOURS[label], shade=True)
            panel.add_collection3d(skin)
            panel.set(xlim=(-110.0, 60.0), ylim=(-100.0, 145.0), zlim=(-50.0, 50.0))
            panel.set_box_aspect((170, 245, 100), zoom=1.15)
            panel.view_init(elev=elevation, azim=azimuth)
            panel.set_axis_off()
        panels[0, column].set_title(preset.name)
    figure.subplots_adjust(0.0, 0.0, 1.0, 0.94, 0.0, 0.0)
    figure.savefig(target, dpi=70)


def measure_table() -> list[str]:
    """Return the measures of the meshes and those of the presets, in mm."""
    lines = [
        "| mesh / preset [mm] | length | breadth | girth of the wrist | girth at the knuckles / ANSUR II |",
        "|---" * 5 + "|",
    ]
    for preset in right_hands():
        found = measures(hand_surface(preset, EDGE_m))
        _, group, percentile = preset.name.split("_")
        mean, deviation = AROUND_m[group]
        pairs = [
            (found["length"], preset.length_m),
            (found["breadth"], preset.breadth_m),
            (found["wrist_circumference"], preset.wrist_circumference_m),
            (found["hand_circumference"], mean + DEVIATIONS[percentile] * deviation),
        ]
        cells = [f"{1e3 * mesh:.1f} / {1e3 * target:.1f} ({mesh / target - 1.0:+.1%})" for mesh, target in pairs]
        lines.append(f"| `{preset.name}` | {' | '.join(cells)} |")
    return lines


def depth_table() -> list[str]:
    """Return the depth from skin to bone by region, in mm."""
    lines = ["| smallest, p10, median [mm] | `" + "` | `".join(DEPTH_PRESETS) + "` |", "|---" * 3 + "|"]
    presets = [load_preset(name) for name in DEPTH_PRESETS]
    depths = [depth_by_region(articulate(preset), hand_surface(preset, EDGE_m)) for preset in presets]
    for region in REGIONS:
        cells = [", ".join(f"{1e3 * value:.1f}" for value in depth[region]) for depth in depths]
        lines.append(f"| `{region}` | {' | '.join(cells)} |")
    return lines


def shown_depths(table: list[str]) -> list[str]:
    """Write all rows of depths to a file; return those for the page, with the link to the file."""
    rows = [line for line in table[2:] if line.split("`")[1] in SHOWN]
    return [*table[:2], *rows, "", f"{keep_rows(DOCS / 'hands.md', table, 'hand_depths')} has all regions."]


if __name__ == "__main__":
    main()
