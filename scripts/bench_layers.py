"""Compare skin layers under whole hands, own and others: thickness, quality, time. Writes docs/bench/layers.md.

python scripts/bench_layers.py
"""

import os
import tempfile
import time
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import trimesh
import warp as wp
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import LightSource, Normalize
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from warp.geometry import IsoSurfaceMarchingCubes

from palmfield.device import resolve
from palmfield.hand.meshfile import load_mesh
from palmfield.hand.preset import load_preset
from palmfield.hand.surface import hand_surface
from palmfield.hand.triangles import vertex_normals
from palmfield.hand.wholelayer import facing_faces, hand_layer, upright_cosine
from palmfield.studies.bench.field import git_commit
from palmfield.studies.bench.table import cells, keep_rows, processor
from palmfield.types import Float, Surface

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "bench" / "layers.md"
SPLAYED_BLEND_m = 0.0015
DEPTHS_m = (0.001, 0.002, 0.003, 0.005)


def row_of_balls(start: tuple, end: tuple, radii: tuple[float, float], count: int) -> Float:
    """Return centres and radii of balls along a line [m], shape (count, 4)."""
    share = np.linspace(0.0, 1.0, count)[:, None]
    a, b = np.append(start, radii[0]), np.append(end, radii[1])
    return a + share * (b - a)


def soft_distance(balls: Float, blend_m: float, points: Float) -> Float:
    """Return the soft minimum of the distances to balls [m], negative inside; points (..., 3)."""
    total = np.zeros(points.shape[:-1])
    for ball in balls:
        total += np.exp((ball[3] - np.linalg.norm(points - ball[:3], axis=-1)) / blend_m)
    return -blend_m * np.log(total)


def blended(balls: Float, blend_m: float, voxel_m: float) -> trimesh.Trimesh:
    """Return the marching-cubes mesh of balls joined by a soft minimum, with its slivers."""
    device = resolve("cpu")
    low = (balls[:, :3] - balls[:, 3:]).min(axis=0) - 3.0 * voxel_m
    count = np.ceil(((balls[:, :3] + balls[:, 3:]).max(axis=0) + 3.0 * voxel_m - low) / voxel_m).astype(int)
    grid = np.stack(np.meshgrid(*(low[i] + voxel_m * np.arange(count[i]) for i in range(3)), indexing="ij"), axis=-1)
    distance = soft_distance(balls, blend_m, grid).astype(np.float32)
    field: wp.array = wp.array(distance, dtype=wp.float32, device=device)
    high = low + voxel_m * (count - 1)
    vertices, faces = IsoSurfaceMarchingCubes.extract(field, 0.0, lower=wp.vec3(*low), upper=wp.vec3(*high))
    mesh = trimesh.Trimesh(vertices.numpy().astype(float), faces.numpy().reshape(-1, 3))
    if mesh.volume < 0.0:
        mesh.invert()
    return mesh


def as_surface(mesh: trimesh.Trimesh) -> Surface:
    vertices, faces = np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int32)
    return Surface(vertices, faces, vertex_normals(vertices, faces))


def mitten() -> Surface:
    """Return a mitten by marching cubes: edges of 0.2 um to 6 mm, angles down to 0.002 degrees."""
    rows = [
        row_of_balls((-0.025, -0.04, 0.014), (-0.03, 0.04, 0.014), (0.014, 0.014), 5),
        row_of_balls((0.025, -0.04, 0.014), (0.03, 0.04, 0.014), (0.014, 0.013), 5),
        row_of_balls((0.0, -0.05, 0.014), (0.0, 0.1, 0.012), (0.015, 0.011), 9),
        row_of_balls((-0.015, 0.04, 0.014), (-0.012, 0.095, 0.012), (0.013, 0.010), 5),
        row_of_balls((0.015, 0.04, 0.014), (0.012, 0.09, 0.012), (0.013, 0.010), 5),
        row_of_balls((-0.03, -0.02, 0.013), (-0.065, 0.03, 0.008), (0.013, 0.010), 6),
    ]
    return as_surface(blended(np.concatenate(rows), 0.0025, 0.0035))


