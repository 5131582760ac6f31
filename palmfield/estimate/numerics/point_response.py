"""Response of one point of a skin to one sound: static, at the main frequency, and over time."""

from collections.abc import Callable

import numpy as np

from palmfield.skin.approximation.estimate import largest_change
from palmfield.skin.fem.influence import harmonic_influence, static_influence
from palmfield.skin.reduction.point_model import PointModel, point_model
from palmfield.skin.scene_layer import SceneLayer
from palmfield.threads import cores, share
from palmfield.types import Float

MOST_AT_ONCE = 2
"""Largest number of parallel factorisations: each factor of a palm takes a third of a gigabyte."""


class Response:
    """Displacement at one point of one mesh of a skin under one sound.

    pressure: ARP at the quadrature points at the factor 1 [Pa], shape (q,).
    static, harmonic, scheme: displacement of the point [m]: static (0 for a body without support), harmonic, and
        harmonic by the time scheme of the wedge model; `rest` computes the first, `swing` the others.
    scheme_too: whether `scheme` is needed.
    small: reduced model for any time course; `begin` builds it and computes `static`.
    """

    small: PointModel

    def __init__(self, layer: SceneLayer, pressure: Float, point: Float, *, scheme_too: bool = False):
        self.layer, self.point, self.scheme_too = layer, point, scheme_too
        self.pressure = pressure
        self.static, self.harmonic, self.scheme = 0.0, 0j, 0j

    def of(self, layer: SceneLayer) -> "Response":
        """Return the response of another layer on the same mesh."""
        return Response(layer, self.pressure, self.point)

    def rest(self) -> None:
        if not self.layer.system.supported:
            return
        self.static = float(static_influence(self.layer.system, self.layer.quadrature, self.point) @ self.pressure)

    def begin(self) -> None:
        layer = self.layer
        force, read = layer.quadrature.operator @ self.pressure, layer.probe(self.point).operator.toarray()[0]
        self.small = point_model(layer.system, force, read, layer.demand.max_frequency_Hz)
        if layer.system.supported:
            self.static = self.small.static()

    def swing(self) -> None:
        layer = self.layer
        step_s = layer.sizes.step_s if self.scheme_too else None
        frequency = layer.demand.main_frequency_Hz
        exact, scheme = harmonic_influence(layer.system, layer.quadrature, self.point, frequency, step_s)
        self.harmonic, self.scheme = complex(exact @ self.pressure), complex(scheme @ self.pressure)


def side_by_side(*solutions: Callable[[], None]) -> None:
    """Run solutions in threads (factorisation releases the GIL)."""
    share([(solution,) for solution in solutions], min(cores(), MOST_AT_ONCE))


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
