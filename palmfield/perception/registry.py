"""All observers in the order in which to read them; the only one measured in mid-air is first."""

from palmfield.perception.force_threshold import FORCE_OBSERVER, ForceObserver
from palmfield.perception.observers import OBSERVERS, Observer

ALL_OBSERVERS: dict[str, ForceObserver | Observer] = {FORCE_OBSERVER.name: FORCE_OBSERVER, **OBSERVERS}
