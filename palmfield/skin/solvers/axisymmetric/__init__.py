"""Layered discs under a spot: elements in r and z, harmonics in the angle, reduced models in time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
