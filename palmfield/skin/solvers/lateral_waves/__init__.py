"""Slabs by lateral waves: modes in depth for each wavenumber, exact in time; the reference for the other solvers."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
