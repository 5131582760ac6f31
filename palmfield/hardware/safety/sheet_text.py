"""Format a safety sheet as one page of markdown, or as numbers for other programs."""

import math
from typing import Any

from palmfield.acoustics.exposure import OCCUPATIONAL_DB, PUBLIC_DB
from palmfield.drive.limits import WINDOW_S, SoundLimits
from palmfield.hardware.safety.byproduct import RATE_HZ, Byproduct
from palmfield.hardware.safety.exposure import Exposure
from palmfield.hardware.safety.scene_sound import MOMENTS
from palmfield.hardware.safety.sheet import SafetySheet


def as_markdown(sheet: SafetySheet, picture: str | None = None) -> str:
    """Return the page. picture: path of the picture relative to the page; None for none"""
    driver, board, head = sheet.driver, sheet.board, sheet.head
    assert driver.head_m is not None
    where = ", ".join(f"{1e3 * x:.0f}" for x in driver.head_m)
    declared = (
        "declared by driver keys head_m and head_radius_m"
        if sheet.head_declared
        else "**not declared by the scene**: default position of a person who sits in front of an array that faces up"
    )
    computed = f"computed, free field, {MOMENTS} moments; band: range of p0"
    rows = [
        ("SPL at the head, loudest moment and point", _level(head.level_dB, head), computed),
        ("SPL at the head, mean over the play", _level(head.mean_level_dB, head), computed),
        (
            "dose at the head for one play, as equivalent level over 8 h",
            _level(head.dose_dB(sheet.duration_s), head),
            computed,
        ),
        ("dose at the head for 1 h of this sound", _level(head.dose_dB(3600.0), head), computed),
    ]
    for hand in sheet.hands:
        loudest = hand.loudest
        rows.append((f"SPL at {hand.skin}, loudest moment and point", _level(loudest.level_dB, loudest), computed))
        low, high = (hand.arp_Pa * 10.0 ** (end / 10.0) for end in loudest.band_dB)
        value = f"{hand.arp_Pa:.3g} Pa ({low:.3g} to {high:.3g})"
        rows.append((f"largest ARP at {hand.skin}", value, "computed by the scene's key arp_law; band: range of p0"))
    lines = [
        f"# Safety sheet of {sheet.scene}",
        "",
        f"One play of {sheet.duration_s:g} s by board {board.name}. Carrier {1e-3 * sheet.carrier_Hz:g} kHz. This "
        "page states exposures and limits; it does not decide whether a study may be done. All values are "
        "computed unless marked as measured.",
        "",
        f"Head: a ball of {1e3 * driver.head_radius_m:.0f} mm round ({where}) mm in the frame of "
        f"the first array, {declared}.",
        "",
        "## Exposure",
        "",
        "| quantity | value (band) | source |",
        "|---|---|---|",
        *(f"| {what} | {value} | {source} |" for what, value, source in rows),
        "",
        f"Interim guidelines for airborne ultrasound of 25 to 50 kHz name {PUBLIC_DB:g} dB for the public and "
        f"{OCCUPATIONAL_DB:g} dB at work, as levels. The levels here are of incident sound: reflection by a hand "
        "or a wall can raise them by up to 6 dB, or send a beam to another place. Ring-up of the transducers and "
        "nonlinear losses are not included.",
        *(f"- {note}" for note in sheet.head_warnings),
        *_looked_at(sheet),
        *(() if picture is None else ("", f"![levels at the head and the hand]({picture})")),
        "",
        "## Level of the array",
        "",
        *(
            f"- {name}: p0 {p0.value:.3g} Pa m ({p0.low:.3g} to {p0.high:.3g}), {p0.kind}: {p0.source}"
            for name, p0 in sheet.p0.items()
        ),
        "",
        "## Audible by-product",
        "",
        *_audible(sheet),
        "",
        "## Duty and on-time",
        "",
        *_limits(sheet),
        "",
        "## The board",
        "",
        *_board(sheet),
    ]
    return "\n".join(lines) + "\n"


def _looked_at(sheet: SafetySheet) -> list[str]:
    """Describe the region that was searched for the loudest points."""
    if sheet.moves:
        note = f"hands and arrays follow the motion of the scene at each of the {MOMENTS} moments"
    else:
        note = f"the scene has no motion; its sound is evaluated at {MOMENTS} moments"
    warned = "with p0 at the high end of its range" if sheet.head.band_dB[1] > 0.0 else "at the nominal p0"
    return [
        "",
        f"One play of the scene: {note}. Limits are compared with the loudest point of a region at its loudest "
        f"moment, {warned}, never with a mean.",
    ]


def _level(level_dB: float, loudest: Exposure) -> str:
    if level_dB == -math.inf:
        return "silence"
    low, high = loudest.band_dB
    return f"{level_dB:.0f} dB ({level_dB + low:.0f} to {level_dB + high:.0f})"


def _stepped(sound: Byproduct) -> bool:
    """Return whether the loudest line is at the upper end of the estimated range, so that no level can be stated.

    Steps of the sound have A-weighted lines that grow with frequency.
    """
    return sound.strongest_Hz > 0.25 * RATE_HZ


