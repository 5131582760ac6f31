"""Write tables and pictures of the skin materials: docs/images/materials/*.png and docs/materials.md.

python scripts/draw_materials.py
"""

import re
import subprocess
import sys
from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
from fit_palm_material import BOUNDS, DECAY, EXPONENT, SPEEDS, decay, speeds
from matplotlib.figure import Figure
from PIL import Image
from scipy.optimize import least_squares

from palmfield.outputs.style import COLOURS, save, style
from palmfield.skin.analytic.layer_oracle import centre_response
from palmfield.skin.extreme_sheets import varied
from palmfield.skin.materials.catalogue import CATALOGUE, DEPTH_M, PRESETS, TISSUES, hand_skin
from palmfield.skin.materials.dispersion import Waves, describe
from palmfield.skin.materials.material import Material, complex_shear, elastic, prony, standard_linear
from palmfield.skin.materials.prony_fit import fractional, fractional_kelvin_voigt
from palmfield.studies.bench.table import keep_rows
from palmfield_papers.chilles2019.ecoflex import ecoflex_rate_law_mixed, ecoflex_time_as_printed
from palmfield_papers.mizushima2024 import as_printed

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "oracles"))

from hyperelastic import advance, at_rest, piola
from observed import UNITS, observations, predicted

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "images" / "materials"
PAGE = ROOT / "docs" / "materials.md"
SHADES = ("#c2410c", "#0f766e", "#4338ca", "#a16207", "#be185d", "#0369a1", "#4d7c0f", "#6b7280")
BAND_HZ = np.geomspace(10.0, 1000.0, 61)
GEL_SOLID = (4e4, 6e4, 30.0)
"""E1, E2 [Pa], eta3 [Pa s] of a gel like those of Mizushima & Sato 2024, who do not print these values."""
EXAMPLE = """```python
import numpy as np

from palmfield.skin.materials.prony_fit import fit_prony, fractional, fractional_kelvin_voigt
from palmfield.skin.materials.material import elastic, kelvin_voigt, prony, standard_linear
from palmfield.skin.materials.catalogue import CATALOGUE, hand_skin, preset
from palmfield.skin.materials.dispersion import describe

gel = standard_linear("gel", 1030.0, 12.5e3, 20e3, 171e-6, nu=0.4999)  # rho, G_r, G_1, tau
describe(gel, 200.0, thickness_m=0.010)  # moduli, speeds, 1/e lengths, cut-off of a bonded layer
f_Hz = np.geomspace(1.0, 1000.0, 20)  # frequencies of your analyser; its moduli follow
storage_Pa, loss_Pa = 2e4 + 50.0 * f_Hz**0.7, 40.0 * f_Hz**0.7
fit_prony(f_Hz, storage_Pa, loss_Pa, branches=3).material("mine", 1000.0)
hand_skin("palm")  # four sheets, skin to bone
```"""
LAW = '''```python
"""Fractional Kelvin-Voigt solid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from palmfield.skin.materials.material import Branch, Material
from palmfield.skin.materials.prony_fit import fit_prony
from palmfield.skin.materials.ranges import Preset


@dataclass(frozen=True, kw_only=True)
class FractionalKelvinVoigt(Material):
    """G(s) = G_r (1 + (s tau)^a): time_s: tau [s]; exponent: a; band_Hz: band in which `series` approximates it."""

    time_s: float
    exponent: float
    band_Hz: tuple[float, float] = (1.0, 4000.0)

    def stiffening(self, s):
        return 1.0 + (s * self.time_s) ** self.exponent

    @cached_property
    def series(self):
        f_Hz = np.geomspace(*self.band_Hz, 81)
        shear = self.modulus(-2j * np.pi * f_Hz)
        fit = fit_prony(f_Hz, shear.real, -shear.imag, 6, self.shear_relaxed_Pa)
        return tuple(map(Branch, fit.branches_Pa, fit.times_s))


PRESETS = (
    Preset(
        FractionalKelvinVoigt(
            "fractional gel", 1000.0, 5e3, (), 2.5e7, "an example, not a measurement", time_s=1e-3, exponent=0.3
        )
    ),
)
```'''


