"""Report likely faults of a scan or of its position, in sentences."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import detrend
from scipy.spatial import cKDTree

from palmfield.instruments.agreement import Agreement, delays
from palmfield.instruments.scan import Scan
from palmfield.instruments.scan_grids import pitch
from palmfield.instruments.surface_motion import SurfaceMotion
from palmfield.metrics.checks import even_step
from palmfield.types import Float

UNIT = 30.0
"""A gain that differs from 1 by this factor, up or down, suggests a wrong unit rather than a level."""
FOLDED = 0.02
"""Share of the computed power above half of the rate of the scan from which aliasing is reported."""
SHARPEN = 4
"""Exponent of the rms that weights points in `middle`, so that the point with the largest motion counts most."""
LEAST_APART_M = 1e-3
OFFSET = 0.02
"""Share of the peak beyond which an offset or drift is reported."""
WILD = 4.0
"""A point with this many times the motion of its neighbours and of the computed motion is a broken channel.
"""
NEIGHBOURS = 4


def wild(measured: Scan, computed: Scan) -> NDArray[np.bool_]:
    """Return which points of a scan have a broken channel, for instance a lost beam, shape (n,).

    Such a point would be taken as the largest motion, to which the other points are compared.
    """
    theirs, ours = (np.sqrt(np.mean(scan.values**2, axis=0)) for scan in (measured, computed))
    count = min(NEIGHBOURS, len(theirs) - 1)
    neighbours = cKDTree(measured.points).query(measured.points, k=count + 1)[1][:, 1:]
    alone = theirs > WILD * theirs[neighbours].max(axis=1)
    level = float(np.median(theirs / ours))
    return np.asarray(alone & (theirs > WILD * level * ours.max()))


def middle(scan: Scan) -> Float:
    """Return the centre of a motion [m], shape (3,): mean of the points, weighted by std to the power SHARPEN."""
    weights = np.std(scan.values, axis=0)
    weights = (weights / weights.max()) ** SHARPEN
    return np.asarray(weights @ scan.points / weights.sum())


def suspected_faults(
    measured: Scan, computed: Scan, motion: SurfaceMotion, numbers: Agreement, most_delay_s: float
) -> list[str]:
    """Return sentences for a report, none if the comparison looks plausible.

    measured, computed: motions at the same points and times; the places of `measured` are those on the skin
    motion: computed motion before any instrument
    """
    found = []
    gain = float(np.median(np.abs(numbers.gain)))
    if not 1.0 / UNIT < gain < UNIT:
        found.append(
            f"the gain is {gain:.3g}: check the unit (mm/s or m/s), the quantity (displacement or velocity) and "
            "the sound level"
        )
    if float(np.median(numbers.gain)) < 0.0:
        found.append("most points have the opposite sign: check the sign of the beam and the trigger")
    peak = np.abs(measured.values).max()
    offset, drift = (float(np.median(np.abs(part)) / peak) for part in (numbers.offset, numbers.drift))
    if max(offset, drift) > OFFSET:
        found.append(
            f"the scan has a constant offset of {100 * offset:.2g} % of its peak and a drift of {100 * drift:.2g} "
            "% over the record; both are removed for gain, delay and shape, and remain in the difference"
        )
    step = even_step(measured.times_s)
    theirs, ours = detrend(measured.values, axis=0), detrend(computed.values, axis=0)
    wide = delays(theirs, ours, step, 0.5 * (measured.times_s[-1] - measured.times_s[0]))[0]
    beyond = np.abs(wide) > most_delay_s + step
    late = float(np.median(wide))
    if beyond.mean() > 0.5 and np.abs(wide - late).max(where=beyond, initial=0.0) < most_delay_s:
        found.append(
            f"a delay of {1e3 * late:.4g} ms fits better than any within {1e3 * most_delay_s:.3g}: correct "
            "trigger_s, or give a larger --most-delay"
        )
    offset_m = float(np.linalg.norm(middle(measured) - middle(computed)))
    if len(measured.points) > 3 and offset_m > max(LEAST_APART_M, 0.5 * pitch(measured.points)):
        found.append(
            f"the maximum of the measured motion lies {1e3 * offset_m:.2g} mm from that of the computed motion: check "
            "the position of the scan on the skin, and of the focus on the specimen"
        )
    folded = above(motion, 0.5 / step)
    if folded > FOLDED:
        found.append(
            f"{100 * folded:.2g} % of the power of the computed motion lies above half of the sampling rate of the "
            f"scan, {0.5 / step:.4g} Hz: the computed motion was low-pass filtered; a measurement without such a "
            "filter contains aliases"
        )
    return found


def above(motion: SurfaceMotion, frequency_Hz: float) -> float:
    """Return the fraction of the power of the normal velocity above a frequency, 0 to 1."""
    velocity = np.einsum("tni,ni->tn", motion.velocity_m_s, motion.normals)
    power = (np.abs(np.fft.rfft(velocity - velocity.mean(axis=0), axis=0)) ** 2).sum(axis=1)
    lines = np.fft.rfftfreq(len(velocity), float(np.median(np.diff(motion.times_s))))
    total = float(power.sum())
    return float(power[lines > frequency_Hz].sum()) / total if total > 0.0 else 0.0
