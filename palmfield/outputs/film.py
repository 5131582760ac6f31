"""Make a video of a run: the skin with its motion or ARP in colour, slowed down and magnified."""

import contextlib
import importlib
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import trimesh
import xarray as xr
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure

from palmfield.errors import OutputError, refuse_unknown, unwritable
from palmfield.outputs.camera import Camera, look_along_emission
from palmfield.outputs.covered import smooth_normals, sunk
from palmfield.outputs.frames import bodies, in_world, nearest, pose_at
from palmfield.outputs.motion import extremes, normal_component
from palmfield.outputs.pictures.options import IN_MICRO, UNITS
from palmfield.outputs.render import Part, cast, joined
from palmfield.outputs.schema import has_records, instances
from palmfield.outputs.style import rounded_down, signed_colours, style
from palmfield.types import Float

SHOWN = ("displacement", "velocity", "arp")
FPS = 25
SLOW = 200.0
"""Default slow-motion factor: a second of film shows 5 ms."""
DISPLAYED_M = 2e-3
"""Displayed size of the largest motion at the default magnification [m]."""
QUALITY = (1, 3)
DPI, DRAWN_FOR = 100, (800, 600)
"""Resolution of text [pixels per inch], and the picture size for which it applies. Text scales with the picture."""
POSES = 16
"""Number of times at which the camera must see all skins."""


@dataclass(frozen=True)
class Cut:
    """Contents of a video.

    start_s, end_s: part of the run [s], None for its ends
    slow: slow-motion factor
    magnify: factor of the motion along the normal; None shows the largest motion as DISPLAYED_M
    shown: quantity of the colours, one of SHOWN
    limits: limits of the colour scale, in the unit of `shown`
    size: width and height [pixels], even numbers
    """

    start_s: float | None = None
    end_s: float | None = None
    slow: float = SLOW
    magnify: float | None = None
    shown: str = "displacement"
    limits: tuple[float, float] | None = None
    size: tuple[int, int] = (960, 720)


class _Look(NamedTuple):
    """Data that all frames share.

    around: surface of each body, lowered below its skins, by the name of one of its skins
    """

    skins: dict[str, xr.Dataset]
    around: dict[str, xr.Dataset]
    camera: Camera
    colours: ListedColormap
    limits: tuple[float, float]
    unit: str
    magnify: float


def film(
    result: xr.DataTree, path: str | Path, cut: Cut | None = None, on_frame: Callable[[int, int], None] | None = None
) -> int:
    """Write an MP4 video (H.264) of the skins of a run; return the number of frames.

    result: as returned by `open_result`, with the displacement of at least one skin
    on_frame: function that is called with the number of completed frames and the number of all frames
    The camera sees all skins at all times. Ctrl-C ends the video early; the finished part can be played.
    Raises OutputError for times outside the run, invalid numbers, and a result without motion. Raises OutputError also
    if PyAV is missing (extra `video`), and if `path` cannot be written.
    """
    settings = cut or Cut()
    file = Path(path)
    if file.suffix.lower() != ".mp4":
        raise OutputError(f"cannot write {file}: a film is an MP4; give a file name that ends in .mp4")
    times = _times(result, settings)
    look = _look(result, settings, times)
    done = 0
    with _encoder(file, settings.size) as add, contextlib.suppress(KeyboardInterrupt), style():
        frame = _Frame(look, settings)
        for number, time_s in enumerate(times, 1):
            add(frame.image(result, float(time_s)))
            done = number
            if on_frame is not None:
                on_frame(done, len(times))
    return done


def _times(result: xr.DataTree, cut: Cut) -> Float:
    """Return the times of frames [s]."""
    all_times: Float = np.asarray(result.coords["time"])
    if len(all_times) < 2:
        raise OutputError("the result contains fewer than two times; run for longer")
    start = float(all_times[0]) if cut.start_s is None else cut.start_s
    end = float(all_times[-1]) if cut.end_s is None else cut.end_s
    if not all_times[0] <= start < end <= all_times[-1]:
        raise OutputError(
            f"the film would run from {1e3 * start:g} to {1e3 * end:g} ms; allowed: rising times within "
            f"{1e3 * all_times[0]:g} to {1e3 * all_times[-1]:g} ms"
        )
    for name, value, most in (("--slow", cut.slow, 1e6), ("--magnify", cut.magnify, 1e9)):
        if value is not None and not 0.0 < value <= most:
            raise OutputError(f"{name} has value {value:g}; allowed: above 0, up to {most:g}")
    refuse_unknown(OutputError, "--show has value {}", cut.shown, SHOWN)
    width, height = cut.size
    if not (64 <= width <= 4096 and 64 <= height <= 4096 and width % 2 == height % 2 == 0):
        raise OutputError(f"--size has value {width}x{height}; allowed: even numbers from 64 to 4096")
    return start + np.arange(0.0, end - start, 1.0 / (FPS * cut.slow))


