"""What error of the skin displacement a plan expects, from mesh, material and p0."""

from palmfield.config.skin import EXPLICIT
from palmfield.session.error_budget import p0_band, p0_known
from palmfield.session.planning.rows import Row
from palmfield.simulation.model import HapticModel, SkinModel, StimulusModel
from palmfield.skin.explicit_layer import explicit_layer


def expected_errors(model: HapticModel) -> list[Row]:
    """Rows of each source of error: of each skin, then of each stimulus."""
    rows = []
    for skin in model.skins:
        name = skin.spec.name
        rows.append(_mesh_row(skin))
        for sheet in skin.layer.sheets:
            source = f"{sheet.material.name}: {sheet.material.source}"
            rows.append(Row("material", "of the order of 50 %", source, name))
    for number, stimulus in enumerate(model.stimuli):
        rows += _p0_row(model, number, stimulus)
    return rows


def _mesh_row(skin: SkinModel) -> Row:
    """What elements or particles cost in error."""
    wanted = f"{100 * skin.spec.config.accuracy:g} % wanted"
    if skin.choice.name not in EXPLICIT:
        why = "sizes follow a convergence study on a disc (docs/bench/skin_c0.md); the run estimates what was reached"
        return Row("mesh and time step", wanted, why, skin.spec.name)
    own = explicit_layer(skin.layer)
    if own.expected_error is None:
        why = "elements follow studies on discs (docs/bench/skin_spectral_elements.md); the run estimates what was "
        why += "reached"
        return Row("mesh and time step", wanted, why, skin.spec.name)
    size = f"a preview, about {100 * own.expected_error:.2g} %; {wanted}"
    why = "what such particles had on discs (docs/bench/skin_particles.md); the run states at least as much"
    return Row("particles", size, why, skin.spec.name)


def _p0_row(model: HapticModel, number: int, stimulus: StimulusModel) -> list[Row]:
    name, band = stimulus.spec.name, p0_band(model, number)
    known = "; ".join(
        f"{'' if p0.kind == 'measured' else 'uncalibrated, '}{p0.kind}: {p0.value:g} Pa m ({p0.low:g} to {p0.high:g}), "
        f"{p0.source}"
        for p0 in p0_known(model, number)
    )
    if stimulus.config.arp_peak_Pa is not None:
        why = f"arp_peak_Pa sets the level; whether the array reaches it goes by p0, {known}"
        return [Row("p0", "none", why, name)]
    if band is None:
        return []
    return [Row("p0", f"x {band[0]:.2f} to x {band[1]:.2f}", f"ARP and displacement go with p0 squared; {known}", name)]
