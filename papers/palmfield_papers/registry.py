"""The papers of the gallery, by their names on the command line."""

import importlib

from palmfield.errors import SceneError, did_you_mean
from palmfield_papers.answer import Paper

TITLES = {
    "chilles2019": "Chilles 2019",
    "reardon2023": "Reardon 2023",
    "mizushima2024": "Mizushima 2024",
    "hasegawa2018": "Hasegawa 2018",
}
"""Names of the papers in the entries of tolerances.toml."""
NAMES = tuple(TITLES)


def paper(name: str) -> Paper:
    """Return the answers of a paper. Raises SceneError for an unknown name."""
    if name not in NAMES:
        raise SceneError(f"paper '{name}'{did_you_mean(name, NAMES)} is unknown; allowed: {', '.join(NAMES)}, all")
    found: Paper = importlib.import_module(f"palmfield_papers.{name}").PAPER
    return found
