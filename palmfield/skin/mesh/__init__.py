"""Quadratic wedges below a surface, the rows and patches that they are made from, and an order to eliminate them in."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
