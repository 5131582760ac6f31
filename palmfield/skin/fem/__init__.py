"""Finite elements of a skin layer: its matrices, loads and readers, and what steps the whole layer in time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
