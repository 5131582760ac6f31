"""Compare a measured scan with a run: register it to the skin, apply the instrument model, and report each point."""

from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import detrend
from scipy.spatial import cKDTree

from palmfield.errors import MeasurementError, OutputError, did_you_mean, naming
from palmfield.files import made_folder
from palmfield.instruments.agreement import Agreement, agreement, delays
from palmfield.instruments.frequency_wavenumber import frequency_wavenumber
from palmfield.instruments.registration import Registration, registration
from palmfield.instruments.scan import Scan, of_record, pitch
from palmfield.instruments.settings import read_settings
from palmfield.instruments.surface_motion import SurfaceMotion, of_skin
from palmfield.instruments.vibrometer import Vibrometer, vibrometer_record
from palmfield.metrics.checks import even_step
from palmfield.outputs.compare_picture import draw_agreement, draw_wavenumbers
from palmfield.outputs.scan_files import read_scan, write_scan
from palmfield.outputs.schema import instances
from palmfield.outputs.store import open_result
from palmfield.studies.compare.report import Comparison, guided_modes, write_report
from palmfield.tables import pop_columns, read_table
from palmfield.types import Float

OFF_M = 5e-3
"""Largest distance of a measured point from the skin [m]. Points farther away are excluded."""
HUGE = 20.0
"""Ratio of the size of a scan to that of the skin above which the scan is probably in another unit."""
PAIR_COLUMNS = ("x_m", "y_m", "z_m", "skin_x_m", "skin_y_m", "skin_z_m")
FILES = ("compare.json", "points.csv", "computed.csv", "agreement.png", "wavenumbers.png")
UNIT = 30.0
"""A gain that differs from 1 by this factor, in either direction, suggests a wrong unit rather than a wrong level."""
FOLDED = 0.02
"""Fraction of the computed power above half of the scan's sampling rate. Above it, aliasing is reported."""
SHARPEN = 4
"""Exponent of the rms in the weights of `middle`. A large exponent emphasises the point with the largest motion."""
LEAST_APART_M = 1e-3
OFFSET = 0.02
"""Offset or drift, relative to the peak, above which it is reported."""
WILD = 4.0
"""Ratio to the motion of the neighbours, and to the computed motion, above which a point is a broken channel."""
NEIGHBOURS = 4


