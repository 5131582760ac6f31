"""Mizushima & Sato 2024, Characteristics of displacement behavior of dummy skin (doi 10.18494/SAM5054)."""

from palmfield_papers.answer import Paper
from palmfield_papers.mizushima2024 import drive, field, gel
from palmfield_papers.mizushima2024.notes import notes
from palmfield_papers.mizushima2024.pictures import PICTURES

PAPER = Paper(
    name="mizushima2024",
    paper="Mizushima 2024",
    title="Mizushima & Sato 2024: two bows of ultrasonic speakers on a dummy skin",
    about="The focus of two bows of six speakers, and the displacement of gels of 1 mm under it "
    "(doi 10.18494/SAM5054). Speakers are baffled pistons in air of 23 degrees; the gel is a flat linear layer.",
    answers={**field.ANSWERS, **drive.ANSWERS, **gel.ANSWERS},
    causes={**field.CAUSES, **gel.CAUSES},
    later=field.LATER,
    pictures=PICTURES,
    notes=notes,
)
