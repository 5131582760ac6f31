"""A scene that runs while one looks at it in the browser, and turns its keys."""

from typing import TYPE_CHECKING

from palmfield.lazy_names import lazy_names

if TYPE_CHECKING:
    from palmfield.studies.view.run import view

_WHERE = {"view": "run"}
__all__ = ["view"]
__getattr__, __dir__ = lazy_names(__name__, _WHERE)
