"""What a run leaves: result.nc (schema 2), summary.json, pictures and a USD scene.

from palmfield.outputs import instances, normal_component, open_result
with open_result("out/palm") as result:
    for name, skin in instances(result, "skin").items():
        print(name, float(abs(normal_component(skin)).max()), "m")
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.outputs.motion import normal_component
    from palmfield.outputs.schema import SCHEMA_VERSION, group, has_records, instances, tree
    from palmfield.outputs.store import MemoryStore, Store, open_result, recover

_WHERE = {
    "normal_component": "motion",
    **dict.fromkeys(("SCHEMA_VERSION", "group", "has_records", "instances", "tree"), "schema"),
    **dict.fromkeys(("MemoryStore", "Store", "open_result", "recover"), "store"),
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
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
