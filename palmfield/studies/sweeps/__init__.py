"""One scene over many values of its keys: designs, workers, one labelled dataset, pictures."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.studies.sweeps.design import Design, Range, grid, listed, random, sobol
    from palmfield.studies.sweeps.whole_sweep import Sweep, sweep

_WHERE = {
    "Design": "design",
    "Range": "design",
    "Sweep": "run",
    "grid": "design",
    "listed": "design",
    "random": "design",
    "sobol": "design",
    "sweep": "run",
}
__all__ = ["Design", "Range", "Sweep", "grid", "listed", "random", "sobol", "sweep"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
