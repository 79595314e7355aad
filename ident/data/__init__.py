"""Conversion of logs to records: measurements at their sample times, and inputs with their hold between samples."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
