"""Microphone moved through a sound field: average over the diaphragm, pressure rise at the face, bandwidth.

Pressures are complex peak amplitudes of the carrier, e^{-i w t}.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from pydantic import Field
from scipy.signal import butter, freqs_zpk
from scipy.special import eval_legendre, spherical_jn, spherical_yn

from palmfield.acoustics.scattering import scatter
from palmfield.config.base import NonNegative, Positive
from palmfield.errors import MeasurementError
from palmfield.instruments.settings import Settings, Vector3
from palmfield.metrics.checks import even_step, trace
from palmfield.types import Complex, Float, Int

PressureAt = Callable[[Float], Complex]
"""Function that returns the pressure [Pa], shape (n,), at points [m], shape (n, 3)."""
LENGTH_RADII = 6.0
"""Length of the cylinder over its radius; other lengths change the pressure at the face by 0.2 dB (diffraction)."""
EDGES_A_RADIUS = 5
EDGES_A_WAVE = 8.0
MOST_KA = 6.0


def series_terms(ka: float) -> tuple[Int, Complex]:
    """Return the orders n and the coefficients (2n + 1) i^n i/((ka)^2 h_n'(ka))."""
    n = np.arange(int(ka + 4.0 * ka ** (1.0 / 3.0) + 12.0), dtype=np.int32)
    slope = spherical_jn(n, ka, derivative=True) + 1j * spherical_yn(n, ka, derivative=True)
    return n, (2 * n + 1) * 1j**n * 1j / (ka**2 * slope)


def surface_pressure(ka: float, cosine: ArrayLike) -> Complex:
    """Return the total pressure on a rigid fixed sphere in the wave exp(ikz), e^{-iwt}; cosine: cosine of the angle
    from +z.

    p = sum (2n+1) i^n P_n [j_n - j_n'/h_n' h_n](ka), by the Wronskian (2n+1) i^n P_n i/((ka)^2 h_n') (Morse & Ingard,
    Theoretical Acoustics, section 8.2).
    """
    n, terms = series_terms(ka)
    return np.stack([eval_legendre(i, np.asarray(cosine, dtype=float)) for i in n], axis=-1) @ terms


class Microphone(Settings):
    """A microphone. Raises MeasurementError for values outside their limits."""

    instrument: ClassVar[str] = "microphone"
    diameter_m: NonNegative = Field(default=0.0, description="diameter of the diaphragm; 0: a point")
    facing: Vector3 = Field(default=(0.0, 0.0, -1.0), description="outward normal of the diaphragm")
    diaphragm: Literal["piston", "membrane"] = Field(
        default="piston", description="weight over the diaphragm: uniform, or as a clamped membrane, 1 - (r/a)^2"
    )
    face: Literal["free", "doubling", "cylinder"] = Field(
        default="free",
        description="pressure at the face: free: undisturbed sound; doubling: twice the sound, as on a wall; "
        "cylinder: as on the face of a rigid cylinder with the diameter of the diaphragm, for sound from the front",
    )
    low_Hz: Positive | None = Field(default=None, description="lower end of its band, -3 dB")
    high_Hz: Positive | None = Field(default=None, description="upper end of its band, -3 dB")
    order: int = Field(default=2, ge=1, le=12, description="order of the Butterworth filters of the band")


def diaphragm_points(settings: Microphone, rings: int = 6) -> tuple[Float, Float]:
    """Return points of a diaphragm relative to its centre [m], shape (m, 3), and weights of sum 1, shape (m,).

    The rule is Gauss-Legendre in the square of the radius, with evenly spaced angles. Its error for a plane wave is
    1e-6 up to k a = 6. Raises MeasurementError for a facing of length 0.
    """
    facing = np.array(settings.facing)
    length = float(np.linalg.norm(facing))
    if not length > 0.0:
        raise MeasurementError(f"microphone: facing is {settings.facing}; give a direction")
    if settings.diameter_m == 0.0:
        return np.zeros((1, 3)), np.ones(1)
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    squares = 0.5 * (1.0 + nodes)
    share = 0.5 * weights * (1.0 if settings.diaphragm == "piston" else 2.0 * (1.0 - squares))
    angles = 2.0 * math.pi * np.arange(4 * rings) / (4 * rings)
    facing = facing / length
    sideways = np.cross(facing, np.eye(3)[int(np.abs(facing).argmin())])
    sideways /= np.linalg.norm(sideways)
    across = np.cross(facing, sideways)
    radii = 0.5 * settings.diameter_m * np.sqrt(squares)
    ring = np.cos(angles)[:, None] * sideways + np.sin(angles)[:, None] * across
    places = (radii[:, None, None] * ring).reshape(-1, 3)
    return places, np.repeat(share / len(angles), len(angles))


def microphone_scan(
    pressure_at: PressureAt, places_m: ArrayLike, settings: Microphone, *, wavenumber: float | None = None
) -> xr.DataArray:
    """Return the reading of a microphone at positions of the centre of its diaphragm [Pa], complex, (point,).

    pressure_at: sound without the microphone, for example `palmfield.acoustics.pressure` at points
    wavenumber: wavenumber of the sound [rad/m], needed for face "cylinder"
    The reading is the mean over the diaphragm times `face_factor`, for sound from the front; for other directions see
    `angle_response` and `palmfield.instruments.microphone.face_rise`.
    """
    places = np.asarray(places_m, dtype=float)
    if places.ndim != 2 or places.shape[1] != 3 or len(places) == 0 or not np.isfinite(places).all():
        raise MeasurementError(f"places of a microphone have shape {places.shape}; give finite numbers, shape (n, 3)")
    offsets, weights = diaphragm_points(settings)
    sound = np.asarray(pressure_at((places[:, None] + offsets).reshape(-1, 3)))
    if sound.shape != (len(places) * len(offsets),):
        raise MeasurementError(f"pressure_at returned shape {sound.shape} for {len(places) * len(offsets)} points")
    read = sound.reshape(len(places), -1) @ weights * face_factor(settings, wavenumber)
    coordinates = {axis: ("point", places[:, n], {"units": "m"}) for n, axis in enumerate("xyz")}
    attributes = {"units": "Pa", "long_name": "peak amplitude of the carrier read by the microphone"}
    return xr.DataArray(read, coordinates, ("point",), "pressure", attributes)


def angle_response(cosine: ArrayLike, diameter_m: float, wavenumber: float) -> Complex:
    """Return the response of the body of a microphone at an angle relative to sound from the front, in the shape of
    cosine.

    The cylinder is approximated by a rigid sphere of its diameter (exact, `surface_pressure`). At k a = 1.2 (1/8 inch
    at 40 kHz), sound from the front rises by 3.4 dB, sound at 50 degrees by 2.5 dB. Multiply the mean over the
    diaphragm of `microphone_scan` by this factor for each source separately.

    cosine: cosine of the angle between the outward normal of the diaphragm and the direction to the source, -1 to 1
    Raises MeasurementError for others, a diameter below 0 and a wavenumber that is not above 0.
    """
    ahead = np.asarray(cosine, dtype=float)
    if not (np.isfinite(ahead).all() and (np.abs(ahead) <= 1.0 + 1e-9).all()):
        raise MeasurementError("cosine: give cosines of angles, -1 to 1")
    if not (0.0 <= diameter_m < math.inf and 0.0 < wavenumber < math.inf):
        raise MeasurementError(
            f"microphone: diameter_m is {diameter_m} and the wavenumber {wavenumber} rad/m; give finite numbers above 0"
        )
    if diameter_m == 0.0:
        return np.ones(ahead.shape, dtype=complex)
    ka = 0.5 * diameter_m * wavenumber
    # A wave along +z comes from -z
    return np.asarray(surface_pressure(ka, -np.clip(ahead, -1.0, 1.0)) / surface_pressure(ka, -1.0))


def face_factor(settings: Microphone, wavenumber: float | None = None) -> float:
    """Return the pressure rise of the face for sound from the front: 1 free, 2 with doubling, or `face_rise`.

    A cylinder needs the wavenumber [rad/m]. Raises MeasurementError without it, and like `face_rise`."""
    if settings.face == "cylinder":
        if wavenumber is None:
            raise MeasurementError(
                "microphone: face is 'cylinder', whose pressure rise depends on the wavenumber: give a wavenumber"
            )
        return abs(face_rise(settings.diameter_m, wavenumber))
    return 2.0 if settings.face == "doubling" else 1.0


def through_band(times_s: ArrayLike, envelope: ArrayLike, carrier_Hz: float, settings: Microphone) -> Complex:
    """Filter the complex envelope of a carrier over time [Pa], shape (t, ...), by the band of the microphone.

    A component of the envelope at f is sound at carrier_Hz + f and multiplied by the response at this frequency. The
    record is assumed periodic. Raises MeasurementError for uneven times.
    """
    times = np.asarray(times_s, dtype=float)
    values = np.asarray(envelope, dtype=complex)
    trace(times, np.abs(values))
    step = even_step(times)
    # With e^{-i w t}, a component e^{-i 2 pi f t} of the envelope is sound at carrier + f
    frequencies = carrier_Hz - np.fft.fftfreq(len(times), step)
    response = band_response(frequencies, settings).reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(np.fft.ifft(np.fft.fft(values, axis=0) * response, axis=0))


def band_response(frequency_Hz: ArrayLike, settings: Microphone) -> Complex:
    """Return the complex response of the band at frequencies [Hz], in their shape; e^{-i w t}, so a delay is +phase."""
    frequencies = np.asarray(frequency_Hz, dtype=float)
    low, high = settings.low_Hz, settings.high_Hz
    if low is not None and high is not None and low >= high:
        raise MeasurementError(f"microphone: low_Hz is {low:g} and high_Hz {high:g}; allowed: low_Hz below high_Hz")
    total = np.ones(frequencies.shape, dtype=complex)
    for edge, kind in ((low, "highpass"), (high, "lowpass")):
        if edge is not None:
            zeros, poles, gain = butter(settings.order, 2.0 * math.pi * edge, kind, analog=True, output="zpk")
            # SciPy uses e^{+i w t}
            total *= freqs_zpk(zeros, poles, gain, worN=2.0 * math.pi * frequencies)[1].conj()
    return total


def face_rise(diameter_m: float, wavenumber: float, cosine: float = 1.0) -> complex:
    """Return the mean pressure on the face of a rigid cylinder in a plane wave, over that of the wave at its centre.

    It is 1 for wavelengths much larger than the face; 1.57 (3.9 dB) from the front at k a = 1.16, 1/8 inch at 40 kHz;
    2.15 from k a = 2 on, with edge diffraction and doubling. With e^{-i w t} a delay is +phase. The error is 0.3 dB:
    0.1 dB by the mesh (change with half the edge length), 0.2 dB by the length. The first call takes over a second.

    diameter_m: diameter of face and body; wavenumber: [rad/m]; cosine: cosine of the angle between the outward normal
    of the face and the direction to the source
    Raises MeasurementError for cosines beyond -1 and 1, and for k a that is not above 0 or above MOST_KA.
    """
    ka = 0.5 * diameter_m * wavenumber
    if not 0.0 < ka <= MOST_KA:
        raise MeasurementError(
            f"microphone: diameter_m is {diameter_m:g} and the wavenumber {wavenumber:g} rad/m, so that k a is {ka:g}; "
            f"allowed: above 0, up to {MOST_KA:g}"
        )
    if not -1.0 <= cosine <= 1.0:
        raise MeasurementError(f"microphone: cosine of the source's direction is {cosine:g}; allowed: -1 to 1")
    return _face_rise(round(ka, 6), round(cosine, 6))


@lru_cache(maxsize=256)
def _face_rise(ka: float, cosine: float) -> complex:
    vertices, faces = cylinder(max(EDGES_A_RADIUS, math.ceil(EDGES_A_WAVE * ka / (2.0 * math.pi))))
    sine = math.sqrt(1.0 - cosine**2)
    solution = scatter(
        vertices, faces, lambda points: np.exp(-1j * ka * (cosine * points[:, 2] + sine * points[:, 0])), ka,
        device="cpu",
    )  # fmt: skip
    on_face = np.abs(solution.centroids[:, 2]) < 1e-9
    areas = solution.areas[on_face]
    return complex((solution.pressure[on_face] * areas).sum() / areas.sum())


def cylinder(edges: int) -> tuple[Float, Int]:
    """Return vertices and outward faces of a cylinder of radius 1 whose face is at z = 0 and points along +z.

    edges: number of triangle edges from the centre of the face to its rim
    """
    step = 1.0 / edges
    along = max(2, round(LENGTH_RADII / step))
    radii = np.arange(1, edges + 1) * step
    profile = [(float(r), 0.0) for r in radii]
    profile += [(1.0, -LENGTH_RADII * n / along) for n in range(1, along + 1)]
    profile += [(float(r), -LENGTH_RADII) for r in radii[-2::-1]]
    vertices, rings = [np.zeros(3)], []
    for radius, z in profile:
        count = max(6, round(2.0 * math.pi * radius / step))
        rings.append((len(vertices), count))
        angles = 2.0 * math.pi * np.arange(count) / count
        vertices += list(np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(count, z)]))
    vertices.append(np.array([0.0, 0.0, -LENGTH_RADII]))
    first, count = rings[0]
    faces = [(0, first + n, first + (n + 1) % count) for n in range(count)]
    for (one, many), (other, more) in pairwise(rings):
        n = m = 0
        while n < many or m < more:
            # Advance the ring whose next vertex comes first
            if m == more or (n < many and (n + 1) * more <= (m + 1) * many):
                faces.append((one + n % many, other + m % more, one + (n + 1) % many))
                n += 1
            else:
                faces.append((one + n % many, other + m % more, other + (m + 1) % more))
                m += 1
    last, count = rings[-1]
    faces += [(len(vertices) - 1, last + (n + 1) % count, last + n) for n in range(count)]
    return np.array(vertices), np.array(faces)
