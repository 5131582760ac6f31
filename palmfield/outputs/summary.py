"""Compute the numbers of a run as plain JSON: lists of skins, arrays and stimuli, and numbers of the whole run."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr

from palmfield.acoustics.exposure import level_dB
from palmfield.outputs.motion import extremes, pieces
from palmfield.outputs.schema import SCHEMA_VERSION, has_records, instances

PEAKS = ("peak_pressure_Pa", "peak_arp_Pa", "peak_displacement_m", "peak_velocity_m_s", "total_force_peak_N")

More = Mapping[str, Mapping[str, Any]]
"""Additional numbers for each instance."""


def summary(
    result: xr.DataTree,
    extra: Mapping[str, Any],
    skins: More | None = None,
    stimuli: More | None = None,
    arrays: More | None = None,
) -> dict[str, Any]:
    """Return numbers of a result, units in the names; numbers that an interrupted run lacks are omitted.

    result: as returned by `open_result` or `tree`; extra: additional entries, placed last
    skins, stimuli, arrays: additional entries of the elements of the lists, by instance

    `skins`, `arrays` and `stimuli` are lists with an element for each (`skin_numbers`). The largest of PEAKS over all
    skins and the sound level of the largest pressure are entries of the top level.
    """
    more_skins, more_stimuli, more_arrays = skins or {}, stimuli or {}, arrays or {}
    surfaces, forces = instances(result, "surface"), instances(result, "forces")
    listed = [
        {"name": name, **skin_numbers(skin, surfaces.get(name), forces.get(name)), **more_skins.get(name, {})}
        for name, skin in instances(result, "skin").items()
    ]
    listed_arrays = [
        {"name": name, "transducers": int(array.sizes.get("transducer", 0)), **more_arrays.get(name, {})}
        for name, array in instances(result, "array").items()
    ]
    out: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "skins": listed,
        "arrays": listed_arrays,
        "stimuli": [
            {"name": name, "focal_points": int(stimulus.sizes.get("focus", 0)), **more_stimuli.get(name, {})}
            for name, stimulus in instances(result, "stimulus").items()
        ],
        "transducers": sum(array["transducers"] for array in listed_arrays),
        "drive_frames": int(result.sizes.get("frame_time", 0)),
        "skin_steps": int(result.sizes.get("time", 0)),
        "steps": int(result.sizes.get("step_time", 0)),
    }
    if out["skin_steps"]:
        times = result.coords["time"].values
        out["simulated_time_s"] = float(times[-1] - times[0])
    for key in PEAKS:
        values = [skin[key] for skin in listed if key in skin]
        if values:
            out[key] = max(values)
    if "peak_pressure_Pa" in out:
        out["peak_pressure_dB_SPL"] = level_dB_SPL(out["peak_pressure_Pa"])
    return out | dict(extra)


def skin_numbers(skin: xr.Dataset, surface: xr.Dataset | None, forces: xr.Dataset | None) -> dict[str, Any]:
    """Return the numbers of one skin.

    skin, surface, forces: groups of the skin. peak_pressure_Pa is the largest pressure amplitude (peak, not rms) on the
    surface of its body or on the skin at the loudest moment; peak_pressure_dB_SPL is its rms level over 20 µPa, None in
    silence. Displacement and velocity are components along the outward normal. rms_displacement_m (and
    ..._without_dc_m) are over time at the vertex of largest motion; displacement_per_arp_m_Pa is the ratio of the
    maxima of displacement and ARP, independent of the sound level. The numbers motion_... are magnitudes of the
    displacement that the motion of the body causes; no other number includes it. total_force_mean_N is the mean vector
    in the world.
    """
    out: dict[str, Any] = {"vertices": int(skin.sizes.get("vertex", 0))}
    meshes = [mesh for mesh in (surface, skin) if mesh is not None]
    pressures = [float(m["loudest_pressure"].values.max()) for m in meshes if has_records(m, "loudest_pressure")]
    if pressures:
        out["peak_pressure_Pa"] = max(pressures)
        out["peak_pressure_dB_SPL"] = level_dB_SPL(max(pressures))
    loads = [float(mesh["loudest_arp"].values.max()) for mesh in meshes if has_records(mesh, "loudest_arp")]
    if has_records(skin, "arp"):
        loads += [float(values.max()) for _, values in pieces(skin, "arp")]
    if loads:
        out["peak_arp_Pa"] = max(loads)
    if forces is not None and has_records(forces, "force"):
        force = forces["force"].values
        out["total_force_peak_N"] = float(np.linalg.norm(force, axis=1).max())
        out["total_force_mean_N"] = force.mean(axis=0).tolist()
    if has_records(skin, "displacement"):
        motion = extremes(skin)
        vertex = int(motion.peak.argmax())
        mean, square = float(motion.mean[vertex]), float(motion.mean_square[vertex])
        out["peak_displacement_m"] = float(motion.peak[vertex])
        if out.get("peak_arp_Pa", 0.0) > 0.0:
            out["displacement_per_arp_m_Pa"] = out["peak_displacement_m"] / out["peak_arp_Pa"]
        out["peak_displacement_time_s"] = float(skin["time"].values[motion.when[vertex]])
        out["peak_displacement_vertex"] = vertex
        out["rms_displacement_m"] = math.sqrt(square)
        out["rms_displacement_without_dc_m"] = math.sqrt(max(0.0, square - mean**2))
    if has_records(skin, "motion_displacement"):
        # Small: one moment for each MuJoCo step
        moved = np.linalg.norm(skin["motion_displacement"].values, axis=2)
        vertex = int(moved.max(axis=0).argmax())
        out["motion_peak_displacement_m"] = float(moved[:, vertex].max())
        out["motion_rms_displacement_m"] = float(np.sqrt(np.mean(moved[:, vertex] ** 2)))
        along = np.einsum("tvx,vx->tv", skin["motion_displacement"].values, skin["rest_normal"].values)
        out["motion_peak_normal_displacement_m"] = float(np.abs(along).max())
    if has_records(skin, "velocity"):
        out["peak_velocity_m_s"] = float(extremes(skin, "velocity").peak.max())
    return out


def level_dB_SPL(peak_Pa: float) -> float | None:
    """Return the sound pressure level of a sine with this amplitude (rms re 20 µPa); None in silence."""
    return level_dB(peak_Pa / math.sqrt(2.0)) if peak_Pa > 0 else None
