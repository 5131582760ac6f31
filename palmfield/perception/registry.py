"""All observers in the order in which a user of mid-air haptics should read them: first the one of mid-air."""

from palmfield.perception.force_threshold import FORCE_OBSERVER, ForceObserver
from palmfield.perception.observers import OBSERVERS, Observer

ALL_OBSERVERS: dict[str, ForceObserver | Observer] = {FORCE_OBSERVER.name: FORCE_OBSERVER, **OBSERVERS}
