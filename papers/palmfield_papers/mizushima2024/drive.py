"""Rows M6: components of the radiation pressure of an amplitude-modulated sound."""

from typing import Any

import numpy as np

from palmfield.acoustics import pressure64
from palmfield.config import StimulusConfig
from palmfield.drive import Pole
from palmfield.drive.response import envelope_response
from palmfield.stimulus.modulation import arp_lines
from palmfield.types import Float
from palmfield_papers.answer import Answer, Compute, Setting
from palmfield_papers.mizushima2024.bows import ROOM, Bows, array_of, drives_of, focus_of

DEPTHS = np.array([0.25, 0.5, 1.0])
PARTS = ("mean", "first", "second")
LAWS = {"mean": lambda m: 1.0 + m**2 / 2.0, "first": lambda m: 2.0 * m, "second": lambda m: m**2 / 2.0}


def parts(depth: float) -> dict[str, float]:
    """Return the steady part and the components at f and 2f of the radiation pressure, relative to the carrier."""
    keys: dict[str, Any] = {"modulation": "am", "am_quantity": "amplitude", "am_depth": depth, "am_frequency_Hz": 200.0}
    lines = arp_lines(StimulusConfig(**keys))
    assert lines is not None and lines.first is not None and lines.second is not None
    loudest = (1.0 + depth) ** 2
    return {"mean": lines.mean * loudest, "first": lines.first * loudest, "second": lines.second * loudest}


def exponent_of(x: Float, y: Float) -> float:
    """Return the slope of a line through the logarithms of x and y."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def in_voltage(setting: Setting) -> Answer:
    bows, levels = Bows(), np.array([0.25, 0.5, 1.0])
    squares = [
        float(np.abs(pressure64(focus_of(bows)[None], array_of(bows), v * drives_of(bows)[0], ROOM)[0][0]) ** 2)
        for v in levels
    ]
    return Answer(exponent_of(levels, np.array(squares)), error=0.0)


def in_depth(setting: Setting) -> Answer:
    first = np.array([parts(float(depth))["first"] for depth in DEPTHS])
    return Answer(exponent_of(DEPTHS, first), error=0.0)


def against_law(part: str) -> Compute:
    def compute(setting: Setting) -> Answer:
        found = {float(m): parts(float(m))[part] for m in DEPTHS}
        return Answer(
            found[1.0] / LAWS[part](1.0),
            error=max(abs(value - LAWS[part](m)) for m, value in found.items()),
            note="over the law, at m = 1",
            shown={f"at m = {m:g}, over the carrier's": value for m, value in found.items()},
        )

    return compute


def steady_part(setting: Setting) -> Answer:
    half, whole = parts(0.5)["mean"], parts(1.0)["mean"]
    return Answer(half / whole, error=0.0, note="steady part at m = 0.5 over that at m = 1: below 1, it falls with m")


def course_over_frequency(frequencies_Hz: Float, quality: float) -> Float:
    """Return the component of the radiation pressure at f relative to that at 0 Hz, for speakers at resonance."""
    pole = Pole(40e3, quality)
    upper, lower = (envelope_response(sign * frequencies_Hz, pole)[:, 0] for sign in (1.0, -1.0))
    # The square of 1 + (m/2)(H+ e^{-iwt} + H- e^{iwt}) has m |H+ + conj(H-)| at f
    return np.asarray(0.5 * np.abs(upper + lower.conj()))


ANSWERS: dict[str, Compute] = {
    "M6a": in_voltage,
    "M6b": in_depth,
    "M6d": against_law("mean"),
    "M6e": against_law("first"),
    "M6f": against_law("second"),
    "M6g": steady_part,
}
