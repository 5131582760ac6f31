"""Results of a trial: as numbers, as text and as a table."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np

from palmfield.acoustics.calibration_file import Calibration
from palmfield.drive.board import Board
from palmfield.studies.trial.course import Tracker
from palmfield.studies.trial.field import TrialMoment, TrueSound
from palmfield.studies.trial.recording import Compared
from palmfield.studies.trial.sending import VIRTUAL, Sent
from palmfield.studies.trial.skin_response import SkinResponse
from palmfield.types import Float

COLUMNS = (
    "time_s", "true_x_m", "true_y_m", "true_z_m", "believed_x_m", "believed_y_m", "believed_z_m", "sounding_x_m",
    "sounding_y_m", "sounding_z_m", "lateral_error_m", "depth_error_m", "age_s", "frame", "level", "wanted_Pa",
    "late_Pa", "rounded_Pa", "heard_Pa", "push_m", "arp_max_Pa",
)  # fmt: skip


class Spread(NamedTuple):
    """Spread of values over a trial; NaN if there are no values."""

    mean: float
    p95: float
    largest: float


class Share(NamedTuple):
    """Remaining fraction of the pressure at the hand (1: no loss): mean and minimum over the trial."""

    mean: float
    least: float


@dataclass(frozen=True)
class Numbers:
    """A trial in numbers.

    lateral_mm, depth_mm, distance_mm: distance of the focus from its target on the hand, across the axis of the array,
        along it, and in total
    without_focus: fraction of times at which the sound has no focus
    age_ms: time since the tracker sample from which the sound at the hand was computed
    kept_late, kept_rounded, kept_calibration: fraction of the pressure at the hand that remains after latency, after
        rounding by the board, and with the true transducers; kept: after all three. ARP is quadratic in these.
        kept_calibration is None without data on the true transducers
    wanted_Pa: mean pressure amplitude at the hand without losses, at full level
    push_um, push_ideal_um: rms displacement of the skin at the first position of the focus, with and without losses;
        None if the skin was not stepped
    """

    scene: str
    board: str
    port: str
    stimulus: str
    duration_s: float
    ended_s: float
    interrupted: bool
    tracker_rate_Hz: float
    tracker_latency_ms: float
    tracker_noise_mm: float
    ahead_ms: float | None
    frames_due: int
    frames_sent: int
    frames_dropped: int
    late_ms: float
    lateral_mm: Spread
    depth_mm: Spread
    distance_mm: Spread
    without_focus: float
    age_ms: Spread
    kept_late: Share
    kept_rounded: Share
    kept_calibration: Share | None
    kept: Share
    wanted_Pa: float
    push_um: float | None
    push_ideal_um: float | None
    flags: tuple[str, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """Return the numbers for JSON, with units in the names."""
        plain = asdict(self)
        for name, value in plain.items():
            if isinstance(value, Spread | Share):
                plain[name] = {key: _plain(number) for key, number in value._asdict().items()}
            elif isinstance(value, float):
                plain[name] = _plain(value)
        return plain


def _plain(number: float) -> float | None:
    return float(number) if np.isfinite(number) else None


def numbers_of(
    scene: str,
    board: Board,
    sound: TrueSound,
    sent: Sent,
    moments: Sequence[TrialMoment],
    tracker: Tracker,
    duration_s: float,
    skin: SkinResponse | None,
    skin_ideal: SkinResponse | None,
    port: str | None,
    truth: Calibration | None,
    notes: Sequence[str] = (),
) -> Numbers:
    """Compute the numbers of a trial. The arguments are those of `palmfield.studies.trial.run.Trial` and `trial`."""
    names, rows = table_of(moments, None)
    column = dict(zip(names, rows.T, strict=True))
    lateral, depth = 1e3 * column["lateral_error_m"], 1e3 * np.abs(column["depth_error_m"])
    target, late = column["wanted_Pa"], column["late_Pa"]
    rounded, played = column["rounded_Pa"], column["heard_Pa"]
    compared = target[np.isfinite(target)]
    return Numbers(
        scene=scene,
        board=board.name,
        port="its virtual twin, without waiting" if port is None else port,
        stimulus=sound.model.stimuli[sound.number].spec.name,
        duration_s=duration_s,
        ended_s=sent.end_s,
        interrupted=sent.interrupted,
        tracker_rate_Hz=tracker.rate_Hz,
        tracker_latency_ms=1e3 * tracker.latency_s,
        tracker_noise_mm=1e3 * tracker.noise_m,
        ahead_ms=None if tracker.ahead_s is None else 1e3 * tracker.ahead_s,
        frames_due=sent.due,
        frames_sent=len(sent.frames),
        frames_dropped=sent.dropped,
        late_ms=1e3 * sent.late_s,
        lateral_mm=_spread(lateral),
        depth_mm=_spread(depth),
        distance_mm=_spread(np.hypot(lateral, depth)),
        without_focus=float(np.mean(~np.isfinite(lateral))) if len(lateral) else 1.0,
        age_ms=_spread(1e3 * column["age_s"]),
        kept_late=_share(late, target),
        kept_rounded=_share(rounded, late),
        kept_calibration=None if truth is None else _share(played, rounded),
        kept=_share(played, target),
        wanted_Pa=float(compared.mean()) if len(compared) else np.nan,
        push_um=_rms_um(skin),
        push_ideal_um=_rms_um(skin_ideal),
        flags=tuple(sent.flags),
        notes=tuple(notes),
    )


def _rms_um(skin: SkinResponse | None) -> float | None:
    return None if skin is None or not len(skin.times) else 1e6 * float(np.sqrt(np.mean(skin.push**2)))


def _spread(values: Float) -> Spread:
    finite = values[np.isfinite(values)]
    if not len(finite):
        return Spread(np.nan, np.nan, np.nan)
    return Spread(float(finite.mean()), float(np.percentile(finite, 95)), float(finite.max()))


def _share(after: Float, before: Float) -> Share:
    valid = np.isfinite(after) & np.isfinite(before) & (before > 0.0)
    if not valid.any():
        return Share(np.nan, np.nan)
    ratio = after[valid] / before[valid]
    return Share(float(ratio.mean()), float(ratio.min()))


def table_of(moments: Sequence[TrialMoment], skin: SkinResponse | None) -> tuple[tuple[str, ...], Float]:
    """Return the column names, and a row for each time, shape (k, columns). Columns of a skin not stepped are NaN."""
    rows = []
    for one in moments:
        miss = one.sounding - one.true
        push, arp = np.nan, np.nan
        if skin is not None and len(skin.times):
            step = int(np.searchsorted(skin.times, one.time_s - 1e-9))
            if step < len(skin.times):
                push, arp = float(skin.push[step]), float(skin.arp[step])
        error = float(np.hypot(miss[0], miss[1])), float(miss[2])
        where = [*one.true, *one.believed, *one.sounding, *error]
        rows.append([one.time_s, *where, one.age_s, one.frame, one.level, *one.pressures, push, arp])
    return COLUMNS, np.array(rows, dtype=np.float64).reshape(-1, len(COLUMNS))


def as_text(numbers: Numbers, compared: Compared | None) -> str:
    """Return the results of a trial, line by line."""
    n = numbers
    cut = f", ended by Ctrl-C at {n.ended_s:.3g} s" if n.interrupted else ""
    lines = [
        f"trial of {n.scene}: {n.duration_s:g} s of stimulus '{n.stimulus}' on board {n.board} "
        f"({'paced in real time' if n.port == VIRTUAL else n.port}){cut}",
        f"tracker         {_tracker(n)}",
        f"frames          {n.frames_due} due, {n.frames_sent} sent, {n.frames_dropped} dropped; largest delay "
        f"{n.late_ms:.1f} ms",
        f"age of sample   {_of(n.age_ms)} ms when it acts on the skin",
        f"focus error     lateral {_of(n.lateral_mm)} mm, depth {_of(n.depth_mm)} mm",
    ]
    if n.without_focus > 0.0:
        lines.append(f"                no focus for {100.0 * n.without_focus:.1f} % of the time")
    lines += [
        f"pressure kept   {_percent(n.kept)} of {n.wanted_Pa:.0f} Pa at the hand",
        f"  by latency    {_percent(n.kept_late)}",
        f"  by the board  {_percent(n.kept_rounded)}: its rounding, and its own focus computation",
    ]
    if n.kept_calibration is None:
        lines.append("  by calibration  unknown: transducers are assumed as in the scene (--truth)")
    else:
        lines.append(f"  by calibration {_percent(n.kept_calibration)}")
    if n.push_um is not None and n.push_ideal_um:
        lines.append(
            f"skin            displacement {n.push_um:.3g} um (rms) at the intended focus, "
            f"{n.push_um / n.push_ideal_um:.3f} of that without these losses"
        )
    lines += [f"board error     {flag}" for flag in n.flags[:5]]
    if len(n.flags) > 5:
        lines.append(f"                and {len(n.flags) - 5} more of this kind")
    lines += n.notes
    if compared is not None:
        lines += str(compared).split("\n")
    return "\n".join(lines)


def _tracker(n: Numbers) -> str:
    rate = "one sample per frame" if n.tracker_rate_Hz == 0.0 else f"{n.tracker_rate_Hz:g} samples/s"
    ahead = "predicted to the middle of each frame"
    if n.ahead_ms is not None:
        ahead = "without prediction" if n.ahead_ms == 0.0 else f"predicted {n.ahead_ms:g} ms ahead"
    noise = f", noise {n.tracker_noise_mm:g} mm" if n.tracker_noise_mm else ""
    return f"{rate}, {n.tracker_latency_ms:g} ms late{noise}, {ahead}"


def _of(spread: Spread) -> str:
    return f"{spread.mean:.2f} (95 %: {spread.p95:.2f}, largest {spread.largest:.2f})"


def _percent(share: Share) -> str:
    return f"{share.mean:.4f} (least {share.least:.4f}; of the ARP {share.mean**2:.4f})"
