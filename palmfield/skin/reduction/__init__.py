"""Small models of a body: a Krylov space grown until they are right, exact in time."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
