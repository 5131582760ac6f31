"""Rows H2 to H12 and H18: from a target radiation pressure, through duty cycles, to the pressure in the focus."""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.signal import butter

from palmfield.acoustics import sound_speed
from palmfield.acoustics.nonlinear import arp_left
from palmfield.drive import Pole
from palmfield.drive.boards.autd2018 import CARRIER_HZ, PACKET_RATE_HZ
from palmfield.drive.pulse_width import HASEGAWA_TICKS, edge_phase, widths
from palmfield.drive.response import envelope_response, filter_frames
from palmfield.stimulus.duty_law import duty_cycle, relative_pressure
from palmfield.types import Complex, Float
from palmfield_papers.answer import Answer, Cause, Compute, Setting
from palmfield_papers.hasegawa2018.pulses import duty_course, waveform
from palmfield_papers.hasegawa2018.units import FORCE_DEPTH_M, ROOM, Units, array_of, value_of

FREQUENCIES_HZ = (5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 300.0, 500.0, 1000.0)
DEVICE_EXPONENT = 1.5
PHASES_DEG = (0.0, 45.0, 90.0)
"""Phases of the sine at which a packet is sent. At 1000 Hz there are two packets per period, so the phase matters."""
SETTLED_S = 0.05
"""Time after which transients of the resonators have decayed [s]."""
CLOCK_HZ = 25.6e6
HOP_S = 40e-9


@dataclass(frozen=True)
class Chain:
    """Processing chain from packets to the focus. Hashable, so that runs can be cached.

    quality: quality factor of the transducers
    phase_deg: phase of the sine at the first packet
    design: exponent for which duty cycles are computed
    flight: whether to include the flight time from the four units to the focus at 200 mm
    """

    quality: float = 25.0
    phase_deg: float = 0.0
    design: float = DEVICE_EXPONENT
    flight: bool = False


def packets(target: Float, design: float) -> Float:
    """Return pulse widths in ticks for a radiation pressure relative to the largest, one per packet, shape (k,)."""
    return widths(np.sqrt(target), HASEGAWA_TICKS, design).astype(np.float64)


def emitted(packet_widths: Float, quality: float, exponent: float = DEVICE_EXPONENT) -> Complex:
    """Return the emission in each carrier period relative to full drive, shape (20 k,).

    The units interpolate the duty to the carrier rate and round it to ticks. The transducers have a resonance.
    """
    duty = np.rint(HASEGAWA_TICKS * duty_course(packet_widths)) / HASEGAWA_TICKS
    commanded = relative_pressure(duty, exponent)[:, None].astype(complex)
    return filter_frames(commanded, 1.0 / CARRIER_HZ, Pole(CARRIER_HZ, quality), initial=commanded[0])[1:, 0]


@cache
def flights() -> tuple[Float, Float]:
    """Return the delays of the sound of four units at the focus [carrier periods], and their weights of sum 1."""
    array = array_of(Units(4))
    distance = np.linalg.norm(array.positions - [0.0, 0.0, FORCE_DEPTH_M], axis=1)
    weight = 1.0 / distance
    count, edges = np.histogram(distance / sound_speed(ROOM) * CARRIER_HZ, 64, weights=weight)
    return 0.5 * (edges[1:] + edges[:-1]), count / weight.sum()


@cache
def focal_envelope(frequency_Hz: float, chain: Chain) -> Complex:
    """Return the envelope in the focus for a sinusoidal radiation pressure, over whole periods.

    It is relative to full drive.
    """
    periods = max(1, round(0.2 * frequency_Hz))
    length = round(CARRIER_HZ * periods / frequency_Hz)
    before = math.ceil(SETTLED_S * PACKET_RATE_HZ)
    after = 20
    times = (np.arange(-before, length * PACKET_RATE_HZ / CARRIER_HZ + after)) / PACKET_RATE_HZ
    target = 0.5 + 0.5 * np.sin(2.0 * np.pi * frequency_Hz * times + np.radians(chain.phase_deg))
    course = emitted(packets(target, chain.design), chain.quality)
    first = before * round(CARRIER_HZ / PACKET_RATE_HZ)
    if not chain.flight:
        return course[first : first + length]
    delays, weights = flights()
    at = first + np.arange(length)[:, None] - (delays - delays.min())
    return np.interp(at, np.arange(len(course)), course.real) @ weights + 1j * (
        np.interp(at, np.arange(len(course)), course.imag) @ weights
    )


def rms_pressure_dB(envelope: Complex) -> float:
    return 10.0 * math.log10(float(np.mean(np.abs(envelope) ** 2)))


def rms_arp_dB(envelope: Complex) -> float:
    """Return the level of the varying part. A microphone does not measure the steady part."""
    square = np.abs(envelope) ** 2
    return 20.0 * math.log10(float(np.std(square)))