def compare(
    run: str | Path,
    measured: str | Path | Scan,
    *,
    instrument: str | Path | Vibrometer | None = None,
    skin: str | None = None,
    fiducials: str | Path | None = None,
    onto_surface: bool = True,
    most_delay_s: float = 5e-3,
    mode_Hz: float | None = None,
    source_m: tuple[float, float, float] | None = None,
    source_radius_m: float = 0.016,
    out: str | Path | None = None,
    overwrite: bool = False,
) -> Comparison:
    """Compare a measured scan with the skin of a run.

    run: folder of a run, or its result.nc; measured: file of a scan (`palmfield.outputs.scan_files.READERS`), or a Scan
    instrument: TOML file with a table [vibrometer], or settings. Sampling rate, length, quantity and, if available,
        lines of sight are taken from the scan. None: motion along the normal, on the side of the first array, without
        filters
    skin: name, needed if the run has several; fiducials: CSV file with columns PAIR_COLUMNS, points in the frame of the
        scan and their positions on the skin at rest
    onto_surface: whether to move the scan onto the skin, as far as the shape of the skin determines its position
    mode_Hz: frequency at which the guided mode of both motions is fitted
    source_m: source of the mode on the skin [m]; None: point of largest computed motion
    source_radius_m: radius about the source that is excluded; default 1.5 times the width of the spot
    out: folder for FILES; None writes no files
    Raises MeasurementError for invalid scans, settings and fiducials, OutputError for the run and for a folder that
    contains such files.
    """
    folder = None if out is None else Path(out)
    if folder is not None and not overwrite and any((folder / name).exists() for name in FILES):
        raise OutputError(f"{folder} contains another comparison; give --overwrite, or another folder by --out")
    scan = measured if isinstance(measured, Scan) else read_scan(measured)
    settings = read_settings(instrument, Vibrometer) if isinstance(instrument, str | Path) else instrument
    with open_result(run) as result:
        name, data = _skin(result, skin)
        rest, faces = data["rest_position"].values, data["face"].values
        place = registration(scan.points, rest, faces, pairs=_pairs(fiducials), surface=onto_surface)
        near = place.residual_m <= OFF_M
        if near.sum() < 2:
            raise MeasurementError(
                f"{scan.name}: {near.sum()} of {len(near)} points lie within {1e3 * OFF_M:g} mm of the skin, the "
                f"nearest at {1e3 * place.residual_m.min():.3g} mm; give the scan in the frame of the body at "
                "rest, or give fiducials" + _in_millimetres(scan, rest)
            )
        motion = of_skin(data, place.transform.points(scan.points[near]), OFF_M)
    ours = _through_instrument(motion, scan.at_points(near), place, settings)
    count = len(ours.times_s)
    moves = (np.abs(ours.values).max(axis=0) > 0.0) & (np.abs(scan.values[:count, near]).max(axis=0) > 0.0)
    if moves.sum() < 2:
        raise MeasurementError(
            f"{scan.name}: fewer than two points move both in the scan and in the run; check the position of the scan"
        )
    still, ours = int((~moves).sum()), ours.at_points(moves)
    near[near] = moves
    theirs = Scan(scan.quantity, scan.times_s[:count], scan.points[near], scan.values[:count, near], name=scan.name)
    broken = wild(theirs, ours)
    if (~broken).sum() < 2:
        broken[:] = False
    lost = np.flatnonzero(near)[broken]
    near[lost] = False
    theirs, ours = theirs.at_points(~broken), ours.at_points(~broken)
    with naming(scan.name):
        numbers = agreement(theirs.times_s, theirs.values, ours.values, most_delay_s=most_delay_s)
    on_skin = Scan(theirs.quantity, theirs.times_s, ours.points, theirs.values, name=scan.name)
    odd = suspected_faults(on_skin, ours, motion, numbers, most_delay_s)
    if still:
        one = still == 1
        odd.append(
            f"{still} point{'' if one else 's'} without motion, in the scan or at the fixed rim of the skin: excluded"
        )
    if len(lost):
        odd.append(
            f"the channel of point{'' if len(lost) == 1 else 's'} {', '.join(map(str, lost))} seems faulty: its "
            f"signal is over {WILD:g} times that of all neighbours and of the computed motion; excluded"
        )
    moved = float(np.linalg.norm(place.transform.points(scan.points).mean(axis=0) - scan.points.mean(axis=0)))
    if fiducials is None and moved > float(np.linalg.norm(np.ptp(scan.points, axis=0))):
        odd.append(
            f"the scan was moved by {1e3 * moved:.3g} mm, more than its width, to lie on the skin, and may lie on "
            "another part of it: give --fiducials"
        )
    if near.mean() < 0.5:
        odd.append("more than half of the points are excluded: check position, unit and axes of the scan")
    modes = None
    if mode_Hz is not None:
        source = None if source_m is None else np.asarray(source_m, dtype=float)
        modes = guided_modes(theirs, ours, mode_Hz, source, source_radius_m)
    done = Comparison(
        scan.name, name, scan.quantity, place, near, ours, numbers, settings is None,
        float(scan.times_s[-1] - theirs.times_s[-1]), most_delay_s, tuple(odd), mode_Hz, modes,
    )  # fmt: skip
    if folder is None:
        return done
    made_folder(folder)
    write_report(done, folder)
    write_scan(folder / "computed.csv", ours)
    draw_agreement(theirs, ours, numbers, folder / "agreement.png")
    first, second = (frequency_wavenumber(one.times_s, one.values, one.points) for one in (theirs, ours))
    draw_wavenumbers(first, second, folder / "wavenumbers.png")
    return done


