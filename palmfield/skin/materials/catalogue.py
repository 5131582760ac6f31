"""Named skin materials, the uncertainty of their numbers, and the layered skin of the hand.

`preset(name)` returns a Material. `CATALOGUE` also has ranges of its numbers. docs/materials.md is made from this data.
Modules `law_*` of this package add their `PRESETS`.
"""

from dataclasses import dataclass
from importlib import import_module
from pkgutil import iter_modules

from palmfield.errors import SceneError, did_you_mean
from palmfield.skin.materials.material import Branch, Material, Sheet, bulk_from_poisson, kelvin_voigt, prony
from palmfield.skin.materials.ranges import Preset, Range

MANFREDI = "Manfredi et al. 2012, PLoS ONE 7:e31203"
ZHANG = "Zhang et al. 2011, Med. Eng. Phys. 33:31 (doi 10.1016/j.medengphy.2010.08.016)"
MIZUSHIMA = "Mizushima & Sato 2024 (doi 10.18494/SAM5054)"
GEL_STORAGE_PA = {"hitohada_c0": 1.07e4, "hitohada_c7": 5.08e4, "hitohada_c15": 8.35e4}
"""Storage modulus in compression at 10 Hz [Pa], Mizushima & Sato 2024."""
GEL_BAND_HZ = (1.0, 1000.0)
GEL_TIMES_S = (163e-6, 1.538e-3, 12.03e-3, 104.4e-3)


def gel(name: str, relaxed_Pa: float, branches_Pa: tuple[float, ...], times_s: tuple[float, ...]) -> Preset:
    hardness = name.removeprefix("hitohada_c")
    material = prony(
        name,
        1000.0,
        relaxed_Pa,
        branches_Pa,
        times_s,
        source=f"HITOHADA gel, Asker C {hardness}, {MIZUSHIMA}: E' at 10 Hz as printed. Frequency dependence "
        "assumed, because it is only in a figure: fractional Kelvin-Voigt with exponent 0.2, 4 branches over 1 to "
        "1000 Hz (scripts/fit_palm_material.py); the loss tangent rises to 100 Hz and is constant above, as "
        "stated there. The paper states similar loss moduli for the three gels; here they scale with the storage "
        "modulus. Density assumed. nu 0.4999 with the instantaneous modulus",
    )
    factors = Range(
        "shear",
        0.67,
        1.0,
        "discs of 2 mm, 1 mm thick, were clamped; if they were bonded, the measured E' is 1 + 2 S^2 = 1.5 times "
        "that of the material (Gent & Lindley, S = 0.5)",
    )
    return Preset(material, (factors,))


