"""Response of some points of a skin to one sound: static, at the main frequency, and over time."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from palmfield.skin.approximation.estimate import largest_change
from palmfield.skin.reduction.reducer import PointModel, point_model
from palmfield.skin.scene_layer import SceneLayer
from palmfield.threads import cores, share
from palmfield.types import Complex, Float

MOST_AT_ONCE = 2
"""Largest number of parallel factorisations: each factor of a palm takes a third of a gigabyte."""
ROUND_SPOT = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
"""Points at which meshes are compared. The unit is a quarter of the spot width (a third of the usual edges). Errors may
cancel at one point: on a palm under 226 Hz, edges of 0.87 times the length changed the middle by 0.05 %, and these
points by 0.64 %, with a true error of 1.2 %."""


def points_of_spot(layer: SceneLayer, point: Float) -> Float:
    """Return a point of a skin and four about it within the spot, body frame [m], shape (5, 3)."""
    probe = layer.probe(point)
    # Any two directions along the surface: rows 2 and 3 of the decomposition are orthogonal to the normal
    along = np.linalg.svd(probe.normals[:1])[2][1:]
    return np.asarray(probe.closest + 0.25 * layer.demand.spot_fwhm_m * np.array(ROUND_SPOT) @ along)


class Response:
    """Displacement at points of one mesh of a skin under one sound, by a reduced model.

    points: the points, (p, 3), or one, (3,), body frame [m].
    pressure: ARP at the quadrature points at the factor 1 [Pa], shape (q,). path: that along a path, (k, q), or None.
    static: displacement of the points at rest [m], 0 for a body without support; harmonic: that at the main frequency,
    exact in time, both (p,).
    small: the model; `solve` makes it, and those of `others`, of other materials on the same mesh.
    """

    small: PointModel

    def __init__(self, layer: SceneLayer, pressure: Float, points: Float, path: Float | None = None):
        self.layer, self.points, self.pressure, self.path = layer, points, pressure, path
        self.others: list[Response] = []

    def of(self, layer: SceneLayer) -> "Response":
        """Return the response of a layer of other materials on the same mesh, solved together with this one."""
        other = Response(layer, self.pressure, self.points)
        self.others.append(other)
        return other

    def solve(self) -> None:
        """Make the models; matrices that were computed only for this are freed afterwards."""
        layer, others = self.layer, self.others
        fresh = [one.layer.system.matrices for one in (self, *others) if not one.layer.system.matrices.made]
        operator, read = layer.quadrature.operator, layer.probe(self.points).operator.toarray()
        path = None if self.path is None else operator @ self.path.T
        frequencies = layer.demand.main_frequency_Hz, layer.demand.max_frequency_Hz
        same = [other.layer.system for other in others]
        models = point_model(layer.system, operator @ self.pressure, read, *frequencies, same, path)
        for response, model in zip((self, *others), models, strict=True):
            response.small = model
        for matrices in fresh:
            matrices.forget()

    @property
    def static(self) -> Float:
        return self.small.static() if self.layer.system.supported else np.zeros(len(np.atleast_2d(self.points)))

    @property
    def harmonic(self) -> Complex:
        return self.small.harmonic(self.layer.demand.main_frequency_Hz)

    @property
    def discrete(self) -> Complex:
        """The harmonic displacement by the substeps of the whole layer [m], (p,)."""
        return self.small.discrete(self.layer.demand.main_frequency_Hz, self.layer.sizes.step_s)


def solve_all(responses: Sequence[Response]) -> None:
    """Solve some responses in threads (factorisation releases the GIL), the most expensive first."""
    share([(response.solve,) for response in responses], min(cores(), MOST_AT_ONCE))


class Changes(NamedTuple):
    """Relative differences of two responses: L2 over the points, or of the first point alone, whichever is larger.

    steady: of the static or harmonic displacement, the larger. harmonic: of the harmonic one.
    moved, velocity: of displacement and velocity over time, L2 over times too.
    """

    steady: float
    harmonic: float
    moved: float
    velocity: float


def changes(one: Response, other: Response, moved: dict[Response, Float]) -> Changes:
    """Return the relative difference of two meshes. Raises SceneError if the second response is zero."""
    lines = [[response.harmonic, response.static] for response in (one, other)]
    mine, theirs = (np.array(line if other.layer.system.supported else line[:1]) for line in lines)
    steady, harmonic = (
        max(largest_change(mine[lines], theirs[lines]), largest_change(mine[lines, :1], theirs[lines, :1]))
        for lines in (slice(None), slice(1))
    )
    of_course = (
        max(course_change(moved[one][n][:, points], moved[other][n][:, points]) for points in (slice(None), slice(1)))
        for n in range(2)
    )
    return Changes(steady, harmonic, *of_course)


def course_change(course: Float, reference: Float) -> float:
    """Return the relative difference of two motions, L2 over times and points; 0 if the second is zero."""
    size = float(np.linalg.norm(reference))
    return float(np.linalg.norm(course - reference)) / size if size > 0.0 else 0.0
