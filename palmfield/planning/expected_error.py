"""Expected error of the skin displacement in a plan, from mesh, material and p0."""

from palmfield.estimate.array_inputs import p0_band, p0_known
from palmfield.planning.pins import coarse_pins
from palmfield.planning.rows import Row
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.skin.extreme_sheets import softest_and_stiffest_sheets
from palmfield.skin.materials.catalogue import CATALOGUE
from palmfield.skin.materials.material import Material


def expected_errors(model: HapticModel) -> list[Row]:
    """Return one row for each source of error, first for each skin, then for each stimulus."""
    rows = []
    for number, skin in enumerate(model.skins):
        name = skin.spec.name
        rows.append(_mesh_row(skin, coarse_pins(model, number)))
        for sheet in skin.layer.sheets:
            rows.append(_material_row(sheet.material, softest_and_stiffest_sheets(skin.spec.config) is not None, name))
    for number, stimulus in enumerate(model.stimuli):
        rows += _p0_row(model, number, stimulus)
    return rows


def _mesh_row(skin: SkinModel, pinned: list[str]) -> Row:
    """Return the row of the error due to elements or particles. pinned: see `coarse_pins`"""
    target = f"target {100 * skin.spec.config.accuracy:g} %"
    if pinned:
        why = f"keys make it coarser than this target needs: {', '.join(pinned)}; the run estimates the error"
        return Row("mesh and time step", target, why, skin.spec.name)
    own = skin.solver
    if own.expected_error is None:
        return Row("mesh and time step", target, own.sizes_follow, skin.spec.name)
    size = f"{'a preview, ' * own.preview}about {100 * own.expected_error:.2g} %; {target}"
    return Row(skin.choice.name, size, own.sizes_follow, skin.spec.name)


def _material_row(material: Material, ranges: bool, skin: str) -> Row:
    """Return the row for the uncertainty of a material. The run itself solves for both ends of its ranges."""
    entry = CATALOGUE.get(material.name)
    if not ranges or entry is None or not entry.ranges:
        return Row("material", "range unknown", f"{material.name}: {material.source}", skin)
    size = ", ".join(
        f"{'moduli x ' if one.parameter == 'shear' else one.parameter + ' '}{one.low:g} to {one.high:g}"
        for one in entry.ranges
    )
    sources = "; ".join(one.source for one in entry.ranges)
    why = (
        f"the run solves with all ranges at their lower and at their upper ends; {sources}. {material.name}: "
        f"{material.source}"
    )
    return Row("material", size, why, skin)


def _p0_row(model: HapticModel, number: int, stimulus: StimulusModel) -> list[Row]:
    name, band = stimulus.spec.name, p0_band(model, number)
    described = "; ".join(
        f"{'' if p0.kind == 'measured' else 'uncalibrated, '}{p0.kind}: {p0.value:g} Pa m ({p0.low:g} to {p0.high:g}), "
        f"{p0.source}"
        for p0 in p0_known(model, number)
    )
    if stimulus.config.arp_peak_Pa is not None:
        why = f"arp_peak_Pa sets the level; p0 decides whether the array reaches it, {described}"
        return [Row("p0", "none", why, name)]
    if band is None:
        return []
    why = f"ARP and displacement are proportional to p0 squared; {described}"
    return [Row("p0", f"x {band[0]:.2f} to x {band[1]:.2f}", why, name)]
