"""Compute a scene for many values of its keys: designs, workers, one labelled dataset, pictures."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
