"""Spikes of the afferents of a result, from the recorded motion at their endings."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from palmfield.perception.afferents import AFFERENTS, spikes
from palmfield.types import Float, Int


def spikes_of(skin: xr.Dataset) -> dict[str, tuple[Float, Int]]:
    """Return the spike times [s] and the numbers of the afferents that fire, both (m,), for each class of afferents.

    skin: group of a skin with `afferent_motion`
    Times are measured from the start of the run; numbers are indices along `afferent`.
    """
    times, classes = skin["time"].values.astype(float), skin["afferent_class"].values
    step_s, result = float(times[1] - times[0]), {}
    for name, afferent in AFFERENTS.items():
        numbers = np.flatnonzero(classes == name).astype(np.int32)
        if len(numbers):
            moments, units = spikes(afferent, skin["afferent_motion"].values[:, numbers], step_s)
            result[name] = times[0] + moments, numbers[units]
    return result


def mean_rates(skin: xr.Dataset, fired: Mapping[str, tuple[Float, Int]]) -> Float:
    """Return the mean rate of each afferent over the run [spikes/s], shape (n,). fired: result of `spikes_of`"""
    lasts_s = float(skin["time"].values[-1] - skin["time"].values[0])
    numbers = np.concatenate([numbers for _, numbers in fired.values()])
    return np.bincount(numbers, minlength=skin.sizes["afferent"]) / lasts_s
