"""Numerical methods for any field: signal processing, autocorrelation, linear algebra, rotations, pattern search."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
