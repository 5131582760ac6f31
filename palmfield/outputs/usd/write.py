"""Write a result as a USD scene, frame by frame, so that memory does not grow with the run; foci, paths and legend."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import xarray as xr
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.ticker import MaxNLocator
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, Vt
from scipy.spatial import Delaunay

from palmfield.errors import OutputError
from palmfield.outputs.camera import Camera, look_along_emission
from palmfield.outputs.frames import IDENTITY, bodies, in_world, pose_at, to_world
from palmfield.outputs.levels import FLOOR_DB, LevelCourse, level_course
from palmfield.outputs.schema import MUJOCO_SCENE, has_records, instances
from palmfield.outputs.style import rounded_down
from palmfield.outputs.usd.arrays import ArrayWriter
from palmfield.outputs.usd.bodies import SKIN_COLOUR, BodyWriter, identifiers
from palmfield.outputs.usd.clock import Clock, clock_of
from palmfield.outputs.usd.field import add_field
from palmfield.outputs.usd.looks import (
    COLOURS,
    LEGEND_SHARE,
    PICTURE,
    Palette,
    add_camera,
    add_lights,
    add_material,
    indices_of,
    paint,
    palette_of,
)
from palmfield.outputs.usd.physics import PhysicsWriter
from palmfield.outputs.usd.prims import about, add_lines, add_mesh, integers, vectors
from palmfield.outputs.usd.quantities import QUANTITIES, Quantity
from palmfield.outputs.usd.samples import Samples
from palmfield.outputs.usd.shown import NO_COLOUR, Shown, check_shown
from palmfield.outputs.usd.skins import SkinWriter, frame_blocks, ranges_of, recorded_quantities, result_times
from palmfield.outputs.usd.stage_file import SAVE_EVERY, StageFile, unwritable_scene
from palmfield.types import Float, Int

FPS = 30.0
FIELD_LEGEND_SHARE = 0.17
"""Fraction of the picture width that the field legend uses, if skins are coloured too."""
DISPLAYED_M = 2e-3
"""Displayed size of the largest motion at the default magnification [m]."""
POINTS_BYTES = 8_000_000
"""Largest size of magnified points that are written by default [bytes]."""
FOCUS_COLOUR = (0.06, 0.04, 0.55)
PATH_COLOUR = (0.20, 0.18, 0.75)
ARM_M = 3e-3
WIDTH_M = 6e-4
RESTS_M = 1e-6
MOST_POINTS = 2000
CROSS = ARM_M * np.stack([sign * np.eye(3)[k] for k in range(3) for sign in (-1.0, 1.0)])
INK = (0.02, 0.02, 0.02)
TALL = 0.55
"""Height of the bar as a fraction of the picture height."""
WIDE = 0.06
"""Width of the whole legend as a fraction of the height of the bar."""
TEXT = 0.05
STEPS_A_LETTER = 14.0


class _Writer(Protocol):
    def write(self, clock: Clock, frames: slice) -> None: ...


class _Ranges(NamedTuple):
    """Ranges of quantities.

    own: range by skin and quantity
    courses: level over time by skin
    missing: reasons why quantities are missing
    """

    own: dict[str, dict[str, tuple[float, float]]]
    courses: dict[str, LevelCourse]
    missing: list[str]

    def whole(self, name: str) -> tuple[float, float] | None:
        """Return the lowest and highest value of a quantity over all skins; None if no skin has it."""
        found = [ranges[name] for ranges in self.own.values() if name in ranges]
        return (min(low for low, _ in found), max(high for _, high in found)) if found else None


def write_usd(
    result: xr.DataTree,
    path: str | Path,
    shown: Shown | None = None,
    fps: float = FPS,
    on_frame: Callable[[int, int], None] | None = None,
) -> None:
    """Write a result as a USD scene: .usdc (crate), .usda (text) or .usdz (package), by the suffix.

    result: as returned by `open_result` or `tree`
    shown: contents, see `Shown`
    fps: frames per second for players [1/s], independent of the time step of the run
    on_frame: function that is called with the number of completed time codes and the number of all time codes
    Units are metres and kilograms, and z points up. Time code / timeCodesPerSecond is the time of the run in seconds.
    docs/usd.md lists prims and primvars. Every 200 frames the scene is saved and copied to NAME.partial.usdc, which
    remains after a kill, and is removed when the scene is complete.
    Raises OutputError if `path` cannot be written or has an unknown suffix, for invalid numbers, and for a colour or a
    field that the result does not contain.
    """
    contents = shown or Shown()
    check_shown(contents)
    if not fps > 0:
        raise OutputError(f"frames per second is {fps}; allowed: above 0")
    clock = clock_of(result, contents)
    with _written(StageFile(Path(path))) as file:
        _write(result, file, contents, clock, fps, on_frame)


@contextmanager
def _written(file: StageFile) -> Iterator[StageFile]:
    try:
        yield file
        file.finish()
    except (OSError, Tf.ErrorException) as error:
        raise unwritable_scene(file.path, error) from error
    finally:
        file.clear()


def _write(
    result: xr.DataTree,
    file: StageFile,
    shown: Shown,
    clock: Clock,
    fps: float,
    on_frame: Callable[[int, int], None] | None,
) -> None:
    stage = file.stage
    root = file.begin(clock.per_second, fps)
    add_material(stage)
    arrays, stimuli, skins = (instances(result, kind) for kind in ("array", "stimulus", "skin"))
    for scope in ("Arrays", "Bodies", "Stimuli"):
        UsdGeom.Scope.Define(stage, f"/Scene/{scope}")
    writers: list[_Writer] = [
        ArrayWriter(stage, f"/Scene/Arrays/{prim}", arrays[name]) for name, prim in identifiers(arrays).items()
    ]
    ranges = _ranges(result, shown, clock)
    palette = _palette(shown, ranges)
    # Skin at rest has the colour of its body, so that its rim is not visible
    standing = _add_bodies(stage, result, SKIN_COLOUR if palette is None else palette.at_rest)
    skin_writers = {name: writer for body in standing for name, writer in body.skins.items()}
    for name, skin_writer in skin_writers.items():
        _add_quantities(skin_writer, name, skins[name], shown, clock, ranges, palette)
    writers += [*standing, *skin_writers.values()]
    writers += [
        StimulusWriter(stage, f"/Scene/Stimuli/{prim}", stimuli[name], clock)
        for name, prim in identifiers(stimuli).items()
    ]
    scene = instances(result, "mujoco").get(MUJOCO_SCENE)
    physics = [] if scene is None else [PhysicsWriter(stage, scene)]
    writers += physics
    field = add_field(stage, result, shown, clock) if shown.field else None
    _add_view(stage, result, shown, clock, palette, field)
    _label(stage, root, result, shown, clock, ranges)
    if len(clock.codes) == 0:
        for body in standing:
            body.stand()
        for one in physics:
            one.stand()
        return
    stage.SetStartTimeCode(float(clock.codes[0]))
    stage.SetEndTimeCode(float(clock.codes[-1]))
    times = Samples(root.GetAttribute("palmfield:time_s"), float)
    largest = max(skins.values(), key=lambda skin: skin.sizes["vertex"], default=None)
    for frames in frame_blocks(largest, clock, SAVE_EVERY):
        for writer in writers:
            writer.write(clock, frames)
        times.extend(clock.codes[frames].tolist(), clock.times_s[frames])
        if frames.stop < len(clock.codes):
            file.save(float(clock.codes[frames.stop - 1]))
        if on_frame is not None:
            on_frame(frames.stop, len(clock.codes))
    stage.SetEndTimeCode(float(clock.codes[-1]))


def _add_bodies(stage: Usd.Stage, result: xr.DataTree, colour: tuple[float, ...]) -> list[BodyWriter]:
    skins, surfaces = instances(result, "skin"), instances(result, "surface")
    groups, forces = instances(result, "body"), instances(result, "forces")
    named = bodies(result)
    made = []
    for name, prim in identifiers(named).items():
        own = named[name]
        on_it = [surfaces[one] for one in own if one in surfaces]
        made.append(
            BodyWriter(
                stage, f"/Scene/Bodies/{prim}", groups.get(own[0]), forces.get(own[0]), on_it,
                {one: skins[one] for one in own}, colour,
            )
        )  # fmt: skip
    return made


def _ranges(result: xr.DataTree, shown: Shown, clock: Clock) -> _Ranges:
    """Return ranges of all written quantities; missing ones are omitted and reported."""
    ranges = _Ranges({}, {}, [])
    if len(clock.codes) == 0:
        return ranges
    names = list(QUANTITIES) if shown.quantities is None else list(shown.quantities)
    if shown.colour not in (*names, NO_COLOUR):
        names.append(shown.colour)
    for name, skin in instances(result, "skin").items():
        recorded = recorded_quantities(skin)
        ranges.own[name] = ranges_of(skin, clock, [one for one in names if one in recorded])
        ranges.missing.extend(f"{name}: {one}: the result does not store it over time" for one in names
                              if one not in recorded and one != "level")  # fmt: skip
        if "level" not in names:
            continue
        try:
            course = ranges.courses[name] = level_course(result, name, shown.observer)
        except OutputError as error:
            ranges.missing.append(f"{name}: level: {error}")
            continue
        windows = range(course.window_at(float(clock.times_s[0])), course.window_at(float(clock.times_s[-1])) + 1)
        found = [course.levels(window) for window in windows]
        ranges.own[name]["level"] = min(float(one.min()) for one in found), max(float(one.max()) for one in found)
    return ranges


def _palette(shown: Shown, ranges: _Ranges) -> Palette | None:
    """Return the palette of the requested colour. Returns None if no colour is requested, and for a run without times.

    Raises OutputError if no skin has the quantity. If the quantity is the default one, it only omits the colours.
    """
    whole = None if shown.colour == NO_COLOUR else ranges.whole(shown.colour)
    if whole is None:
        why = [text for text in ranges.missing if f": {shown.colour}: " in text]
        if why and shown.colour != Shown().colour:
            raise OutputError(f"'{shown.colour}' is not available for any skin: {why[0]}")
        return None
    limits = shown.limits
    if limits is None and shown.colour == "level":
        limits = 0.0, max(1.0, whole[1])
    return palette_of(*whole, QUANTITIES[shown.colour].two_sided, limits)


def _add_quantities(
    writer: SkinWriter,
    name: str,
    skin: xr.Dataset,
    shown: Shown,
    clock: Clock,
    ranges: _Ranges,
    palette: Palette | None,
) -> None:
    for quantity, (low, high) in ranges.own.get(name, {}).items():
        facts = {}
        if quantity == "level":
            course = ranges.courses[name]
            writer.set_levels(course)
            facts = {"observer": shown.observer, "window_s": course.window_s, "floor_dB": FLOOR_DB}
        writer.add_quantity(quantity, low, high, palette if quantity == shown.colour else None, **facts)
    factor = _magnification(shown, clock, ranges, skin)
    if factor > 0.0:
        writer.magnify(factor)


def _magnification(shown: Shown, clock: Clock, ranges: _Ranges, skin: xr.Dataset) -> float:
    """Return the magnification of the motion of a skin, equal for all skins; 0 for no magnified points."""
    if shown.magnify is not None:
        return shown.magnify if has_records(skin, "displacement") and len(clock.codes) else 0.0
    whole = ranges.whole("normal_displacement")
    most = 0.0 if whole is None else max(map(abs, whole))
    if most == 0.0 or 12 * skin.sizes["vertex"] * len(clock.codes) > POINTS_BYTES:
        return 0.0
    return rounded_down(DISPLAYED_M / most)


def _add_view(
    stage: Usd.Stage, result: xr.DataTree, shown: Shown, clock: Clock, palette: Palette | None, field: Palette | None
) -> None:
    """Add camera, lights, and the legends of colours of skins and field."""
    times = clock.times_s if len(clock.codes) else np.zeros(1)
    points = _points(result, [float(times[0]), float(times[len(times) // 2]), float(times[-1])])
    if len(points) == 0:
        return
    if field is not None:
        points = np.concatenate([points, _corners(stage.GetPrimAtPath("/Scene/Field"))])
    first = next(iter(instances(result, "array").values()), None)
    width, height = PICTURE
    left = 0.0 if field is None or palette is None else FIELD_LEGEND_SHARE * width
    window = (left, 0.0, LEGEND_SHARE * width - left, float(height))
    camera = look_along_emission(points, IDENTITY if first is None else pose_at(first, float(times[0])), window)
    depth = float(((points - camera.eye) @ camera.forward).mean())
    add_camera(stage, camera, 2.0 * depth)
    add_lights(stage, camera)
    _add_legends(stage, shown, palette, field, camera, depth)


def _add_legends(
    stage: Usd.Stage, shown: Shown, palette: Palette | None, field: Palette | None, camera: Camera, depth_m: float
) -> None:
    if palette is not None:
        add_legend(stage, "/Scene/Legend", shown.colour, QUANTITIES[shown.colour], palette, camera, depth_m)
    if field is not None:
        # Place the legend of the field on the left if skins have a legend too
        shift = 0.0 if palette is None else LEGEND_SHARE * PICTURE[0]
        left = camera._replace(centre=camera.centre + np.array([shift, 0.0]))
        add_legend(stage, "/Scene/FieldLegend", "pressure", QUANTITIES["pressure"], field, left, depth_m)


def _corners(root: Usd.Prim) -> Float:
    """Return corners of bounding boxes of the geometry under a prim, shape (n, 3)."""
    ends = np.concatenate(
        [np.array(UsdGeom.Boundable(one).GetExtentAttr().Get(), float)[None] for one in root.GetChildren()]
    )
    sides = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1]), axis=-1).reshape(-1, 3)
    return np.concatenate([ends[:, sides[:, k], k].reshape(-1, 1) for k in range(3)], axis=1)


def _points(result: xr.DataTree, times: list[float]) -> Float:
    """Return points of all bodies and arrays at some times, in the world [m], shape (n, 3)."""
    groups, surfaces = instances(result, "body"), instances(result, "surface")
    found: list[Float] = []
    for time_s in dict.fromkeys(times):
        now = [np.empty((0, 3))]
        for name, skin in instances(result, "skin").items():
            now.append(in_world(surfaces.get(name, skin), groups.get(name), time_s))
        for array in instances(result, "array").values():
            now.append(to_world(array["transducer_position"].values, pose_at(array, time_s)))
        # Of a scene that stands still, the points at one time are enough
        if not found or not np.array_equal(found[-1], np.concatenate(now)):
            found.append(np.concatenate(now))
    return np.concatenate(found)


def _label(stage: Usd.Stage, root: Usd.Prim, result: xr.DataTree, shown: Shown, clock: Clock, ranges: _Ranges) -> None:
    """Describe the file in customLayerData of the root layer."""
    facts: dict[str, str | float] = {
        "scene": str(result.attrs.get("scene", "")),
        "colour": shown.colour,
        "left_out": "; ".join(ranges.missing),
    }
    if len(clock.codes):
        facts |= {
            "start_s": float(clock.times_s[0]),
            "seconds_per_time_code": 1.0 / clock.per_second,
            "stride": clock.places.step,
        }
    stage.GetRootLayer().customLayerData = {"palmfield": facts}
    attribute = root.CreateAttribute("palmfield:time_s", Sdf.ValueTypeNames.Double, custom=True)
    about(attribute, units="s", sign="from the start of the run")


class StimulusWriter:
    """Writes one stimulus: positions of its foci, and whether it is active (USD visibility).

    The prim contains Foci, a cross of three lines at each focus, and Path, a line for each focus that moves. The
    attribute palmfield:foci contains the foci [m].
    """

    def __init__(self, stage: Usd.Stage, path: str, stimulus: xr.Dataset, clock: Clock):
        self._stimulus = stimulus
        prim = UsdGeom.Xform.Define(stage, path).GetPrim()
        self._live = has_records(stimulus, "foci", "sounding") and len(clock.codes) > 0
        if not self._live:
            return
        whole = result_times(clock, slice(0, len(clock.codes)))
        step = whole.step * max(1, len(clock.codes) // MOST_POINTS)
        foci = stimulus["foci"].isel(time=slice(whole.start, whole.stop, step)).values
        lines = [line for focus in foci[0] for line in (focus + CROSS).reshape(3, 2, 3)]
        crosses = add_lines(stage, f"{path}/Foci", lines, WIDTH_M, FOCUS_COLOUR)
        # Extent of the whole path, for viewers that do not read it over time
        low, high = foci.min(axis=(0, 1)) - ARM_M - WIDTH_M, foci.max(axis=(0, 1)) + ARM_M + WIDTH_M
        crosses.GetExtentAttr().Set(Vt.Vec3fArray([Gf.Vec3f(*low.tolist()), Gf.Vec3f(*high.tolist())]))
        ways = [way for way in np.moveaxis(foci, 1, 0) if np.ptp(way, axis=0).max() > RESTS_M]
        if ways:
            add_lines(stage, f"{path}/Path", ways, 0.5 * WIDTH_M, PATH_COLOUR)
        attribute = prim.CreateAttribute("palmfield:foci", Sdf.ValueTypeNames.Double3Array, custom=True)
        about(attribute, units="m", sign="focal points in the world, also while the stimulus is silent")
        self._samples = (
            Samples(crosses.GetPointsAttr(), vectors),
            Samples(attribute, lambda points: Vt.Vec3dArray.FromNumpy(np.ascontiguousarray(points))),
            Samples(crosses.CreateVisibilityAttr(), lambda on: "inherited" if on else "invisible"),
        )

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones."""
        if not self._live:
            return
        times = result_times(clock, frames)
        foci = self._stimulus["foci"].isel(time=times).values
        sounding = self._stimulus["sounding"].isel(time=times).values
        crosses, places, visible = self._samples
        codes = clock.codes[frames].tolist()
        crosses.extend(codes, (foci[:, :, None] + CROSS).reshape(len(codes), -1, 3))
        places.extend(codes, foci)
        visible.extend(codes, sounding)


