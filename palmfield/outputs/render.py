"""Draw a picture of the scene by ray casting with Warp, without a window or OpenGL."""

from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import trimesh
import warp as wp
import xarray as xr
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, cKDTree

from palmfield.device import resolve, run_kernel, whole_numbers
from palmfield.errors import OutputError
from palmfield.outputs.camera import AZIMUTH_DEG, Camera, look_along_emission
from palmfield.outputs.frames import arrays_of, bodies, foci_at, in_world, loudest, nearest, pose_at, to_local, to_world
from palmfield.outputs.schema import has_records, instances
from palmfield.outputs.style import linear_rgb, save, style
from palmfield.threads import cores, share
from palmfield.types import Float
from warp_kernels import raycast

DPI = 120
SUPERSAMPLING = 2
AMBIENT_RAYS, VERTEX_RAYS = 1, 16
"""Number of shading rays of a sample, and of a vertex of a painted mesh. Between vertices the shade is interpolated."""
AMBIENT_REACH_M = 0.035
SAME_INSTANT_S = 1e-9
BAND_RAYS = 15_000
UNEVEN = 0.05
"""Difference in linear RGB between two neighbouring pixels above which both get all samples.

Such differences occur at edges, fine parts and coarse shade.
"""
AZIMUTHS_DEG = (0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180)
BOARD_RIM_M = 0.008
CAPTION = 110
"""Number of characters in a line of the caption."""
# magma from pale to dark, without black, so that silence has the colour of skin and shading is always visible
COLOURS = ListedColormap(colormaps["magma_r"](np.linspace(0.07, 0.82, 256)))


class Part(NamedTuple):
    """A mesh in the world. It has one sRGB colour, a strength of highlight, and an opacity."""

    mesh: trimesh.Trimesh
    colour: tuple[float, float, float]
    gloss: float
    opacity: float


class Scene(NamedTuple):
    """Objects to draw.

    time_s: time of their poses
    peak_Pa: end of the colour map
    bodies: meshes in the world with the pressure at each vertex [Pa]
    arrays: pose, shape (7,), and transducers in the frame of the array [m], shape (n, 3), by name
    others: meshes in the world without pressure
    """

    time_s: float
    peak_Pa: float
    bodies: list[tuple[trimesh.Trimesh, Float]]
    arrays: dict[str, tuple[Float, Float]]
    others: list[trimesh.Trimesh]


class Image(NamedTuple):
    """Objects as a camera sees them. image: sRGB picture, shape (height, width, 3), in [0, 1]"""

    scene: Scene
    camera: Camera
    image: Float


def render_scene(
    result: xr.DataTree, path: Path, size: tuple[int, int] = (960, 720), image: Image | None = None
) -> None:
    """Draw a PNG of arrays and bodies, coloured by peak pressure amplitude at the loudest moments.

    result: as returned by `open_result` or `tree`, with arrays and a surface that has loudest_pressure
    size: width and height [pixels]; image: `scene_image` of the result, made now if None
    Poses are those of the loudest moment of all skins. The camera looks obliquely along the emission of the first
    array. So it sees the insonified side of the body, and the array from behind; the board is transparent. With several
    arrays, the camera takes the direction in which the arrays hide least of the sound. Raises OutputError without data
    to show and if `path` cannot be written.
    """
    scene, camera, pixels = image or scene_image(result, size)
    height, width = pixels.shape[:2]
    with style():
        figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI)
        picture = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        picture.imshow(pixels, interpolation="none", aspect="auto", extent=(0, width, height, 0))
        picture.set_axis_off()
        for stimulus in instances(result, "stimulus").values():
            _draw_guides(picture, camera, scene, stimulus)
        bar = figure.add_axes((0.91, 0.18, 0.016, 0.56))
        scale = ScalarMappable(Normalize(0.0, max(scene.peak_Pa, 1e-9)), COLOURS)
        figure.colorbar(scale, cax=bar).outline.set_visible(False)
        bar.set_title("Pa", fontsize=8, loc="left", fontweight="normal")
        figure.text(0.025, 0.955, "Peak sound pressure on the surface", fontsize=12, fontweight="bold", va="center")
        caption = fill(_caption(result, scene), CAPTION)
        figure.text(0.025, 0.93, caption, fontsize=8.5, color="#555555", va="top")
        save(figure, path, DPI)


