"""Amplitude of transducers off their axes. Each file here defines one form as `FORM`; its name is that of the file."""

from functools import lru_cache
from importlib import import_module
from pkgutil import iter_modules

import numpy as np

from palmfield.acoustics.directivity import Directivity, Measured
from palmfield.errors import SceneError, refuse_unknown
from palmfield.types import Array, Float

FORMS: dict[str, Directivity] = {
    module.name: import_module(f"{__name__}.{module.name}").FORM
    for module in sorted(iter_modules(__path__), key=lambda module: module.name)
}
"""All forms by name."""


def form_of(array: Array) -> Directivity:
    """Return the form of the array: its table or its named form. Raises SceneError for an unknown name."""
    if array.directivity_table is not None:
        return _measured(np.asarray(array.directivity_table, float).tobytes())
    refuse_unknown(SceneError, f"array '{array.name}' has directivity {{}}", array.directivity, FORMS)
    return FORMS[array.directivity]


def directivity_coefficients(array: Array, wavenumber: float) -> tuple[Float, Float]:
    """Return the directivity as a quintic in s = sin^2(angle off the axis), and its derivative in s.

    wavenumber: 2 pi f/c [rad/m].
    Returns coefficients, lowest power first, of shapes (6,) and (5,), the input of all field kernels.
    Raises SceneError for a form that a quintic cannot approximate.
    """
    quintic = form_of(array).polynomial(wavenumber * array.piston_radius_m)
    return quintic, quintic[1:] * np.arange(1, 6)


@lru_cache(maxsize=64)
def _measured(table: bytes) -> Measured:
    return Measured("table", np.frombuffer(table).reshape(-1, 2))
