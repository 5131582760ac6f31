"""Set up slab, load and vibrometer of the paper under a reading and a control."""

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from palmfield.skin import CATALOGUE, Material, Sheet, Slab, Spot, preset, softest_and_stiffest
from palmfield.skin.base import BaseKind, SideKind
from palmfield.skin.extreme_sheets import scaled
from palmfield.types import Float
from palmfield_papers.answer import Setting
from palmfield_papers.chilles2019.ecoflex import ecoflex_bulk_corrected, ecoflex_time_as_printed
from palmfield_papers.entries import book

SILICONE = "ecoflex_00-10"
RADIUS_M, THICKNESS_M, FWHM_M = 0.06, 0.02, 0.0103
LEVEL_PA = 12.0
AM_HZ, CIRCLE_HZ, CIRCLE_RADIUS_M = 200.0, 70.0, 0.01
STIMULUS_S, RECORD_S, RAMP_S = 0.2, 0.256, 1e-3
OFF_S = 1e-9
"""Time in which a load decreases to 0 at the end of the stimulus [s]."""
LOAD_RATE_HZ = 32e3
"""Sampling rate of a load, which is linear between samples. This reduces a sine of 400 Hz by 0.1 %."""
CIRCLE_RATE_HZ = 8e3
"""Sampling rate of the circle. Its chords deviate from the circle by 0.004 mm; solvers subdivide them."""

Stimulus = Literal["step", "ramp", "am_load", "am_pressure", "stm"]
MaterialName = Literal["given", "half", "soft", "stiff", "tau_printed", "bulk_corrected", "massless"]
SIDES: dict[str, SideKind | None] = {
    "fixed": "fixed", "traction_free": "free", "roller": "roller", "infinite": None,
}  # fmt: skip
STARTS: dict[str, Stimulus] = {"pure step": "step", "raised-cosine ramp of 1 ms": "ramp"}


@dataclass(frozen=True)
class Case:
    """One configuration: a slab, a spot, its peak pressure. Hashable, so that runs are cached by it.

    side: a value of reading chilles_sides
    level_Pa: peak pressure; runs do not depend on it, because they are linear
    circle_m: radius of the path of the spot
    device: for waves of the infinite slab; discs are solved on the host
    """

    side: str = "fixed"
    base: BaseKind = "bonded"
    material: MaterialName = "given"
    thickness_m: float = THICKNESS_M
    fwhm_m: float = FWHM_M
    level_Pa: float = LEVEL_PA
    circle_m: float = CIRCLE_RADIUS_M
    quick: bool = False
    device: str = "cpu"

    @property
    def accuracy(self) -> float:
        """Target relative accuracy of the solver."""
        return 0.02 if self.quick else 0.005


@dataclass(frozen=True)
class Probe:
    """Beam and filter of the vibrometer. highpass: whether the 50 Hz filter is used."""

    incidence_deg: float = 45.0
    azimuth_deg: float = 0.0
    distance_m: float | None = None
    order: int = 2
    phase: Literal["causal", "zero_phase"] = "causal"
    highpass: bool = True


CONTROLS: dict[str, dict[str, Any]] = {
    "moduli_half": {"material": "half"},
    "arp_double": {"level_Pa": 2.0 * LEVEL_PA},
    "slab_10_mm": {"thickness_m": 0.01},
    "base_free": {"base": "free_slip"},
    "tau_as_printed": {"material": "tau_printed"},
    "spot_narrow": {"fwhm_m": 0.7 * FWHM_M},
}
LINES_OF_SIGHT = {
    "0 deg to the radius of the observer, parallel rays": (0.0, None),
    "90 deg, parallel rays": (90.0, None),
    "0 deg, head at 0.5 m": (0.0, 0.5),
}


def reading(setting: Setting, axis: str) -> str:
    """Return the value of an axis. If the number does not depend on the axis, return its base value."""
    return dict(setting.readings).get(axis) or book().axes[axis][0]


def at_base(setting: Setting) -> bool:
    """Return whether all axes have their base values and no control is active."""
    return not setting.control and all(value == book().axes[axis][0] for axis, value in setting.readings)


def case_of(setting: Setting) -> Case:
    """Return the configuration under readings and control. Raises KeyError for a control that this paper lacks."""
    case = Case(side=reading(setting, "chilles_sides"), quick=setting.quick, device=setting.device)
    return replace(case, **CONTROLS[setting.control]) if setting.control else case


def probe_of(setting: Setting) -> Probe:
    azimuth, distance = LINES_OF_SIGHT[reading(setting, "chilles_line_of_sight")]
    return Probe(azimuth_deg=azimuth, distance_m=distance, order=int(reading(setting, "chilles_filter_order")))


def ends(case: Case) -> tuple[Case, Case]:
    """Return the cases with moduli one standard deviation (50 %) below and above (row C22)."""
    return replace(case, material="soft"), replace(case, material="stiff")


def material_of(name: MaterialName) -> Material:
    """Return a material; half, soft and stiff keep the bulk modulus and the characteristic time."""
    if name == "tau_printed":
        return ecoflex_time_as_printed()
    if name == "bulk_corrected":
        return ecoflex_bulk_corrected()
    if name == "massless":
        # Without inertia every moment is static, except for relaxation
        return replace(preset(SILICONE), density_kg_m3=1e-3 * preset(SILICONE).density_kg_m3)
    if name == "half":
        return scaled(preset(SILICONE), 0.5, f"{SILICONE}, moduli halved")
    if name in ("soft", "stiff"):
        both = softest_and_stiffest(CATALOGUE[SILICONE])
        assert both is not None
        return both[0] if name == "soft" else both[1]
    return preset(SILICONE)


def slab_of(case: Case) -> Slab:
    sheets = (Sheet(material_of(case.material), case.thickness_m),)
    side = SIDES[case.side]
    if side is None:
        return Slab(sheets, base=case.base)
    return Slab(sheets, shape="disc", base=case.base, side=side, radius_m=RADIUS_M)


def course(stimulus: Stimulus, times_s: Float) -> Float:
    """Return pressure divided by peak pressure while the stimulus is active, shape (t,)."""
    if stimulus == "ramp":
        return 0.5 - 0.5 * np.cos(np.pi * np.clip(times_s / RAMP_S, 0.0, 1.0))
    if stimulus in ("am_load", "am_pressure"):
        wave = 0.5 + 0.5 * np.sin(2.0 * np.pi * AM_HZ * times_s)
        return wave if stimulus == "am_load" else wave**2
    return np.ones_like(times_s)


def load_of(stimulus: Stimulus, fwhm_m: float, circle_m: float = CIRCLE_RADIUS_M) -> Spot:
    """Return the spot with a peak of 1 Pa, active for 200 ms from time 0."""
    if stimulus == "step":
        return Spot(fwhm_m, np.array([0.0, STIMULUS_S, STIMULUS_S + OFF_S]), np.array([1.0, 1.0, 0.0]))
    rate = CIRCLE_RATE_HZ if stimulus == "stm" else LOAD_RATE_HZ
    times = np.linspace(0.0, STIMULUS_S, round(STIMULUS_S * rate) + 1)
    peak = np.append(course(stimulus, times), 0.0)
    turn = 2.0 * np.pi * CIRCLE_HZ * np.append(times, STIMULUS_S)
    circle = circle_m * np.column_stack([np.cos(turn), np.sin(turn)])
    centre = circle if stimulus == "stm" else np.zeros(2)
    return Spot(fwhm_m, np.append(times, STIMULUS_S + OFF_S), peak, centre)