def add_legend(
    stage: Usd.Stage, path: str, name: str, quantity: Quantity, palette: Palette, camera: Camera, depth_m: float
) -> None:
    """Add the legend of a quantity in the right part of the picture, at a distance [m] from the camera.

    Its customData contains the quantity, low and high in the unit of the primvar, and the ticks in this unit and in the
    displayed unit.
    """
    root = UsdGeom.Xform.Define(stage, path)
    pixel = depth_m / camera.focal
    height = TALL * PICTURE[1] * pixel
    left = (LEGEND_SHARE + 0.02) * PICTURE[0] - camera.centre[0]
    corner = camera.eye + depth_m * camera.forward + pixel * left * camera.right
    corner = corner + (pixel * (camera.centre[1] - 0.5 * PICTURE[1]) - 0.5 * height) * camera.up

    def placed(flat: Float) -> Float:
        return corner + height * (flat[:, :1] * camera.right + flat[:, 1:] * camera.up)

    rows = np.linspace(0.0, 1.0, COLOURS + 1)
    sides = np.stack([np.zeros(COLOURS + 1), rows], axis=1), np.stack([np.full(COLOURS + 1, WIDE), rows], axis=1)
    lower = np.arange(COLOURS)
    right = lower + COLOURS + 1
    quads = np.stack([lower, right, right + 1, lower + 1], axis=1)
    bar = add_mesh(stage, f"{path}/Bar", placed(np.concatenate(sides)), quads, None)
    colour = paint(bar, palette, "uniform", quantity=name, units=quantity.unit)
    indices_of(colour).Set(integers(lower))
    low, high = quantity.per_unit * palette.low, quantity.per_unit * palette.high
    ticks: Float = np.asarray(MaxNLocator(7, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))
    ticks = ticks[(ticks >= low - 1e-9 * (high - low)) & (ticks <= high + 1e-9 * (high - low))]
    heights = (ticks - low) / (high - low)
    about(
        root.GetPrim(), quantity=name, units=quantity.unit, low=palette.low, high=palette.high, map=palette.map,
        ticks=(ticks / quantity.per_unit).tolist(), shown_ticks=ticks.tolist(),
        shown_units=quantity.shown_unit,
    )  # fmt: skip
    marks = np.concatenate([_box(WIDE, WIDE + 0.02, at - 0.002, at + 0.002) for at in heights])
    add_mesh(stage, f"{path}/Ticks", placed(marks), np.arange(len(marks)).reshape(-1, 4), INK)
    texts = [(WIDE + 0.03, at - 0.35 * TEXT, f"{0.0 if abs(tick) < 1e-12 else tick:g}".replace("-", "\u2212"))
             for at, tick in zip(heights, ticks, strict=True)]  # fmt: skip
    lines = [f"[{quantity.shown_unit}]", *reversed(quantity.title.split())]
    texts += [(0.0, 1.0 + (0.6 + 1.3 * number) * TEXT, line) for number, line in enumerate(lines)]
    points, faces = lettering(texts)
    add_mesh(stage, f"{path}/Labels", placed(points), faces, INK)


