# Schema 1: for the old recorder, and deleted with it.
"""A picture of the scene, ray-cast with Warp: no window, no OpenGL."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import trimesh
import warp as wp
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from palmfield.device import resolve
from palmfield.errors import OutputError
from palmfield.outputs.camera import Camera, look_along_emission
from palmfield.outputs.style import save, style
from palmfield.outputs.v1_frames import body_pose_at, has_records, loudest, posed, to_world
from palmfield.types import Float
from warp_kernels import raycast

DPI = 120
SUPERSAMPLING = 2
AMBIENT_RAYS = 5
AMBIENT_REACH_M = 0.035
# magma from pale to dark, short of black: a silent palm looks like skin and shading stays visible everywhere.
COLOURS = ListedColormap(colormaps["magma_r"](np.linspace(0.07, 0.82, 256)))
NEEDED = ("surface_vertices", "surface_faces", "surface_pressure", "transducer_position", "array_pose")


class Part(NamedTuple):
    """A mesh in the world with one sRGB colour, strength of highlight and opacity."""

    mesh: trimesh.Trimesh
    colour: tuple[float, float, float]
    gloss: float
    opacity: float


def render_scene(ds: xr.Dataset, path: Path, size: tuple[int, int] = (960, 720)) -> None:
    """PNG of the array and the hand (or phantom) above it, coloured by peak pressure amplitude when loudest.

    ds: a result with surface_vertices, surface_faces, surface_pressure, transducer_position and array_pose
    size: width and height [pixels]
    The camera looks along the emission at a slant, so that the side which the sound reaches faces it and the array is
    seen from behind, through its board. Raises OutputError where one of these variables is missing and where `path`
    cannot be written.
    """
    missing = [name for name in NEEDED if name not in ds]
    if missing:
        raise OutputError(f"the result lacks {', '.join(missing)}; run with the whole surface to render the scene")
    index, time_s = loudest(ds)
    pressure = np.nan_to_num(ds["surface_pressure"].values.astype(float))
    peak = float(pressure.max())
    vertices = to_world(posed(ds, "surface", time_s), body_pose_at(ds, time_s))
    hand = trimesh.Trimesh(vertices, ds["surface_faces"].values, process=False)
    parts = _array_parts(ds["transducer_position"].values, ds["array_pose"].values)
    if "obstacle_vertices" in ds:
        beside = to_world(ds["obstacle_vertices"].values, body_pose_at(ds, time_s))
        mesh = trimesh.Trimesh(beside, ds["obstacle_faces"].values, process=False)
        mesh.unmerge_vertices()
        parts.append(Part(mesh, (0.55, 0.60, 0.68), 0.2, 1.0))
    width, height = size
    solids = np.concatenate([hand.vertices, *(part.mesh.vertices for part in parts)])
    camera = look_along_emission(solids, ds["array_pose"].values, (0.0, 0.09 * height, 0.9 * width, 0.91 * height))
    image = _cast(hand, pressure / max(peak, 1e-9), parts, camera, size)
    with style():
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        scene = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        scene.imshow(image, interpolation="none", aspect="auto", extent=(0, width, height, 0))
        scene.set_axis_off()
        if has_records(ds, "focus"):
            _draw_guides(scene, camera, ds, ds["focus"].values[index])
        bar = figure.add_axes((0.91, 0.18, 0.016, 0.56))
        figure.colorbar(ScalarMappable(Normalize(0.0, max(peak, 1e-9)), COLOURS), cax=bar).outline.set_visible(False)
        bar.set_title("Pa", fontsize=8, loc="left", fontweight="normal")
        figure.text(0.025, 0.955, "Peak sound pressure on the surface", fontsize=12, fontweight="bold", va="center")
        figure.text(0.025, 0.915, _caption(ds, peak, time_s), fontsize=8.5, color="#555555", va="center")
        save(figure, path, DPI)


def _caption(ds: xr.Dataset, peak: float, time_s: float) -> str:
    level = f" ({20.0 * np.log10(peak / np.sqrt(2.0) / 20e-6):.0f} dB SPL)" if peak > 0 else ""
    return (
        f"{ds.sizes['transducer']} transducers, at most {peak:.4g} Pa{level}, t = {time_s * 1e3:.2f} ms; "
        "seen from behind the array"
    )


def _draw_guides(scene: Axes, camera: Camera, ds: xr.Dataset, focus: Float) -> None:
    """Dashed lines from the corners of the array to the focus."""
    positions = ds["transducer_position"].values
    low, high = positions.min(axis=0), positions.max(axis=0)
    corners = np.array([[x, y, high[2]] for x in (low[0], high[0]) for y in (low[1], high[1])])
    ends = camera.project(np.vstack([to_world(corners, ds["array_pose"].values), focus]))
    for corner in ends[:-1]:
        scene.plot(*np.array([corner, ends[-1]]).T, "--", color="#4338ca", lw=0.7, alpha=0.45)


def _array_parts(positions: Float, pose: Float) -> list[Part]:
    """Cases and grilles of the transducers, and the board behind them, in the world."""
    gap = float(cKDTree(positions).query(positions, k=2)[0][:, 1].min()) if len(positions) > 1 else 0.010
    radius, tall = 0.46 * gap, 0.7 * gap
    case = trimesh.creation.cylinder(radius, tall, sections=24)
    case.apply_translation([0, 0, -0.5 * tall])
    grille = trimesh.creation.cylinder(0.72 * radius, 0.04 * tall, sections=24)
    low, high = positions.min(axis=0) - 0.8 * gap, positions.max(axis=0) + 0.8 * gap
    board = trimesh.creation.box([high[0] - low[0], high[1] - low[1], 0.16 * gap])
    board.apply_translation([*(0.5 * (low + high))[:2], positions[:, 2].min() - tall - 0.09 * gap])
    parts = [
        Part(_copies(case, positions), (0.80, 0.82, 0.85), 0.35, 1.0),
        Part(_copies(grille, positions), (0.30, 0.31, 0.33), 0.0, 1.0),
        Part(board, (0.10, 0.45, 0.35), 0.0, 0.15),
    ]
    for part in parts:
        part.mesh.vertices = to_world(part.mesh.vertices, pose)
        part.mesh.unmerge_vertices()
    return parts


def _copies(mesh: trimesh.Trimesh, positions: Float) -> trimesh.Trimesh:
    count = len(mesh.vertices)
    vertices = (positions[:, None, :] + mesh.vertices[None]).reshape(-1, 3)
    faces = (count * np.arange(len(positions))[:, None, None] + mesh.faces[None]).reshape(-1, 3)
    return trimesh.Trimesh(vertices, faces, process=False)


def _cast(hand: trimesh.Trimesh, level: Float, parts: list[Part], camera: Camera, size: tuple[int, int]) -> Float:
    """sRGB image, shape (height, width, 3), in [0, 1]; level: place in the colour map by vertex of the hand."""
    meshes = [hand, *(part.mesh for part in parts)]
    offsets = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    points = np.concatenate([m.vertices for m in meshes])
    faces = np.concatenate([m.faces + start for m, start in zip(meshes, offsets[:-1], strict=True)])
    normals = np.concatenate([hand.vertex_normals, *(np.repeat(p.mesh.face_normals, 3, axis=0) for p in parts)])
    counts = [len(part.mesh.vertices) for part in parts]
    painted = np.repeat([_linear(np.array(part.colour)) for part in parts], counts, axis=0)
    albedo = np.concatenate([np.zeros((len(level), 3)), painted])
    gloss = np.repeat([0.06, *(part.gloss for part in parts)], [len(level), *counts])
    opacity = np.repeat([1.0, *(part.opacity for part in parts)], [len(m.faces) for m in meshes])
    levels = np.concatenate([level, np.full(sum(counts), -1.0)])
    # A ray's direction is (pixel - centre) / focal on the plane one unit ahead of the eye.
    right, down = camera.right / camera.focal, -camera.up / camera.focal
    corner = camera.forward - camera.centre[0] * right - camera.centre[1] * down
    key = _unit(-camera.forward + 1.0 * camera.right + 0.15 * camera.up)
    fill = _unit(-camera.forward - 1.3 * camera.right - 0.2 * camera.up)
    # The CPU, wherever the run was: a picture takes about two seconds there, and looks the same everywhere.
    device = resolve("cpu")
    vectors: list[wp.array] = [wp.array(a, dtype=wp.vec3, device=device) for a in (points, normals, albedo)]
    corners: wp.array = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    solid_corners: wp.array = wp.array(faces[opacity >= 1.0].ravel(), dtype=wp.int32, device=device)
    everything = wp.Mesh(points=vectors[0], indices=corners)
    solid = wp.Mesh(points=vectors[0], indices=solid_corners)
    image = wp.zeros(size[0] * size[1], dtype=wp.vec3, device=device)
    wp.launch(
        raycast.render,
        dim=size[0] * size[1],
        inputs=[
            everything.id,
            solid.id,
            corners,
            *vectors[1:],
            *(wp.array(a, dtype=float, device=device) for a in (levels, gloss, opacity)),
            wp.array(_linear(np.asarray(COLOURS.colors)[:, :3]), dtype=wp.vec3, device=device),
            *(wp.vec3(*v) for v in (camera.eye, corner, right, down, key, fill, camera.up)),
            AMBIENT_REACH_M,
            *size,
            SUPERSAMPLING,
            AMBIENT_RAYS,
        ],
        outputs=[image],
        device=device,
    )
    return _srgb(image.numpy().reshape(size[1], size[0], 3))


def _unit(vector: Float) -> Float:
    return vector / np.linalg.norm(vector)


def _linear(srgb: Float) -> Float:
    """Linear RGB of sRGB (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def _srgb(linear: Float) -> Float:
    """sRGB of linear RGB (IEC 61966-2-1), clipped to [0, 1]."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