def waves_of(material: Material) -> list[Waves]:
    return [describe(material, f) for f in BAND_HZ]


def draw_presets() -> Figure:
    figure = Figure(figsize=(13.0, 4.4), layout="constrained")
    moduli, speed, length = figure.subplots(1, 3)
    for colour, (name, entry) in zip(cycle(SHADES), CATALOGUE.items(), strict=False):
        waves = waves_of(entry.material)
        shear = np.array([wave.shear_Pa for wave in waves])
        moduli.loglog(BAND_HZ, shear.real / 1e3, color=colour, label=name)
        moduli.loglog(BAND_HZ, -shear.imag / 1e3, color=colour, linestyle=":")
        speed.semilogx(BAND_HZ, [wave.rayleigh_speed_m_s for wave in waves], color=colour)
        length.loglog(BAND_HZ, [wave.rayleigh_length_m * 1e3 for wave in waves], color=colour)
        for one in observations(entry):
            if one.quantity == "surface speed" and name != "finger_pad":
                speed.errorbar(one.f_Hz, one.value, yerr=one.spread, color=colour, marker="o", markersize=4, capsize=3)
    moduli.set_ylim(0.2, 200.0)
    moduli.set_title("storage (line) and loss modulus (dots)")
    moduli.set_ylabel("[kPa]")
    figure.legend(loc="outside right upper")
    speed.set_ylim(0.0, 9.0)
    speed.set_title("surface wave; circles: aims")
    speed.set_ylabel("phase speed [m/s]")
    length.set_ylim(1.0, 1e4)
    length.set_title("surface wave falls to 1/e within")
    length.set_ylabel("[mm]")
    for axes in (moduli, speed, length):
        axes.set_xlabel("frequency [Hz]")
    return figure


def solid_of(logs: np.ndarray) -> Material:
    values = np.exp(logs)
    count = len(values) // 2
    return prony("trial", 1100.0, values[0], values[1 : 1 + count], values[1 + count :])


def trade(branches: int) -> tuple[list[float], list[float]]:
    """Return the rms misfit to the speeds and the decay of the best solids, for growing weights of the decay."""
    misfits, decays = [], []
    times = np.geomspace(2e-4, 2e-3, branches) if branches > 1 else np.array([4e-4])
    start = np.log(np.concatenate([[10e3], np.full(branches, 60e3 / branches), times]))
    low = np.log([BOUNDS[0][0]] + [1e2] * branches + [BOUNDS[0][2]] * branches)
    high = np.log([BOUNDS[1][0]] + [BOUNDS[1][1]] * branches + [BOUNDS[1][2]] * branches)
    for weight in (0.03, 0.1, 0.2, 0.35, 0.6, 1.0, 2.0, 5.0):

        def misfit(logs: np.ndarray, weight: float = weight) -> np.ndarray:
            material = solid_of(logs)
            return np.append(np.log(speeds(material) / SPEEDS), weight * np.log(decay(material) / DECAY))

        found = least_squares(misfit, np.clip(start, low + 1e-6, high - 1e-6), bounds=(low, high), max_nfev=60)
        start = found.x
        material = solid_of(found.x)
        misfits.append(100.0 * float(np.sqrt(np.mean((speeds(material) / SPEEDS - 1.0) ** 2))))
        decays.append(decay(material))
    return misfits, decays


