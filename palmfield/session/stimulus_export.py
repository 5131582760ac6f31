"""Export the stimulus of a scene as a table of foci, an STM file of AUTD3 devices, or a pattern of Adaptics."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from palmfield.config.stimulus import StimulusConfig
from palmfield.errors import OutputError, SceneError, did_you_mean
from palmfield.session.open_scene import Source
from palmfield.session.preview import Preview, preview
from palmfield.simulation.model import StimulusModel
from palmfield.stimulus.adaptics_export import write_adaptics
from palmfield.stimulus.autd3_stm import stm_of_table, write_foci_stm
from palmfield.stimulus.duty_law import FULL_DUTY, duty_cycle
from palmfield.stimulus.focal_points import FocalPoints
from palmfield.stimulus.focus_table import FocusTable, Quantity, TableFrame
from palmfield.stimulus.focus_table_file import MOST_ROWS, focus_table, write_focus_table
from palmfield.stimulus.schedule import frame_rates, frames_at, main_frequencies, silent_after_s, table_of
from palmfield.transforms import IDENTITY
from palmfield.types import Float

USUAL_RATE_HZ = 1000.0
KINDS = {
    ".csv": ".csv (a table)", ".json": ".json (an STM of AUTD3)", ".adaptics": ".adaptics (a pattern of Adaptics)"
}  # fmt: skip


@dataclass(frozen=True)
class Exported:
    """A stimulus as a table. table: its last row ends the sound; warnings: properties that a table cannot represent

    config: keys of the stimulus
    """

    table: FocusTable
    stimulus: str
    warnings: tuple[str, ...]
    config: StimulusConfig


def exported(
    scene: Source,
    *,
    stimulus: str | None = None,
    rate_Hz: float | None = None,
    quantity: Quantity | None = None,
    frame: TableFrame = "array",
    duration_s: float | None = None,
    keys: Mapping[str, object] | None = None,
) -> Exported:
    """Sample the foci and levels of a stimulus as a table. Each sample applies until the next one.

    stimulus: instance, needed if the scene has several
    rate_Hz: rate of the samples; default: the rate of the steps of the stimulus (table, points of the path, control
        ticks), or else USUAL_RATE_HZ
    quantity: quantity of the intensities; default: that of the table, or else ARP
    frame: array, or skin for the frame of its site
    duration_s: duration; default: that of the scene
    If the stimulus is itself a table that the scene plays unchanged, the table is returned unchanged, with its straight
    lines.
    Raises SceneError for an invalid scene, an unknown stimulus or frame, and a rate or duration out of range.
    """
    view = preview(scene, keys=keys)
    model = view.runtime.model
    names = [part.spec.name for part in model.stimuli]
    if stimulus is not None and stimulus not in names:
        near = did_you_mean(stimulus, names)
        raise SceneError(f"{view.name} has no stimulus '{stimulus}'{near}; it has: {', '.join(names)}")
    if stimulus is None and len(names) > 1:
        raise SceneError(f"{view.name} has several stimuli; give --stimulus, one of: {', '.join(names)}")
    number = 0 if stimulus is None else names.index(stimulus)
    part = model.stimuli[number]
    if frame == "world" or (frame == "skin" and (part.config.frame == "array" or part.path is not None)):
        raise SceneError(
            f"--frame has value '{frame}', but stimulus '{part.spec.name}' has frame '{part.config.frame}', path_on "
            f"{part.config.path_on}; allowed: array{', and skin where frame is a site' if frame == 'skin' else ''}"
        )
    own = table_of(part.config)
    warnings = _warnings(part, names)
    if own is not None and rate_Hz is None and _plays_as_it_is(part, own, frame, quantity, duration_s):
        return Exported(own, part.spec.name, warnings, part.config)
    usual = own.rate_Hz if own is not None else max(frame_rates(part.config), default=USUAL_RATE_HZ)
    rate = usual if rate_Hz is None else rate_Hz
    lasts = view.duration_s if duration_s is None else duration_s
    end = silent_after_s(part.config)
    count = math.ceil(min(lasts, math.inf if end is None else end) * rate - 1e-6)
    if not 1 <= count <= MOST_ROWS:
        raise SceneError(
            f"{lasts:g} s at {rate:g} Hz give {count} rows; allowed: 1 to {MOST_ROWS}: give another --rate or "
            "--duration"
        )
    times: Float = np.arange(count) / rate
    fastest = max(main_frequencies(part.config), default=0.0)
    if 2.0 * fastest > rate:
        warnings += (f"the stimulus changes at up to {fastest:g} Hz, which {rate:g} samples per second do not resolve",)
    points, factors = frames_at(part.config, times)
    places = _places(view, number, times, points, frame)
    loud = np.array([_each(part, one) for one in points]) * factors[:, None]
    chosen: Quantity = quantity or ("arp" if own is None else own.quantity)
    exponent = model.spec.driver.duty_exponent
    table = focus_table(
        times, places, _intensities(loud, chosen, exponent), rate_Hz=rate, frame=frame, quantity=chosen
    )  # fmt: skip
    return Exported(table.without_repeats(), part.spec.name, warnings, part.config)


def export_stimulus(
    result: Exported, path: Path, *, again: bool = False, overwrite: bool = False
) -> tuple[str, ...]:  # fmt: skip
    """Write a table (.csv), an STM file (.json) or a pattern of Adaptics (.adaptics), and return notes for users.

    again: whether the STM repeats without end
    Raises OutputError for an unknown suffix or a file that may not be replaced. Raises SceneError for a table that
    AUTD3 devices or Adaptics cannot play.
    """
    kind = path.suffix.lower()
    if kind not in KINDS:
        raise OutputError(f"{path}: the kind of the file is '{path.suffix}'; allowed: {', '.join(KINDS.values())}")
    if path.exists() and not overwrite:
        raise OutputError(f"{path} exists and would be replaced; give another file, or --overwrite")
    if kind == ".adaptics":
        return write_adaptics(path, result.table, result.config)
    if kind == ".csv":
        write_focus_table(path, result.table)
    else:
        write_foci_stm(path, stm_of_table(result.table, again=again))
    return ()


def _plays_as_it_is(
    part: StimulusModel, own: FocusTable, frame: TableFrame, quantity: Quantity | None, duration_s: float | None
) -> bool:
    config = part.config
    plain = config.modulation == config.burst_window == "none" and not config.control_rate_Hz
    plain = plain and config.start_s == config.ramp_s == 0.0 and config.stop_s is None
    return plain and own.frame == frame and quantity in (None, own.quantity) and duration_s is None


def _warnings(part: StimulusModel, names: list[str]) -> tuple[str, ...]:
    config, notes = part.config, []
    if config.arp_peak_Pa is not None:
        notes.append(f"intensity 1 means arp_peak_Pa {config.arp_peak_Pa:g}, which the table does not store")
    elif config.drive_amplitude not in (None, 1.0):
        notes.append(f"intensity 1 means drive_amplitude {config.drive_amplitude:g}, which the table does not store")
    if len(names) > 1:
        notes.append(f"stimulus '{part.spec.name}' is one of {len(names)}, with its own arrays")
    return tuple(notes)


def _places(view: Preview, number: int, times: Float, points: Float, frame: TableFrame) -> Float:
    """Return positions of the foci at some times [m], shape (n, foci, 3), in the frame of the array or stimulus."""
    part = view.runtime.model.stimuli[number]
    if frame == "skin":
        own = FocalPoints(IDENTITY, part.offsets, None,
                          part.spec.focus_table)  # fmt: skip
        return np.array([np.atleast_2d(own.at(point)) for point in points])
    if not part.spec.frame_moves:
        foci = view.runtime.posed.focal_points(part, number)
        return np.array([np.atleast_2d(foci.at(point)) for point in points])
    result = []
    for (_, _, posed), point in zip(view.posed_at(times), points, strict=True):
        result.append(np.atleast_2d(posed.focal_points(part, number).at(point)))
    return np.array(result)


def _each(part: StimulusModel, point: Float) -> Float:
    """Return the ARP of each focus relative to the loudest focus, shape (foci,)."""
    if (table := part.spec.focus_table) is not None:
        each = table.arp_of_each(point[:1])[0]
        return np.asarray(each / each.max()) if each.max() > 0.0 else np.zeros(table.foci)
    arp = np.array(part.config.foci_arp or np.ones(max(1, len(part.offsets))))
    return np.asarray(arp / arp.max())


def _intensities(arp: Float, quantity: Quantity, exponent: float) -> Float:
    if quantity == "arp":
        return np.clip(arp, 0.0, 1.0)
    amplitude = np.clip(np.sqrt(arp), 0.0, 1.0)
    return amplitude if quantity == "amplitude" else duty_cycle(amplitude, exponent) / FULL_DUTY
