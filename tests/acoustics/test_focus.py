import numpy as np
import pytest

from palmfield.acoustics.arrays import layout
from palmfield.acoustics.focus import focus
from palmfield.acoustics.reference import pressure64
from palmfield.errors import SceneError
from palmfield.types import Air

POINT = np.array([0.02, -0.01, 0.2])


def test_all_transducers_arrive_in_phase() -> None:
    """The focus reaches the sum of the magnitudes, which no other drive of unit amplitude can exceed."""
    array, air = layout("uhev1"), Air()
    drive = focus(array, air, POINT)
    np.testing.assert_allclose(np.abs(drive), 1.0, rtol=1e-14)
    together, _ = pressure64(POINT[None], array, drive, air)
    single = np.eye(len(array))
    magnitudes = [abs(pressure64(POINT[None], array, one, air)[0][0]) for one in single]
    assert together[0].real == pytest.approx(sum(magnitudes), rel=1e-12)
    assert abs(together[0].imag) < 1e-9 * together[0].real


@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (0.0, 0.0, -0.2), (0.5, 0.0, 0.0)])
def test_focus_behind_the_array_is_refused(point: tuple[float, float, float]) -> None:
    with pytest.raises(SceneError, match="give a point in front of the array"):
        focus(layout("uhev1"), Air(), point)


@pytest.mark.parametrize("point", [(0.0, np.nan, 0.2), (0.0, 0.2), (0.0, 0.0, np.inf)])
def test_focus_must_be_a_position(point: tuple[float, ...]) -> None:
    with pytest.raises(SceneError, match="not a finite position"):
        focus(layout("uhev1"), Air(), point)
