"""Picture of the sound of a scene in a MuJoCo viewer: foci, transducers, and ARP on the skins.

The picture is computed separately from the simulation, from poses and stimuli only, so a viewer does not change a run.
Fast changes are averaged over an exposure of EXPOSURE_s, as by a camera.
"""

from typing import NamedTuple

import numpy as np
from matplotlib import colormaps

from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.engine.host import World
from palmfield.engine.scene_runtime import SceneRuntime
from palmfield.hand.split_edges import split_long_edges
from palmfield.simulation.cached import Cached
from palmfield.simulation.emission import Emission
from palmfield.simulation.posed_scene import PosedScene, posed_scene
from palmfield.simulation.radiation import Radiation
from palmfield.stimulus.schedule import factors_at
from palmfield.types import Complex, Float, Int

EXPOSURE_s = 0.02
MOMENTS = 23
"""Number of moments in an exposure. It is chosen so that usual modulation periods do not match it."""
EDGE_m = 0.002
"""Longest edge of the coloured triangles, a quarter of the wavelength of 40 kHz."""
FEW = 2
"""Number of different drives up to which the mean ARP is computed for each triangle.

With more drives the mean is smooth, and it is computed at the skin nodes and interpolated linearly.
"""
ALIKE = 1e-6
"""Largest relative difference between two drives that are treated as one drive at two levels."""
FAINT = 0.02
"""Fraction of the largest ARP below which the skin is not coloured."""
FULL = 0.25
"""Fraction of the largest ARP above which the colour is opaque."""
FOCUS: Float = np.array([0.0, 0.75, 0.65, 1.0])


class SeenTransducers(NamedTuple):
    """Commanded drive of an array during an exposure.

    places [m], axes: positions and directions in the world, shape (n, 3)
    levels: rms amplitude relative to full drive, shape (n,)
    phases: phase of each transducer when it next sounds [rad], positive for a delay, shape (n,)
    radius_m: radius of a transducer
    """

    places: Float
    axes: Float
    levels: Float
    phases: Float
    radius_m: float


class ShownSkin(NamedTuple):
    """Mean ARP on a skin during an exposure.

    vertices [m], normals: in the world, shape (v, 3)
    faces: shape (f, 3)
    arp: ARP at each vertex [Pa], shape (v,)
    top: largest ARP since the view began [Pa]
    """

    vertices: Float
    normals: Float
    faces: Int
    arp: Float
    top: float


class _Moment(NamedTuple):
    """Content of one exposure.

    posed: the pose
    times: times in the exposure [s], shape (k,)
    drives: commanded drives at these times, shape (k, N)
    units: the different drives, shape (N,) each, with the mean square of the level of each
    """

    posed: PosedScene
    times: Float
    drives: Complex
    units: list[tuple[Complex, float]]