def _look(result: xr.DataTree, cut: Cut, times: Float) -> _Look:
    skins = {name: skin for name, skin in instances(result, "skin").items() if has_records(skin, "displacement")}
    if not skins or not instances(result, "array"):
        raise OutputError("the result contains no displacement of a skin, or no array; run at least one step with both")
    most = max(float(extremes(skin).peak.max()) for skin in skins.values())
    magnify = cut.magnify if cut.magnify is not None else rounded_down(DISPLAYED_M / most) if most > 0.0 else 1.0
    lacking = [name for name, skin in skins.items() if not has_records(skin, cut.shown)]
    if lacking:
        raise OutputError(f"the result contains no {cut.shown} of skin '{lacking[0]}'; give another quantity by --show")
    if cut.shown == "arp":
        top, unit = max(float(skin["arp"].max()) for skin in skins.values()), "Pa"
        low, colours = 0.0, colormaps["magma_r"](np.linspace(0.05, 0.85, 256))
    else:
        top = IN_MICRO * max(float(extremes(skin, cut.shown).peak.max()) for skin in skins.values())
        unit, low = UNITS["velocity" if cut.shown == "velocity" else "displacement"], -top
        colours = np.zeros((0, 4))
    groups = instances(result, "body")
    moments = times[np.unique(np.linspace(0, len(times) - 1, POSES).astype(int))].tolist()
    surfaces = instances(result, "surface")
    whole = {name: surfaces.get(name, skin) for name, skin in skins.items()}
    points = np.concatenate([in_world(mesh, groups.get(name), t) for name, mesh in whole.items() for t in moments])
    first = next(iter(instances(result, "array").values()))
    width, height = cut.size
    window = (0.0, 0.10 * height, 0.88 * width, 0.88 * height)
    camera = look_along_emission(points, pose_at(first, moments[0]), window)
    limits = cut.limits or (low, max(top, low + 1e-12))
    if cut.shown != "arp":
        colours = signed_colours(*limits, cut_off=0.02)
    around: dict[str, xr.Dataset] = {}
    for on_body in bodies(result).values():
        own = [name for name in on_body if name in skins]
        # Skins on one body share its surface
        first_own = next((name for name in own if name in surfaces), None)
        if first_own is not None:
            around[first_own] = sunk(surfaces[first_own], [skins[name] for name in own])
    return _Look(skins, around, camera, ListedColormap(colours), limits, unit, magnify)


