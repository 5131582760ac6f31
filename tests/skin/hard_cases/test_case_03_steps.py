"""Case 3, relaxation far below and above the step; steps and times of 20 to 50 ms."""

import dataclasses
import re

import numpy as np
import pytest

from palmfield.errors import SceneError
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson
from palmfield.skin.problem import Slab, Spot

ALL = ["lateral_waves", "axisymmetric", "wedges", "reduced", "spectral_elements", "particles"]
AT = np.array([[0.0, 0.0], [0.005, 0.0]])
VOIGT = Material("voigt", 1030.0, 12.5e3, (), bulk_from_poisson(0.45, 12.5e3), "", viscosity_Pa_s=3.0)


def disc(material):
    return Slab((Sheet(material, 0.008),), "disc", "bonded", "roller", 0.02)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("tau", [1e-9, 1e3])
def test_a_branch_far_off_is_not_there_or_a_spring(name, tau, solve_by, miss, burst):
    """Steps are 1e3 to 1e6 of the one tau, 1e-6 of the other."""
    times = np.linspace(1e-3, 6e-3, 8)
    stiff = 12.5e3 if tau < 1.0 else 22.5e3
    materials = (
        dataclasses.replace(VOIGT, branches=(Branch(10e3, tau),)),
        dataclasses.replace(VOIGT, shear_relaxed_Pa=stiff),
    )
    found, wanted = (solve_by(name, disc(m), burst, times, AT).displacement_m for m in materials)
    print(name, tau, miss(found, wanted))
    assert miss(found, wanted) < 2e-3


def settling(pressure=1.0):
    """A ramp on a body whose branch takes shear and pressure waves out within tens of milliseconds."""
    material = dataclasses.replace(VOIGT, viscosity_Pa_s=0.0, branches=(Branch(25e3, 1e-3),), bulk_relaxes=True)
    return disc(material), Spot(0.0103, np.array([0.0, 2e-3]), np.array([0.0, pressure]))


@pytest.mark.parametrize("name", ALL)
def test_late_times_50_ms_apart_are_the_static_answer(name, solve_by):
    body, load = settling()
    times = np.array([0.02, 0.07]) if name in ("spectral_elements", "particles") else np.array([0.02, 0.07, 0.12, 1.0])
    how = {"wedges": {"step_s": 0.02}, "spectral_elements": {"size_m": 0.008}}.get(name, {})
    motion = solve_by(name, body, load, times, AT, **how)
    exact = centre_response(0.0, body.sheets[0].material, 0.008, load.fwhm_m, 0.02, AT[:, 0]).real
    error = np.abs(-motion.displacement_m[:, :, 2] / exact - 1.0)
    print(name, error, motion.error)
    assert error[-1].max() < {"particles": 0.05, "wedges": 0.02, "reduced": 0.02}.get(name, 3e-3)


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_implicit_steps_of_50_ms_stay_bounded(rho, solve_by):
    """Asked at every step: below 3 static answers at once, at the static one in the end (L-stable at 0)."""
    body, load = settling()
    times = 0.05 * np.arange(1, 41)
    push = -solve_by("wedges", body, load, times, AT[:1], step_s=0.05, rho_inf=rho).displacement_m[:, 0, 2]
    exact = centre_response(0.0, body.sheets[0].material, 0.008, load.fwhm_m, 0.02).real
    assert push.max() < 3.0 * exact and push.min() > -exact
    assert push[-1] == pytest.approx(exact, rel=0.02, abs=0.0)
    assert np.ptp(push[-3:]) < 1e-3 * exact


@pytest.mark.parametrize("name", ["spectral_elements", "particles"])
@pytest.mark.parametrize("step_s", [0.02, 0.05])
def test_explicit_steps_of_that_length_are_refused_with_the_stable_one(name, step_s, solve_by):
    body, load = settling()
    with pytest.raises(SceneError, match="stable") as caught:
        solve_by(name, body, load, np.array([0.1]), AT, step_s=step_s)
    stable = [float(x) for x in re.findall(r"\d\.\d+(?:e-\d+)?", str(caught.value))]
    assert str(step_s) in str(caught.value) and 0.0 < min(stable) < 1e-3
