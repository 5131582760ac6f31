"""A simulated laboratory: measurements of a board that differs from the layout, by another model than the fit.

Float64 sums written here from the equations, with the T4010A1's measured directivity (linear between its entries), a
reflecting plate behind the microphones, a wrong assumed air temperature, wrong assumed microphone positions, and 8-bit
readings. Only the positions of the layouts are imported from the package.
"""

from dataclasses import dataclass, field

import numpy as np

FREQUENCY_HZ = 40e3
ANGLES_DEG = np.arange(0.0, 91.0, 10.0)
AMPLITUDES = np.array([1.0, 1.0, 1.0, 0.891, 0.708, 0.501, 0.355, 0.251, 0.200, 0.178])


def speed_of_sound(temperature_C: float) -> float:
    """Return the speed of sound of dry air as an ideal gas [m/s]."""
    return 331.3 * np.sqrt(1.0 + temperature_C / 273.15)


@dataclass(frozen=True)
class Laboratory:
    """The board and its air.

    positions: of the transducers [m], (n, 3); response: true complex factor of each, (n,); p0 [Pa m]
    """

    positions: np.ndarray
    response: np.ndarray
    p0: float = 2.2
    temperature_C: float = 20.0
    absorption_Np_m: float = 0.15
    plate_m: float | None = None
    reflection: float = 0.0
    bits: int | None = None
    noise: float = 0.0
    random: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def each(self, at: np.ndarray) -> np.ndarray:
        """Return the pressure of each transducer alone at points [m], (k, n)."""
        total = self._direct(at)
        if self.plate_m is not None:
            total = total + self.reflection * self._direct(at * [1.0, 1.0, -1.0] + [0.0, 0.0, 2.0 * self.plate_m])
        return total

    def read(self, pressure: np.ndarray) -> np.ndarray:
        """Return complex pressures as digitised with this number of bits and the range of the loudest reading."""
        loudest = np.abs(pressure).max()
        noise = self.random.normal(size=(2, *pressure.shape)) * self.noise * loudest / np.sqrt(2.0)
        noisy = pressure + noise[0] + 1j * noise[1]
        if self.bits is None:
            return noisy
        step = 2.0 * loudest / 2**self.bits
        return step * (np.rint(noisy.real / step) + 1j * np.rint(noisy.imag / step))

    def _direct(self, at: np.ndarray) -> np.ndarray:
        way = at[:, None] - self.positions[None]
        distance = np.linalg.norm(way, axis=2)
        angle = np.degrees(np.arccos(np.clip(way[..., 2] / distance, -1.0, 1.0)))
        shape = np.interp(angle, ANGLES_DEG, AMPLITUDES)
        number = 2.0 * np.pi * FREQUENCY_HZ / speed_of_sound(self.temperature_C)
        wave = np.exp((1j * number - self.absorption_Np_m) * distance) / distance
        return self.p0 * self.response * shape * wave


def strange_board(random: np.random.Generator, count: int, dead: int = 5) -> np.ndarray:
    """Return a board with half of the transducers inverted, 10 deg and 8 % sd, and some dead; complex, (count,)."""
    polarity = np.where(random.random(count) < 0.5, -1.0, 1.0)
    response = polarity * random.normal(1.0, 0.08, count) * np.exp(1j * np.radians(random.normal(0.0, 10.0, count)))
    response[random.choice(count, dead, replace=False)] = 0.0
    return response
