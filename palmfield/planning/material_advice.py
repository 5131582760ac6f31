"""What a user should know of a scene's materials before the run: numbers that look as if in another unit."""

from palmfield.simulation.model import HapticModel
from palmfield.skin.materials.material import Material

DENSITIES_kg_m3 = 500.0, 3000.0
SHEAR_Pa = 50.0, 1e9
"""Of what skin and phantoms are made of, from the softest gels to dry stratum corneum."""
LEAST_POISSON = 0.3
"""Soft tissue, gels and rubbers keep their volume: 0.45 to 0.5."""


def material_advice(model: HapticModel) -> list[str]:
    """Warnings of the sheets of all skins."""
    return [
        f"material '{sheet.material.name}' of skin '{skin.spec.name}' {said}"
        for skin in model.skins
        for sheet in skin.layer.sheets
        for said in _doubts(sheet.material)
    ]


def _doubts(material: Material) -> list[str]:
    result = []
    for what, value, unit, (low, high) in (
        ("density", material.density_kg_m3, "kg/m^3", DENSITIES_kg_m3),
        ("relaxed shear modulus", material.shear_relaxed_Pa, "Pa", SHEAR_Pa),
    ):
        if not low <= value <= high:
            result.append(
                f"has a {what} of {value:.3g} {unit}, that of skins and phantoms {low:g} to {high:g}: look at the unit"
            )
    bulk, shear = material.bulk_Pa, material.shear_relaxed_Pa
    poisson = (3.0 * bulk - 2.0 * shear) / (2.0 * (3.0 * bulk + shear))
    if poisson < LEAST_POISSON:
        result.append(
            f"has a Poisson's ratio of {poisson:.2g}, where skin, gels and rubbers have 0.45 to 0.5: look at bulk_Pa"
        )
    return result