def draw_trade() -> tuple[Figure, dict[int, tuple[list[float], list[float]]]]:
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    axes = figure.subplots()
    found = {count: trade(count) for count in (1, 3)}
    for colour, (count, (misfits, decays)) in zip(COLOURS, found.items(), strict=False):
        line = "-o" if count == 1 else "--"
        axes.semilogy(misfits, decays, line, color=colour, markersize=4, label=f"best of {count} branch(es)")
    for name, marker in (("palm", "s"), ("finger_pad", "D")):
        material = PRESETS[name]
        misfit = 100.0 * float(np.sqrt(np.mean((speeds(material) / SPEEDS - 1.0) ** 2)))
        axes.semilogy(misfit, decay(material), marker, color=COLOURS[2], markersize=8, fillstyle="none", label=name)
    axes.axhspan(0.067, 0.102, color="#e5e7eb", label="measured: distance to the power -1.1 to -1.3")
    axes.set_xlim(left=0.0)
    axes.set_xlabel("rms misfit to surface speeds 3.6, 4.6, 6.0, 7.1 m/s at 50 to 400 Hz [%]")
    axes.set_ylabel("u(40 mm) / u(5 mm) at 200 Hz")
    axes.set_title("surface speeds against decay with distance")
    axes.legend(loc="lower right")
    return figure, found


def law(f: np.ndarray) -> np.ndarray:
    return fractional_kelvin_voigt(f, 1e3, 3e3, EXPONENT)


def draw_fractional() -> tuple[Figure, list[tuple[int, float, float]]]:
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    tangent, misfit = figure.subplots(1, 2)
    f = np.geomspace(1.0, 1000.0, 121)
    rows = []
    for count in (1, 2, 3, 4, 5, 6, 8):
        material, fit = fractional("x", 1000.0, law, (1.0, 1000.0), count)
        rows.append((count, fit.storage_misfit, fit.loss_misfit))
        if count in (1, 2, 4):
            shear = np.array([complex_shear(material, x) for x in f])
            colour = COLOURS[(1, 2, 4).index(count)]
            tangent.semilogx(f, -shear.imag / shear.real, color=colour, label=f"{count} branch(es)")
    shear = law(f)
    tangent.semilogx(f, -shear.imag / shear.real, "--", color="black", label="fractional law")
    tangent.set_title("loss tangent of a fractional Kelvin-Voigt solid")
    tangent.set_xlabel("frequency [Hz]")
    tangent.legend()
    misfit.semilogy([row[0] for row in rows], [100.0 * row[1] for row in rows], "-o", color=COLOURS[1], label="storage")
    misfit.semilogy([row[0] for row in rows], [100.0 * row[2] for row in rows], "-s", color=COLOURS[0], label="loss")
    misfit.set_title("rms misfit of the Prony series, 1 to 1000 Hz [%]")
    misfit.set_xlabel("branches")
    misfit.legend()
    return figure, rows


def draw_as_printed() -> Figure:
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    gel, ecoflex = figure.subplots(1, 2)
    f = np.geomspace(1.0, 10e3, 121)
    gel.semilogx(f, [abs(as_printed.sls_modulus(x, *GEL_SOLID)) / 1e3 for x in f], color="black", label="right, |E*|")
    for label, formula, colour in (
        ("eq 4 as printed", as_printed.equivalent_modulus_as_printed, COLOURS[0]),
        ("eq 5 as printed, |E*|", lambda *values: abs(as_printed.law_as_printed(*values)), COLOURS[1]),
        ("eq 6 as printed", as_printed.vibration_modulus_as_printed, COLOURS[2]),
    ):
        gel.semilogx(f, [formula(x, *GEL_SOLID) / 1e3 for x in f], color=colour, label=label)
    gel.set_title("standard linear solid of Mizushima & Sato")
    gel.set_ylabel("stress over strain [kPa]")
    gel.set_ylim(bottom=0.0)
    right, printed = PRESETS["ecoflex_00-10"], ecoflex_time_as_printed()
    for label, loss, colour in (
        ("right, tau 171 us", [-complex_shear(right, x).imag for x in f], "black"),
        ("tau 0.171 us as printed", [-complex_shear(printed, x).imag for x in f], COLOURS[0]),
        ("rate law, mixed", [-ecoflex_rate_law_mixed(x).imag for x in f], COLOURS[1]),
    ):
        ecoflex.loglog(f, np.array(loss) / 1e3, color=colour, label=label)
    ecoflex.set_title("loss modulus of Chilles et al.'s Ecoflex")
    ecoflex.set_ylabel("[kPa]")
    for axes in (gel, ecoflex):
        axes.set_xlabel("frequency [Hz]")
        axes.legend()
    return figure