def _box(left: float, right: float, low: float, high: float) -> Float:
    return np.array([[left, low], [right, low], [right, high], [left, high]])


def lettering(texts: list[tuple[float, float, str]]) -> tuple[Float, Int]:
    """Return texts at positions as flat triangles: points, shape (n, 2), and triangles, shape (m, 3)."""
    points, faces, count = [], [], 0
    for x, y, text in texts:
        outline = TextPath((0.0, 0.0), text, size=1.0)
        rings = [ring for ring in map(np.asarray, outline.to_polygons()) if len(ring) > 3]
        dense = np.unique(np.concatenate([_dense(ring) for ring in rings]).round(6), axis=0)
        corners = dense[Delaunay(dense).simplices]
        # A triangle is part of a letter if an odd number of outlines encloses its centre
        inside = np.zeros(len(corners), bool)
        for ring in rings:
            inside ^= Outline(ring).contains_points(corners.mean(axis=1))
        kept = corners[inside].reshape(-1, 2)
        points.append(TEXT * kept + [x, y])
        faces.append(count + np.arange(len(kept)).reshape(-1, 3))
        count += len(kept)
    return np.concatenate(points), np.concatenate(faces)


def _dense(ring: Float) -> Float:
    """Return a closed outline whose point spacing is small compared with a letter."""
    parts = []
    for a, b in pairwise(ring):
        count = max(1, int(np.ceil(np.linalg.norm(b - a) * STEPS_A_LETTER)))
        parts.append(a + np.arange(count)[:, None] / count * (b - a))
    return np.concatenate(parts)
