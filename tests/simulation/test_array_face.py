"""Echoes between a rigid array face and a flat disc, against image sums and series that share nothing with them."""

import mujoco
import numpy as np
import pytest
from scipy.special import j1

import palmfield
from palmfield.acoustics.air import absorption_Np_m, sound_speed
from palmfield.acoustics.echo import REST, image_shifts
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray
from palmfield.acoustics.reference import pressure64
from palmfield.config import ArrayConfig
from palmfield.errors import PalmfieldError, SceneError
from palmfield.estimate.biases import ECHO, biases
from palmfield.planning.facts import first_drive
from palmfield.session.loudest_moment import loudest_place
from palmfield.simulation.posed_scene import reference_scene
from palmfield.simulation.radiation import Radiation
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Array

pytestmark = pytest.mark.usefixtures("kept_operators")

AIR = Air()
WAVELENGTH = sound_speed(AIR) / 40e3
HEIGHT = 0.12
RIGID = {"array_face": "rigid"}


@pytest.fixture
def fixed_scene(small_scene):
    """Writes the small scene with its pad fixed in the world. height: over the array [m]; turn: the pad's quaternion"""

    def write(height=HEIGHT, turn="0 1 0 0", **changes):
        path = small_scene(**changes)
        plain = path.parent / "plain.xml"
        text = plain.read_text()
        begin, end = text.index("<joint"), text.index("<site")
        text = text[:begin] + text[end:]
        plain.write_text(text.replace('pos="0 0 0.12" quat="0 1 0 0"', f'pos="0 0 {height}" quat="{turn}"'))
        return path

    return write


def focused(height):
    """Unit phases of a 16x16 array for a focus straight above its middle, by path lengths."""
    array = ArrayInstance(ArrayConfig(), Placement.of(IDENTITY)).array()
    lengths = np.linalg.norm(array.positions - [0.0, 0.0, height], axis=1)
    return array, np.exp(-2j * np.pi / WAVELENGTH * lengths)


def mirrored(points, array, drive, height, round_trips):
    """Half the pressure on the wall of all images, on both sides of it: baffled pistons at 2 m heights for all m."""
    k, loss = 2.0 * np.pi / WAVELENGTH, absorption_Np_m(AIR, 40e3)
    total = np.zeros(len(points), complex)
    for m in range(-round_trips, round_trips + 2):
        rays = points[:, None] - array.positions - [0.0, 0.0, 2.0 * m * height]
        d = np.linalg.norm(rays, axis=2)
        x = k * array.piston_radius_m * np.hypot(rays[..., 0], rays[..., 1]) / d
        shape = np.where(x > 1e-9, 2.0 * j1(np.maximum(x, 1e-9)) / np.maximum(x, 1e-9), 1.0)
        total += (array.p0_Pa_m * shape / d * np.exp((1j * k - loss) * d)) @ drive
    return 0.5 * total


def ratio(height):
    """|p|^2 at the focus on a disc with the array's echoes over that without."""
    place = Placement.of(IDENTITY)
    arrays = PhasedArray([ArrayInstance(ArrayConfig(), place)], [place], "cpu", height)
    _, drive = focused(height)
    at = np.array([[0.0, 0.0, height]])
    return abs(arrays.field.pressure(at, drive).pressure[0] / pressure64(at, arrays.array, drive, AIR)[0][0]) ** 2


def test_the_sound_on_the_disc_is_that_of_all_images(fixed_scene):
    """Also in a tenth of the peak, to single precision and what the bound on the rest allows."""
    model = palmfield.load(fixed_scene(array=RIGID)).runtime.model
    posed, drive = reference_scene(model), first_drive(model, 0)
    sound = Radiation(model).on(posed, 0, "quadrature", drive)
    points = posed.skins[0].quadrature[0]
    expected = np.abs(mirrored(points, model.arrays.array, drive, HEIGHT, 300))
    assert model.arrays.wall_m == pytest.approx(HEIGHT)
    assert np.abs(sound.amplitude - expected).max() < REST * expected.max()
    alone = np.abs(pressure64(points, model.arrays.array, drive, AIR)[0])
    assert np.abs(alone - expected).max() > 10.0 * REST * expected.max()


def test_fringes_are_half_a_wavelength_apart():
    """Over a wavelength of distance the ARP goes up and down twice; the envelope changes slowly."""
    heights = 0.2 + WAVELENGTH * np.arange(16) / 16
    ratios = np.array([ratio(height) for height in heights])
    spectrum = np.abs(np.fft.rfft(ratios - ratios.mean()))
    assert spectrum.argmax() == 2
    assert np.ptp(ratios) > 0.1
    assert np.abs(ratios[8:] - ratios[:8]).max() < 0.1 * np.ptp(ratios)


def test_the_series_of_a_beam_as_wide_as_a_plane_wave():
    """A Gaussian beam on its axis falls as 1/(1 + i z/zR): each round trip is another term of a known series."""
    waist, step, height = 0.04, 0.004, 0.05
    axis = np.arange(-35, 36) * step
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis))
    places = np.stack([x, y, 0.0 * x], axis=1)
    array = Array("beam", places, np.tile([0.0, 0.0, 1.0], (len(x), 1)), 1.0, piston_radius_m=0.0)
    drive = np.exp(-(x**2 + y**2) / waist**2).astype(complex)
    air = Air(pressure_Pa=20e3)
    k, loss = 2.0 * np.pi * 40e3 / sound_speed(air), absorption_Np_m(air, 40e3)
    shifts = np.concatenate([np.zeros((1, 3)), image_shifts(air, 40e3, height, np.array([0.0, 0.0, 1.0]))])
    found = pressure64(np.array([0.0, 0.0, height]) - shifts, array, drive, air)[0]
    z = (2.0 * np.arange(len(shifts)) + 1.0) * height
    series = np.exp((1j * k - loss) * z) / (1.0 + 1j * z / (0.5 * k * waist**2))
    assert found.sum() / found[0] == pytest.approx(series.sum() / series[0], rel=0.02)


