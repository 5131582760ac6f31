"""Forms of directivity: what each file gives, and a form that is made here, from points to a moving focus."""

from collections.abc import Iterator
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import warp as wp

from palmfield.acoustics.air import absorption_Np_m, density, sound_speed
from palmfield.acoustics.arp import LAWS
from palmfield.acoustics.arrays import layout
from palmfield.acoustics.directivities import FORMS, form_of
from palmfield.acoustics.directivity import EXACT, Directivity
from palmfield.acoustics.field import pressure
from palmfield.acoustics.phased_array import ArrayInstance, PhasedArray, directivity_groups
from palmfield.acoustics.point_sound import Transducers
from palmfield.acoustics.reference import pressure64
from palmfield.acoustics.surface_arp import SurfaceArp
from palmfield.config.array import ArrayConfig, DirectivityName
from palmfield.drive.array_drive import ArrayDrive
from palmfield.drive.boards import board_named
from palmfield.drive.path_drives import PathDrives
from palmfield.errors import SceneError
from palmfield.transforms import IDENTITY, Placement
from palmfield.types import Air, Array, Complex, Float
from warp_kernels.path_drives import focus_waves

AIR = Air()
K = 2 * np.pi * 40e3 / sound_speed(AIR)
S = np.linspace(0.0, 1.0, 301)
FALL = 1.7


class Gaussian(Directivity):
    """exp(-FALL sin^2), of which the module knows nothing but what is said here."""

    name = "gaussian"

    def level(self, s: Float, kb: float) -> Float:
        return np.exp(-FALL * s)


@pytest.fixture
def gaussian(monkeypatch: pytest.MonkeyPatch) -> Iterator[Array]:
    monkeypatch.setitem(FORMS, "gaussian", Gaussian())
    yield FORMS["gaussian"].of(layout("uhev1"))


def summed(points: Float, array: Array, drive: Complex) -> tuple[Complex, Complex]:
    """Pressure and gradient by the formula, written out for this form."""
    rays = points[:, None, :] - array.positions
    d = np.linalg.norm(rays, axis=2)
    axial = np.einsum("pnc,nc->pn", rays, array.normals)
    decay = 1j * K - absorption_Np_m(AIR, 40e3)
    wave = np.exp(decay * d - FALL * (1 - axial**2 / d**2)) / d * array.p0_Pa_m * drive * (axial > 0)
    # log of the wave: decay d - log d + FALL axial^2/d^2
    along = (decay - 1 / d - 2 * FALL * axial**2 / d**3)[..., None] * rays / d[..., None]
    slope = along + (2 * FALL * axial / d**2)[..., None] * array.normals
    return wave.sum(axis=1), np.einsum("pn,pnc->pc", wave, slope)


def test_names_are_those_of_files_and_of_the_key() -> None:
    assert get_args(DirectivityName) == ("layout", *FORMS)
    assert [form.name for form in FORMS.values()] == list(FORMS)
    assert ArrayConfig.model_fields["directivity"].default == "layout"
    lost = replace(layout("uhev1"), directivity="pistn")
    with pytest.raises(SceneError, match=r"array 'uhev1' has directivity 'pistn'.*did you mean.*allowed: .*piston"):
        pressure([[0.0, 0.0, 0.1]], lost, np.ones(256), AIR)


@pytest.mark.parametrize("kb", [0.0, 1.0, 3.3, 4.4])
@pytest.mark.parametrize("name", [*FORMS, "gaussian"])
def test_polynomials_follow_the_level(name: str, kb: float) -> None:
    form = FORMS.get(name, Gaussian())
    level = form.level(S, kb)
    assert level[0] == pytest.approx(1.0, abs=1e-15)
    evaluate = np.polynomial.polynomial.polyval
    assert np.abs(evaluate(S, form.polynomial(kb)) - level).max() <= form.misfit
    assert np.abs(evaluate(S, form.polynomial(kb, EXACT)) - level).max() < 1e-13
    middle, step = S[30:-30], 1e-5
    ahead, behind = form.level(middle + step, kb), form.level(middle - step, kb)
    np.testing.assert_allclose(form.slope(middle, kb), (ahead - behind) / (2 * step), atol=2e-9)