def scene_image(result: xr.DataTree, size: tuple[int, int] = (960, 720)) -> Image:
    """Return the picture data of `render_scene` in its view. A thread can compute this while another thread draws.

    Raises the OutputError of `render_scene` for a result without data to show.
    """
    scene = _scene(result)
    parts = [part for pose, positions in scene.arrays.values() for part in array_parts(positions, pose)]
    for mesh in scene.others:
        mesh.unmerge_vertices()
        parts.append(Part(mesh, (0.55, 0.60, 0.68), 0.2, 1.0))
    width, height = size
    painted = joined([mesh for mesh, _ in scene.bodies])
    level = np.concatenate([pressure for _, pressure in scene.bodies]) / max(scene.peak_Pa, 1e-9)
    solids = np.concatenate([painted.vertices, *(part.mesh.vertices for part in parts)])
    camera = _camera(scene, painted, level, solids, (0.0, 0.09 * height, 0.9 * width, 0.91 * height))
    return Image(scene, camera, cast(painted, level, parts, camera, size, quality=(SUPERSAMPLING, AMBIENT_RAYS)))


def _scene(result: xr.DataTree) -> Scene:
    skins, surfaces = instances(result, "skin"), instances(result, "surface")
    groups, arrays = instances(result, "body"), instances(result, "array")
    loud = {name: loudest(skin) for name, skin in skins.items()}
    painted = [name for name in skins if name in surfaces and has_records(surfaces[name], "loudest_pressure")]
    if not painted or not arrays:
        lacking = "array" if painted else "surface with loudest_pressure"
        raise OutputError(f"the result contains no {lacking}; run with the whole surface to render the scene")
    time_s = max((loud[name] for name in painted), key=lambda one: one.arp_Pa).time_s
    shown: list[tuple[trimesh.Trimesh, Float]] = []
    for names in bodies(result).values():
        own = {name: surfaces[name] for name in names if name in surfaces}
        if not own:
            continue
        # Skins on one body share its surface; each has the pressure of its own loudest moment
        name, surface = next(iter(own.items()))
        vertices = in_world(surface, groups.get(name), time_s)
        mesh = trimesh.Trimesh(vertices, surface["face"].values, process=False)
        shown.append((mesh, np.maximum.reduce([_pressure(one) for one in own.values()])))
    others = {
        surface["obstacle_position"].values.tobytes(): surface
        for name, surface in surfaces.items()
        if "obstacle_position" in surface and abs(loud[name].time_s - time_s) < SAME_INSTANT_S
    }
    return Scene(
        time_s,
        max(float(pressure.max()) for _, pressure in shown),
        shown,
        {name: (pose_at(array, time_s), array["transducer_position"].values) for name, array in arrays.items()},
        [trimesh.Trimesh(s["obstacle_position"].values, s["obstacle_face"].values, process=False)
         for s in others.values()],
    )  # fmt: skip


def _pressure(surface: xr.Dataset) -> Float:
    """Return the pressure of a surface at its loudest moment [Pa].

    It is 0 if an interrupted run does not contain it.
    """
    if not has_records(surface, "loudest_pressure"):
        return np.zeros(surface.sizes["vertex"])
    return np.nan_to_num(surface["loudest_pressure"].values.astype(float))


def _camera(
    scene: Scene, painted: trimesh.Trimesh, level: Float, solids: Float, window: tuple[float, float, float, float]
) -> Camera:
    """Return a camera along the emission of the first array.

    With several arrays, the camera is at the azimuth that shows most of the sound.

    painted: meshes with a pressure
    level: level of each of their vertices, from 0 to 1
    solids: all points that must be visible [m]
    """
    first = next(iter(scene.arrays.values()))[0]
    # Corners need the same camera as the whole mesh, in a hundredth of the time
    corners = solids[ConvexHull(solids).vertices]
    if len(scene.arrays) == 1:
        return look_along_emission(corners, first, window)
    cameras = [look_along_emission(corners, first, window, AZIMUTH_DEG + turn) for turn in AZIMUTHS_DEG]
    loud = level > 0.3 * level.max(initial=0.0)
    points, normals, weights = painted.vertices[loud], painted.vertex_normals[loud], level[loud]
    visible = []
    for camera in cameras:
        facing = np.einsum("ni,ni->n", normals, camera.eye - points) > 0.0
        free = np.logical_and.reduce([~_behind(points, camera.eye, *array) for array in scene.arrays.values()])
        visible.append(float(weights[facing & free].sum()))
    # For a slightly better view the usual direction is not changed
    return cameras[next(k for k, much in enumerate(visible) if much >= 0.9 * max(visible))]