def test_a_plane_wave_makes_a_geometric_series():
    """1/(1 - e^{2 i k h - 2 beta h}), less what is beyond the last image."""
    height = 0.25 * WAVELENGTH + 0.2
    shifts = image_shifts(AIR, 40e3, height, np.array([0.0, 0.0, 1.0]))
    trip = np.exp((2j * np.pi / WAVELENGTH - absorption_Np_m(AIR, 40e3)) * 2.0 * height)
    steps = np.exp((2j * np.pi / WAVELENGTH - absorption_Np_m(AIR, 40e3)) * -shifts[:, 2])
    assert 1.0 + steps.sum() == pytest.approx((1.0 - trip ** (len(shifts) + 1)) / (1.0 - trip), rel=1e-9)


@pytest.mark.parametrize("height", [0.1, 0.2, 0.3])
def test_what_is_left_out_is_less_than_the_bound(height):
    array, drive = focused(height)
    images = len(image_shifts(AIR, 40e3, height, np.array([0.0, 0.0, 1.0])))
    at = np.array([[0.0, 0.0, (2 * m + 1) * height] for m in range(4 * images)])
    rest = abs(pressure64(at, array, drive, AIR)[0][images + 1 :].sum())
    assert rest < REST * len(array) * array.p0_Pa_m / height


def test_the_band_of_an_absorbing_face_holds_what_a_rigid_one_does(fixed_scene):
    """Over half a wavelength of distance; and it is no wider than three times that."""
    ratios, bands = [], []
    for height in HEIGHT + WAVELENGTH * np.arange(8) / 16:
        path = fixed_scene(height=height, stimulus={"focus_m": f"0 0 {height}"})
        model = palmfield.load(path).runtime.model
        posed, drive = reference_scene(model), first_drive(model, 0)
        highest = loudest_place(posed, 0, Radiation(model), drive)
        found = biases(model, 0, 0, posed, drive, model.stimuli[0].first_focus, highest)
        bands.append(next((one.low, one.high) for one in found if one.what == ECHO))
        ratios.append(ratio(height) - 1.0)
    low, high = np.array(bands).T
    assert (low < ratios).all() and (ratios < high).all()
    assert np.mean(high - low) < 3.0 * np.ptp(ratios)


def test_a_run_with_a_rigid_face_says_what_it_computed(fixed_scene):
    path = fixed_scene(array=RIGID)
    names = [row.what for row in palmfield.plan(path).modelled]
    assert "echo" in names
    result = palmfield.run(path, progress=False)
    left = {one["what"]: one for one in result.summary["skins"][0]["error_budget"]["left_out"]}
    assert (
        ECHO not in left
        and left["finite size of disc and board in the echo"]["low"]
        <= 0.0
        <= left["finite size of disc and board in the echo"]["high"]
    )
    # 200 Hz: a round trip of 0.7 ms turns the modulation by 0.88
    assert 0.0 < left["delay of the echo"]["high"] < 0.5
    assert result.summary["skins"][0]["error_budget"]["numerical"]["field_error_relative"] < 1e-4
    free = palmfield.run(fixed_scene(), progress=False)
    louder, farther = (result.summary[name] / free.summary[name] for name in ("peak_arp_Pa", "peak_displacement_m"))
    assert louder == pytest.approx(ratio(HEIGHT), rel=0.01) and abs(louder - 1.0) > 0.05
    # The echo is wide, so that the skin moves by more than what is under the focus
    assert 0.5 < (farther - 1.0) / (louder - 1.0) < 2.0


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"turn": "0.02 1 0 0"}, "tilted by 2.29 degrees"),
        ({"skin": {"body_sound": "shadows"}}, "body_sound 'shadows'"),
        ({"array": RIGID | {"layout": "two_bow_corrected"}, "stimulus": {"focus_m": "0 0 0.12"}}, "not a flat face"),
    ],
)
def test_what_images_do_not_follow_is_refused(fixed_scene, changes, why):
    with pytest.raises(SceneError, match=f"array_face.*rigid.*{why}.*absorbing"):
        palmfield.load(fixed_scene(**{"array": RIGID} | changes))


def test_a_body_on_a_joint_is_refused(small_scene):
    with pytest.raises(SceneError, match=r"can move relative to the array.*absorbing"):
        palmfield.load(small_scene(array=RIGID))


def test_a_disc_that_is_pushed_aside_is_refused_when_it_happens(fixed_scene):
    scene = palmfield.load(fixed_scene(array=RIGID))
    scene.step(1)
    scene.model.body_pos[mujoco.mj_name2id(scene.model, mujoco.mjtObj.mjOBJ_BODY, "pad"), 2] += 1e-3
    with pytest.raises(PalmfieldError, match=r"120\.000 mm, but the disc is now at 121\.000"):
        scene.step(2)


def test_air_that_takes_too_little_is_refused():
    with pytest.raises(SceneError, match="more than 400 round trips"):
        image_shifts(Air(humidity_percent=0.0), 40e3, 0.02, np.array([0.0, 0.0, 1.0]))
