#!/usr/bin/env python3
"""Fit the filters of afferents to published thresholds, and compare both: docs/bench/afferents.png.

    python scripts/verification/fit_afferents.py [--picture docs/bench/afferents.png]

It fits the constants of `palmfield.perception.afferents.AFFERENTS` again and prints them; thresholds of the model and
their difference from the table; levels of the populations at the thresholds of people under a contactor of 2.9 cm2; and
the range of amplitudes with one spike per cycle.
"""

import argparse
import math
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from palmfield.perception.afferents import (
    AFFERENTS,
    Afferent,
    largest_under_probe,
    potentials,
    spikes,
    under_probe,
)
from palmfield.perception.observers import OBSERVERS, threshold_m
from palmfield.perception.populations import DENSITIES_PER_CM2, REACH_M, CONTACT_m2, class_level_dB
from palmfield.types import Complex, Float

STEP_S = 1.25e-4
BEGIN = {
    "sa1": (0.03, 20.0, 5e-3),
    "ra1": (1.0, 30.0, 10.0, 3e-3),
    "pc": (30.0, 100.0, 250.0, 0.5, 1e-3),
}
"""Initial constants of the fit: gain per um, corner frequencies [Hz], damping of PC, time constant [s]."""


def response(name: str, f_Hz: Float, constants: Float) -> tuple[Complex, float]:
    """Return the filter of a class per um at some frequencies, and its time constant [s]."""
    s, turn = 2j * math.pi * f_Hz, 2.0 * math.pi
    gain, corner, *rest, tau_s = constants
    if name == "sa1":
        return gain * (1.0 + s / (turn * corner)) / (1.0 + s / (10.0 * turn * corner)), tau_s
    if name == "ra1":
        return gain * s * (s + turn * rest[0]) / (s + turn * corner) ** 2, tau_s
    squared = (turn * rest[0]) ** 2
    return gain * (s / (s + turn * corner)) ** 3 * squared / (
        s * s + 2.0 * rest[1] * turn * rest[0] * s + squared
    ), tau_s


def peak_of_integrator(f_Hz: float, tau_s: float, samples: int = 2000) -> float:
    """Return the largest level of the integrator under the positive half of a sine of amplitude 1."""
    left = math.exp(-1.0 / (f_Hz * samples * tau_s))
    driven = np.maximum(np.sin(2.0 * np.pi * np.arange(samples) / samples), 0.0)
    once = lfilter([1.0 - left], [1.0, -left], driven)
    return float((once + once[-1] / (1.0 - left**samples) * left ** np.arange(1, samples + 1)).max())


def fitted(name: str) -> Float:
    """Return constants with the least squares of the differences in dB, the best of 20 initial points."""
    f_Hz, peak_m = (np.array(one) for one in AFFERENTS[name].tuning)

    def differences_dB(logarithms: Float) -> Float:
        filtered, tau_s = response(name, f_Hz, np.exp(logarithms))
        level = np.abs(filtered) * [peak_of_integrator(f, tau_s) for f in f_Hz]
        return -20.0 * np.log10(level * 1e6 * peak_m)

    begin, random = np.log(BEGIN[name]), np.random.default_rng(0)
    tries = [least_squares(differences_dB, begin + random.normal(0.0, 0.3, len(begin)) * (n > 0)) for n in range(20)]
    return np.exp(min(tries, key=lambda one: one.cost).x)


def sine(f_Hz: float, lasts_s: float) -> Float:
    return np.sin(2.0 * np.pi * f_Hz * np.arange(0.0, lasts_s, STEP_S))[:, None]


def model_threshold_m(afferent: Afferent, f_Hz: float) -> float:
    level, _ = potentials(afferent, sine(f_Hz, max(0.3, 6.0 / f_Hz)), STEP_S)
    return 1.0 / float(level[len(level) // 2 :].max())


def plateau_dB(afferent: Afferent, f_Hz: float) -> tuple[int, int] | None:
    """Return the range of levels above threshold with one spike per cycle [dB]."""
    course, threshold = sine(f_Hz, 40.0 / f_Hz), 1.02 * model_threshold_m(afferent, f_Hz)
    found = []
    for above in range(31):
        moments, _ = spikes(afferent, 10.0 ** (above / 20.0) * threshold * course, STEP_S)
        if abs(np.sum(moments > 20.0 / f_Hz) / 20.0 - 1.0) < 0.06:
            found.append(above)
    return (found[0], found[-1]) if found else None


def contact_level_dB(name: str, f_Hz: float) -> float:
    """Return the level of a class of the palm under the contactor, at the threshold of people."""
    afferent, radius = AFFERENTS[name], math.sqrt(CONTACT_m2 / math.pi)
    count = round(1e4 * DENSITIES_PER_CM2["palm"][name] * math.pi * REACH_M**2)
    distances = REACH_M * np.sqrt((np.arange(count) + 0.5) / count)
    shares = np.abs(under_probe(afferent, radius, distances)) / largest_under_probe(afferent)
    peak = float(threshold_m(OBSERVERS["bolanowski_1988"], f_Hz))
    return class_level_dB(name, peak / model_threshold_m(afferent, f_Hz) * shares)


def draw(path: Path) -> None:
    from matplotlib.figure import Figure

    from palmfield.outputs.style import save, style

    with style():
        figure = Figure(figsize=(6.4, 4.2), layout="constrained")
        axes = figure.subplots()
        for (name, afferent), colour, marker in zip(AFFERENTS.items(), ("C0", "C1", "C2"), "os^", strict=True):
            f_Hz = np.geomspace(2.0 if name != "pc" else 8.0, 500.0, 60)
            axes.loglog(
                f_Hz, [1e6 * model_threshold_m(afferent, f) for f in f_Hz], color=colour, label=f"{name.upper()}, model"
            )
            known, peak = np.array(afferent.tuning)
            axes.loglog(known, 1e6 * peak, marker, color=colour, label=f"{name.upper()}, published")
        axes.set(xlabel="frequency [Hz]", ylabel="threshold, peak displacement [µm]", ylim=(0.02, 200.0))
        axes.legend(ncols=3, loc="upper right")
        save(figure, path, 150)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, help="PNG of the thresholds of model and print")
    args = parser.parse_args()
    for name, afferent in AFFERENTS.items():
        print(f"{name}: fitted anew {', '.join(f'{one:.4g}' for one in fitted(name))}")
        for f_Hz, peak_m in zip(*afferent.tuning, strict=True):
            own = model_threshold_m(afferent, f_Hz)
            print(f"  {f_Hz:5g} Hz: published {1e6 * peak_m:.3g} um, model {20.0 * math.log10(own / peak_m):+.1f} dB")
    for name, f_Hz in (("ra1", 20.0), ("ra1", 30.0), ("ra1", 50.0), ("pc", 100.0), ("pc", 150.0), ("pc", 250.0)):
        print(f"{name}, {f_Hz:g} Hz: one spike a cycle at {plateau_dB(AFFERENTS[name], f_Hz)} dB above threshold")
    print("levels at the threshold of people under 2.9 cm2 [dB]:")
    for f_Hz in (0.4, 2.0, 10.0, 20.0, 40.0, 100.0, 250.0, 400.0, 500.0):
        levels = {name: contact_level_dB(name, f_Hz) for name in AFFERENTS}
        print(f"  {f_Hz:5g} Hz:", ", ".join(f"{name} {level:+.1f}" for name, level in levels.items()))
    if args.picture:
        draw(args.picture)


if __name__ == "__main__":
    main()