def _behind(points: Float, eye: Float, pose: Float, positions: Float) -> NDArray[np.bool_]:
    """Return which of the points [m], shape (n, 3), the board of an array hides from an eye."""
    here, there = to_local(points, pose), to_local(eye[None], pose)[0]
    way = there - here
    with np.errstate(divide="ignore", invalid="ignore"):
        share = -here[:, 2] / way[:, 2]
        crossing = here[:, :2] + share[:, None] * way[:, :2]
    low, high = positions[:, :2].min(axis=0) - BOARD_RIM_M, positions[:, :2].max(axis=0) + BOARD_RIM_M
    return (share > 0.0) & (share < 1.0) & ((crossing > low) & (crossing < high)).all(axis=1)


def _caption(result: xr.DataTree, scene: Scene) -> str:
    level = f" ({20.0 * np.log10(scene.peak_Pa / np.sqrt(2.0) / 20e-6):.0f} dB SPL)" if scene.peak_Pa > 0 else ""
    times = [loudest(skin).time_s for skin in instances(result, "skin").values()]
    each = "" if max(times) - min(times) < SAME_INSTANT_S else ", each body at the loudest moment of its skin"
    count = sum(len(positions) for _, positions in scene.arrays.values())
    whose = "the array" if len(scene.arrays) == 1 else f"array '{next(iter(scene.arrays))}'"
    return (
        f"{count} transducers, at most {scene.peak_Pa:.4g} Pa{level}{each}, t = {scene.time_s * 1e3:.2f} ms; "
        f"seen from behind {whose}"
    )


def _draw_guides(picture: Axes, camera: Camera, scene: Scene, stimulus: xr.Dataset) -> None:
    """Draw dashed lines from the corners of each array of a stimulus to each of its foci."""
    if not has_records(stimulus, "foci"):
        return
    foci = foci_at(stimulus, nearest(stimulus["time"].values, scene.time_s))
    if len(foci) == 0:
        return
    for name in arrays_of(stimulus, list(scene.arrays)):
        pose, positions = scene.arrays[name]
        low, high = positions.min(axis=0), positions.max(axis=0)
        corners = np.array([[x, y, high[2]] for x in (low[0], high[0]) for y in (low[1], high[1])])
        ends = camera.project(np.vstack([to_world(corners, pose), foci]))
        for corner in ends[: len(corners)]:
            for focus in ends[len(corners) :]:
                picture.plot(*np.array([corner, focus]).T, "--", color="#4338ca", lw=0.7, alpha=0.45)


def array_parts(positions: Float, pose: Float) -> list[Part]:
    """Return meshes in the world for the cases and grilles of the transducers, and for the board behind them."""
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


def joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    vertices, faces = trimesh.util.append_faces([mesh.vertices for mesh in meshes], [mesh.faces for mesh in meshes])
    return trimesh.Trimesh(vertices, faces, process=False)