class SceneView:
    """The picture of one mjData."""

    def __init__(self, runtime: SceneRuntime):
        self.runtime, self.model = runtime, runtime.model
        self._emission, self._radiation = Emission(runtime.model), Radiation(runtime.model)
        self._posed = runtime.work.reference
        self._positions, self._matrices = np.zeros((runtime.frames, 3)), np.zeros((runtime.frames, 9))
        self._reading = runtime.reading(self._positions, self._matrices)
        self._last: tuple[tuple[float, bytes, bytes], _Moment] | None = None
        self._cached = Cached()
        self._shown: dict[int, tuple[int, bytes, ShownSkin]] = {}
        self._top = 0.0

    def transducers(self, array: int) -> SeenTransducers:
        """Return the command of one array, by its number."""
        posed, _, drives, _ = self._now()
        part = posed.arrays.slices[array]
        mine, own = drives[:, part], posed.arrays.array
        sounding = mine[int(np.argmax(mine.any(axis=1)))]
        places, axes = posed.array_frame.surface(own.positions[part], own.normals[part])
        levels = np.sqrt(np.mean(np.abs(mine) ** 2, axis=0))
        return SeenTransducers(places, axes, levels, np.angle(sounding), posed.arrays.parts[array].piston_radius_m)

    def foci(self, stimulus: int) -> Float:
        """Return the foci of a stimulus during the exposure, in order of time [m], world, shape (k, m, 3).

        In silence the shape is (0, m, 3).
        """
        posed, times, _, _ = self._now()
        foci = self._emission.foci(posed, times)[stimulus]
        sounding = foci[factors_at(self.model.configs[stimulus], times) > 0.0]
        return posed.array_frame.points(sounding.reshape(-1, 3)).reshape(sounding.shape)

    def skin(self, number: int) -> ShownSkin | None:
        """Return the ARP on one skin.

        Returns None in silence, and for a scattering body whose field the run has not computed.
        """
        posed, _, _, units = self._now()
        key = b"".join(unit.tobytes() + np.float64(weight).tobytes() for unit, weight in units)
        cached = self._shown.get(number)
        if cached is not None and cached[:2] == (posed.serial, key):
            return cached[2]._replace(top=self._top)
        part = self.model.skins[number]
        carry, faces = self._cached.of(("mesh", number), (), split_long_edges, part.nodes[0], part.faces, EDGE_m)
        nodes, directions = posed.skins[number].nodes
        points, normals = carry @ nodes, carry @ directions
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        if len(units) <= FEW:
            arp = self._arp(posed, number, points, normals, units)
        else:
            coarse = self._arp(posed, number, nodes, directions, units)
            arp = None if coarse is None else carry @ coarse
        if arp is None:
            return None
        self._top = max(self._top, float(arp.max()))
        shown = ShownSkin(*posed.array_frame.surface(points, normals), faces, arp, self._top)
        self._shown[number] = posed.serial, key, shown
        return shown

    def _arp(
        self, posed: PosedScene, skin: int, points: Float, normals: Float, units: list[tuple[Complex, float]]
    ) -> Float | None:
        """Return the mean ARP [Pa] at points of a skin, given in the array frame, shape (n, 3).

        Returns None as `skin` does.
        """
        if not units:
            return None
        kind = self.model.skins[skin].spec.config.body_sound
        if kind != "scattering":
            weights = np.array([weight for _, weight in units])
            if kind == "none":
                drives = np.array([unit for unit, _ in units])
                inputs = posed.arrays.field, len(points), self.model.skins[skin].spec.arp_law
                field = self._cached.of(("field", skin, len(points)), posed.arrays.serial, SurfaceArp, *inputs)
                sounds = field.evaluate_many(points, normals, drives)
            else:
                many = [self._radiation.at(posed, skin, "vertices", points, normals, unit).arp for unit, _ in units]
                sounds = np.array(many)
            return np.asarray(weights @ sounds, dtype=np.float64)
        solution = self.runtime.work.radiation.solution(skin)
        if solution is None or len(units) > 1:
            return None
        level = _level(units[0][0], solution.drive)
        if level is None or solution.posed.skins[skin] is not posed.skins[skin]:
            return None
        own = posed.skins[skin].body.frame.inverse_points(points)
        return np.asarray(units[0][1] * level * solution.at(own).arp, dtype=np.float64)

    def _now(self) -> _Moment:
        """Compute the exposure that begins at the present MuJoCo time."""
        runtime = self.runtime
        for read in self._reading:
            read()
        key = runtime.view.time, self._positions.tobytes(), self._matrices.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        rotations = self._matrices.reshape(-1, 3, 3)
        reference = runtime.work.reference
        self._posed = posed_scene(self.model, runtime.layout, self._positions, rotations, self._posed, reference)
        self._emission.held = list(runtime.work.emission.held)
        times = key[0] + EXPOSURE_s / MOMENTS * np.arange(MOMENTS, dtype=np.float64)
        drives = self._emission.commanded(self._posed, times)
        moment = _Moment(self._posed, times, drives, _units(drives))
        self._last = key, moment
        return moment


def view_of(world: World) -> SceneView | None:
    """Return the view of the scene of an mjData, made when the scene is first drawn.

    Returns None if there is nothing to draw. Before its first step, a viewer draws data without computed positions; the
    result is None for these data too.
    """
    scene = world.scene
    if scene is None or not scene.view.frames["site"][1][scene.binding.array_sites[0]].any():
        return None
    if world.view is None or world.view.model is not scene.model:
        world.view = SceneView(scene)
    view: SceneView = world.view
    return view


def _units(drives: Complex) -> list[tuple[Complex, float]]:
    """Return the different drives among several, (k, N), each with the mean square of its level; empty in silence."""
    units: list[tuple[Complex, float]] = []
    for drive in drives[drives.any(axis=1)]:
        for number, (unit, weight) in enumerate(units):
            level = _level(drive, unit)
            if level is not None:
                units[number] = unit, weight + level / len(drives)
                break
        else:
            units.append((drive, 1.0 / len(drives)))
    return units


def _level(drive: Complex, unit: Complex) -> float | None:
    """Return the power of a drive relative to a unit drive, both of shape (N,).

    Returns None if the drive is not a multiple of the unit drive.
    """
    factor = np.vdot(unit, drive) / np.vdot(unit, unit).real
    apart = np.abs(drive - factor * unit).max()
    return float(abs(factor) ** 2) if apart <= ALIKE * np.abs(drive).max() else None


def arp_colours(shares: Float) -> Float:
    """Return a colour for each ARP value: red, green, blue and opacity, shape (n, 4).

    shares: ARP relative to the largest ARP, shape (n,)
    """
    colours = np.array(colormaps["magma_r"](0.07 + 0.75 * np.clip(shares, 0.0, 1.0)))
    colours[:, 3] = np.clip((shares - FAINT) / (FULL - FAINT), 0.0, 1.0)
    return colours


def phase_colours(phases: Float) -> Float:
    """Return colours of phases [rad], shape (n,), on a cyclic scale, shape (n, 4)."""
    return np.array(colormaps["twilight"](np.mod(phases, 2.0 * np.pi) / (2.0 * np.pi)))
