import math

import pytest

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.errors import SceneError
from palmfield.types import Air

DB_PER_NP = 20.0 / math.log(10.0)


@pytest.mark.parametrize(
    ("temperature_C", "humidity_percent", "dB_m"),
    [(20.0, 50.0, 1.318), (20.0, 30.0, 1.07), (20.0, 70.0, 1.29), (25.0, 50.0, 1.39)],
)
def test_absorption_at_40_kHz(temperature_C: float, humidity_percent: float, dB_m: float) -> None:
    found = DB_PER_NP * absorption_Np_m(Air(temperature_C, humidity_percent), 40e3)
    assert found == pytest.approx(dB_m, abs=0.006)


# ISO 9613-2:1996 table 2: absorption of octave bands, dB/km, at the exact mid-band frequencies 1000 * 10^(3 n/10) Hz
TABLE = {
    (10.0, 70.0): (0.1, 0.4, 1.0, 1.9, 3.7, 9.7, 32.8, 117.0),
    (20.0, 70.0): (0.1, 0.3, 1.1, 2.8, 5.0, 9.0, 22.9, 76.6),
    (30.0, 70.0): (0.1, 0.3, 1.0, 3.1, 7.4, 12.7, 23.1, 59.3),
    (15.0, 20.0): (0.3, 0.6, 1.2, 2.7, 8.2, 28.2, 88.8, 202.0),
    (15.0, 50.0): (0.1, 0.5, 1.2, 2.2, 4.2, 10.8, 36.2, 129.0),
    (15.0, 80.0): (0.1, 0.3, 1.1, 2.4, 4.1, 8.3, 23.7, 82.8),
}


@pytest.mark.parametrize(("air", "dB_km"), TABLE.items())
def test_absorption_matches_printed_table(air: tuple[float, float], dB_km: tuple[float, ...]) -> None:
    for n, printed in enumerate(dB_km, start=-4):
        found = 1000.0 * DB_PER_NP * absorption_Np_m(Air(*air), 1000.0 * 10.0 ** (0.3 * n))
        rounding = 0.06 if printed < 100.0 else 0.6
        assert found == pytest.approx(printed, abs=rounding)


def test_absorption_of_thin_air_follows_density_scaling() -> None:
    """At fixed temperature and molar vapour content, absorption per wavelength depends on f/p only."""
    dense = absorption_Np_m(Air(20.0, 25.0, 101325.0), 40e3)
    thin = absorption_Np_m(Air(20.0, 12.5, 101325.0 / 2), 20e3)
    assert thin == pytest.approx(dense / 2, rel=1e-12)


def test_sound_speed_and_density() -> None:
    assert sound_speed(Air(0.0)) == pytest.approx(331.3)
    assert sound_speed(Air()) == pytest.approx(343.2, abs=0.1)
    assert density(Air()) == pytest.approx(1.2041, abs=1e-4)  # standard tables, dry air at 20 C


@pytest.mark.parametrize(
    ("air", "name"),
    [
        (Air(temperature_C=-300.0), "temperature_C"),
        (Air(temperature_C=math.nan), "temperature_C"),
        (Air(humidity_percent=101.0), "humidity_percent"),
        (Air(pressure_Pa=0.0), "pressure_Pa"),
    ],
)
def test_impossible_air_is_refused(air: Air, name: str) -> None:
    for use in (sound_speed, density, lambda a: absorption_Np_m(a, 40e3)):
        with pytest.raises(SceneError, match=name):
            use(air)


@pytest.mark.parametrize("frequency_Hz", [0.0, -1.0, math.nan, math.inf])
def test_impossible_frequency_is_refused(frequency_Hz: float) -> None:
    with pytest.raises(SceneError, match="frequency_Hz"):
        absorption_Np_m(Air(), frequency_Hz)
