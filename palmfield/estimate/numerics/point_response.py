"""Response of one point of a skin to one sound: static, at the main frequency, and over time."""

from collections.abc import Sequence

import numpy as np

from palmfield.skin.approximation.estimate import largest_change
from palmfield.skin.reduction.reducer import PointModel, point_model
from palmfield.skin.scene_layer import SceneLayer
from palmfield.threads import cores, share
from palmfield.types import Float

MOST_AT_ONCE = 2
"""Largest number of parallel factorisations: each factor of a palm takes a third of a gigabyte."""


class Response:
    """Displacement at a point of one mesh of a skin under one sound, by a reduced model.

    pressure: ARP at the quadrature points at the factor 1 [Pa], shape (q,).
    static: displacement of the point at rest [m], 0 for a body without support; harmonic: that at the main frequency,
    exact in time.
    small: the model; `solve` makes it, and those of `others`, of other materials on the same mesh.
    """

    small: PointModel

    def __init__(self, layer: SceneLayer, pressure: Float, point: Float):
        self.layer, self.point, self.pressure = layer, point, pressure
        self.others: list[Response] = []

    def of(self, layer: SceneLayer) -> "Response":
        """Return the response of a layer of other materials on the same mesh, solved together with this one."""
        other = Response(layer, self.pressure, self.point)
        self.others.append(other)
        return other

    def solve(self) -> None:
        """Make the models; matrices that were computed only for this are freed afterwards."""
        layer, others = self.layer, self.others
        fresh = [one.layer.system.matrices for one in (self, *others) if not one.layer.system.matrices.made]
        force, read = layer.quadrature.operator @ self.pressure, layer.probe(self.point).operator.toarray()[0]
        frequencies = layer.demand.main_frequency_Hz, layer.demand.max_frequency_Hz
        models = point_model(layer.system, force, read, *frequencies, [other.layer.system for other in others])
        for response, model in zip((self, *others), models, strict=True):
            response.small = model
        for matrices in fresh:
            matrices.forget()

    @property
    def static(self) -> float:
        return self.small.static() if self.layer.system.supported else 0.0

    @property
    def harmonic(self) -> complex:
        return self.small.harmonic(self.layer.demand.main_frequency_Hz)

    @property
    def discrete(self) -> complex:
        """The harmonic displacement by the substeps of the whole layer [m]."""
        return self.small.discrete(self.layer.demand.main_frequency_Hz, self.layer.sizes.step_s)


def solve_all(responses: Sequence[Response]) -> None:
    """Solve some responses in threads (factorisation releases the GIL), the most expensive first."""
    share([(response.solve,) for response in responses], min(cores(), MOST_AT_ONCE))


def changes(one: Response, other: Response, moved: dict[Response, Float]) -> tuple[float, float]:
    """Return the relative difference of two meshes, static or harmonic, the larger, and over time.

    Raises SceneError if the second response is zero.
    """
    fixed = other.layer.system.supported
    mine, theirs = (
        np.array([response.static, response.harmonic] if fixed else [response.harmonic]) for response in (one, other)
    )
    return largest_change(mine, theirs), course_change(moved[one], moved[other])


def course_change(course: Float, reference: Float) -> float:
    """Return the relative difference of two time series, L2 over time; 0 if the second is zero."""
    size = float(np.linalg.norm(reference))
    return float(np.linalg.norm(course - reference)) / size if size > 0.0 else 0.0
