"""What error of the skin displacement a plan expects, from mesh, material and p0."""

from palmfield.session.error_budget import PUBLISHED_P0_Pa_m, p0_band, p0_given
from palmfield.session.planning.rows import Row
from palmfield.simulation.model import HapticModel, StimulusModel


def expected_errors(model: HapticModel) -> list[Row]:
    """Rows of each source of error: of each skin, then of each stimulus."""
    rows = []
    for skin in model.skins:
        name = skin.spec.name
        rows.append(
            Row(
                "mesh and time step",
                f"{100 * skin.spec.config.accuracy:g} % wanted",
                "sizes follow a convergence study on a disc (docs/bench/skin_c0.md); the run estimates what was "
                "reached",
                name,
            )
        )
        for sheet in skin.layer.sheets:
            source = f"{sheet.material.name}: {sheet.material.source}"
            rows.append(Row("material", "of the order of 50 %", source, name))
    for number, stimulus in enumerate(model.stimuli):
        rows += _p0_row(model, number, stimulus)
    return rows


def _p0_row(model: HapticModel, number: int, stimulus: StimulusModel) -> list[Row]:
    name, band = stimulus.spec.name, p0_band(model, number)
    if stimulus.config.arp_peak_Pa is not None:
        return [Row("p0", "none", "arp_peak_Pa sets the level", name)]
    if band is None:
        return []
    published = "{:g} to {:g} Pa m".format(*PUBLISHED_P0_Pa_m)
    why = "the given range" if p0_given(model, number) else f"where no range is given, published values: {published}"
    return [Row("p0", f"x {band[0]:.2f} to x {band[1]:.2f}", f"displacement goes with p0 squared; {why}", name)]
