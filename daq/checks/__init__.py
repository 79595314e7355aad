"""Checks of the devices in a log: rates, clocks, noise, implausible values, and what an import left out."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