def component_dB(envelope: Complex, frequency_Hz: float) -> float:
    """Return the level of the radiation pressure at the modulation frequency."""
    turns = frequency_Hz / CARRIER_HZ * np.arange(len(envelope))
    return 20.0 * math.log10(2.0 * abs(np.mean(np.abs(envelope) ** 2 * np.exp(-2j * np.pi * turns))))


DEFINITIONS = {
    "rms pressure": lambda envelope, f: rms_pressure_dB(envelope),
    "rms of the changing radiation pressure": lambda envelope, f: rms_arp_dB(envelope),
    "radiation pressure at f": component_dB,
}


def levels_dB(definition: str, chain: Chain) -> Float:
    """Return levels at FREQUENCIES_HZ, shape (f,)."""
    level = DEFINITIONS[definition]
    return np.array([level(focal_envelope(f, chain), f) for f in FREQUENCIES_HZ])


def coarser_spread_dB(quality: float, phase_deg: float) -> float:
    """Return the spread of the rms pressure if only every second carrier period is used."""
    chain = Chain(quality, phase_deg)
    return float(np.ptp([rms_pressure_dB(focal_envelope(f, chain)[::2]) for f in FREQUENCIES_HZ]))


def spread_dB(
    definition: str, quality: float, *, flight: bool = False, phases: tuple[float, ...] = PHASES_DEG
) -> float:
    """Return the largest minus the smallest level, for the phase at which this spread is largest."""
    return max(float(np.ptp(levels_dB(definition, Chain(quality, phase, flight=flight)))) for phase in phases)


def flatness(setting: Setting) -> Answer:
    quality = float(value_of(setting, "hasegawa_q").removeprefix("quality factor "))
    value = spread_dB("rms pressure", quality)
    crest = (90.0,)
    return Answer(
        value,
        error=abs(value - max(coarser_spread_dB(quality, phase) for phase in PHASES_DEG)),
        margin=2.0 - value,
        note="largest over three phases of the sine relative to the packets; error: from half as many carrier periods",
        shown={
            "rms pressure with the sound's flight from four units [dB]": spread_dB(
                "rms pressure", quality, flight=True
            ),
            "rms of the changing radiation pressure, packets on crests [dB]": spread_dB(
                "rms of the changing radiation pressure", quality, phases=crest
            ),
            "radiation pressure at f, packets on crests [dB]": spread_dB(
                "radiation pressure at f", quality, phases=crest
            ),
            "rms pressure without packets and filter [dB]": continuous_loss_dB("pressure", quality),
            "radiation pressure at f without packets and filter [dB]": continuous_loss_dB("component", quality),
        },
    )


# -- without packets -----------------------------------------------------------------------------------------------


@cache
def continuous(frequency_Hz: float, quality: float, count: int = 4096) -> Complex:
    """Return the envelope over one period after the resonance, for a target (1 + sin)/2 without delay."""
    target = 0.5 + 0.5 * np.sin(2.0 * np.pi * np.arange(count) / count)
    lines = np.fft.ifft(np.sqrt(target))
    # e^{-i w t}: line n of the inverse transform is the component of the envelope at n f
    response = envelope_response(np.fft.fftfreq(count, 1.0 / (count * frequency_Hz)), Pole(CARRIER_HZ, quality))[:, 0]
    return np.asarray(np.fft.fft(lines * response))


def continuous_loss_dB(what: str, quality: float) -> float:
    """Return the loss from the lowest to the highest of FREQUENCIES_HZ. what: "pressure" (rms) or "component" (at f)"""

    def level(frequency: float) -> float:
        square = np.abs(continuous(frequency, quality)) ** 2
        if what == "pressure":
            return 10.0 * math.log10(float(square.mean()))
        return 20.0 * math.log10(2.0 * abs(np.fft.fft(square)[1]) / len(square))

    return level(FREQUENCIES_HZ[0]) - level(FREQUENCIES_HZ[-1])


def pressure_loss(setting: Setting) -> Answer:
    return Answer(continuous_loss_dB("pressure", 25.0), error=1e-3)


def component_loss(setting: Setting) -> Answer:
    return Answer(continuous_loss_dB("component", 25.0), error=1e-3)


def largest_quality(setting: Setting) -> Answer:
    found = brentq(lambda quality: continuous_loss_dB("component", quality) - 2.0, 5.0, 40.0, xtol=1e-3)
    return Answer(float(found), error=1e-2)


# -- single numbers ------------------------------------------------------------------------------------------------


def hop_phase(setting: Setting) -> Answer:
    chain = 1000.0 * HOP_S * CARRIER_HZ
    return Answer(360.0 * HOP_S * CARRIER_HZ, error=0.0, shown={"a chain of 1000 units [turns]": chain})


def ticks_of_a_period(setting: Setting) -> Answer:
    return Answer(CLOCK_HZ / CARRIER_HZ, error=0.0)


