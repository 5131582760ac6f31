"""Quadratic wedges below a surface, the rows and patches of which they are made, and their elimination order."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
