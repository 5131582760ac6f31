"""Write the stimuli of a run to USD: foci as moving crosses, and their paths, as curves in the world."""

import numpy as np
import xarray as xr
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

from palmfield.outputs.schema import has_records
from palmfield.outputs.usd.clock import Clock
from palmfield.outputs.usd.prims import about, add_lines, vectors
from palmfield.outputs.usd.samples import Samples
from palmfield.outputs.usd.skins import result_times

FOCUS_COLOUR = (0.06, 0.04, 0.55)
PATH_COLOUR = (0.20, 0.18, 0.75)
ARM_M = 3e-3
WIDTH_M = 6e-4
RESTS_M = 1e-6
MOST_POINTS = 2000
CROSS = ARM_M * np.stack([sign * np.eye(3)[k] for k in range(3) for sign in (-1.0, 1.0)])


class StimulusWriter:
    """Writes one stimulus: positions of its foci, and whether it is active (USD visibility).

    The prim contains Foci, a cross of three lines at each focus, and Path, a line for each focus that moves. The
    attribute palmfield:foci contains the foci [m].
    """

    def __init__(self, stage: Usd.Stage, path: str, stimulus: xr.Dataset, clock: Clock):
        self._stimulus = stimulus
        prim = UsdGeom.Xform.Define(stage, path).GetPrim()
        self._live = has_records(stimulus, "foci", "sounding") and len(clock.codes) > 0
        if not self._live:
            return
        whole = result_times(clock, slice(0, len(clock.codes)))
        step = whole.step * max(1, len(clock.codes) // MOST_POINTS)
        foci = stimulus["foci"].isel(time=slice(whole.start, whole.stop, step)).values
        lines = [line for focus in foci[0] for line in (focus + CROSS).reshape(3, 2, 3)]
        crosses = add_lines(stage, f"{path}/Foci", lines, WIDTH_M, FOCUS_COLOUR)
        # Extent of the whole path, for viewers that do not read it over time
        low, high = foci.min(axis=(0, 1)) - ARM_M - WIDTH_M, foci.max(axis=(0, 1)) + ARM_M + WIDTH_M
        crosses.GetExtentAttr().Set(Vt.Vec3fArray([Gf.Vec3f(*low.tolist()), Gf.Vec3f(*high.tolist())]))
        ways = [way for way in np.moveaxis(foci, 1, 0) if np.ptp(way, axis=0).max() > RESTS_M]
        if ways:
            add_lines(stage, f"{path}/Path", ways, 0.5 * WIDTH_M, PATH_COLOUR)
        attribute = prim.CreateAttribute("palmfield:foci", Sdf.ValueTypeNames.Double3Array, custom=True)
        about(attribute, units="m", sign="focal points in the world, also while the stimulus is silent")
        self._samples = (
            Samples(crosses.GetPointsAttr(), vectors),
            Samples(attribute, lambda points: Vt.Vec3dArray.FromNumpy(np.ascontiguousarray(points))),
            Samples(crosses.CreateVisibilityAttr(), lambda on: "inherited" if on else "invisible"),
        )

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones."""
        if not self._live:
            return
        times = result_times(clock, frames)
        foci = self._stimulus["foci"].isel(time=times).values
        sounding = self._stimulus["sounding"].isel(time=times).values
        crosses, places, visible = self._samples
        codes = clock.codes[frames].tolist()
        crosses.extend(codes, (foci[:, :, None] + CROSS).reshape(len(codes), -1, 3))
        places.extend(codes, foci)
        visible.extend(codes, sounding)