def test_a_form_that_the_kernels_cannot_follow_is_refused() -> None:
    class Narrow(Gaussian):
        def level(self, s: Float, kb: float) -> Float:
            return np.exp(-40.0 * s)

    with pytest.raises(SceneError, match=r"directivity 'gaussian'.*the error of .* is 0.*allowed: 0.0001"):
        Narrow().polynomial(0.0)


def test_sound_of_a_new_form_at_points(gaussian: Array) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.08, -0.08, 0.02], [0.08, 0.08, 0.25], (200, 3))
    drive = np.exp(2j * np.pi * rng.random(256))
    exact, slope = summed(points, gaussian, drive)
    for found, bound in (
        (pressure64(points, gaussian, drive, AIR, gradient=True), 1e-12),
        # The field's own 1.2e-5 and the quintic's misfit
        (pressure(points, gaussian, drive, AIR, gradient=True, device="cpu", warn=False), 5e-5),
    ):
        p, g = found if isinstance(found, tuple) else (found.pressure, found.gradient)
        assert g is not None
        assert np.abs(p - exact).max() < bound * np.abs(exact).max()
        assert np.abs(g - slope).max() < bound * np.abs(slope).max()


def test_arp_and_a_moving_focus_of_a_new_form(gaussian: Array) -> None:
    """As a scene has them: ARP on a surface, and what a GPU's kernels of a moving focus take for the sound there."""
    config = ArrayConfig().model_copy(update={"directivity": "gaussian", "p0_Pa_m": gaussian.p0_Pa_m})
    arrays = PhasedArray([ArrayInstance(config, Placement.of(IDENTITY))], [Placement.of(IDENTITY)], "cpu")
    rng = np.random.default_rng(2)
    points = rng.uniform([-0.05, -0.05, 0.1], [0.05, 0.05, 0.25], (200, 3))
    normals = np.tile([0.0, 0.0, -1.0], (200, 1))  # so that nothing comes from behind
    drive = np.exp(-1j * K * np.linalg.norm(gaussian.positions - points[0], axis=1))
    p, g = summed(points, gaussian, drive)
    rho, c = density(AIR), sound_speed(AIR)
    u = g / (2j * np.pi * 40e3 * rho)
    law, through = LAWS["default"], np.abs(u[:, 2]) ** 2
    load = law.pressure * np.abs(p) ** 2 / (rho * c**2) + law.across * rho * through
    load -= law.along * rho * (np.abs(u[:, :2]) ** 2).sum(axis=1)
    load[np.real(p * np.conj(-u[:, 2])) > 0] = 0.0
    sound = SurfaceArp(arrays.field, 200, "default").evaluate(points, normals, drive)
    assert np.abs(sound.amplitude - np.abs(p)).max() < 5e-5 * np.abs(p).max()
    assert np.abs(sound.arp - load).max() < 2e-4 * load.max()

    one = ArrayDrive(arrays, np.arange(256, dtype=np.int32), None, None, board_named("ideal"))
    path = PathDrives(one, Transducers(arrays, "cpu"), None)
    waves, strengths = (wp.zeros((1, 200, 256), dtype=wp.vec2d, device="cpu") for _ in range(2))
    counts, foci = (
        wp.array([[200, 1]], dtype=wp.int32, device="cpu"),
        wp.array(points[None], dtype=wp.vec3d, device="cpu"),
    )
    wp.launch(focus_waves, (1, 200, 256), [path._focusing, counts, foci, waves, strengths], device="cpu")
    loudness = strengths.numpy()[0, ..., 0].sum(axis=1)
    in_phase = np.exp(-1j * K * np.linalg.norm(points[:, None] - gaussian.positions, axis=2))
    exact = np.array([summed(point[None], gaussian, turn)[0][0] for point, turn in zip(points, in_phase, strict=True)])
    np.testing.assert_allclose(loudness, exact.real, rtol=1e-12)


def test_unlike_forms_are_groups_of_their_own(gaussian: Array) -> None:
    groups = directivity_groups([gaussian, layout("uhev1"), gaussian])
    assert [form_of(group.array).name for group in groups] == ["gaussian", "piston"]
    assert len(groups[0].chosen) == 512
