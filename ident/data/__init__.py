"""Measured data: logs to records, every sensor at its own sample times, inputs with their hold."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
