"""Write the arrays of a run to USD: transducers with amplitude and phase over time."""

import numpy as np
import trimesh
import xarray as xr
from pxr import Gf, Usd, UsdGeom, Vt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from palmfield.outputs.frames import drive_frames, nearest
from palmfield.outputs.schema import has_records
from palmfield.outputs.usd.clock import Clock, rows_at
from palmfield.outputs.usd.looks import Palette, cyclic_palette, indices_of, paint
from palmfield.outputs.usd.prims import Moves, add_mesh, add_primvar, describe_rounding, floats, integers, vectors
from palmfield.outputs.usd.quantise import rounding
from palmfield.outputs.usd.samples import Samples
from palmfield.transforms import facing
from palmfield.types import Float, Int

CASE_COLOUR = (0.35, 0.37, 0.40)
CORNERS = 16
TURN = 2.0 * np.pi
SILENT = 1e-3
"""Amplitude below which a transducer is drawn as silent."""


class ArrayWriter:
    """Writes one array, frame by frame.

    The prim contains Transducers, a point instancer with primvars drive_amplitude and drive_phase for each,
    and Drive, discs in front of and behind each transducer (all front discs first), coloured by phase while active.
    """

    def __init__(self, stage: Usd.Stage, path: str, array: xr.Dataset):
        positions: Float = array["transducer_position"].values
        gap = float(cKDTree(positions).query(positions, k=2)[0][:, 1].min()) if len(positions) > 1 else 0.010
        self._array = array
        self._moves = Moves(UsdGeom.Xform.Define(stage, path))
        moves = has_records(array, "pose")
        self._poses: Float | None = array["pose"].values if moves else None
        self._step_times: Float = array["step_time"].values if moves else np.zeros(0)
        case = trimesh.creation.cylinder(0.46 * gap, 0.7 * gap, sections=CORNERS)
        case.apply_translation([0.0, 0.0, -0.35 * gap])
        instancer = UsdGeom.PointInstancer.Define(stage, f"{path}/Transducers")
        prototype = add_mesh(stage, f"{path}/Transducers/Case", case.vertices, case.faces, CASE_COLOUR)
        instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
        instancer.CreateProtoIndicesAttr(Vt.IntArray([0] * len(positions)))
        instancer.CreatePositionsAttr(vectors(positions))
        turns = _turns(array)
        if turns is not None:
            instancer.CreateOrientationsAttr(Vt.QuathArray([Gf.Quath(*one) for one in turns.tolist()]))
        instancer.CreateExtentAttr(instancer.ComputeExtentAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
        palette = cyclic_palette(TURN)
        self._palette = palette._replace(colours=np.vstack([palette.colours, CASE_COLOUR]))  # with a colour for silence
        discs = np.concatenate([_discs(positions, turns, 0.36 * gap, above) for above in (0.02 * gap, -0.72 * gap)])
        faces = np.arange(len(discs)).reshape(-1, CORNERS)
        self._drive: tuple[Samples, Samples, Samples] | None = None
        if not has_records(array, "drive_amplitude", "drive_phase"):
            return
        face = add_mesh(stage, f"{path}/Drive", discs, faces, None)
        colour = paint(
            face, self._palette, "uniform", quantity="drive_phase", units="rad",
            last="the last colour marks silent transducers",
        )  # fmt: skip
        self._frame_times: Float = array["frame_time"].values
        largest = float(array["drive_amplitude"].max())
        self._roundings = rounding(0.0, largest), rounding(0.0, TURN)
        signs = "1 is full drive", "positive is a delay (time factor e^{-i w t}); from 0 to a turn"
        made = []
        for name, unit, sign, rounded in zip(
            ("drive_amplitude", "drive_phase"), ("1", "rad"), signs, self._roundings, strict=True
        ):
            details = describe_rounding(rounded)
            primvar = add_primvar(instancer.GetPrim(), name, unit, sign, details)
            made.append(Samples(primvar.GetAttr(), floats))
        self._drive = made[0], made[1], Samples(indices_of(colour), integers)

    def write(self, clock: Clock, frames: slice) -> None:
        """Write frames, which must be later than earlier ones."""
        codes, times = clock.codes[frames].tolist(), clock.times_s[frames]
        if self._poses is not None:
            now = [nearest(self._step_times, time_s) for time_s in times.tolist()]
            self._moves.extend(codes, self._poses[now])
        if self._drive is None:
            return
        array = self._array
        driven = drive_frames(self._frame_times, times)
        sizes = rows_at(array["drive_amplitude"], "frame_time", driven)
        phases = np.mod(rows_at(array["drive_phase"], "frame_time", driven).astype(float), TURN)
        amplitudes, turns, numbers = self._drive
        amplitudes.extend(codes, self._roundings[0].of(sizes))
        turns.extend(codes, self._roundings[1].of(phases))
        numbers.extend(codes, np.tile(_numbers(self._palette, sizes, phases), 2))


def _numbers(palette: Palette, size: Float, phase: Float) -> Int:
    return np.where(size > SILENT, palette.numbers(phase), len(palette.colours) - 1).astype(np.int32)


def _turns(array: xr.Dataset) -> Float | None:
    """Return quaternions (w, x, y, z) that rotate z to the directions of transducers, (n, 4); None if all are z."""
    directions = array.get("transducer_direction")
    if directions is None or np.abs(directions.values - [0.0, 0.0, 1.0]).max() < 1e-9:
        return None
    return facing(directions.values)


def _discs(positions: Float, turns: Float | None, radius: float, above: float) -> Float:
    """Return the corners of a disc at each transducer, shape (n * CORNERS, 3).

    above: height over the face of the transducer
    """
    angle = TURN * np.arange(CORNERS) / CORNERS
    ring = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), np.full(CORNERS, above)])
    if turns is None:
        return (positions[:, None, :] + ring).reshape(-1, 3)
    matrices = Rotation.from_quat(turns, scalar_first=True).as_matrix()
    return (positions[:, None, :] + np.einsum("nij,cj->nci", matrices, ring)).reshape(-1, 3)
