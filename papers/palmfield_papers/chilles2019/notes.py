"""Write the notes below the tables: chains, results for ambiguous inputs, hypotheses."""

from dataclasses import replace

from palmfield.metrics import peak_to_peak, rms
from palmfield_papers.answer import Setting
from palmfield_papers.chilles2019.chains import Explained, all_explained, both_ways, fully
from palmfield_papers.chilles2019.filter_rows import ORDERS, SIX
from palmfield_papers.chilles2019.maps import raw_profile, round_map
from palmfield_papers.chilles2019.setup import LEVEL_PA, Case, Stimulus, case_of
from palmfield_papers.chilles2019.sound_rows import focal_sound, fwhm_m
from palmfield_papers.chilles2019.step_rows import diameter_of, peak_of, steady_of
from palmfield_papers.chilles2019.traces import raw
from palmfield_papers.entries import book
from palmfield_papers.verdicts import distance_in_tolerances

WIDE_M = 0.01446
"""FWHM of the load that fits the FEM of the paper. It was found from answers before this gallery: a hypothesis."""
FEM = ("C15a", "C15c", "C15d", "C19b", "C19d", "C20b", "C20d")
LABELS = ("steady", "peak", "diameter [mm]", "AM p-p", "AM rms", "STM p-p", "STM rms")
MEASURED_LABELS = ("steady", "peak", "AM p-p", "AM rms", "STM p-p", "STM rms")
SHOWN_CHAINS = 12
EARLIER_S = 0.1


def fem_numbers(case: Case) -> dict[str, float]:
    """Return the seven numbers of the FEM column under the base readings, in um, the diameter in mm."""
    step = raw(case, "step")
    diameter = diameter_of(round_map(*raw_profile(case, "step", "rms of the displacement")))
    found = {"C15a": steady_of(step), "C15c": peak_of(step), "C15d": diameter}
    stimuli: tuple[tuple[Stimulus, str, str], ...] = (("am_load", "C19b", "C19d"), ("stm", "C20b", "C20d"))
    for stimulus, size, mean in stimuli:
        trace = raw(case, stimulus)
        found[size], found[mean] = (number(trace.times_s, trace.values) for number in (peak_to_peak, rms))
    return found


def printed() -> dict[str, float]:
    return {entry.id: float(str(entry.value)) for entry in book().entries if entry.id in (*FEM, *SIX)}


def _within(found: dict[str, float]) -> int:
    entries = {entry.id: entry.tolerance for entry in book().entries if entry.id in FEM}
    values = printed()
    return sum(
        distance_in_tolerances(value, values[name], entries[name].kind, entries[name].value) >= 0.0
        for name, value in found.items()
    )


def cases(setting: Setting) -> dict[str, Case]:
    """Return cases for inputs that the text leaves open or prints twice, each changed separately."""
    base, sound = case_of(setting), focal_sound()
    return {
        "base: 12 Pa, 10.3 mm, tau 171 µs, nu 0.495 beside the relaxed modulus": base,
        f"from p0 {sound.p0_Pa_m:g} Pa m: the field of the UHEV1 presses with {sound.arp_Pa[0]:.3g} Pa and is "
        f"{1e3 * fwhm_m():.3g} mm wide": replace(base, level_Pa=float(sound.arp_Pa[0]), fwhm_m=fwhm_m()),
        "tau as printed, 0.171 µs": replace(base, material="tau_printed"),
        "nu 0.495 beside the modulus at once (`corrected`)": replace(base, material="bulk_corrected"),
        "both moduli 50 % lower": replace(base, material="soft"),
        "both moduli 50 % higher": replace(base, material="stiff"),
        f"**hypothesis**: load of {1e3 * WIDE_M:.3g} mm": replace(base, fwhm_m=WIDE_M),
    }


def open_inputs(setting: Setting) -> list[str]:
    values = printed()
    lines = [
        "### What the paper leaves open, against its FEM column", "",
        "Raw motion in µm, sides fixed, pure step, windows of 0-200 ms. The last column counts numbers within 25 %, of "
        f"{len(FEM)}.", "",
        "| run | " + " | ".join(LABELS) + " | within |", "|" + "---|" * (len(LABELS) + 2),
        "| paper's FEM | " + " | ".join(f"{values[name]:.3g}" for name in FEM) + " | |",
    ]  # fmt: skip
    for name, case in cases(setting).items():
        found = fem_numbers(case)
        lines.append(f"| {name} | " + " | ".join(f"{found[one]:.3g}" for one in FEM) + f" | {_within(found)} |")
    return [
        *lines, "",
        "The load of 14.5 mm was found by looking at answers. It is a hypothesis about how the pressure was put on the "
        "paper's mesh: none of its agreements counts, and no row uses it. p0 of the layout was itself inferred from "
        f"{LEVEL_PA:g} Pa, so that the second line tests the width of the spot alone.", "",
    ]  # fmt: skip


