"""Linear viscoelastic materials: named ones, fits to measurements, and the waves that they carry."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
