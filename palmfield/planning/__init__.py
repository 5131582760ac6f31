"""What a scene needs to be modelled, what is left out, what that costs in error and time: before anything runs.

`palmfield.plan` is public there.
"""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.planning.rows import Row
    from palmfield.planning.scene_plan import Plan, warnings

_WHERE = {"Plan": "scene_plan", "Row": "rows", "warnings": "scene_plan"}
__all__ = ["Plan", "Row", "warnings"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