def draw_large() -> Figure:
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    stretch_axes, relax_axes = figure.subplots(1, 2)
    material = elastic("e", 1000.0, 1e4)
    shear, bulk = material.shear_relaxed_Pa, material.bulk_Pa
    stretches = np.linspace(0.5, 2.0, 61)
    F = np.stack([np.diag([x, x**-0.5, x**-0.5]) for x in stretches])
    P = piola(F, shear, bulk)
    free = P[:, 0, 0] - P[:, 1, 1] * F[:, 1, 1] / stretches
    stretch_axes.plot(stretches, free / shear, color=COLOURS[0], label="stretched, neo-Hookean")
    stretch_axes.plot(stretches, 3.0 * (stretches - 1.0), "--", color=COLOURS[0], label="stretched, linear")
    stretch_axes.set_xlabel("stretch")
    stretch_axes.set_ylabel("first Piola stress over G")
    stretch_axes.set_title("finite strain, constant volume")
    stretch_axes.legend()
    soft = standard_linear("s", 1000.0, 1e4, 2e4, 1e-3)
    step_s = 2e-5
    times = step_s * np.arange(1, 301)
    for colour, amount in zip(COLOURS, (0.01, 0.5, 1.5), strict=True):
        F_held = np.eye(3)
        F_held[0, 1] = amount
        memory = at_rest(soft, ())
        stress = []
        for _ in times:
            P_now, memory = advance(soft, memory, F_held, np.zeros((3, 3)), step_s)
            stress.append(P_now[0, 1] / amount / soft.shear_relaxed_Pa)
        relax_axes.plot(times * 1e3, stress, color=colour, label=f"shear {amount}")
    relax_axes.plot(times * 1e3, 1.0 + 2.0 * np.exp(-times / 1e-3), ":", color="black", label="linear law")
    relax_axes.set_xlabel("time since the shear [ms]")
    relax_axes.set_ylabel("stress over G_r and shear")
    relax_axes.set_title("relaxation, G_1 = 2 G_r, tau 1 ms")
    relax_axes.legend()
    return figure


def incompressible_rows() -> list[str]:
    material = standard_linear("s", 1030.0, 12.5e3, 20e3, 171e-6, 0.5)
    stiffer = replace(material, bulk_Pa=100.0 * material.bulk_Pa)
    lines = ["| layer | spot 6 mm | spot 10.3 mm | spot 20 mm |", "|---|---|---|---|"]
    for depth in (0.0005, 0.001, 0.002, 0.005, 0.02):
        cells = []
        for width in (0.006, 0.0103, 0.02):
            errors = []
            for f in (0.0, 100.0, 200.0, 400.0):
                near, limit = (centre_response(f, m, depth, width, at=[0.0, 0.005, 0.01]) for m in (material, stiffer))
                errors.append(np.abs(near - limit).max() / np.abs(limit).max())
            cells.append(f"{max(errors):.0e}")
        lines.append(f"| {depth * 1e3:g} mm | {' | '.join(cells)} |")
    return lines


