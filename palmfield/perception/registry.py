"""Observers in the order in which to read them: in mid-air, of afferents, of contact."""

from palmfield.perception.force_threshold import FORCE_OBSERVER, ForceObserver
from palmfield.perception.observers import OBSERVERS, Observer
from palmfield.perception.populations import POPULATIONS, Population

ALL_OBSERVERS: dict[str, ForceObserver | Observer] = {FORCE_OBSERVER.name: FORCE_OBSERVER, **OBSERVERS}
"""Observers that need no afferents."""
READ_FIRST: dict[str, ForceObserver | Population | Observer] = {
    FORCE_OBSERVER.name: FORCE_OBSERVER,
    **POPULATIONS,
    **OBSERVERS,
}
"""All observers; populations have a level only in runs that record afferents."""