def splayed_hand() -> Float:
    """Return the balls of a hand with spread fingers, joined with SPLAYED_BLEND_m."""
    rows = [
        row_of_balls((x, -0.045, 0.014), (1.1 * x, 0.04, 0.014), (0.014, 0.013), 7) for x in (-0.03, -0.01, 0.01, 0.03)
    ]
    fingers = ((-0.036, -0.022, 0.07), (-0.012, -0.006, 0.078), (0.012, 0.01, 0.072), (0.035, 0.026, 0.055))
    for x, aside, length in fingers:
        rows.append(row_of_balls((x, 0.04, 0.013), (x + aside, 0.04 + length, 0.01), (0.0095, 0.0075), 9))
    rows.append(row_of_balls((-0.03, -0.02, 0.013), (-0.075, 0.03, 0.006), (0.013, 0.009), 7))
    return np.concatenate(rows)


def coarse_hand(subdivided: bool = True) -> Surface:
    """Return a spread hand of facets with edges of 6 mm, each split into four or whole."""
    mesh = blended(splayed_hand(), SPLAYED_BLEND_m, 0.0066)
    trimesh.smoothing.filter_taubin(mesh, iterations=6)
    return as_surface(mesh.subdivide() if subdivided else mesh)


def noisy_scan(preset: str, noise_m: float, edge_m: float = 0.003, seed: int = 1) -> Surface:
    """Return a parametric hand whose vertices are moved at random by an rms of noise_m [m]."""
    surface = hand_surface(load_preset(preset), edge_m).surface
    noise = np.random.default_rng(seed).normal(0.0, noise_m / np.sqrt(3.0), surface.vertices.shape)
    moved = surface.vertices + noise
    return Surface(moved, surface.faces, vertex_normals(moved, surface.faces))


def bodies() -> dict[str, Surface]:
    return {
        "men p50, edges 3 mm": hand_surface(load_preset("open_men_p50"), 0.003).surface,
        "women p50, edges 3 mm": hand_surface(load_preset("open_women_p50"), 0.003).surface,
        "women p50, edges 4 mm": hand_surface(load_preset("open_women_p50"), 0.004).surface,
        "men p50, edges 2 mm, noise 0.2 mm": noisy_scan("open_men_p50", 0.0002, 0.002),
        "women p50, edges 3 mm, noise 0.2 mm": noisy_scan("open_women_p50", 0.0002),
        "facets of 6 mm": coarse_hand(subdivided=False),
        "facets of 6 mm, each cut into four": coarse_hand(),
        "mitten, raw marching cubes": mitten(),
    }


def worst(rows: list[str]) -> list[str]:
    """Return one row per hand: the worse result of the whole hand and the palmar side at each thickness."""
    lines = [
        "| hand | faces | thinned area [%] at 1, 2, 3, 5 mm | smallest thickness [mm] | smallest quality | volume / "
        "integral |",
        "|---|---|---|---|---|---|",
    ]
    found = [cells(row) for row in rows[2:]]
    for name in dict.fromkeys(row[0] for row in found):
        own = [row for row in found if row[0] == name]
        depths = [[row for row in own if row[3] == depth] for depth in dict.fromkeys(row[3] for row in own)]
        thinned = ", ".join(max((row[6].split()[0] for row in some), key=float) for some in depths)
        least = ", ".join(min((row[5] for row in some), key=float) for some in depths)
        volumes = sorted((row[9] for row in own), key=float)
        quality = min((row[8] for row in own), key=float)
        lines.append(f"| {name} | {own[0][2]} | {thinned} | {least} | {quality} | {volumes[0]}-{volumes[-1]} |")
    return lines


