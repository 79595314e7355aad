"""The compiled engine: extended Kalman filters, their adjoints and simulators, from CasADi graphs to machine code."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