def _audible(sheet: SafetySheet) -> list[str]:
    sound = sheet.byproduct
    if sound is None:
        return ["Not estimated: the ball of the head lies in the beam, where the formulas do not apply."]
    if sound.level_dBA == -math.inf:
        return ["None: the intensity of the sound does not change over the evaluated quarter of a second."]
    low, high = (2.0 * end for end in max(sheet.hands, key=lambda hand: hand.loudest.peak_Pa).loudest.band_dB)
    if _stepped(sound):
        return [
            "Not estimated: the loudest part of the sound lies at the upper end of the estimate, "
            f"{0.5e-3 * RATE_HZ:g} kHz. Expect clicks and a buzz at the frame rate, and measure them."
        ]
    level = sound.level_dBA
    return [
        f"Rough estimate: {level:.0f} dB(A) ({level + low:.0f} to {level + high:.0f}), "
        f"{1e3 * sheet.distance_m:.0f} mm from the beam, strongest near {sound.strongest_Hz:.0f} Hz: "
        f"{sound.air_dBA:.0f} dB(A) generated in the air along the beam (Westervelt 1963, Berktay 1965), "
        f"{sound.force_dBA:.0f} dB(A) generated by the force on the hand (Morse and Ingard 1968); A-weighting by "
        "IEC 61672-1.",
        "",
        "The estimate is rough and usually too high. Assumptions: all ultrasound has the time course of the "
        "loudest skin point, which overstates a moving focus; the beam is straight and as long as absorption "
        "allows; the hand stops all of it; steps of the drive are smoothed by one resonance. Not included: sound "
        f"above {0.5e-3 * RATE_HZ:g} kHz, the room, and noise of transducers and electronics, which can be louder. "
        "Measure it.",
    ]


def _limits(sheet: SafetySheet) -> list[str]:
    limits = SoundLimits.of(sheet.driver)
    longest = "none is set" if limits.on_time_s is None else f"{limits.on_time_s:g} s"
    duty = "none is set" if limits.duty >= 1.0 else f"{100 * limits.duty:g} % of any {WINDOW_S:g} s"
    head = "none is set" if sheet.driver.head_limit_dB is None else f"{sheet.driver.head_limit_dB:g} dB"
    return [
        f"- Sound on: {100 * sheet.sounding_share:.0f} % of {MOMENTS} moments of the play (computed).",
        f"- Longest sound in one play: {longest} (driver key on_time_s).",
        f"- Largest share of time with sound: {duty} (driver key duty_limit).",
        f"- Highest level at the head at which the board plays: {head} (driver key head_limit_dB).",
        f"- Ramp: {limits.in_words(sheet.board) or 'none is set'} (driver key ramp_s).",
    ]


def _board(sheet: SafetySheet) -> list[str]:
    board = sheet.board
    if board.exact:
        return [f"{board.name} is not a real board and receives no bytes. Give the board of the study by --board."]
    return [
        f"{board.name}: {board.description} (palmfield's registry of boards).",
        f"- If the host stops: {board.when_host_dies}.",
        f"- Limits of the board: {board.cannot_guarantee}",
        "- The limits above are enforced by the program on the host. They do not replace a switch that cuts power.",
    ]


def as_dict(sheet: SafetySheet) -> dict[str, Any]:
    """Return the numbers with their units in the names. Levels of silence are null."""
    driver, board = sheet.driver, sheet.board
    sound = None if sheet.byproduct is None or _stepped(sheet.byproduct) else sheet.byproduct
    return {
        "scene": sheet.scene,
        "duration_s": sheet.duration_s,
        "board": board.name,
        "when_host_dies": board.when_host_dies,
        "cannot_guarantee": board.cannot_guarantee,
        "head_declared": sheet.head_declared,
        "head_m": driver.head_m,
        "head_radius_m": driver.head_radius_m,
        "head": _facts(sheet.head, sheet.duration_s),
        "head_warnings": list(sheet.head_warnings),
        "hands": [
            {"skin": one.skin, **_facts(one.loudest, sheet.duration_s), "arp_Pa": one.arp_Pa} for one in sheet.hands
        ],
        "p0": {
            name: {
                "value_Pa_m": p0.value,
                "low_Pa_m": p0.low,
                "high_Pa_m": p0.high,
                "kind": p0.kind,
                "source": p0.source,
            }
            for name, p0 in sheet.p0.items()
        },
        "audible_dBA": None if sound is None else _finite(sound.level_dBA),
        "audible_air_dBA": None if sound is None else _finite(sound.air_dBA),
        "audible_force_dBA": None if sound is None else _finite(sound.force_dBA),
        "audible_distance_m": _finite(sheet.distance_m),
        "sounding_share": sheet.sounding_share,
        **driver.model_dump(include={"ramp_s", "on_time_s", "duty_limit", "head_limit_dB"}),
    }


def _facts(loudest: Exposure, duration_s: float) -> dict[str, Any]:
    low, high = loudest.band_dB
    return {
        "place_m": loudest.place.tolist(),
        "level_dB": _finite(loudest.level_dB),
        "mean_level_dB": _finite(loudest.mean_level_dB),
        "dose_8h_dB": _finite(loudest.dose_dB(duration_s)),
        "band_low_dB": low,
        "band_high_dB": high,
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