def preset_rows() -> list[str]:
    lines = [
        "| preset | rho [kg/m^3] | G_r [kPa] | branches G_i [kPa] at tau_i [ms] | eta [Pa s] | K [MPa] | "
        "200 Hz: G', G'' [kPa] | shear wave [m/s], 1/e [mm] | surface wave [m/s], 1/e [mm] |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, material in PRESETS.items():
        waves = describe(material, 200.0)
        branches = ", ".join(f"{b.shear_Pa / 1e3:.4g} at {b.time_s * 1e3:.3g}" for b in material.series) or "-"
        lines.append(
            f"| {name} | {material.density_kg_m3:g} | {material.shear_relaxed_Pa / 1e3:.4g} | {branches} | "
            f"{material.viscosity_Pa_s:g} | {material.bulk_Pa / 1e6:.3g} | {waves.shear_Pa.real / 1e3:.2f}, "
            f"{-waves.shear_Pa.imag / 1e3:.2f} | {waves.shear_speed_m_s:.2f}, {waves.shear_length_m * 1e3:.0f} | "
            f"{waves.rayleigh_speed_m_s:.2f}, {waves.rayleigh_length_m * 1e3:.0f} |"
        )
    return lines


def misfit_rows() -> list[str]:
    lines = [
        "| preset | quantity | at [Hz] | aim or measurement | model | misfit | source |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, entry in CATALOGUE.items():
        if not observations(entry):
            lines.append(f"| {name} | - | - | no speed or decay measured on it is known | - | - | - |")
        for one in observations(entry):
            found = predicted(entry.material, one)
            spread = f" +- {one.spread:.3g}" if one.spread is not None else ""
            lines.append(
                f"| {name} | {one.quantity} [{UNITS[one.quantity]}] | {one.f_Hz:g} | {one.value:.4g}{spread} | "
                f"{found:.4g} | {100 * (found / one.value - 1):+.1f} % | {one.source} |"
            )
    return lines


def range_rows() -> list[str]:
    lines = [
        "| preset | parameter | from | to | surface wave at 200 Hz [m/s], 1/e [mm] | what the range is |",
        "|---|---|---|---|---|---|",
    ]
    for name, entry in CATALOGUE.items():
        if not entry.ranges:
            lines.append(f"| {name} | - | - | - | - | not known; see its misfit |")
        ends = [describe(material, 200.0) for material in varied(entry)]
        waves = [f"{end.rayleigh_speed_m_s:.2f}, {end.rayleigh_length_m * 1e3:.0f}" for end in ends]
        for i, known in enumerate(entry.ranges):
            unit = "factor on all shear moduli" if known.parameter == "shear" else f"`{known.parameter}`"
            lines.append(
                f"| {name} | {unit} | {known.low:g} | {known.high:g} | "
                f"{waves[2 * i]} to {waves[2 * i + 1]} | {known.source} |"
            )
    return lines


def skin_rows() -> list[str]:
    lines = [
        "| layer | E relaxed [kPa] | rho [kg/m^3] | palm [mm] | finger pad [mm] | source |",
        "|---|---|---|---|---|---|",
    ]
    thickness = {site: [sheet.thickness_m * 1e3 for sheet in hand_skin(site)] for site in DEPTH_M}
    for i, tissue in enumerate(TISSUES):
        lines.append(
            f"| {tissue.name} | {tissue.young_Pa / 1e3:g} | {tissue.density_kg_m3:g} | {thickness['palm'][i]:.2f} | "
            f"{thickness['finger_pad'][i]:.2f} | {tissue.source} |"
        )
    return lines


def write(name: str, figure: Figure) -> None:
    path = FOLDER / f"{name}.png"
    save(figure, path, dpi=130)
    shown = Image.open(path).convert("RGB")
    shown.quantize(128, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"{path.relative_to(ROOT)}: {path.stat().st_size / 1000:.0f} kB")


def described() -> dict[str, list[str]]:
    """Return the names of presets by their source; those that differ only in Asker hardness are together."""
    found: dict[str, list[str]] = {}
    for name, material in PRESETS.items():
        found.setdefault(re.sub(r", Asker C \d+", " (the name has its Asker C hardness)", material.source), []).append(
            name
        )
    return found


def page(traded: dict[int, tuple[list[float], list[float]]], fits: list[tuple[int, float, float]]) -> str:
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()
    closest = {count: min(m for m, d in zip(*pair, strict=True) if d > 0.067) for count, pair in traded.items()}
    sources = "\n".join(
        f"- {', '.join(f'**{name}**' for name in names)}: {text}." for text, names in described().items()
    )
    misfits = "; ".join(
        f"{n} {'branch' if n == 1 else 'branches'} {100 * s:.2g} % storage, {100 * lo:.2g} % loss" for n, s, lo in fits
    )
    blocks = [
        "# Skin materials",
        f"For everyone who chooses a skin material. Made by `python scripts/draw_materials.py`, commit {commit}; do "
        "not edit. [Skin mechanics](concepts/skin_mechanics.md#relaxation-laws) explains the symbols.",
        EXAMPLE,
        "## Presets",
        "\n".join(preset_rows()),
        sources,
        "![presets](images/materials/presets.png)",
        f"{keep_rows(PAGE, misfit_rows(), 'material_misfit')} has the misfit of each preset to published speeds and "
        f"decays, and {keep_rows(PAGE, range_rows(), 'material_ranges')} the range of its moduli; both name their "
        "sources. A range is used for the band of the material in the error budget.",
        "### Speed against decay",
        "In every causal material, dispersion and loss are linked. If the speed of a surface wave rises from 50 to "
        "400 Hz as on the finger pad, the wave must decay quickly. No preset can have both the measured speeds and "
        "the measured decay. Solids with 1 and with 3 branches whose decay lies in the measured band miss the "
        f"speeds by at least {closest[1]:.0f} and {closest[3]:.0f} % rms. So `palm`, the default, has the measured "
        "decay, and `finger_pad` the measured speeds. Layered skin, or a finger that moves as a whole, may have both.",
        "![speed against decay](images/materials/speed_decay.png)",
        "## Layered skin",
        "\n".join(skin_rows()),
        "We assume that each layer relaxes like the preset of its site, by the same share of its modulus. "
        "Thicknesses and moduli come from models. Thicknesses vary by about a third, and moduli by a factor of 2.",
        "## nu = 0.5",
        "For Poisson's ratio 0.5, constructors use the bulk modulus K = 1e6 G. The table has the largest relative "
        "change of the motion with K = 1e8 G instead, by the exact series for a bonded layer, 0 to 10 mm from the "
        "axis of a spot and at 0 to 400 Hz:",
        "\n".join(incompressible_rows()),
        "## Fractional laws",
        "A fractional Kelvin-Voigt or Zener law is approximated by a Prony series over a band. These are the rms "
        f"errors for exponent {EXPONENT} over three decades: {misfits}.",
        "![fractional](images/materials/fractional.png)",
        "## A law of your own",
        "To add a law G(s) that is not a Prony series, write one file, `law_NAME.py` in "
        "`palmfield/skin/materials/`. It defines a subclass of `Material` with two methods: `stiffening` (G(s)/G_r, "
        "1 at rest) and `series` (branches for time stepping). Parameters are times and ratios to G_r. Scenes find "
        "its `PRESETS` by name. Harmonic solutions use G(s). Steppers and reduced models use the series, and stated "
        "errors include its difference from G(s), rms over 5 to 1000 Hz.",
        LAW,
        "## Finite strain",
        "Solver `particles` uses a compressible neo-Hookean law with the branches of the material. The law is "
        "linear at small strain and in simple shear.",
        "![finite strain](images/materials/finite_strain.png)",
        "## As printed",
        "Two papers print formulas with errors. `palmfield_papers` has these formulas and the correct ones, in "
        "`mizushima2024.as_printed` and `chilles2019.ecoflex`. The parameters of the gel are not printed; the "
        f"picture uses E1 {GEL_SOLID[0]:g}, E2 {GEL_SOLID[1]:g} Pa, eta3 {GEL_SOLID[2]:g} Pa s.",
        "![as printed](images/materials/as_printed.png)",
    ]
    return "\n\n".join(blocks) + "\n"


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    with style():
        write("presets", draw_presets())
        trade_figure, traded = draw_trade()
        write("speed_decay", trade_figure)
        fractional_figure, fits = draw_fractional()
        write("fractional", fractional_figure)
        write("as_printed", draw_as_printed())
        write("finite_strain", draw_large())
    PAGE.write_text(page(traded, fits), encoding="utf-8")


if __name__ == "__main__":
    main()