def table() -> list[str]:
    lines = [
        "| hand | part | faces | requested mm | p10 of obtained / requested | least mm | thinned area | limited area "
        "| least quality | volume / integral | vertices moved |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name, surface in bodies().items():
        for part, faces in (("whole", None), ("palmar", facing_faces(surface))):
            for depth in DEPTHS_m:
                r = hand_layer(surface, depth, faces).report
                lines.append(
                    f"| {name} | {part} | {r['triangles']:.0f} | {1e3 * depth:g} | {100 * r['p10_share']:.0f} % "
                    f"| {1e3 * r['depth_got_min_m']:.2f} | {100 * r['area_thinned']:.1f} % "
                    f"| {100 * r['area_limited']:.1f} % | {r['quality_min']:.2g} | {r['volume_share']:.3f} "
                    f"| {r['vertices_moved']:.0f} |"
                )
    return lines


def timings() -> list[str]:
    """Measure load, repair and layer of an OBJ file of a hand of about 20 000 faces, wall and processor time."""
    source = hand_surface(load_preset("open_men_p50"), 0.0023).surface
    lines = ["| work | wall time [s] | processor time [s] |", "|---|---|---|"]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hand.obj"
        trimesh.Trimesh(1e3 * source.vertices, source.faces, process=False).export(path)
        marks = [(time.perf_counter(), time.process_time())]
        surface = load_mesh(path, "mm")
        marks.append((time.perf_counter(), time.process_time()))
        hand_layer(surface, 0.005)
        marks.append((time.perf_counter(), time.process_time()))
    for name, first, last in (
        (f"load and repair, {len(surface.faces)} faces (OBJ)", 0, 1),
        ("layer of 5 mm under the whole hand", 1, 2),
        ("both", 0, 2),
    ):
        wall, processor_s = (marks[last][i] - marks[first][i] for i in (0, 1))
        lines.append(f"| {name} | {wall:.2f} | {processor_s:.2f} |")
    return lines


def draw() -> None:
    """Draw the obtained over the requested thickness on the whole hand, palmar and dorsal."""
    bounds, colours = Normalize(0.4, 1.0), colormaps["viridis"]
    surface = hand_surface(load_preset("open_women_p50"), 0.003).surface
    for depth in (0.002, 0.005):
        patch = hand_layer(surface, depth)
        share = patch.depth * upright_cosine(patch.vertices, patch.faces, patch.inward) / depth
        figure, panels = plt.subplots(1, 2, figsize=(12, 6.4), subplot_kw={"projection": "3d"})
        views = ((-90.0, "palmar", 0.0), (90.0, "dorsal", 0.45))
        for panel, (elevation, title, left) in zip(panels, views, strict=True):
            panel.set_position((left, 0.02, 0.45, 0.88))
            corners = 1e3 * patch.vertices[patch.faces]
            skin = Poly3DCollection(
                corners, facecolors=colours(bounds(share[patch.faces].mean(axis=1))), shade=True,
                lightsource=LightSource(azdeg=225.0, altdeg=np.sign(elevation) * 60.0),
            )  # fmt: skip
            panel.add_collection3d(skin)
            low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
            middle, half = 0.5 * (low + high), 0.5 * float((high - low).max())
            panel.set(**{f"{axis}lim": (middle[i] - half, middle[i] + half) for i, axis in enumerate("xyz")})
            panel.set_box_aspect((1, 1, 1), zoom=1.6)
            panel.view_init(elev=elevation, azim=90.0 if elevation < 0 else -90.0)
            panel.set_axis_off()
            panel.set_title(title)
        bar = figure.colorbar(ScalarMappable(bounds, colours), cax=figure.add_axes((0.91, 0.2, 0.015, 0.5)))
        bar.set_label("thickness / requested thickness")
        figure.suptitle(f"{1e3 * depth:g} mm requested, median woman's hand")
        figure.savefig(ROOT / "docs" / "images" / f"layer_{1e3 * depth:g}mm.png", dpi=70)
        plt.close(figure)


def main() -> None:
    draw()
    rows = table()
    lines = [
        "# Skin layers under whole hands",
        "",
        f"For developers. `python scripts/bench_layers.py`, {processor()}, {os.cpu_count()} cores seen, one used, "
        f"commit {git_commit()}.",
        "",
        "`palmfield.hand.wholelayer.hand_layer` makes layers of 1, 2, 3 and 5 mm under whole closed surfaces, and",
        f"under their palmar side only. The table has the worse value. {keep_rows(PAGE, rows)} has all rows.",
        "",
        "- Thickness is measured along the skin normal.",
        "- Thinned area is the area where the thickness is less than 0.999 of the requested one: at finger webs, tips",
        "  and creases, where thicker wedges would fold.",
        "- Quality is the smallest scaled Jacobian (a Bernstein bound). If it is above 0, no wedge is folded.",
        "- The volume of the wedges is divided by the integral of t - t^2 H + t^3 K / 3 over the skin, with thickness",
        "  t, mean curvature H and Gaussian curvature K.",
        "",
        *worst(rows),
        "",
        "## Time",
        "",
        *timings(),
        "",
        "## Where it is thin",
        "",
        "![2 mm requested](../images/layer_2mm.png)",
        "",
        "![5 mm requested](../images/layer_5mm.png)",
        "",
    ]  # fmt: skip
    text = "\n".join(lines)
    print(text)
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