def _skin(result: xr.DataTree, name: str | None) -> tuple[str, xr.Dataset]:
    skins = instances(result, "skin")
    if not skins:
        raise OutputError("the result has no skin to compare with a scan")
    if name is None:
        if len(skins) > 1:
            raise MeasurementError(f"the run has skins {', '.join(skins)}; give one by --skin")
        name = next(iter(skins))
    if name not in skins:
        raise MeasurementError(f"skin '{name}' is not in the run{did_you_mean(name, skins)}; it has {', '.join(skins)}")
    return name, skins[name]


def _pairs(file: str | Path | None) -> tuple[Float, Float] | None:
    if file is None:
        return None
    columns, _ = read_table(Path(file))
    table = pop_columns(Path(file), columns, PAIR_COLUMNS, MeasurementError)
    return table[:, :3], table[:, 3:]


def _in_millimetres(scan: Scan, vertices: Float) -> str:
    """Return a hint if a scan is much larger than the skin, so that its positions cannot be in metres; otherwise ""."""
    sizes = [float(np.linalg.norm(np.ptp(points, axis=0))) for points in (scan.points, vertices)]
    if sizes[0] < HUGE * sizes[1]:
        return ""
    return f" (its size is {sizes[0]:.3g} m, that of the skin {sizes[1]:.2g} m: positions are in metres)"


def _through_instrument(motion: SurfaceMotion, scan: Scan, place: Registration, settings: Vibrometer | None) -> Scan:
    """Return the computed motion at the positions of the scan, as its instrument reads it.

    The times are those of the scan within the run.
    """
    head = settings or _straight(motion.normals.mean(axis=0))
    rate = scan.rate_Hz
    trigger = head.trigger_s + float(scan.times_s[0])
    room = motion.times_s[-1] - (trigger - head.flight_s)
    count = min(len(scan.times_s), int(np.floor(room * rate + 1e-6)) + 1)
    if count < 16:
        raise MeasurementError(
            f"{scan.name}: {max(count, 0)} of its samples lie within the run, which ends at {motion.times_s[-1]:g} "
            "s; simulate for longer, or correct trigger_s"
        )
    chosen = head.model_copy(
        update={"sampling_rate_Hz": rate, "duration_s": count / rate, "reading": scan.quantity, "trigger_s": trigger}
    )
    sights = None if scan.sights is None else place.transform.vectors(scan.sights)
    record = vibrometer_record(motion, chosen, sights=sights)
    return Scan(**{**of_record(record).__dict__, "times_s": record["time"].values + scan.times_s[0]})


def _straight(normal: Float) -> Vibrometer:
    """Return a vibrometer that reads the motion along a direction, without filters."""
    x, y, z = (float(part) for part in normal / np.linalg.norm(normal))
    along = int(np.abs(normal).argmin())
    return Vibrometer(normal=(x, y, z), x_axis=(float(along == 0), float(along == 1), float(along == 2)))


def wild(measured: Scan, computed: Scan) -> NDArray[np.bool_]:
    """Return which points of a scan have a broken channel, for instance because the beam was lost, shape (n,).

    Such a point would otherwise be taken as the point of largest motion, to which the other points are compared.
    """
    theirs, ours = (np.sqrt(np.mean(scan.values**2, axis=0)) for scan in (measured, computed))
    count = min(NEIGHBOURS, len(theirs) - 1)
    neighbours = cKDTree(measured.points).query(measured.points, k=count + 1)[1][:, 1:]
    alone = theirs > WILD * theirs[neighbours].max(axis=1)
    level = float(np.median(theirs / ours))
    return np.asarray(alone & (theirs > WILD * level * ours.max()))


def middle(scan: Scan) -> Float:
    """Return the centre of a motion [m], shape (3,): the mean of the points, weighted by std to the power SHARPEN."""
    weights = np.std(scan.values, axis=0)
    weights = (weights / weights.max()) ** SHARPEN
    return np.asarray(weights @ scan.points / weights.sum())


def suspected_faults(
    measured: Scan, computed: Scan, motion: SurfaceMotion, numbers: Agreement, most_delay_s: float
) -> list[str]:
    """Return sentences for a report. There are none if the comparison is plausible.

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
