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
"""FWHM of the load that fits the FEM of the paper.

It was found from answers before this gallery, so it is a hypothesis.
"""
FEM = ("C15a", "C15c", "C15d", "C19b", "C19d", "C20b", "C20d")
LABELS = ("steady", "peak", "diameter [mm]", "AM p-p", "AM rms", "STM p-p", "STM rms")
MEASURED_LABELS = ("steady", "peak", "AM p-p", "AM rms", "STM p-p", "STM rms")
SHOWN_CHAINS = 12
EARLIER_S = 0.1


def fem_numbers(case: Case) -> dict[str, float]:
    """Return the seven numbers of the FEM column under the base readings: in um, and the diameter in mm."""
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
    """Return cases for inputs that the text leaves open or prints twice. Each input is changed separately."""
    base, sound = case_of(setting), focal_sound()
    return {
        "base: 12 Pa, 10.3 mm, tau 171 µs, nu 0.495 with the relaxed modulus": base,
        f"from p0 {sound.p0_Pa_m:g} Pa m: the field of the UHEV1 presses with {sound.arp_Pa[0]:.3g} Pa and is "
        f"{1e3 * fwhm_m():.3g} mm wide": replace(base, level_Pa=float(sound.arp_Pa[0]), fwhm_m=fwhm_m()),
        "tau as printed, 0.171 µs": replace(base, material="tau_printed"),
        "nu 0.495 with the instantaneous modulus (`corrected`)": replace(base, material="bulk_corrected"),
        "both moduli 50 % lower": replace(base, material="soft"),
        "both moduli 50 % higher": replace(base, material="stiff"),
        f"**hypothesis**: load of {1e3 * WIDE_M:.3g} mm": replace(base, fwhm_m=WIDE_M),
    }


def open_inputs(setting: Setting) -> list[str]:
    values = printed()
    lines = [
        "### Inputs that the paper leaves open, compared with its FEM column", "",
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
        "The load of 14.5 mm was found from the answers. It is a hypothesis about how the paper applied the pressure "
        "to its mesh. Its agreements do not count, and no row uses it. p0 of the layout was inferred from "
        f"{LEVEL_PA:g} Pa, so the second line tests only the width of the spot.", "",
    ]  # fmt: skip


def chain_lines(setting: Setting) -> list[str]:
    found = all_explained(case_of(setting))
    best = sorted(found, key=lambda one: -len(one.within))
    whole = fully(found)
    values = printed()
    text = (
        f"{len(whole)} of {len(found)} chains have all six numbers in their tolerances"
        if whole
        else f"None of {len(found)} chains has all six numbers in their tolerances; the best have {len(best[0].within)}"
    )
    lines = [
        "### Chains from the beam to the measured column", "",
        "A chain is order and phase of the 50 Hz high-pass, a straight line subtracted from the displacement (drift), "
        "the load (12 Pa, or a gain to the peak of the step), azimuth of the head, window of rms and peak to peak. "
        f"{text}. With the gain the peak agrees by definition. The base readings are order 2, causal, no drift, "
        "0-256 ms; a chain that is picked from this table is no evidence.", "",
        "| order | phase | drift off | level | azimuth | window | " + " | ".join(MEASURED_LABELS) + " | within |",
        "|" + "---|" * (len(MEASURED_LABELS) + 7),
        "| paper | | | | | | " + " | ".join(f"{values[name]:.3g}" for name in SIX) + " | |",
    ]  # fmt: skip
    lines += [_chain_line(one) for one in best[:SHOWN_CHAINS]]
    return [*lines, "", f"The {SHOWN_CHAINS} best are shown here, all in the figure.", "", *_offset(case_of(setting))]


def _offset(case: Case) -> list[str]:
    """Describe the effect of a zero-phase filter on a record that begins at the trigger."""
    shown = []
    for order in ORDERS:
        late, early = both_ways(case, order, 0.0), both_ways(case, order, EARLIER_S)
        shown.append(f"order {order}: {late[0]:.2g} and {late[1]:.3g} µm, {early[0]:.2g} and {early[1]:.3g} µm")
    return [
        "**Hypothesis.** After a causal high-pass the steady state is 0, but not in Table I. The output of a filter "
        "that runs forward and backward begins before its input. Record and integral begin at the trigger, so the "
        "integral keeps an offset that looks like a steady state. Steady state and peak of the step at 12 Pa with a "
        f"record that begins at the trigger, and with one that begins {1e3 * EARLIER_S:g} ms before it: "
        f"{'; '.join(shown)}. This hypothesis was found from the answers and does not count.", "",
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


CHOICES = """### Choices where the file of tolerances is open

- The control `moduli_half` and the bands of 50 % scale both shear moduli and keep the bulk modulus and tau. Poisson's
  ratio is then 0.4975 or 0.4925.
- The band varies only the moduli. No row uses p0: the text gives 12 Pa, and a gain on the step replaces p0.
- "The rms at 10 mm" of C21c is the mean over the angle; the largest rms beyond 20 mm is over all angles.
- C9f agrees at an end of its range: 4 over the first term of the printed formula, 2 over a wall that absorbs all sound.
- The linear elements of C13g are the linear functions among those of the quadratic wedges, on the same mesh.
- The configuration and the records do not contain the time of flight of 0.58 ms.
- With `tau_as_printed` the slab has almost no losses: its runs have elements of degree 5 and print the error that
  remains.
- Maps contain displacements at 8 kHz. Their velocities are central differences, which have no drift after
  integration: pressure waves ring between the sides of a nearly incompressible disc at kilohertz.
"""


def notes(setting: Setting) -> str:
    base = replace(setting, readings=(), control="")
    return "\n".join([*chain_lines(base), *open_inputs(base), CHOICES])
