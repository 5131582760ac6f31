"""What error of the skin displacement a plan expects, from mesh, material and p0."""

from palmfield.config.skin import EXPLICIT
from palmfield.session.error_budget import PUBLISHED_P0_Pa_m, p0_band, p0_given
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
    if stimulus.config.arp_peak_Pa is not None:
        return [Row("p0", "none", "arp_peak_Pa sets the level", name)]
    if band is None:
        return []
    published = "{:g} to {:g} Pa m".format(*PUBLISHED_P0_Pa_m)
    why = "the given range" if p0_given(model, number) else f"where no range is given, published values: {published}"
    return [Row("p0", f"x {band[0]:.2f} to x {band[1]:.2f}", f"displacement goes with p0 squared; {why}", name)]
