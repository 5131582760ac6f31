# Schema 1: for the old recorder, and deleted with it.
"""The numbers of a run in one flat, plain dictionary."""

import math
from typing import Any

import numpy as np
import xarray as xr

from palmfield.outputs.v1_frames import has_records

REFERENCE_PA = 20e-6


def summary(ds: xr.Dataset, extra: dict[str, Any]) -> dict[str, Any]:
    """Plain-JSON numbers of a result, units in the names; what a run cut off early lacks is left out.

    ds: a result (outputs/schema.py); extra: further entries, which come last
    peak_pressure_Pa is the largest pressure amplitude (peak, not rms) on the surface or the skin patch;
    peak_pressure_dB_SPL is its rms level over 20 µPa, None in silence. rms_displacement_m (and ..._without_dc_m) are
    over time at the vertex that moves most. total_force_mean_N is the mean vector in the world.
    """
    out: dict[str, Any] = {}
    for name, dim in (("skin_vertices", "vertex"), ("transducers", "transducer"), ("drive_frames", "frame")):
        out[name] = int(ds.sizes.get(dim, 0))
    if has_records(ds, "time"):
        out["skin_steps"] = int(ds.sizes["time"])
        out["simulated_time_s"] = float(ds["time"].values[-1] - ds["time"].values[0])
    _add_peak(out, ds, "peak_pressure_Pa", ("surface_pressure", "skin_pressure"))
    if "peak_pressure_Pa" in out:
        rms = out["peak_pressure_Pa"] / math.sqrt(2.0)
        out["peak_pressure_dB_SPL"] = 20.0 * math.log10(rms / REFERENCE_PA) if rms > 0 else None
    _add_peak(out, ds, "peak_arp_Pa", ("surface_arp", "arp"))
    if has_records(ds, "arp_force"):
        force = ds["arp_force"].values
        out["total_force_peak_N"] = float(np.linalg.norm(force, axis=1).max())
        out["total_force_mean_N"] = force.mean(axis=0).tolist()
    if has_records(ds, "normal_displacement"):
        motion = ds["normal_displacement"].values
        when, vertex = np.unravel_index(np.abs(motion).argmax(), motion.shape)
        there = motion[:, vertex].astype(np.float64)
        out["peak_displacement_m"] = float(abs(there[when]))
        out["peak_displacement_time_s"] = float(ds["time"].values[when])
        out["peak_displacement_vertex"] = int(vertex)
        out["rms_displacement_m"] = float(np.sqrt(np.mean(there**2)))
        out["rms_displacement_without_dc_m"] = float(there.std())
    _add_peak(out, ds, "peak_velocity_m_s", ("normal_velocity",))
    return out | extra


def _add_peak(out: dict[str, Any], ds: xr.Dataset, key: str, names: tuple[str, ...]) -> None:
    found = [float(np.abs(ds[name].values).max()) for name in names if has_records(ds, name)]
    if found:
        out[key] = max(found)
