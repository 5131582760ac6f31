"""Warn about skin patches that the sound does not reach during the motion: hidden, turned away, edge-on, too far.

This check before the run is cheap: it uses straight rays from the transducers at some moments.
"""

import math
from typing import NamedTuple

import numpy as np
import warp as wp

from palmfield.acoustics.shadow import shadow_mesh, visibility
from palmfield.hand.triangles import vertex_normals
from palmfield.planning.facts import turn_times
from palmfield.session.preview import Preview
from palmfield.simulation.model import HapticModel, StimulusModel
from palmfield.simulation.posed_scene import PosedScene
from palmfield.stimulus.schedule import frames_at
from palmfield.types import Float, Surface

MOMENTS, COURSE = 32, 16
"""Number of moments of a motion, and number of points of a path on fixed bodies, that are checked."""
POINTS = 48
"""Largest number of points of a patch."""
EDGE_ON = math.sin(math.radians(15.0))
"""Mean cosine between the skin normal and the rays to the transducers, below which a patch counts as edge-on."""
HIDDEN = 0.75
"""Visible fraction of the side that faces the array, below which a patch counts as hidden.

Its ARP is about half or less.
"""
CLEARANCE_M = 1e-3
"""Height above the skin at which rays begin [m]. Smooth patches may lie below the meshes of their bodies."""
KINDS = {
    "turned away": "skin '{skin}' faces away from the array at the focus of stimulus '{stimulus}'",
    "edge-on": "skin '{skin}' is edge-on to the array at the focus of stimulus '{stimulus}'",
    "hidden": "the focus of stimulus '{stimulus}' on skin '{skin}' is hidden from the array by a body or an obstacle",
    "too far": "the focus of stimulus '{stimulus}' is too far from skin '{skin}'",
}
"""Message for each kind of patch, see `Visibility.kind`."""


class Visibility(NamedTuple):
    """Visibility of a skin around its focus, from the transducers of a stimulus.

    If the focus is far from the skin, it is that of the whole layer. With arrays on several sides of a body, it is the
    visibility from the array with the best view.
    time_s: time [s]
    near: whether the focus is close to the skin
    facing: fraction of the rays to the transducers that leave on the outer side
    incidence: mean cosine between these rays and the normal, negative from behind
    lit: visible fraction of the area of the patch, if all transducers are equal
    """

    time_s: float
    near: bool
    facing: float
    incidence: float
    lit: float

    @property
    def kind(self) -> str | None:
        """Key of KINDS that applies, or None."""
        if not self.near:
            return "too far"
        if self.facing < 0.5:
            return "turned away"
        if self.incidence < EDGE_ON:
            return "edge-on"
        return "hidden" if self.lit < HIDDEN * self.facing else None


def hidden_patches(view: Preview) -> list[str]:
    """Return a sentence for each skin and each of KINDS that occurs, with how often it occurs and the visible fraction.

    A skin without a close focus is ignored. "Too far" is reported only if it is true at more than half of the moments.
    """
    result = []
    for skin, results in enumerate(_over_motion(view)):
        stimulus = max(range(len(results)), key=lambda number: sum(one.near for one in results[number]))
        found, model = results[stimulus], view.runtime.model
        if not any(one.near for one in found):
            continue
        for kind, words in KINDS.items():
            so = [one for one in found if one.kind == kind]
            if not so or (kind == "too far" and 2 * len(so) <= len(found)):
                continue
            often = "" if len(found) == 1 else f" at {len(so)} of {len(found)} moments, first at {so[0].time_s:.3g} s"
            share = 100.0 * sum(one.lit for one in so) / len(so)
            named = words.format(skin=model.skins[skin].spec.name, stimulus=model.stimuli[stimulus].spec.name)
            through = model.skins[skin].spec.config.body_sound == "none" and kind == "hidden"
            unseen = "; body_sound 'none' ignores this: set it to shadows" if through else ""
            result.append(f"{named}{often}; {share:.0f} % of the patch of the skin is lit then{unseen}")
    return result


def _over_motion(view: Preview) -> list[list[list[Visibility]]]:
    """Return the visibility by skin and stimulus, at times between start and stop of the stimulus.

    Without motion, the times are those of one turn of the path.
    """
    model = view.runtime.model
    result: list[list[list[Visibility]]] = [[[] for _ in model.stimuli] for _ in model.skins]
    moments = list(view.moments(MOMENTS))
    for now_s, posed in moments:
        mesh = shadow_mesh(_everything(posed), "cpu")
        for number, stimulus in enumerate(model.stimuli):
            if stimulus.silent:
                continue
            times = _sounding(stimulus, now_s) if len(moments) > 1 else turn_times(stimulus, COURSE)
            places = posed.focal_points(stimulus, number)
            for time_s, focus in zip(times, frames_at(stimulus.config, times)[0], strict=True):
                foci = np.atleast_2d(places.at(focus))
                for skin in range(len(model.skins)):
                    result[skin][number].append(_visibility(model, posed, skin, stimulus, foci, mesh, float(time_s)))
    return result


def _sounding(stimulus: StimulusModel, time_s: float) -> Float:
    """Return the time [s] if the stimulus is active then, shape (1,), or an empty array, shape (0,)."""
    config = stimulus.config
    on = config.start_s <= time_s < (math.inf if config.stop_s is None else config.stop_s)
    return np.full(int(on), time_s)


def _everything(posed: PosedScene) -> Surface:
    """Return one mesh, in the array frame, of all objects that can block sound."""
    parts = [(body.vertices_in_array, body.faces) for body in posed.bodies]
    parts += [skin.obstacles for skin in posed.skins if skin.obstacles is not None]
    firsts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [own + first for (_, own), first in zip(parts, firsts[:-1], strict=True)]
    vertices, triangles = np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)
    return Surface(vertices, triangles, vertex_normals(vertices, triangles))


def _visibility(
    model: HapticModel, posed: PosedScene, skin: int, stimulus: StimulusModel, foci: Float, mesh: wp.Mesh, time_s: float
) -> Visibility:
    layer = model.skins[skin].layer
    points, normals = posed.skins[skin].quadrature
    areas = layer.quadrature.weights
    reach_m = max(layer.demand.spot_fwhm_m, 2.0 * layer.sizes.edge_coarse_m)
    distance = np.linalg.norm(points[:, None] - foci[None], axis=2).min(axis=1)
    near = bool(distance.min() <= reach_m)
    # Elements may be larger than the spot; then use the nearest one
    spot_m = max(layer.demand.spot_fwhm_m, float(np.partition(distance, 5)[5]))
    patch = np.flatnonzero(distance <= spot_m) if near else np.arange(len(points))
    patch = patch[:: -(-len(patch) // POINTS)]
    points, normals, areas = points[patch], normals[patch], areas[patch] / areas[patch].sum()
    results = []
    for side in posed.arrays.sides:
        sources = posed.arrays.array.positions[np.intersect1d(side, stimulus.transducers)]
        if len(sources) == 0:
            continue
        ways = sources[None] - points[:, None]
        cosines = np.einsum("pst,pt->ps", ways / np.linalg.norm(ways, axis=2)[..., None], normals)
        facing, incidence = float(areas @ (cosines > 0.0).mean(axis=1)), float(areas @ cosines.mean(axis=1))
        lit = visibility(points, normals, mesh, sources, clearance_m=CLEARANCE_M)
        results.append(Visibility(time_s, near, facing, incidence, float(areas @ lit)))
    return max(results, key=lambda one: (one.kind is None, one.incidence))
