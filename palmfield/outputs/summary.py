"""The numbers of a run in one flat, plain dictionary."""

import io
import math
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from palmfield.outputs.frames import has_records

REFERENCE_PA = 20e-6
UNITS = {"_dB_SPL": "dB SPL", "_m_s": "m/s", "_Pa": "Pa", "_N": "N", "_m": "m", "_s": "s", "_Hz": "Hz"}
PREFIXES = ((1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
PREFIXED = {"Pa", "N", "m", "s", "Hz", "m/s"}


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


def format_table(summary: dict[str, Any]) -> str:
    """The summary as a text table for a terminal, in readable units."""
    table = Table(title="palmfield result", title_justify="left")
    table.add_column("quantity")
    table.add_column("value", justify="right")
    table.add_column("unit")
    for name, value in summary.items():
        label, unit = _split(name)
        text, unit = _readable(value, unit)
        table.add_row(label, text, unit)
    stream = io.StringIO()
    Console(file=stream, width=100, color_system=None).print(table)
    return stream.getvalue()


def _add_peak(out: dict[str, Any], ds: xr.Dataset, key: str, names: tuple[str, ...]) -> None:
    found = [float(np.abs(ds[name].values).max()) for name in names if has_records(ds, name)]
    if found:
        out[key] = max(found)


def _split(name: str) -> tuple[str, str]:
    for suffix, unit in UNITS.items():
        if name.endswith(suffix):
            return name.removesuffix(suffix).replace("_", " "), unit
    return name.replace("_", " "), ""


def _readable(value: Any, unit: str) -> tuple[str, str]:
    """Text and unit, with the metric prefix that leaves one to three digits before the point."""
    numbers = value if isinstance(value, list) else [value]
    if not numbers or any(isinstance(v, bool) or not isinstance(v, int | float) for v in numbers):
        return str(value), unit
    scale, prefix = 1.0, ""
    size = max(abs(v) for v in numbers)
    if unit in PREFIXED and size > 0:
        scale, prefix = next(((s, p) for s, p in PREFIXES if size >= s), PREFIXES[-1])
    texts = [str(v) if isinstance(v, int) and scale == 1.0 else f"{v / scale:.4g}" for v in numbers]
    return ", ".join(texts), prefix + unit
