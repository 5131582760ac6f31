"""Detect jumps of the phases between the foci of a stimulus. They occur where two eigenvalues cross."""

import numpy as np

from palmfield.drive.array_drive import ArrayDrive
from palmfield.types import Complex, Float

MOVED_WAVELENGTHS = 1.0 / 16.0
"""Largest motion of a focus between two records [wavelengths]. For larger motions, phase jumps are not counted."""
LOUDER = 1.0 / 16.0
"""Largest change of the pressure of a focus between two records, relative to the loudest focus. Larger: not counted."""
SAME = 0.7
"""Smallest |v^H w| at which the leading eigenvectors v, w of two records count as equal."""


class PhaseTurns:
    """Follows the leading eigenvector of the foci of a stimulus from record to record.

    times: times of the records at which the eigenvector jumped [s]
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self._last: tuple[Float, Float, Complex] | None = None

    def see(self, time_s: float, drive: ArrayDrive, foci: Float, loudness: Float | None) -> None:
        """Add a record of active foci, array frame [m], shape (m, 3); loudness: see `FocalPoints.loudness`."""
        levels = np.ones(len(foci)) if loudness is None else loudness
        foci, levels, last = foci[levels > 0.0], levels[levels > 0.0], self._last
        if len(foci) < 2:
            self._last = None
        elif last is None or not (np.array_equal(last[0], foci) and np.array_equal(last[1], levels)):
            vector = drive.leading_of(foci, levels)
            if last is not None and len(last[0]) == len(foci):
                moved_m = np.linalg.norm(foci - last[0], axis=1).max()
                near = moved_m <= MOVED_WAVELENGTHS * 2.0 * np.pi / drive.wavenumber
                if near and np.abs(levels - last[1]).max() <= LOUDER and abs(np.vdot(vector, last[2])) < SAME:
                    self.times.append(time_s)
            self._last = foci, levels, vector
