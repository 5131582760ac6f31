"""Colours of the page: maps that colour-blind people can distinguish, the same as in the pictures of a run."""

from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from numpy.typing import NDArray

from palmfield.types import Complex, Float32

SILENT = (150, 150, 150)
NICE = (1.0, 2.0, 5.0, 10.0)
NOTHING = 1e-6
"""Smaller values (um or Pa) are residues after a sound or motion has ended; they do not get full colours."""


def _table(name: str, low: float = 0.0, high: float = 1.0) -> NDArray[np.uint8]:
    return np.asarray(np.round(255.0 * colormaps[name](np.linspace(low, high, 256))), np.uint8)


MOTION, PRESSURE, PHASE = _table("RdBu_r", 0.02, 0.98), _table("magma_r", 0.03, 0.85), _table("twilight")
AT_REST = (int(MOTION[128, 0]), int(MOTION[128, 1]), int(MOTION[128, 2]))
"""Colour of bodies and of skin that does not move."""


@dataclass(frozen=True)
class Scale:
    """A colour scale. table: 256 colours, (256, 4); low, high: its ends, in `unit`; factor: factor from SI to `unit`"""

    title: str
    table: NDArray[np.uint8]
    low: float
    high: float
    unit: str
    factor: float

    def colours(self, values: Float32) -> NDArray[np.uint8]:
        """Return the colours of values in the SI unit, (n,) -> (n, 4)."""
        width = max(self.high - self.low, 1e-30)
        place = (self.factor * np.asarray(values) - self.low) / width
        return self.table[np.clip(np.round(255.0 * place), 0, 255).astype(np.uint8)]

    @property
    def legend(self) -> str:
        """Return a bar with its ends, as HTML."""
        return _bar(self.title, self.table, f"{self.low:g}", f"{self.high:g} {self.unit}")


def motion_scale(title: str, largest_m: float) -> Scale:
    """Return the scale for signed values along the normal."""
    top = rounded_up(1e6 * largest_m)
    return Scale(title, MOTION, -top, top, "um", 1e6)


def size_scale(title: str, largest: float, unit: str, factor: float) -> Scale:
    """Return the scale for values of 0 or more."""
    return Scale(title, PRESSURE, 0.0, rounded_up(factor * largest), unit, factor)


def rounded_up(value: float) -> float:
    """Return the next larger of 1, 2, 5, 10, 20, ...; 1 for values up to NOTHING."""
    if not np.isfinite(value) or value < NOTHING:
        return 1.0
    ten = 10.0 ** np.floor(np.log10(value))
    return float(f"{ten * min(step for step in NICE if step * ten >= value * (1 - 1e-9)):.3g}")


def phase_colours(drive: Complex) -> NDArray[np.uint8]:
    """Return colours of transducers by their phase, greyer with lower amplitude relative to the loudest, (N, 4)."""
    size = np.abs(drive)
    share = (size / size.max() if size.max() > 0.0 else size)[:, None]
    turn = np.mod(np.angle(drive) / (2.0 * np.pi), 1.0)
    colour = PHASE[np.round(255.0 * turn).astype(np.uint8)][:, :3]
    shown = np.full((len(drive), 4), 255, np.uint8)
    shown[:, :3] = np.round(share * colour + (1.0 - share) * np.array(SILENT))
    return shown


def phase_legend() -> str:
    """Return the legend of phases as HTML."""
    return _bar("phase of each transducer's drive", PHASE, "0", "360 deg")


def _bar(title: str, table: NDArray[np.uint8], low: str, high: str) -> str:
    stops = ",".join("#{:02x}{:02x}{:02x}".format(*colour[:3]) for colour in table[::17])
    return (
        f'<div style="margin:0.2em 0.8em;font-size:0.8em"><div>{title}</div>'
        f'<div style="height:0.7em;background:linear-gradient(to right,{stops})"></div>'
        f'<div style="display:flex;justify-content:space-between"><span>{low}</span><span>{high}</span></div></div>'
    )
