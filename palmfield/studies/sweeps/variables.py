"""Variables that a sweep stores for each point, with dimensions, units and descriptions.

They are as in `palmfield.outputs.schema`. The dimensions here come after those of the design.
"""

from palmfield.outputs.schema import Variable

NOT_DONE, DONE, FAILED = 0, 1, 2
_NORMAL = "positive outward: a push is negative"
_MOST = "at the vertex that moves most"

VARIABLES: dict[str, Variable] = {
    "peak_displacement": Variable(
        ("skin",), "float64", "m", "largest magnitude of the normal displacement, over all vertices and substeps"
    ),
    "peak_velocity": Variable(
        ("skin",), "float64", "m s-1", "largest magnitude of the normal velocity, over all vertices and substeps"
    ),
    "rms_displacement": Variable(
        ("skin",), "float64", "m", f"root mean square of the normal displacement over the run, {_MOST}"
    ),
    "rms_displacement_without_mean": Variable(
        ("skin",), "float64", "m", f"root mean square of the normal displacement about its mean over the run, {_MOST}"
    ),
    "rms_displacement_last_period": Variable(
        ("skin",), "float64", "m",
        f"root mean square of the normal displacement over the last period of main_frequency, {_MOST}",
    ),
    "rms_velocity": Variable(
        ("skin",), "float64", "m s-1", f"root mean square of the normal velocity over the run, {_MOST}"
    ),
    "rms_velocity_last_period": Variable(
        ("skin",), "float64", "m s-1",
        f"root mean square of the normal velocity over the last period of main_frequency, {_MOST}",
    ),
    "peak_arp": Variable(
        ("skin",), "float64", "Pa", "largest acoustic radiation pressure (ARP), over all vertices and substeps",
        sign="positive values push into the surface",
    ),
    "loudest_position": Variable(
        ("skin", "xyz"), "float64", "m", "vertex whose normal displacement is largest", "body frame at rest",
    ),
    "normal_displacement": Variable(
        ("skin", "time"), "float32", "m", "normal displacement at loudest_position", sign=_NORMAL
    ),
    "sensor_displacement": Variable(
        ("sensor", "step_time"), "float32", "m", "normal displacement at the sensors, at the start of each step",
        sign=_NORMAL,
    ),
    "peak_force": Variable(
        ("skin",), "float64", "N", "largest magnitude of the acoustic force on the body of the skin, mean over a step"
    ),
    "mean_force": Variable(
        ("skin", "xyz"), "float64", "N", "acoustic force on the body of the skin, mean over the run", "world",
        "acts on the body",
    ),
    "drive_level": Variable(
        ("stimulus",), "float64", "1",
        "largest amplitude of the transducers of the stimulus at the highest ARP, 1 is full drive",
    ),
    "main_frequency": Variable(
        ("skin",), "float64", "Hz",
        "frequency of the strongest response of the skin; none for a load that does not repeat",
    ),
    "level": Variable(
        ("skin", "observer"), "float64", "dB",
        f"level of the line at main_frequency above the threshold of the observer (dB SL), {_MOST}; for "
        "hasegawa_2018 that of the force",
    ),
    "level_all_lines": Variable(
        ("skin", "observer"), "float64", "dB",
        f"level of all main lines together above the threshold of the observer (dB SL), {_MOST}",
    ),
    "level_with_area": Variable(
        ("skin", "observer"), "float64", "dB",
        "level_all_lines, with thresholds for the area that moves by half of the maximum or more",
    ),
    "level_why": Variable(("skin", "observer"), "str", "", "reason why the observer applies or is refused"),
}  # fmt: skip
"""Variables of every sweep. NaN if a point has failed, is not computed yet, or has no such number."""
ERRORS: dict[str, Variable] = {
    "displacement_error": Variable(
        ("skin",), "float64", "1", "estimated relative error of the displacement: mesh, step, reduction, cut edges"
    ),
    "displacement_error_missing": Variable(("skin",), "str", "", "reason for a missing estimate"),
}
"""Variables of a sweep with estimates of errors."""
RECORDS: dict[str, Variable] = {
    "substep": Variable((), "float64", "s", "substep of the skins; normal_displacement is resampled where it differs"),
    "wall_time": Variable((), "float64", "s", "wall time of the point"),
    "failure": Variable((), "str", "", "cause of a failed point"),
    "status": Variable((), "int8", "1", "0 not computed yet, 1 done, 2 failed"),
}
"""Variables on the computation."""
COURSES = ("time", "step_time")
"""Dimensions along which each point has many numbers."""


def variables(errors: bool) -> dict[str, Variable]:
    """Return all variables of a sweep, with estimates of errors or without."""
    return VARIABLES | (ERRORS if errors else {}) | RECORDS
