"""Warn about MuJoCo geoms between array and skin that are not obstacles. The simulated sound passes through them."""

from collections.abc import Iterable

import mujoco
import numpy as np

from palmfield.estimate.array_inputs import stimulus_of
from palmfield.session.preview import Preview
from palmfield.types import Float

POINTS, TRANSDUCERS = 8, 32
"""Number of skin points nearest to the focus, and number of transducers, between which test rays run."""
BEGIN_M, END_M = 1e-3, 5e-3
"""Distances between the ends of a ray and the skin or the transducers [m]. The board itself may have a geom."""
SHARE = 0.05
"""Fraction of blocked rays above which a warning is given."""
MOST_HITS = 64
"""Largest number of geoms that one ray may hit."""


def obstructions(view: Preview) -> list[str]:
    """Return a sentence for each skin and each body whose geoms are in the path of the sound, in the present pose.

    Bodies with skins or arrays, their descendants, and the bodies in key `obstacles` are ignored.
    """
    model, data, runtime = view.data.model, view.data, view.runtime
    expected = _expected(view)
    posed, result = runtime.posed, []
    for number, skin in enumerate(runtime.model.skins):
        stimulus = stimulus_of(runtime.model, number)
        part = runtime.model.stimuli[stimulus]
        points, normals = posed.skins[number].quadrature
        foci = np.atleast_2d(part.first_focus)
        distance = np.linalg.norm(points[:, None] - foci[None], axis=2).min(axis=1)
        near = np.argsort(distance)[:POINTS]
        sources = posed.arrays.array.positions[part.transducers]
        sources = posed.array_frame.points(sources[:: -(-len(sources) // TRANSDUCERS)])
        begins = posed.array_frame.points(points[near] + BEGIN_M * normals[near])
        met = [body for begin in begins for end in sources for body in _met(model, data, begin, end, expected)]
        for body in dict.fromkeys(met):
            share = met.count(body) / (len(begins) * len(sources))
            if share >= SHARE:
                name = model.body(body).name or f"number {body}"
                result.append(
                    f"a geom of body '{name}' blocks {100 * share:.0f} % of the lines from the array to skin "
                    f"'{skin.spec.name}', but the sound passes through it: list the body in key obstacles, with "
                    "body_sound shadows, or move it"
                )
    return result


def _expected(view: Preview) -> set[int]:
    """Return the bodies of skins and arrays, the bodies in key `obstacles`, and all their descendants."""
    model, binding = view.data.model, view.runtime.binding
    sites = [*binding.array_sites, *(site for own in binding.transducer_sites for site in own)]
    named = {name for skin in view.runtime.spec.skins for name in skin.config.obstacles}
    roots = {int(model.body_rootid[model.site_bodyid[site]]) for site in sites}
    roots |= {int(model.body_rootid[skin.body]) for skin in binding.skins}
    first = {model.body(name).id for name in named}
    return {
        body
        for body in range(model.nbody)
        if (model.body_rootid[body] in roots and model.body_rootid[body] != 0) or _ancestors(model, body) & first
    }


def _ancestors(model: mujoco.MjModel, body: int) -> set[int]:
    found = {body}
    while body != 0:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


def _met(model: mujoco.MjModel, data: mujoco.MjData, begin: Float, end: Float, expected: set[int]) -> Iterable[int]:
    """Yield the other bodies whose geoms a ray hits, each once.

    begin, end: ends of the ray in the world [m], shape (3,)
    """
    length = float(np.linalg.norm(end - begin)) - END_M
    way, travelled, found = (end - begin) / np.linalg.norm(end - begin), 0.0, set()
    geom = np.zeros(1, np.int32)
    for _ in range(MOST_HITS):
        step = mujoco.mj_ray(model, data, begin + travelled * way, way, None, 1, -1, geom)
        travelled += step + 1e-6
        if step < 0.0 or travelled > length:
            break
        body = int(model.geom_bodyid[geom[0]])
        if body not in expected:
            found.add(body)
    return found
