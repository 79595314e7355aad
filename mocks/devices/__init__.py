"""Emulated devices: samples to the bytes of each device, their faults."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
