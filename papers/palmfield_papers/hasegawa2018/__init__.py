"""Hasegawa & Shinoda 2018, Aerial vibrotactile display based on multiunit ultrasound phased array: rows H1 to H22."""

from palmfield_papers.answer import Paper
from palmfield_papers.hasegawa2018 import drive, focus, observer
from palmfield_papers.hasegawa2018.notes import notes
from palmfield_papers.hasegawa2018.pictures import PICTURES

PAPER = Paper(
    name="hasegawa2018",
    paper="Hasegawa 2018",
    title="Hasegawa & Shinoda 2018: units of an ultrasonic phased array, together",
    about="One and four units of 249 transducers: their focus at six depths, the radiation pressure that "
    "duty cycles generate for a requested one, and the thresholds of persons. Air of 20 degrees Celsius; transducers "
    "are pistons of 4.5 mm or have the table of the T4010A1; pressures are readings of a 1/8 inch microphone.",
    answers={**focus.ANSWERS, **drive.ANSWERS, **observer.ANSWERS},
    causes={**focus.CAUSES, **drive.CAUSES, **observer.CAUSES},
    later={**focus.LATER, **drive.LATER},
    found_later=focus.FOUND_LATER,
    pictures=(*PICTURES, *observer.PICTURES),
    notes=notes,
)