def first_harmonic(setting: Setting) -> Answer:
    """Return the largest deviation of the first harmonic of the pulse train from sin(pi d), relative to the largest."""
    width = np.arange(0, HASEGAWA_TICKS // 2 + 1)
    trains = waveform(np.zeros(len(width), int), width, HASEGAWA_TICKS)
    harmonic = np.abs(np.fft.fft(trains, axis=1)[:, 1])
    law = relative_pressure(width / HASEGAWA_TICKS)
    return Answer(
        float(np.abs(harmonic / harmonic.max() - law).max()), error=1e-12, note="largest distance from the law"
    )


def fixed_edge(setting: Setting) -> Answer:
    turned = float(np.degrees(edge_phase(0.25, "leading") - edge_phase(0.5, "leading")))
    return Answer(
        turned,
        error=0.0,
        note="degrees of phase from half a period to a quarter with the edge of eq. 6 held",
        shown={"centred [deg]": float(np.degrees(edge_phase(0.25, "centre") - edge_phase(0.5, "centre")))},
    )


def inverse_law(setting: Setting) -> Answer:
    """Return the largest deviation of sin^2(pi d) from the target pressure, with the corrected inverse."""
    target = np.linspace(0.0, 1.0, 101)
    found = relative_pressure(duty_cycle(np.sqrt(target))) ** 2
    return Answer(float(np.abs(found - target).max()), error=1e-12, note="as corrected, sin^2(pi d) less the wanted")


def carrier_average(setting: Setting) -> Answer:
    phases = 2.0 * np.pi * np.arange(64) / 64
    return Answer(float(np.mean(np.sin(phases) ** 2)), error=0.0, note="corrected over printed")


def shock_loss(setting: Setting) -> Answer:
    return Answer(100.0 * (arp_left(1.2) - 1.0), error=1e-6)


PRINTED_B0 = {10e6: 0.0749e-14, 2e6: 0.0229e-10}
PRINTED_A1 = {10e6: -4.9939, 2e6: -4.9695}


def cut_off(rate_Hz: float) -> Compute:
    """Return the cut-off frequency of the Butterworth low-pass of order 5 with the printed first coefficient [kHz]."""

    def off(cut: float, which: int, printed: float) -> float:
        return float(butter(5, cut, fs=rate_Hz)[0 if which == 0 else 1][which] - printed)

    def compute(setting: Setting) -> Answer:
        by_b = brentq(lambda cut: off(cut, 0, PRINTED_B0[rate_Hz]), 500.0, 20e3)
        by_a = brentq(lambda cut: off(cut, 1, PRINTED_A1[rate_Hz]), 500.0, 20e3)
        half = 0.00005e-14 / PRINTED_B0[10e6] / 5.0
        return Answer(
            1e-3 * by_b,
            error=1e-3 * by_b * half,
            note="by the first coefficient b; error: of its last printed digit",
            shown={"by the second coefficient a [kHz]": 1e-3 * by_a},
        )

    return compute


def stimulus_peak(setting: Setting) -> Answer:
    """Return the largest force of eqs 8 and 9 at beta = 1, divided by the largest force."""

    def largest(amplitude: float) -> float:
        times = np.linspace(0.0, 1.0, 20_001)
        window = 0.5 - 0.5 * np.cos(2.0 * np.pi * times)
        return float((amplitude * window * np.cos(2.0 * np.pi * 200.0 * (times - 0.5)) + 0.5).max())

    return Answer(largest(1.0), error=0.0, note="over F_M, as printed", shown={"with the factor 1/2": largest(0.5)})


def flatness_with(definition: str, quality: float, flight: bool) -> Compute:
    def compute(setting: Setting) -> Answer:
        value = spread_dB(definition, quality, flight=flight, phases=(90.0,))
        return Answer(value, margin=2.0 - value)

    return compute


ANSWERS: dict[str, Compute] = {
    "H2-H3c": carrier_average,
    "H5c": hop_phase,
    "H7a": first_harmonic,
    "H7c": ticks_of_a_period,
    "H7d": fixed_edge,
    "H8a": inverse_law,
    "H9c": shock_loss,
    "H11c": cut_off(10e6),
    "H11d": cut_off(2e6),
    "H12a": flatness,
    "H12c": pressure_loss,
    "H12d": component_loss,
    "H12e": largest_quality,
    "H18c": stimulus_peak,
}
CAUSES = {
    "H12a": (
        Cause("quality 10 instead of 25", flatness_with("rms pressure", 10.0, False)),
        Cause("the time of flight from four units is included", flatness_with("rms pressure", 25.0, True)),
    )
}
LATER = {"H12a": (Cause("quality 250 instead of 25: the envelope falls", flatness_with("rms pressure", 250.0, False)),)}
