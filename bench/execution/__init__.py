"""Execution of missions: set-points in time, safety guard and operator interface. Every run ends at zero thrust."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