CATALOGUE: dict[str, Preset] = {
    "ecoflex_00-10": Preset(
        Material(
            name="ecoflex_00-10",
            density_kg_m3=1030.0,
            shear_relaxed_Pa=12.5e3,
            branches=(Branch(20e3, 3.42 / 20e3),),
            bulk_Pa=bulk_from_poisson(0.495, 12.5e3),
            source="Chilles et al., Ecoflex 00-10 phantom: G_r 12.5 kPa, G_m 20 kPa, eta 3.42 Pa s (tau = eta/G_m "
            "= 171 us), nu 0.495 as printed, with the relaxed modulus",
        ),
        (
            Range(
                "shear",
                0.5,
                1.5,
                "one standard deviation of the moduli, 50 % (Chilles et al. 2019; their model moved 1.8 to 3.8 "
                "times as far as their measured gel)",
            ),
        ),
    ),
    "gelatin_2": Preset(
        kelvin_voigt(
            "gelatin_2",
            923.5,
            23087.5,
            0.0202,
            source="Humimic gelatin #2, Reardon et al. 2023 (doi 10.1126/sciadv.adf2037), parameters of their "
            "simulation: density 923.5 kg/m^3, shear speed 5 m/s, absorption 3e5 dB/(MHz^2 cm), which is eta = 2 "
            "rho c^3 alpha = 0.0202 Pa s. nu is not printed: 0.4999",
        ),
        (
            Range(
                "viscosity_Pa_s",
                0.0202,
                1.0,
                "almost lossless as printed; with 1 Pa s a shear wave of 400 Hz decays to a tenth in 8 cm, less "
                "than their shortest wakes of 10 cm on the gel",
            ),
        ),
    ),
    "hitohada_c0": gel("hitohada_c0", 2041.0, (4404.0, 1991.0, 1317.0, 1039.0), GEL_TIMES_S),
    "hitohada_c7": gel("hitohada_c7", 9689.0, (20.91e3, 9453.0, 6254.0, 4933.0), GEL_TIMES_S),
    "hitohada_c15": gel("hitohada_c15", 15.93e3, (34.37e3, 15.54e3, 10.28e3, 8108.0), GEL_TIMES_S),
    "finger_pad": Preset(
        prony(
            "finger_pad",
            1100.0,
            10.3e3,
            (65.4e3,),
            (0.412e-3,),
            source="fitted by scripts/fit_palm_material.py to the wave speed only, which rises to 7 m/s as on the "
            f"finger pad ({MANFREDI}); the wave decays much faster with distance than measured. nu 0.4999 with the "
            "instantaneous modulus",
        ),
        (
            Range(
                "shear",
                0.5,
                1.5,
                "assumed as for ecoflex_00-10: the fitted readings have no spread, and hands differ",
            ),
        ),
    ),
    "palm": Preset(
        Material(
            name="palm",
            density_kg_m3=1100.0,
            shear_relaxed_Pa=19.9e3,
            branches=(Branch(17.3e3, 1.56e-3),),
            bulk_Pa=bulk_from_poisson(0.4999, 37.2e3),
            source="fitted by scripts/fit_palm_material.py to speed and decay together. Surface wave "
            "4.5/5.0/5.4/5.5 m/s at 50/100/200/400 Hz, target 3.6/4.6/6.0/7.1 m/s, rising to 7 m/s as on the "
            "finger pad (Manfredi et al. 2012): misfit +26/+9/-11/-23 %. |u(40 mm)/u(5 mm)| at 200 Hz 0.085 on 12 "
            "mm bonded to bone (0.081 at 16 mm, 0.086 at 20 mm), target 0.085. No causal, passive solid can meet "
            "both targets: a speed that rises so fast implies losses (Kramers-Kronig) with which a shear wave of "
            "200 Hz decays to 1/e in 11 mm, as in finger_pad, not in 43 mm. nu 0.4999 with the instantaneous "
            "modulus",
        ),
        (
            Range(
                "shear",
                0.64,
                1.67,
                "inferred from the misfit of the speed, +26 % at 50 Hz and -23 % at 400 Hz; the modulus is "
                "proportional to its square",
            ),
        ),
    ),
    "forearm": Preset(
        kelvin_voigt(
            "forearm",
            1100.0,
            7.86e3,
            5.03,
            source=f"forearm in vivo, {ZHANG}: Voigt solid of 7.86 kPa and 5.03 Pa s, fitted there to surface "
            "waves of 100 to 400 Hz; above this range its speed continues to rise, unlike that of tissue. nu "
            "0.4999",
        ),
        (
            Range("shear_relaxed_Pa", 6.00e3, 9.72e3, f"one standard deviation, {ZHANG}"),
            Range("viscosity_Pa_s", 4.43, 5.63, f"one standard deviation, {ZHANG}"),
        ),
    ),
    "muscle": Preset(
        prony(
            "muscle",
            1060.0,
            3.7e3,
            (6.22e3,),
            (1.021e-3,),
            source="relaxed calf muscles in vivo by magnetic resonance elastography, Kang et al. 2007 (doi "
            "10.4028/www.scientific.net/KEM.342-343.901): shear modulus 3.7 kPa, taken as G_r; viscosity 4.5 Pa s at "
            "100 Hz and 2.4 Pa s at 200 Hz, whose loss moduli set the branch. Isotropic and density assumed. nu "
            "0.4999 with the instantaneous modulus",
        ),
        (
            Range(
                "shear",
                0.52,
                2.25,
                "relaxed muscle: 1.93 kPa across and 5.77 kPa along the fibres of a thigh (PMC8754054) to 8.3 kPa, a "
                "third of Young's modulus of the thenar muscle abductor pollicis brevis, 25.0 kPa (Iida et al. 2025, "
                "doi 10.1016/j.ultrasmedbio.2024.12.003)",
            ),
        ),
    ),
}


