"""Pictures of `palmfield plot`. Each module of this package defines the dictionary `KINDS`, its pictures by name."""

from collections.abc import Sequence
from importlib import import_module
from pkgutil import iter_modules

from palmfield.errors import OutputError
from palmfield.outputs.pictures.options import Kind, Options

_FOUND: list[tuple[str, Kind]] = [
    entry
    for module in sorted(iter_modules(__path__), key=lambda module: module.name)
    for entry in import_module(f"{__name__}.{module.name}").KINDS.items()
]
KINDS = dict(sorted(_FOUND, key=lambda entry: entry[1].place))
"""All kinds by name, ordered by `place`."""
OPTIONS = {
    "time_s": "--time",
    "places": "--place",
    "limits": "--limits",
    "skin": "--skin",
    "quantity": "--quantity",
    "observer": "--observer",
}


def check_options(kinds: Sequence[str], options: Options) -> None:
    """Raise OutputError for options that no kind uses, and for limits if the kinds have several units."""
    for name, option in OPTIONS.items():
        if getattr(options, name) != getattr(Options(), name) and not any(name in KINDS[kind].heeds for kind in kinds):
            able = [kind for kind, one in KINDS.items() if name in one.heeds]
            raise OutputError(f"{option} has no effect on {', '.join(kinds)}; allowed with: {', '.join(able)}")
    units = list(dict.fromkeys(KINDS[kind].unit for kind in kinds if KINDS[kind].unit))
    if options.limits is not None and len(units) > 1:
        raise OutputError(f"--limits would apply to several units ({', '.join(units)}); give kinds with one unit")
