"""Emulators of the devices: the bytes that they send and answer, and their faults. Noise and systematic errors of their
samples are in sensors.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
