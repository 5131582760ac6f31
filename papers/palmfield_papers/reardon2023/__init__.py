"""Reardon et al. 2023, shear shock waves of haptic holography: every number that can be computed."""

from collections.abc import Mapping
from typing import Any

from palmfield_papers.answer import Cause, Paper
from palmfield_papers.reardon2023 import figures, given, hand, lines, phantom
from palmfield_papers.reardon2023.configuration import DEEP
from palmfield_papers.reardon2023.notes import notes
from palmfield_papers.reardon2023.pictures import PICTURES

CHANGES: Mapping[str, dict[str, Any]] = {
    "a spot of 10 mm, the array's own (row R2e), for 6 mm": {"fwhm_m": 0.01},
    "bonded below, with 1 Pa s": {"back": "bonded", "viscosity_Pa_s": 1.0},
    "a slab of 2 cm, in which waves are nearer to those of a deep body": {"thickness_m": 0.02},
}
"""Possible reasons for a claim on the slab that disagrees, each tested separately."""
FIGURE_CHANGES = dict(list(CHANGES.items())[:2])
"""Reasons tested for figures, which take longer."""
HAND_CHANGES: Mapping[str, dict[str, Any]] = {
    "almost no losses, 0.1 Pa s": {"viscosity_Pa_s": 0.1},
    "a free back": {"back": "free"},
    "a spot of 10 mm, the array's own (row R2e), for 6 mm": {"fwhm_m": 0.01},
}
"""Reasons tested for the hand."""


LATER = {
    "R6c": (Cause("shear waves of 2.5 m/s, which 3 m/s outruns too", lines.VARIED["R6c"](shear_speed_m_s=2.5)),),
    "R16-R18l": (Cause("losses of 10 Pa s in place of 1", hand.VARIED["R16-R18l"](viscosity_Pa_s=10.0)),),
    "R20d": (
        Cause(
            "a bonded slab of 2 mm, whose waves begin at the resonance of 625 Hz",
            phantom.VARIED["R20d"](back="bonded", thickness_m=0.002),
        ),
    ),
}
"""Failures that entries name. They were tested when answers were known."""


def _causes(varied: Mapping[str, Any], changes: Mapping[str, dict[str, Any]]) -> dict[str, tuple[Cause, ...]]:
    return {name: tuple(Cause(what, make(**one)) for what, one in changes.items()) for name, make in varied.items()}


PAPER = Paper(
    name="reardon2023",
    paper="Reardon 2023",
    title="Reardon et al. 2023: shear shock waves",
    about="A focus that moves over a slab of 1 cm, faster and slower than its shear waves: wakes, fronts, energies, "
    "figures, the measured gelatin plate, and the hand with the perception of direction. The solver "
    "lateral_waves computes the slab, infinite or within a smooth wall. No compared quantity depends on the pressure.",
    answers={**given.ANSWERS, **lines.ANSWERS, **figures.ANSWERS, **phantom.ANSWERS, **hand.ANSWERS},
    causes={
        **_causes(lines.VARIED | phantom.VARIED, CHANGES),
        **_causes(figures.VARIED, FIGURE_CHANGES),
        **_causes(hand.VARIED, HAND_CHANGES),
        "R12k": (
            *_causes(lines.VARIED, CHANGES)["R12k"],
            Cause(
                "compared with a focus late by half a control step, the mean delay of the hold", lines.late_rate(4200.0)
            ),
        ),
    },
    later=LATER,
    found_later=_causes(lines.VARIED | figures.VARIED, {"no reflection from below: 60 mm deep": DEEP}),
    pictures=PICTURES,
    notes=notes,
)