def chain_lines(setting: Setting) -> list[str]:
    found = all_explained(case_of(setting))
    best = sorted(found, key=lambda one: -len(one.within))
    whole = fully(found)
    values = printed()
    text = (
        f"{len(whole)} of {len(found)} chains bring all six within their tolerances"
        if whole
        else f"None of {len(found)} chains brings all six within its tolerance; the best bring {len(best[0].within)}"
    )
    lines = [
        "### Chains from the beam to the measured column", "",
        "Order and phase of the 50 Hz high-pass, a straight line taken off the displacement (drift), the load at "
        "12 Pa or with the gain of the step's peak, azimuth of the head, window of rms and peak to peak. "
        f"{text}. With the gain the peak agrees by itself. The base readings are order 2, causal, no drift, 0-256 ms; "
        "a chain that is picked from this table counts for nothing.", "",
        "| order | phase | drift off | level | azimuth | window | " + " | ".join(MEASURED_LABELS) + " | within |",
        "|" + "---|" * (len(MEASURED_LABELS) + 7),
        "| paper | | | | | | " + " | ".join(f"{values[name]:.3g}" for name in SIX) + " | |",
    ]  # fmt: skip
    lines += [_chain_line(one) for one in best[:SHOWN_CHAINS]]
    return [*lines, "", f"The {SHOWN_CHAINS} best are shown, the figure has all.", "", *_offset(case_of(setting))]


def _offset(case: Case) -> list[str]:
    """Describe the effect of a zero-phase filter on a record that begins at the trigger."""
    shown = []
    for order in ORDERS:
        late, early = both_ways(case, order, 0.0), both_ways(case, order, EARLIER_S)
        shown.append(f"order {order}: {late[0]:.2g} and {late[1]:.3g} µm, {early[0]:.2g} and {early[1]:.3g} µm")
    return [
        "**Hypothesis.** No causal high-pass leaves a steady state, and Table I prints one. A filter that runs forward "
        "and backward moves before its cause. The record begins at the trigger, and so does the integral, which then "
        "keeps an offset that looks like a steady state. Steady state and peak of the step at 12 Pa with a record that "
        f"begins at the trigger, and with one that begins {1e3 * EARLIER_S:g} ms before it: {'; '.join(shown)}. It was "
        "found by looking at the answers, and counts for nothing.", "",
    ]  # fmt: skip


def _chain_line(one: Explained) -> str:
    chain = one.chain
    order = "none" if chain.order == 0 else str(chain.order)
    phase = "" if chain.order == 0 else chain.phase.replace("_", " ")
    numbers = " | ".join(f"{one.numbers[name]:.3g}" for name in SIX)
    return (
        f"| {order} | {phase} | {'yes' if chain.drift else 'no'} | {'gain' if chain.gain else '12 Pa'} | "
        f"{chain.azimuth_deg:g}° | {chain.window} | {numbers} | {len(one.within)} |"
    )


CHOICES = """### Choices that the file of tolerances leaves

- The control `moduli_half` and the bands of 50 % scale both shear moduli and keep the bulk modulus and tau. Poisson's
  ratio is then 0.4975 or 0.4925.
- The band is of the moduli alone. p0 enters no row: the text gives 12 Pa, and a gain on the step takes its place.
- C21c takes the mean over the angle as "the rms at 10 mm"; the largest rms beyond 20 mm is over all angles.
- C9f holds at its very end: 4 over the first term of the printed formula, 2 over a wall that takes all sound in.
- C13g's linear elements are the linear fields among those of the quadratic wedges, on the same mesh.
- The flight of 0.58 ms is not in the configuration and not in the records.
- Under `tau_as_printed` the slab has next to no losses: its runs have elements of degree 5 and state the error that
  this leaves.
- Maps hold displacements at 8 kHz. Their velocities are central differences, which don't drift when they are
  integrated: pressure waves ring between the sides of a nearly incompressible disc at kilohertz.
"""


def notes(setting: Setting) -> str:
    base = replace(setting, readings=(), control="")
    return "\n".join([*chain_lines(base), *open_inputs(base), CHOICES])
