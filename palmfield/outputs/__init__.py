"""What a run leaves: result.nc (schema 2), summary.json, pictures and a USD scene.

from palmfield.outputs import instances, normal_component, open_result
with open_result("out/palm") as result:
    for name, skin in instances(result, "skin").items():
        print(name, float(abs(normal_component(skin)).max()), "m")
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palmfield.outputs.motion import normal_component
    from palmfield.outputs.schema import SCHEMA_VERSION, group, has_records, instances, tree
    from palmfield.outputs.store import MemoryStore, Store, open_result, recover

_WHERE = {
    **dict.fromkeys(("SCHEMA_VERSION", "group", "has_records", "instances", "tree"), "schema"),
    **dict.fromkeys(("MemoryStore", "Store", "open_result", "recover"), "store"),
    "normal_component": "motion",
}
__all__ = [
    "SCHEMA_VERSION",
    "MemoryStore",
    "Store",
    "group",
    "has_records",
    "instances",
    "normal_component",
    "open_result",
    "recover",
    "tree",
]


def __getattr__(name: str) -> Any:
    # Loaded when asked for: xarray, Matplotlib and USD take a second between them.
    if name not in _WHERE:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return getattr(import_module(f"{__name__}.{_WHERE[name]}"), name)