def law_presets() -> dict[str, Preset]:
    """Return the PRESETS of the modules `law_*` of this package."""
    modules = sorted(one.name for one in iter_modules(import_module(__package__).__path__) if one.name[:4] == "law_")
    entries = [entry for name in modules for entry in import_module(f"{__package__}.{name}").PRESETS]
    return {entry.material.name: entry for entry in entries}


CATALOGUE |= law_presets()
PRESETS: dict[str, Material] = {name: entry.material for name, entry in CATALOGUE.items()}


def preset(name: str) -> Material:
    """Return the material with this name in PRESETS. Raises SceneError, with the available names, for another name."""
    if name not in PRESETS:
        near = did_you_mean(name, PRESETS)
        raise SceneError(f"skin material '{name}' is unknown{near}; use one of {', '.join(sorted(PRESETS))}")
    return PRESETS[name]


@dataclass(frozen=True)
class Tissue:
    """A layer of skin: Young's modulus of the relaxed tissue [Pa], density [kg/m^3], thickness by site [m].

    thickness_m: None for the layer that fills the rest of the depth above the bone
    """

    name: str
    young_Pa: float
    density_kg_m3: float
    thickness_m: dict[str, float | None]
    source: str


DEPTH_M = {"palm": 0.012, "finger_pad": 0.005}
"""Depth from skin to bone [m]. Usual ranges: palm 8 to 20 mm, pulp of the finger 4 to 6 mm."""
MAENO = "attributed to Maeno et al. 1998; not checked against the paper"
TISSUES = (
    Tissue(
        "stratum corneum",
        1.5e6,
        1100.0,
        {"palm": 0.17e-3, "finger_pad": 0.30e-3},
        "1 to 2 MPa under an indenter (Geerligs et al. 2011, J. Biomech. 44:1176); 0.3 mm on a finger by optical "
        "coherence tomography (Adams et al. 2013, doi 10.1098/rsif.2012.0467); on the palm 0.17 mm, source not found",
    ),
    Tissue(
        "epidermis",
        136e3,
        1100.0,
        {"palm": 0.38e-3, "finger_pad": 0.40e-3},
        f"{MAENO}; with the stratum corneum 0.4 to 0.7 mm thick",
    ),
    Tissue("dermis", 80e3, 1100.0, {"palm": 1.15e-3, "finger_pad": 1.15e-3}, f"{MAENO}; 0.8 to 1.5 mm thick"),
    Tissue(
        "subcutis", 34e3, 911.0, {"palm": None, "finger_pad": None}, f"{MAENO}; density of fat; extends to the bone"
    ),
)


def hand_skin(site: str, depth_m: float | None = None) -> tuple[Sheet, ...]:
    """Return stratum corneum, epidermis, dermis and subcutis of the "palm" or "finger_pad", outermost first.

    depth_m: from skin to bone [m]; default DEPTH_M[site]. The subcutis has the depth below the other layers.
    Moduli and thicknesses of TISSUES come from models and are uncertain by a factor of 2 and by about a third. The
    relaxation of single layers is unknown. So all layers relax like the preset of the site, by the same share of their
    modulus. nu = 0.4999 applies to the instantaneous modulus.
    Raises SceneError for another site, and for a depth without room for the subcutis.
    """
    if site not in DEPTH_M:
        raise SceneError(f"hand skin: site '{site}' is unknown; use one of {', '.join(DEPTH_M)}")
    depth = DEPTH_M[site] if depth_m is None else depth_m
    whole = preset(site)
    thicknesses = [tissue.thickness_m[site] for tissue in TISSUES]
    rest = depth - sum(thickness for thickness in thicknesses if thickness is not None)
    if not rest > 0.0:
        raise SceneError(
            f"hand skin: depth is {depth} m; allowed: more than {depth - rest:.4f} m, the layers above the subcutis"
        )
    sheets = []
    for tissue, thickness in zip(TISSUES, thicknesses, strict=True):
        shear = tissue.young_Pa / 3.0
        material = prony(
            f"{site}, {tissue.name}",
            tissue.density_kg_m3,
            shear,
            [ratio * shear for ratio, _ in whole.relaxation.branches],
            [time_s for _, time_s in whole.relaxation.branches],
            source=f"{tissue.source}; relaxes like '{site}'",
        )
        sheets.append(Sheet(material, rest if thickness is None else thickness))
    return tuple(sheets)
