"""Numbers made of signals, maps and snapshots: one function each, SI units, every choice an argument.

from palmfield.metrics import overshoot, settling_time, steady_value
steady = steady_value(times, trace, (0.18, 0.2))
print(overshoot(times, trace, steady), settling_time(times, trace, steady, band=0.05, end_s=0.2))
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.metrics.energy import average_residual_energy, energy_density, focal_energy_ratio, mse, ssim, strip
    from palmfield.metrics.maps import area_above, half_width, level_depth, radial_profile, spot_diameter
    from palmfield.metrics.moving_frames import co_rotating_average
    from palmfield.metrics.spectra import (
        amplitude_spectrum,
        harmonics,
        spectral_centroid,
        spectral_peaks,
        strongest_line,
    )
    from palmfield.metrics.traces import (
        last_periods,
        mean_value,
        overshoot,
        peak,
        peak_to_peak,
        rms,
        rms_map,
        settling_time,
        steady_value,
        within,
    )
    from palmfield.metrics.wakes import mach_angle, wake_along_path, wake_area, wake_length

_WHERE = {
    **dict.fromkeys(
        ("average_residual_energy", "energy_density", "focal_energy_ratio", "mse", "ssim", "strip"), "energy"
    ),
    **dict.fromkeys(("area_above", "half_width", "level_depth", "radial_profile", "spot_diameter"), "maps"),
    "co_rotating_average": "moving_frames",
    **dict.fromkeys(
        ("amplitude_spectrum", "harmonics", "spectral_centroid", "spectral_peaks", "strongest_line"), "spectra"
    ),
    **dict.fromkeys(
        (
            "last_periods",
            "mean_value",
            "overshoot",
            "peak",
            "peak_to_peak",
            "rms",
            "rms_map",
            "settling_time",
            "steady_value",
            "within",
        ),
        "traces",
    ),
    **dict.fromkeys(("mach_angle", "wake_along_path", "wake_area", "wake_length"), "wakes"),
}
__all__ = [
    "amplitude_spectrum",
    "area_above",
    "average_residual_energy",
    "co_rotating_average",
    "energy_density",
    "focal_energy_ratio",
    "half_width",
    "harmonics",
    "last_periods",
    "level_depth",
    "mach_angle",
    "mean_value",
    "mse",
    "overshoot",
    "peak",
    "peak_to_peak",
    "radial_profile",
    "rms",
    "rms_map",
    "settling_time",
    "spectral_centroid",
    "spectral_peaks",
    "spot_diameter",
    "ssim",
    "steady_value",
    "strip",
    "strongest_line",
    "wake_along_path",
    "wake_area",
    "wake_length",
    "within",
]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
