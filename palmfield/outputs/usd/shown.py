"""What a USD scene of a run contains."""

from dataclasses import dataclass

from palmfield.errors import OutputError, refuse_unknown
from palmfield.outputs.usd.quantities import QUANTITIES

FIELD_SHAPES = "slice", "points", "isosurface"
NO_COLOUR = "none"
MOST_FRAMES = 600


@dataclass(frozen=True)
class Shown:
    """Contents of a USD scene of a run.

    colour: quantity of the colours of skins, of `palmfield.outputs.usd.quantities.QUANTITIES`, or "none"
    limits: limits of the colours, in the SI unit of the quantity; None for the range of the run, symmetric for signed
        quantities
    magnify: factor of the motion in the variant "magnified"; None: the largest motion appears as about 2 mm, if its
        points take 8 MB or less; 0: no such variant
    quantities: quantities that are written as primvars, None for all quantities of the result
    start_s, end_s: part of the run [s], None for its ends; frames: largest number of time codes
    field: shapes of the sound field, of FIELD_SHAPES; field_times_s: their times [s], () for the loudest time
    level_Pa: level of the isosurface and lower limit of points, peak amplitude [Pa];
        None for half of the maximum around the foci
    observer: observer of the level above threshold
    """

    colour: str = "normal_displacement"
    limits: tuple[float, float] | None = None
    magnify: float | None = None
    quantities: tuple[str, ...] | None = None
    start_s: float | None = None
    end_s: float | None = None
    frames: int = MOST_FRAMES
    field: tuple[str, ...] = ()
    field_times_s: tuple[float, ...] = ()
    level_Pa: float | None = None
    observer: str = "bolanowski_1988"


def check_shown(shown: Shown) -> None:
    """Raise OutputError for options that are invalid for every run."""
    refuse_unknown(OutputError, "colour has value {}", shown.colour, [*QUANTITIES, NO_COLOUR])
    for name in shown.quantities or ():
        refuse_unknown(OutputError, "quantities has value {}", name, QUANTITIES)
    for name in shown.field:
        refuse_unknown(OutputError, "field has value {}", name, FIELD_SHAPES)
    if shown.limits is not None and not -float("inf") < shown.limits[0] < shown.limits[1] < float("inf"):
        raise OutputError(f"limits have values {shown.limits[0]:g}, {shown.limits[1]:g}; allowed: finite and rising")
    if shown.magnify is not None and not 0.0 <= shown.magnify <= 1e9:
        raise OutputError(f"magnify has value {shown.magnify:g}; allowed: 0 (no magnified points) to 1e9")
    if not 1 <= shown.frames <= 1_000_000:
        raise OutputError(f"frames has value {shown.frames}; allowed: 1 to 1000000")
    if shown.level_Pa is not None and not 0.0 < shown.level_Pa < float("inf"):
        raise OutputError(f"level_Pa has value {shown.level_Pa:g}; allowed: above 0")
