import numpy as np
import pytest

from palmfield.acoustics.arrays import LAYOUTS, layout
from palmfield.errors import SceneError


@pytest.mark.parametrize(("name", "pitch_m"), [("uhev1", 10.3e-3), ("sonicsurface", 10.5e-3)])
def test_layout_is_a_centred_16_by_16_grid_facing_z(name: str, pitch_m: float) -> None:
    array = layout(name)
    sites = array.positions[:, :2] / pitch_m + 7.5
    np.testing.assert_allclose(sites, np.rint(sites), atol=1e-9)
    assert len({tuple(site) for site in np.rint(sites).astype(int)}) == len(array) == 256
    assert sites.min() == pytest.approx(0) and sites.max() == pytest.approx(15)
    np.testing.assert_allclose(array.positions.mean(axis=0), 0.0, atol=1e-12)
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


def test_p0_is_a_calibration() -> None:
    assert layout("uhev1", 1.27).p0_Pa_m == 1.27
    for p0 in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(SceneError, match="p0_Pa_m"):
            layout("uhev1", p0)


def test_unknown_layout_names_the_known_ones() -> None:
    with pytest.raises(SceneError, match=", ".join(LAYOUTS)):
        layout("uhev2")
