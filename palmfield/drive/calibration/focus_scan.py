"""Estimate the true pose of the board from pressures around its commanded foci."""

import math

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from palmfield.acoustics import check
from palmfield.acoustics.air import sound_speed, sound_speed_sd
from palmfield.acoustics.calibration_file import Pose
from palmfield.acoustics.focus import compensate, focus
from palmfield.acoustics.placement import placed
from palmfield.acoustics.reference import pressure64
from palmfield.errors import PalmfieldError
from palmfield.types import Air, Array, Float

TURN_SD_RAD = math.radians(3.0)
"""Prior standard deviation of the rotations of the board about each axis."""
OFFSET_SD_M = 10e-3
WITHIN_M = 0.03
"""Largest distance of the loudest reading from its focus [m]; a larger distance is due to another error."""


def fit_pose(
    array: Array, air: Air, foci_m: ArrayLike, at: ArrayLike, pressures_Pa: ArrayLike, temperature_sd_K: float = 1.0
) -> Pose:
    """Fit offset and rotation of the board that move its foci to the measured foci, by least squares over amplitudes.

    array: array with calibrated gains, in its nominal frame
    foci_m: commanded focus of each reading, in this frame [m], shape (k, 3)
    at: places of the microphone, in the same frame [m], shape (k, 3); pressures_Pa: amplitudes, shape (k,)
    temperature_sd_K: standard deviation of the temperature of the air: faster sound moves foci closer
    Rotations are fitted only for three or more separate foci, else only offsets (turn 0).
    Raises PalmfieldError for fewer than 8 readings, invalid shapes, readings below 0 or not finite, and for a loudest
    reading farther than WITHIN_M from its focus.
    """
    aims, where = check.points(np.asarray(foci_m, float), np.float64), check.points(np.asarray(at, float), np.float64)
    measured = np.asarray(pressures_Pa, float)
    if not (len(aims) == len(where) == len(measured)) or len(measured) < 8:
        raise PalmfieldError(
            f"{len(aims)} foci, {len(where)} positions and {len(measured)} readings; needed: at least 8 of each"
        )
    if not np.all(np.isfinite(measured) & (measured >= 0.0)) or measured.max() == 0.0:
        raise PalmfieldError("pressures_Pa has values that are negative or not finite, or only zeros: give amplitudes")
    foci, which = np.unique(aims, axis=0, return_inverse=True)
    drives = [compensate(array, focus(array, air, point)) for point in foci]
    start = np.zeros(3)
    for number, point in enumerate(foci):
        own = np.flatnonzero(which == number)
        gap = where[own[np.argmax(measured[own])]] - point
        if np.linalg.norm(gap[:2]) > WITHIN_M:
            raise PalmfieldError(
                f"the loudest reading of the focus at {point.tolist()} m is "
                f"{1e3 * float(np.linalg.norm(gap[:2])):.0f} mm from it: check that both are in the array frame, "
                "in metres"
            )
        start += gap * [1.0, 1.0, 0.0] / len(foci)
    turning = len(foci) >= 3 and np.linalg.matrix_rank(foci - foci.mean(axis=0), tol=1e-3) >= 2

    def residual(unknown: Float) -> Float:
        turn = unknown[3:] * TURN_SD_RAD if turning else np.zeros(3)
        moved = placed(array, unknown[:3] * OFFSET_SD_M, Rotation.from_rotvec(turn).as_matrix())
        model = np.empty(len(where))
        for number, drive in enumerate(drives):
            own = which == number
            model[own] = np.abs(pressure64(where[own], moved, drive, air)[0])
        scale = float(model @ measured) / float(model @ model)
        return np.asarray((measured - scale * model) / (0.03 * measured.max()))

    begin = np.concatenate([start / OFFSET_SD_M, np.zeros(3 if turning else 0)])
    # The unknowns are in units of their prior standard deviations, so they are also the residuals of the priors
    fit = least_squares(lambda unknown: np.concatenate([residual(unknown), unknown]), begin, x_scale=0.1)
    if not fit.success:
        raise PalmfieldError(
            f"the fit of the board position does not converge ({fit.message}): scan closer to the foci"
        )
    rest = residual(fit.x)
    noise = math.sqrt(float(rest @ rest) / max(len(rest) - len(fit.x) - 1, 1))
    errors = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac))) * max(noise, 1e-9)
    # The distance of a focus changes by the relative error of the speed of sound
    air_sd_m = sound_speed_sd(air, temperature_sd_K) / sound_speed(air) * np.abs(foci).mean(axis=0)
    turns = fit.x[3:] * TURN_SD_RAD if turning else np.zeros(3)
    turn_errors = errors[3:] * TURN_SD_RAD if turning else np.zeros(3)
    return Pose(
        offset_m=tuple((fit.x[:3] * OFFSET_SD_M).tolist()),
        offset_sd_m=tuple(np.hypot(errors[:3] * OFFSET_SD_M, air_sd_m).tolist()),
        turn_rad=tuple(turns.tolist()),
        turn_sd_rad=tuple(turn_errors.tolist()),
    )