def cast(
    painted: trimesh.Trimesh,
    level: Float,
    parts: list[Part],
    camera: Camera,
    size: tuple[int, int],
    colours: ListedColormap = COLOURS,
    quality: tuple[int, int] = (SUPERSAMPLING, AMBIENT_RAYS),
) -> Float:
    """Return an sRGB image, shape (height, width, 3), in [0, 1].

    level: position in the colour map at each vertex of the painted meshes, 0 to 1
    quality: number of samples per pixel side, for pixels that differ from a neighbour (others get one sample); number
        of shading rays of a sample on the other meshes
    """
    meshes = [painted, *(part.mesh for part in parts)]
    points, faces = trimesh.util.append_faces([m.vertices for m in meshes], [m.faces for m in meshes])
    normals = np.concatenate([painted.vertex_normals, *(p.mesh.vertex_normals for p in parts)])
    counts = [len(part.mesh.vertices) for part in parts]
    tints = [np.zeros(3), *(linear_rgb(np.array(part.colour)) for part in parts)]
    albedo = np.repeat(tints, [len(level), *counts], axis=0)
    gloss = np.repeat([0.06, *(part.gloss for part in parts)], [len(level), *counts])
    opacity = np.repeat([1.0, *(part.opacity for part in parts)], [len(m.faces) for m in meshes])
    levels = np.concatenate([level, np.full(sum(counts), -1.0)])
    # Ray directions are (pixel - centre) / focal on the plane at unit distance from the eye
    right, down = camera.right / camera.focal, -camera.up / camera.focal
    corner = camera.forward - camera.centre[0] * right - camera.centre[1] * down
    key = _unit(-camera.forward + 1.0 * camera.right + 0.15 * camera.up)
    fill = _unit(-camera.forward - 1.3 * camera.right - 0.2 * camera.up)
    # Always on the CPU, where a picture takes less than a second and is the same on all machines
    device = resolve("cpu")
    vectors: list[wp.array] = [wp.array(a, dtype=wp.vec3, device=device) for a in (points, normals, albedo)]
    corners: wp.array = wp.array(faces.ravel(), dtype=wp.int32, device=device)
    solid_corners: wp.array = wp.array(faces[opacity >= 1.0].ravel(), dtype=wp.int32, device=device)
    everything = wp.Mesh(points=vectors[0], indices=corners)
    solid = wp.Mesh(points=vectors[0], indices=solid_corners)
    image = wp.zeros(size[0] * size[1], dtype=wp.vec3, device=device)
    open_sky: wp.array = wp.full(len(levels), -1.0, dtype=float, device=device)
    inputs: list[Any] = [
        everything.id,
        solid.id,
        corners,
        *vectors[1:],
        *(wp.array(a, dtype=float, device=device) for a in (levels, gloss, opacity)),
        open_sky,
        wp.array(linear_rgb(np.asarray(colours.colors)[:, :3]), dtype=wp.vec3, device=device),
        *(wp.vec3(*v) for v in (camera.eye, corner, right, down, key, fill, camera.up)),
        AMBIENT_REACH_M,
        *size,
    ]

    def launch(kernel: Any, numbers: NDArray[np.integer], rays: int, arguments: list[Any], result: Any) -> None:
        # A launch on the CPU uses one thread, so bands of pixels or vertices are distributed to all threads
        bands, size = [], BAND_RAYS // rays
        for start in range(0, len(numbers), size):
            band = whole_numbers(numbers[start : start + size])
            launched = run_kernel(kernel, len(band), [*arguments, band], [result], device=device, record_cmd=True)
            bands.append((launched.launch,))
        share(bands, cores())

    shading = [solid.id, *vectors[:2], AMBIENT_REACH_M, VERTEX_RAYS]
    launch(raycast.open_sky, np.arange(len(level)), VERTEX_RAYS, shading, open_sky)
    picture = image.numpy().reshape(size[1], size[0], 3)
    launch(raycast.render, np.arange(size[0] * size[1]), 1, [*inputs, 1, quality[1]], image)
    if quality[0] > 1:
        launch(raycast.render, np.flatnonzero(_uneven(picture)), 1, [*inputs, *quality], image)
    return _srgb(picture)


def _uneven(picture: Float) -> NDArray[np.bool_]:
    """Return which pixels differ from a neighbour, shape (height, width)."""
    result = np.zeros(picture.shape[:2], bool)
    for marks, values in ((result, picture), (result.T, picture.swapaxes(0, 1))):
        # `any` along three numbers takes ten times as long
        red, green, blue = np.moveaxis(np.abs(np.diff(values, axis=0)) > UNEVEN, -1, 0)
        uneven = red | green | blue
        marks[:-1] |= uneven
        marks[1:] |= uneven
    return result


def _unit(vector: Float) -> Float:
    return vector / np.linalg.norm(vector)


def _srgb(linear: Float) -> Float:
    """Return sRGB of linear RGB (IEC 61966-2-1), clipped to [0, 1]."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055)
