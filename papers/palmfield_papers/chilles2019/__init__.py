"""Chilles et al. 2019 (doi 10.1109/WHC.2019.8816097): a vibrometer and finite elements on a silicone disc."""

from palmfield_papers.answer import Paper
from palmfield_papers.chilles2019 import (
    causes,
    filter_rows,
    medium_rows,
    mesh_rows,
    modulated_rows,
    sound_rows,
    step_rows,
)
from palmfield_papers.chilles2019.notes import notes
from palmfield_papers.chilles2019.pictures import PICTURES

PAPER = Paper(
    name="chilles2019",
    paper="Chilles 2019",
    title="Chilles et al. 2019: laser vibrometry and finite elements of a silicone disc",
    about="A focus of a UHEV1 presses on a disc of Ecoflex 00-10: constant, modulated at 200 Hz or on a circle at "
    "70 Hz. The raw motion is compared with the finite elements of the paper, the motion through a virtual vibrometer "
    "with the measurement of the paper.",
    answers={
        **medium_rows.ANSWERS,
        **sound_rows.ANSWERS,
        **mesh_rows.ANSWERS,
        **filter_rows.ANSWERS,
        **step_rows.ANSWERS,
        **modulated_rows.ANSWERS,
    },
    causes=causes.CAUSES,
    later=modulated_rows.LATER,
    pictures=PICTURES,
    notes=notes,
)