class _Frame:
    """Canvas that is redrawn for each frame of the video."""

    def __init__(self, look: _Look, cut: Cut) -> None:
        self._look, self._cut = look, cut
        width, height = cut.size
        dpi = DPI * min(width / DRAWN_FOR[0], height / DRAWN_FOR[1])
        # The size of a canvas is truncated, not rounded, to whole pixels
        self._figure = Figure(figsize=((width + 0.01) / dpi, (height + 0.01) / dpi), dpi=dpi)
        self._canvas = FigureCanvasAgg(self._figure)
        # The canvas contains only text, because drawing an image in Matplotlib is slower than composing it
        self._figure.patch.set_alpha(0.0)
        axes = self._figure.add_axes((0.0, 0.0, 1.0, 1.0), xlim=(0, width), ylim=(height, 0))
        axes.set_axis_off()
        self._clock = self._figure.text(0.025, 0.915, "", fontsize=10, color="#444444", va="center")
        what = "ARP" if cut.shown == "arp" else f"Normal {cut.shown}"
        self._figure.text(0.025, 0.955, f"{what} on the skin", fontsize=13, fontweight="bold", va="center")
        bar = self._figure.add_axes((0.90, 0.18, 0.018, 0.56))
        scale = ScalarMappable(Normalize(*look.limits), look.colours)
        self._figure.colorbar(scale, cax=bar).outline.set_visible(False)
        bar.set_title(look.unit, fontsize=9, loc="left", fontweight="normal")
        self._axes = axes
        self._scale_bar: list[Any] = []

    def image(self, result: xr.DataTree, time_s: float) -> Any:
        """Return the picture at a time, uint8, shape (height, width, 3)."""
        look, cut = self._look, self._cut
        meshes, levels, parts = [], [], []
        groups, surfaces = instances(result, "body"), instances(result, "surface")
        for name, skin in look.skins.items():
            index = nearest(skin["time"].values, time_s)
            vertices = in_world(skin, groups.get(name), time_s)
            mesh = trimesh.Trimesh(vertices, skin["face"].values, process=False)
            now = slice(index, index + 1)
            push = normal_component(skin, "displacement", now).values[0].astype(float)
            if cut.shown == "arp":
                shown = skin["arp"].isel(time=index).values.astype(float)
            else:
                shown = IN_MICRO * normal_component(skin, cut.shown, now).values[0].astype(float)
            outward = np.array(mesh.vertex_normals)
            mesh.vertices = vertices + look.magnify * push[:, None] * outward
            meshes.append(mesh)
            low, high = look.limits
            levels.append(np.clip((shown - low) / (high - low), 0.0, 1.0))
            if name in look.around:
                faces = surfaces[name]["face"].values
                # Shaded with normals of the true surface: the edge of the lowered part would darken the body next to it
                normals = smooth_normals(in_world(surfaces[name], groups.get(name), time_s), faces)[faces.ravel()]
                corners = in_world(look.around[name], groups.get(name), time_s)[faces.ravel()]
                triangles = np.arange(len(corners)).reshape(-1, 3)
                body = trimesh.Trimesh(corners, triangles, vertex_normals=normals, process=False)
                at_rest = look.colours(float(np.clip(-low / (high - low), 0.0, 1.0)))[:3]
                parts.append(Part(body, at_rest, 0.05, 1.0))
        painted = joined(meshes)
        picture = cast(painted, np.concatenate(levels), parts, look.camera, cut.size, look.colours, QUALITY)
        self._clock.set_text(
            f"{1e3 * time_s:.2f} ms, {cut.slow:g} times slower; motion magnified {look.magnify:,.0f} times"
        )
        if not self._scale_bar:
            self._draw_scale(painted.vertices)
        self._canvas.draw()
        written = np.asarray(self._canvas.buffer_rgba())
        opacity = written[..., 3:].astype(np.float32) / 255.0
        mixed = opacity * written[..., :3] + (1.0 - opacity) * (255.0 * picture)
        return (mixed + 0.5).astype(np.uint8)

    def _draw_scale(self, points: Float) -> None:
        """Draw a scale bar with a round length, at the distance of the centre of the skin."""
        camera, middle = self._look.camera, points.mean(axis=0)
        ends = camera.project(np.stack([middle, middle + 0.01 * camera.right]))
        pixels_a_cm = float(np.linalg.norm(ends[1] - ends[0]))
        width, height = self._cut.size
        length_mm = 10.0 * rounded_down(max(0.18 * width / pixels_a_cm, 1e-3))
        end = 0.03 * width + 0.1 * length_mm * pixels_a_cm
        y = 0.955 * height
        self._scale_bar = self._axes.plot([0.03 * width, end], [y, y], "-", color="#333333", lw=2.5)
        self._axes.text(0.03 * width, y - 0.012 * height, f"{length_mm:g} mm", fontsize=9, color="#333333")


@contextlib.contextmanager
def _encoder(path: Path, size: tuple[int, int]) -> Iterator[Callable[[Any], None]]:
    """Yield a function that writes pictures, uint8, shape (height, width, 3). An interrupted video can be played."""
    try:
        av = importlib.import_module("av")
    except ImportError:
        raise OutputError("a film needs PyAV; install the extra: pip install 'palmfield[video]'") from None
    temporary = path.with_name(f".{path.stem}.tmp.mp4")
    try:
        temporary.touch()
        # Fragments, so that an incomplete file is readable
        container = av.open(str(temporary), "w", options={"movflags": "frag_keyframe+empty_moov+default_base_moof"})
        stream = container.add_stream("libx264", rate=FPS)
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "20", "preset": "veryfast", "g": str(FPS)}

        def add(picture: Any) -> None:
            for packet in stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")):
                container.mux(packet)

        try:
            yield add
        finally:
            for packet in stream.encode():
                container.mux(packet)
            container.close()
        os.replace(temporary, path)
    except OSError as error:
        raise unwritable(path, error) from None
    finally:
        temporary.unlink(missing_ok=True)
