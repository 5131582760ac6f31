"""Known boards against printed counts, sizes and angles."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.distance import pdist

from palmfield.acoustics.air import density, sound_speed
from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import SceneError
from palmfield.types import Air, Array

AIR = Air()
COUNTS = {
    "uhev1": 256,
    "sonicsurface": 256,
    "autd2018": 249,
    "autd2018_2x2": 996,
    "autd3": 249,
    "autd3_2x2": 996,
    "autd3_3x2": 1494,
    "autd3_4x2": 1992,
    "stratos_explore": 256,
    "openmpd": 256,
    "openmpd_rows": 256,
    "ultraino": 64,
    "two_bow_as_printed": 12,
    "two_bow_corrected": 12,
}


@pytest.mark.parametrize("name", LAYOUTS)
def test_every_layout_is_centred_buildable_and_described(name: str) -> None:
    array, entry = layout(name), LAYOUTS[name]
    assert array.name == name
    assert len(array) == COUNTS[name]
    np.testing.assert_allclose(array.positions.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(array.normals, axis=1), 1.0, rtol=1e-12)
    assert pdist(array.positions).min() > 9.99e-3  # transducers are 10 mm wide
    assert entry.about and entry.source
    assert np.abs(focus(array, AIR, entry.focus_m)).min() == pytest.approx(1.0)  # in front of every transducer
    if array.address is not None:
        np.testing.assert_array_equal(np.sort(array.address), np.arange(len(array)))


@pytest.mark.parametrize(
    ("name", "pitch_m"), [("uhev1", 10.3e-3), ("stratos_explore", 10.3e-3), ("sonicsurface", 10.5e-3)]
)
def test_layout_is_a_16_by_16_grid_facing_z(name: str, pitch_m: float) -> None:
    array = layout(name)
    sites = array.positions[:, :2] / pitch_m + 7.5
    np.testing.assert_allclose(sites, np.rint(sites), atol=1e-9)
    assert len({tuple(site) for site in np.rint(sites).astype(int)}) == len(array) == 256
    assert sites.min() == pytest.approx(0) and sites.max() == pytest.approx(15)
    assert np.all(array.positions[:, 2] == 0.0)
    assert np.all(array.normals == [0.0, 0.0, 1.0])


# address -> (column, row), row 0 at the lowest y
SPOTS = {0: (0, 0), 7: (1, 0), 1: (2, 0), 4: (0, 1), 3: (1, 1), 8: (0, 2), 63: (1, 14), 64: (4, 0), 199: (13, 0)}


@pytest.mark.parametrize(("address", "site"), SPOTS.items())
def test_sonicsurface_byte_order(address: int, site: tuple[int, int]) -> None:
    array = layout("sonicsurface")
    assert array.address is not None
    np.testing.assert_array_equal(array.address, np.arange(256))
    np.testing.assert_allclose(array.positions[address, :2], (np.array(site) - 7.5) * 10.5e-3, atol=1e-12)


@pytest.mark.parametrize("name", ["autd2018", "autd3"])
def test_autd_unit_has_its_printed_aperture_and_the_index_of_its_software(name: str) -> None:
    array = layout(name)
    aperture = np.ptp(array.positions, axis=0)[:2] + 10e-3
    np.testing.assert_allclose(aperture, [0.180, 0.140], rtol=0.02)  # printed 180 x 140 mm
    site = np.rint((array.positions - array.positions[0]) / 10.16e-3).astype(int)
    np.testing.assert_allclose(array.positions, array.positions[0] + site * 10.16e-3, atol=1e-12)
    # index -> (column, row) around the missing sites; 248 is the last of 18 x 14 - 3
    for index, place in {0: (0, 0), 17: (17, 0), 18: (0, 1), 19: (3, 1), 31: (15, 1), 32: (17, 1), 33: (0, 2)}.items():
        assert tuple(site[index, :2]) == place
    assert tuple(site[248, :2]) == (17, 13)


def outer_size(array: Array) -> np.ndarray:
    return np.ptp(array.positions, axis=0)[:2] + 10e-3


def test_four_autd_units_are_as_large_as_printed() -> None:
    """364 x 302.8 mm; the printed width takes margins of 10 mm, the pitch leaves 9.3 mm, so 1.4 mm more."""
    width, height = outer_size(layout("autd2018_2x2"))
    assert height == pytest.approx(0.3028, abs=1e-6)
    assert width == pytest.approx(0.364, abs=1.5e-3)


def test_four_autd3_units_repeat_at_the_size_of_a_board() -> None:
    array = layout("autd3_2x2")
    units = array.positions.reshape(4, 249, 3)
    np.testing.assert_allclose(units[1] - units[0], np.tile([0.192, 0.0, 0.0], (249, 1)), atol=1e-12)
    np.testing.assert_allclose(units[3] - units[0], np.tile([0.192, 0.1514, 0.0], (249, 1)), atol=1e-12)


def peak(array: Array, z: float) -> float:
    """Pressure at a focus on the axis [Pa]."""
    return float(abs(pressure64([[0.0, 0.0, z]], array, focus(array, AIR, (0.0, 0.0, z)), AIR)[0][0]))


def test_focus_of_one_autd_unit_halves_at_400_mm_as_measured() -> None:
    """Hasegawa & Shinoda 2018, figure 11: about half of the value at 200 mm."""
    array = layout("autd2018")
    assert peak(array, 0.4) / peak(array, 0.2) == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(("z", "ratio"), [(0.8, 0.39), (1.0, 0.31)])
def test_focus_of_four_units_of_pistons_weakens_with_depth_as_in_a_separate_calculation(z: float, ratio: float) -> None:
    array = replace(layout("autd3_2x2"), directivity_table=None)
    assert peak(array, z) / peak(array, 0.2) == pytest.approx(ratio, abs=0.006)


def sight_angles_deg(array: Array, name: str) -> np.ndarray:
    """Angle at the focus between each bow's axis and its speakers 1, 2 and 3."""
    rays = (LAYOUTS[name].focus_m - array.positions)[:6]
    axis = rays.sum(axis=0) / np.linalg.norm(rays.sum(axis=0))
    return np.degrees(np.arccos(rays[:3] @ axis / np.linalg.norm(rays[:3], axis=1)))


