"""Reduced models of a body, exact in time: the Krylov space grows until the target accuracy is reached."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
