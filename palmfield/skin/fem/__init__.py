"""Finite elements of a skin layer: matrices, loads, readers, and the stepper of the whole layer."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