@pytest.mark.parametrize(("name", "focal_length_m"), [("two_bow_as_printed", 0.05), ("two_bow_corrected", 0.03)])
def test_bow_speakers_lie_on_a_parabola_and_look_at_its_focus(name: str, focal_length_m: float) -> None:
    array = layout(name)
    rays = np.array(LAYOUTS[name].focus_m) - array.positions
    distances = np.linalg.norm(rays, axis=1)
    np.testing.assert_allclose(rays / distances[:, None], array.normals, atol=1e-9)
    # a parabola is as far from its focus as from its directrix: distance = f + y^2/(4f)
    np.testing.assert_allclose(distances, focal_length_m + array.positions[:, 1] ** 2 / (4 * focal_length_m), rtol=1e-9)
    for one in (array.positions[:6], array.positions[6:]):
        np.testing.assert_allclose(np.linalg.norm(np.diff(one, axis=0), axis=1), 10e-3, rtol=1e-6)
        axis = np.array(LAYOUTS[name].focus_m) - one.mean(axis=0)
        assert np.degrees(np.arctan2(abs(axis[0]), axis[2])) == pytest.approx(30.0, abs=1e-6)
    np.testing.assert_allclose(array.positions[6:] * [-1, 1, 1], array.positions[:6], atol=1e-12)


def test_printed_speaker_angles_fit_the_corrected_focal_length_better() -> None:
    printed = np.array([40.0, 28.0, 10.0])
    off = {name: sight_angles_deg(layout(name), name) - printed for name in LAYOUTS if name.startswith("two_bow")}
    assert np.abs(off["two_bow_corrected"]).max() < 4.5  # 44.2, 27.8, 9.5
    assert np.abs(off["two_bow_as_printed"][:2]).min() > 10.0  # 27.8, 17.0


def half_width(array: Array, target: tuple[float, float, float], axis: int) -> float:
    """Distance from the focus along an axis at which the pressure falls to a half [m]."""
    drive, at = focus(array, AIR, target), np.array(target)

    def excess(offset: float) -> float:
        p, _ = pressure64([at + offset * np.eye(3)[axis], at], array, drive, AIR)
        return float(abs(p[0]) / abs(p[1])) - 0.5

    return float(brentq(excess, 0.0, 0.01))


def test_bows_of_the_corrected_focal_length_have_the_measured_focal_width() -> None:
    """Mizushima & Sato 2024 measured half-widths of 3 mm on each side along the bows."""
    widths = {name: half_width(layout(name), LAYOUTS[name].focus_m, 1) for name in LAYOUTS if "bow" in name}
    assert widths["two_bow_corrected"] == pytest.approx(3e-3, rel=0.05)
    assert widths["two_bow_as_printed"] > 4e-3


def test_focal_width_of_a_16_by_16_board_is_that_of_its_aperture() -> None:
    """Half of |sin(N u)/(N sin u)|, u = pi d x/(lambda z), gives the width; obliquity and directivity add a little."""
    array, z = layout("uhev1"), 0.2
    wavelength = sound_speed(AIR) / 40e3
    u = brentq(lambda u: np.sin(16 * u) / (16 * np.sin(u)) - 0.5, 0.01, np.pi / 16)
    paraxial = 2 * u / np.pi * wavelength * z / 10.3e-3
    width = 2 * half_width(array, (0.0, 0.0, z), 0)
    assert paraxial < width < 1.15 * paraxial


def test_p0_is_a_calibration() -> None:
    assert layout("uhev1", 1.27).p0_Pa_m == 1.27
    for p0 in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SceneError, match="p0_Pa_m"):
            layout("uhev1", p0)


def test_unknown_layout_names_the_known_ones() -> None:
    with pytest.raises(SceneError, match=", ".join(LAYOUTS)):
        layout("uhev2")


def test_p0_of_the_uhev1_gives_the_load_that_chilles_put_in() -> None:
    """12 Pa at the focus 200 mm above the middle, by |p|^2/(rho c^2)."""
    array, at = layout("uhev1"), (0.0, 0.0, 0.2)
    pressure = abs(pressure64([at], array, focus(array, AIR, at), AIR)[0][0])
    assert pressure**2 / (density(AIR) * sound_speed(AIR) ** 2) == pytest.approx(12.0, rel=0.02)


@pytest.mark.parametrize("name", LAYOUTS)
def test_what_is_known_of_a_layout_has_a_range_and_a_source(name: str) -> None:
    entry = LAYOUTS[name]
    assert layout(name).p0_Pa_m == entry.p0.value
    for known in (entry.p0, entry.quality):
        assert known.low < known.value < known.high and known.kind != "measured" and len(known.source) > 20


def test_units_edge_to_edge_are_one_pitch_of_boards_apart() -> None:
    four, eight = layout("autd3_2x2"), layout("autd3_4x2")
    left = eight.positions[:498] - eight.positions[0]
    np.testing.assert_allclose(left, four.positions[:498] - four.positions[0], atol=1e-15)
    np.testing.assert_allclose(eight.positions[996:1245] - eight.positions[:249], [[0.0, 0.1514, 0.0]] * 249)
